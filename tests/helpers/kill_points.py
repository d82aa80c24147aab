"""Commands killed at every point of their work on the disk: a script, which forks a process for each point.

    python kill_points.py SHAPE FOLDER      what each point left, what the next command made of it (JSON)

It imports what writes results and nothing that fits, so that a point takes milliseconds.
"""

import contextlib
import functools
import io
import json
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

from mitsvbrdf.batch.records import Material
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.io import files, results

# a point to be killed at like the others; none of this has to outlive a power cut
os.fsync = lambda descriptor: None
CALLS = ("replace", "rename", "unlink", "rmdir", "mkdir", "link", "fsync")
FIT = dict.fromkeys(("maps/a.exr", "maps/b.exr", "look/deep/x.exr", "fit.json", "checkpoint.safetensors"),
                    "1")
REFIT = dict.fromkeys(("maps/a.exr", "maps/c.exr", "photos/00.png", "fit.json", "checkpoint.safetensors",
                       "sheet.png"), "2")
FRAMES = {"relight.json": "1", "sweep/0000.exr": "1"}
# Options of the folder, what an earlier command wrote, and what the command writes.
SHAPES = {
    "fit": ({"overwrite": True}, FIT, REFIT), "fit by renames": ({"overwrite": True}, FIT, REFIT),
    "export": ({"overwrite": True}, {"gltf/m.glb": "1", "preview.png": "1"},
               {"usd/m.usda": "2", "preview.png": "2"}),
    "relight": ({"overwrite": True, "resume": True, "keep": ("relight.json", "sweep")}, FRAMES,
                {"relight.json": "2", "sweep/0000.exr": "1", "sweep/0001.exr": "2"}),
    "capture": ({"overwrite": False}, {}, {"capture.json": "2", "target/00.png": "2"}),
    "report": ({"overwrite": False, "add": True}, FIT, {"report.html": "2", "photos/00.png": "2"}),
}


def write(folder: Path, content: dict[str, str]) -> None:
    for name, text in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def tree(out: Path) -> dict[str, str]:
    return {str(path.relative_to(out)): path.read_text() for path in sorted(out.rglob("*")) if path.is_file()}


class Fails(Exception):
    """What a command raises that comes to nothing."""


def publish(root: Path) -> None:
    """What a worker of a batch does."""
    results = ResultStore(str(root))
    with results.building("one") as made:
        write(made, {"maps/a.exr": "2", "fit.json": "2"})
        results.publish(made, Material(identity="a" * 64, name="wood"))


def after_publishing(root: Path) -> dict:
    """What a batch that starts anew finds."""
    there = ResultStore(str(root)).result("wood-aaaaaaaa") is not None
    found = tree(root / "wood-aaaaaaaa") if there else {}
    return {"reader": found, "command": found, "beside": []}


class Shape:
    """A command of :data:`SHAPES`, or ``batch``."""

    def __init__(self, name: str) -> None:
        self.batch = name == "batch"
        self.options, self.earlier, self.new = ({}, {}, {}) if self.batch else SHAPES[name]
        if "renames" in name:
            files.ctypes = SimpleNamespace(CDLL=lambda *_, **__: object())

    def prepare(self, out: Path) -> None:
        if self.earlier:
            with results.output_folder(out, overwrite=False) as folder:
                write(folder, self.earlier)

    def run(self, out: Path) -> None:
        if self.batch:
            return publish(out)
        with results.output_folder(out, **self.options) as folder:
            write(folder, self.new)

    def found(self, out: Path) -> dict:
        """What a reader finds, what a command leaves that is to replace it but comes to nothing, and what
        lies beside it after that.
        """
        if self.batch:
            return after_publishing(out)
        reader = tree(out)
        with contextlib.suppress(Fails), results.output_folder(out, overwrite=True):
            raise Fails
        beside = [path.name for path in out.parent.iterdir() if path != out]
        return {"reader": reader, "command": tree(out), "beside": beside}


def killed(shape: Shape, out: Path, point: int) -> bool:
    """Whether the process was killed before it was done: at the given call of those that change the disk."""
    child = os.fork()
    if child == 0:
        left = iter(range(point - 1, -1, -1))

        def counted(real, *words, **options):
            if not next(left, 1):
                os._exit(9)
            return real(*words, **options)

        for name in CALLS:
            setattr(os, name, functools.partial(counted, getattr(os, name)))
        files.exchange = functools.partial(counted, files.exchange)
        with contextlib.redirect_stdout(io.StringIO()):
            shape.run(out)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def main(name: str, folder: Path) -> None:
    shape, points = Shape(name), []
    while True:
        out = folder / f"{len(points)}" / "out"
        shape.prepare(out)
        before = tree(out)
        if not killed(shape, out, len(points) + 1):
            break
        points.append(shape.found(out))
        shutil.rmtree(out.parent, ignore_errors=True)
    after = tree(out / "wood-aaaaaaaa" if shape.batch else out)
    print(json.dumps({"before": before, "after": after, "points": points}))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
