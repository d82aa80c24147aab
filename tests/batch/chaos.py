"""A batch in which everything dies: workers, Ray's head, the command itself; then every result is counted.

    python tests/batch/chaos.py FOLDER --captures 1000 --side 16 --worker-every 20 --heads 0 --commands 3

makes captures in FOLDER/captures, fits them into FOLDER/library while it kills, fits them again undisturbed
into FOLDER/quiet, compares every map, and prints as JSON what it counted: "chaos" of docs/results/batch.json.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import torch

from mitsvbrdf import color, make_material
from mitsvbrdf.capture import Capture, write_capture
from mitsvbrdf.io.files import file_hash
from mitsvbrdf.material.made import MATERIALS
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.render import make_renderer
from mitsvbrdf.views import nine_view_grid

NOISE = 0.004  # of the made photos, in display values
QUICKEST = ("--guess", "min", "--iterations", "4", "--pages", "none")  # a fit of 16 px in a third of a second
HEAD = ("/gcs_server", "/raylet ")
WORKER = ("ray::fit_task", "ray::IDLE")


def make_captures(folder: Path, count: int, side: int) -> None:
    """Photos of pieces of the made materials, each tinted by its number."""
    views, renderer = nine_view_grid(), make_renderer("analytic")
    materials = {name: make_material(name, 256) for name in MATERIALS}
    for number in range(count):
        rng = np.random.default_rng(number)
        name = list(MATERIALS)[number % len(MATERIALS)]
        if (folder / f"{name}-{number:05d}" / "capture.json").is_file():
            continue
        y, x = rng.integers(0, 256 - side, 2)
        maps = {key: value[y:y + side, x:x + side].clone() for key, value in materials[name].maps.items()}
        maps["diffuse"] = maps["diffuse"] * torch.tensor(rng.uniform(0.4, 1, 3), dtype=torch.float32)
        with torch.no_grad():
            photos = color.to_display(renderer.render(SVBRDF(materials[name].bsdf, maps), views), "srgb")
        noise = torch.from_numpy(rng.normal(0, NOISE, photos.shape)).float()
        capture = Capture((photos + noise).clamp(0, 1), views, "srgb", tuple(range(9)), "given")
        write_capture(capture, folder / f"{name}-{number:05d}")


def command(captures: Path, library: Path, side: int, workers: int) -> list[str]:
    """The batch that is disturbed."""
    return [sys.executable, "-m", "mitsvbrdf", "batch", str(captures), "-o", str(library), "--resolution",
            str(side), "--workers", str(workers), *QUICKEST]


def below(root: int, *parts: str) -> list[int]:
    """The processes below one whose command line has one of these parts."""
    parents, words = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "stat").read_text().rpartition(")")[2].split()
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if status[0] != "Z":
                parents[int(entry.name)], words[int(entry.name)] = int(status[1]), line
    family = {root}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sorted(pid for pid in family if any(part in words.get(pid, "") for part in parts))


def disturbed(start: list[str], library: Path, log: Path, *, worker_every: float, heads: int, commands: int,
              total: int, seed: int = 0) -> dict:
    """Run a batch to its end while its processes are killed; what ended by that is typed again."""
    rng, killed, runs = random.Random(seed), Counter[str](), 0
    plan = [("head", share) for share in np.linspace(0.2, 0.7, heads)]  # by how much is done
    plan += [("command", share) for share in np.linspace(0.1, 0.8, commands)]
    plan.sort(key=lambda each: each[1])
    began = time.monotonic()
    with log.open("ab") as words:
        while True:
            runs, head_died = runs + 1, False
            batch = subprocess.Popen(start, stdout=words, stderr=words)
            due = time.monotonic() + worker_every
            while batch.poll() is None:
                time.sleep(0.25)
                what, targets = "", list[int]()
                if plan and not head_died and done_in(library) >= plan[0][1] * total:
                    what = plan[0][0]
                    targets = [batch.pid] if what == "command" else below(batch.pid, *HEAD)
                elif time.monotonic() > due:
                    what, targets = "worker", below(batch.pid, *WORKER)
                    due += worker_every
                if targets:
                    os.kill(rng.choice(targets), signal.SIGKILL)
                    killed[what] += 1
                    head_died = what == "head"
                    if what != "worker":
                        plan.pop(0)
            if batch.returncode != -signal.SIGKILL and not head_died:
                return {"exit": batch.returncode, "runs": runs, "killed": dict(killed),
                        "seconds": round(time.monotonic() - began, 1)}


def done_in(library: Path) -> int:
    """How many results lie there."""
    return sum(1 for _ in library.glob("*-*/batch.json"))


def counted(library: Path) -> dict:
    """What lies in a library, by its folders."""
    found, identities = Counter[str](), Counter[str]()
    for folder in library.iterdir():
        if folder.is_dir() and folder.name != "failed" and not folder.name.startswith("."):
            record = json.loads((folder / "batch.json").read_text())
            there = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
            torn = [name for name, stated in record["files"].items() if name not in there
                    or file_hash(folder / name) != stated["sha256"]]
            found["torn"] += bool(torn or there - {*record["files"], "batch.json"})
            found["attempts"] += record["attempts"]
            identities[record["identity"]] += 1
    names = [path.name for part in (".work*", "failed/*") for path in library.glob(part)]
    return {"folders": identities.total(), "identities": len(identities), "torn": found["torn"],
            "attempts": found["attempts"], "left over": names}


def different_maps(one: Path, other: Path) -> list[str]:
    """Maps of a library that are not the same to the byte in another one, or are missing there."""
    return [str(path.relative_to(one)) for path in sorted(one.glob("*/maps/*")) if not (
        twin := other / path.relative_to(one)).is_file() or path.read_bytes() != twin.read_bytes()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, usual in {"captures": 1000, "side": 16, "workers": 2, "heads": 0, "commands": 3}.items():
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--worker-every", type=float, default=20.0)
    asked = parser.parse_args()
    captures, library, quiet = (asked.folder / name for name in ("captures", "library", "quiet"))
    make_captures(captures, asked.captures, asked.side)
    start = command(captures, library, asked.side, asked.workers)
    noisy = disturbed(start, library, asked.folder / "log", worker_every=asked.worker_every,
                      heads=asked.heads, commands=asked.commands, total=asked.captures)
    began = time.monotonic()
    with (asked.folder / "quiet.log").open("ab") as words:
        subprocess.run(command(captures, quiet, asked.side, asked.workers), stdout=words, check=True)
    calm = {"seconds": round(time.monotonic() - began, 1), "different maps": different_maps(quiet, library),
            "maps": len(list(quiet.glob("*/maps/*")))}
    print(json.dumps({"captures": asked.captures, "side": asked.side, "disturbed": noisy | counted(library),
                      "undisturbed": calm | counted(quiet)}, indent=1))


if __name__ == "__main__":
    main()
