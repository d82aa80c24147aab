"""Commands killed at every point of their work on the disk: a script, which forks a process for each point.

    python kill_points.py SHAPE FOLDER      what each point left, and what the next command made of it, as
    JSON

It imports what writes results and nothing that fits, so that a point takes milliseconds.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import shutil
import sys
from pathlib import Path

from mitsvbrdf.batch.places.place import RECORD, LocalPlace
from mitsvbrdf.io import files, result_folder

# a point to be killed at like the others; none of this has to outlive a power cut
os.fsync = lambda descriptor: None
CALLS = ("replace", "rename", "unlink", "rmdir", "mkdir", "fsync")
AMID = 45  # of the points of ``fit``
FOREIGN = {"thesis.txt": "mine", "maps/mine.psd": "mine", "sheet.png": "mine"}
FIT = dict.fromkeys(("maps/a.exr", "maps/b.exr", "look/deep/x.exr", "fit.json", "checkpoint.safetensors"),
                    "1")
FAILED = {".partial/checkpoint.safetensors": "half"}  # of a fit that was to take the place of the other
REFIT = dict.fromkeys(("maps/a.exr", "maps/c.exr", "photos/00.png", "fit.json", "checkpoint.safetensors",
                       "sheet.png"), "2")
FRAMES = {"relight.json": "1", "sweep/0000.exr": "1"}
# Options of the folder; what lies there before: somebody else's, and of an earlier command; what the command
# writes.
SHAPES = {
    "fit": ({"overwrite": True}, FOREIGN, FIT | FAILED, REFIT),
    "export": ({"overwrite": True}, {}, {"gltf/m.glb": "1", "preview.png": "1"},
               {"usd/m.usda": "2", "preview.png": "2"}),
    "relight": ({"overwrite": True, "resume": True, "keep": ("relight.json", "sweep")}, {}, FRAMES,
                {"relight.json": "2", "sweep/0000.exr": "1", "sweep/0001.exr": "2"}),
    "capture": ({"overwrite": False}, {}, {}, {"capture.json": "2", "target/00.png": "2"}),
    "report": ({"overwrite": False, "add": True}, {"report.html": "mine"}, FIT,
               {"report.html": "2", "photos/00.png": "2"}),
}


def write(folder: Path, content: dict[str, str]) -> None:
    for name, text in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def tree(out: Path) -> dict[str, str]:
    """All files of a result."""
    return {str(path.relative_to(out)): path.read_text() for path in sorted(out.rglob("*"))
            if path.is_file() and path.relative_to(out).parts[0] != ".partial"}


class Fails(Exception):
    """What a command raises that comes to nothing."""


def publish(root: Path) -> None:
    """What a worker of a batch does."""
    place = LocalPlace(root)
    staging = place.staging("one")
    write(staging, {"maps/a.exr": "2", "fit.json": "2"})
    files.write_json(staging / RECORD, {"identity": "i", "attempt": "one-1", "row": {}, "files": {}})
    place.publish(staging, "wood")


def after_publishing(root: Path) -> dict:
    """What a batch that starts anew finds."""
    there = LocalPlace(root).record("wood") is not None
    found = tree(root / "wood") if there else {}
    return {"reader": found, "command": found, "said": ""}


class Shape:
    """A command of :data:`SHAPES`, ``batch``, or ``reader``: of what ``fit`` leaves that was killed amid its
    moves.
    """

    def __init__(self, name: str) -> None:
        self.batch, self.reader = name == "batch", name == "reader"
        if self.reader:
            name = "fit"
        self.options, self.foreign, self.earlier, self.new = ({}, {}, {}, {}) if self.batch else SHAPES[name]

    def prepare(self, out: Path) -> None:
        if self.earlier:
            with result_folder.output_folder(out, overwrite=False) as folder:
                write(folder, {name: text for name, text in self.earlier.items() if not name.startswith(".")})
            write(out, {name: text for name, text in self.earlier.items() if name.startswith(".")})
        write(out, self.foreign)
        if self.reader:
            assert killed(Shape("fit"), out, AMID)

    def run(self, out: Path) -> None:
        if self.batch:
            return publish(out)
        if self.reader:
            return result_folder.settle(out)
        with result_folder.output_folder(out, **self.options) as folder:
            write(folder, self.new)

    def found(self, out: Path) -> dict:
        """What a reader finds, what it is told, and what a command leaves that replaces it or goes on but
        comes to nothing.
        """
        if self.batch:
            return after_publishing(out)
        copy = out.with_name(f"{out.name} copy")
        if out.exists():
            shutil.copytree(out, copy)
        with contextlib.suppress(Fails), contextlib.redirect_stdout(io.StringIO()), \
                result_folder.output_folder(copy, overwrite=True, resume=int(out.name) % 2 == 0):
            raise Fails
        with contextlib.redirect_stdout(io.StringIO()) as said:
            result_folder.settle(out)
        return {"reader": tree(out), "command": tree(copy), "said": said.getvalue()}


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
        with contextlib.redirect_stdout(io.StringIO()):
            shape.run(out)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def main(name: str, folder: Path) -> None:
    shape, points = Shape(name), []
    while True:
        out = folder / f"{len(points)}"
        shape.prepare(out)
        before = tree(out)
        if not killed(shape, out, len(points) + 1):
            break
        points.append({"after the kill": tree(out), **shape.found(out)})
    after = tree(out / "wood" if shape.batch else out)
    print(json.dumps({"before": before, "after": after, "points": points}))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
