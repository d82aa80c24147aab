"""A batch in which everything dies: workers, Ray's head, the command itself; then every result is counted.

    python tests/batch/chaos.py FOLDER --captures 10000 --side 16 --worker-every 20 --heads 2 --commands 3

makes captures in FOLDER/captures, fits them into FOLDER/library while it kills, and counts. With ``--quiet``
it fits them again undisturbed into FOLDER/quiet, holds every map against it, and with ``--results
docs/results`` puts the figures into batch.json. A slow test runs the same with few captures.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sqlite3
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
            str(side),
            "--workers", str(workers), *QUICKEST]


class Family:
    """The processes below one, by what they are."""

    def __init__(self, root: int) -> None:
        parents, self.words = {}, {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    status = (entry / "stat").read_text().rpartition(")")[2].split()
                    parents[int(entry.name)] = int(status[1])
                    self.words[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0",
                                                                                           b" ").decode(errors="replace")
                except OSError:
                    continue
        self.pids = {root}
        while more := {pid for pid, parent in parents.items() if parent in self.pids} - self.pids:
            self.pids |= more

    def like(self, *parts: str) -> list[int]:
        """Those whose command line has one of these parts."""
        return sorted(pid for pid in self.pids if any(part in self.words.get(pid, "") for part in parts))


def resident(pid: int) -> int:
    """Bytes of memory of a process; 0 where it is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) << 10 for line in lines if line.startswith("VmRSS"))
    except (OSError, StopIteration):
        return 0


def disturbed(start: list[str], library: Path, log: Path, *, worker_every: float, heads: int, commands: int,
              total: int, seed: int = 0) -> dict:
    """Run a batch to its end while its processes are killed; what was killed, and the memory of the command
    over time.
    """
    rng, killed, memory, runs = random.Random(seed), Counter[str](), [], 0
    # Deaths of the head and of the command, by how much is done.
    plan = [("head", share) for share in np.linspace(0.2, 0.7, heads)]
    plan = sorted(plan + [("command", share) for share in np.linspace(0.1, 0.8, commands)],
                  key=lambda each: each[1])
    began = time.monotonic()
    with log.open("ab") as words:
        while True:
            runs += 1
            batch = subprocess.Popen(start, stdout=words, stderr=words)
            due = time.monotonic() + worker_every
            while batch.poll() is None:
                time.sleep(0.25)
                done = done_in(library)
                memory.append((round(time.monotonic() - began, 1), runs, done, resident(batch.pid),
                               sum(map(resident, Family(batch.pid).like("batch.gateway")))))
                if plan and done >= plan[0][1] * total:
                    what = plan.pop(0)[0]
                    family = Family(batch.pid)
                    targets = [batch.pid] if what == "command" else family.like("gcs_server", "raylet/raylet")
                    if not targets:
                        plan.insert(0, (what, 0.0))
                        continue
                    os.kill(rng.choice(targets), signal.SIGKILL)
                    killed[what] += 1
                elif time.monotonic() > due:
                    due += worker_every
                    if targets := Family(batch.pid).like("batch.child", "ray::Worker"):
                        victim = rng.choice(targets)
                        os.kill(victim, signal.SIGKILL)
                        killed["worker"] += 1
            if batch.returncode != -signal.SIGKILL:
                return {"exit": batch.returncode, "runs": runs, "killed": dict(killed), "memory": memory,
                        "seconds": round(time.monotonic() - began, 1)}


def done_in(library: Path) -> int:
    """How many the manifest has as done."""
    try:
        with sqlite3.connect(f"file:{library}/manifest.sqlite?mode=ro", uri=True, timeout=5) as db:
            return db.execute("select count(*) from materials where state = 'done'").fetchone()[0]
    except sqlite3.Error:
        return 0


def counted(library: Path) -> dict:
    """What lies in a library, by its manifest and by its files."""
    db = sqlite3.connect(library / "manifest.sqlite")
    published = Counter(row[0] for row in db.execute("select published from materials where state = 'done'"))
    found = Counter[str]()
    for folder in library.iterdir():
        if folder.is_dir() and folder.name not in (".work", "quarantine"):
            record = json.loads((folder / "batch.json").read_text())
            torn = [name for name, stated in record["files"].items()
                    if file_hash(folder / name) != stated["sha256"]]
            extra = ({str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
                     - {*record["files"], "batch.json"})
            found["folders"] += 1
            found["torn"] += bool(torn or extra)
            found["of the attempt that the manifest names"] += published[record["attempt"]]
            found[f"identity {record['identity']}"] += 1
    identities = [count for name, count in found.items() if name.startswith("identity ")]
    return {
        "folders": found["folders"], "identities": len(identities),
        "twice": sum(count > 1 for count in identities),
        "torn": found["torn"], "same attempt": found["of the attempt that the manifest names"],
        "states": dict(db.execute("select state, count(*) from materials group by state")),
        "published": len(published), "published twice": sum(count > 1 for count in published.values()),
        "attempts": dict(db.execute("select state, count(*) from attempts group by state")),
        "done twice": db.execute("select count(*) from (select identity from attempts where state = 'done' "
                                 "group by identity "
                                 "having count(*) > 1)").fetchone()[0],
        "left over": sorted(p.name for p in (library / ".work").iterdir()) if (library / ".work").is_dir()
        else []}


def different_maps(one: Path, other: Path) -> list[str]:
    """Maps of a library that are not the same to the byte in another one, or are missing there."""
    return [str(path.relative_to(one)) for path in sorted(one.glob("*/maps/*"))
            if not (twin := other / path.relative_to(one)).is_file()
            or path.read_bytes() != twin.read_bytes()]


def write_results(folder: Path, out: Path, captures: int, side: int) -> None:
    """Put the figures of both runs into ``batch.json``, memory thinned to some two hundred moments;
    ``python docs/results/batch.py`` makes the page.
    """
    noisy, quiet = (json.loads((folder / f"{name}.json").read_text()) for name in ("library", "quiet"))
    noisy["memory"], quiet["memory"] = noisy["memory"][::max(1, len(noisy["memory"]) // 200)], []
    file = out / "batch.json"
    chaos = {"captures": captures, "side": side, "disturbed": noisy, "undisturbed": quiet}
    file.write_text(json.dumps(json.loads(file.read_text()) | {"chaos": chaos}))


def main() -> None:
    """See the module."""
    words = argparse.ArgumentParser()
    words.add_argument("folder", type=Path)
    words.add_argument("--captures", type=int, default=10_000)
    words.add_argument("--side", type=int, default=16)
    words.add_argument("--workers", type=int, default=2)
    words.add_argument("--worker-every", type=float, default=20.0)
    words.add_argument("--heads", type=int, default=2)
    words.add_argument("--commands", type=int, default=3)
    words.add_argument("--quiet", action="store_true")
    words.add_argument("--results", type=Path)
    asked = words.parse_args()
    torch.set_num_threads(1)
    captures, library = asked.folder / "captures", asked.folder / ("quiet" if asked.quiet else "library")
    make_captures(captures, asked.captures, asked.side)
    start = command(captures, library, asked.side, asked.workers)
    quiet = {"worker_every": 1e9, "heads": 0, "commands": 0}
    noisy = {"worker_every": asked.worker_every, "heads": asked.heads, "commands": asked.commands}
    found = disturbed(start, library, asked.folder / f"{library.name}.log", total=asked.captures,
                      **(quiet if asked.quiet else noisy))
    found |= counted(library)
    if asked.quiet:
        found["different maps"] = different_maps(library, asked.folder / "library")
        found["maps"] = len(list(library.glob("*/maps/*")))
    (asked.folder / f"{library.name}.json").write_text(json.dumps(found, indent=1))
    print({name: value for name, value in found.items() if name != "memory"})
    if asked.results and asked.quiet:
        write_results(asked.folder, asked.results, asked.captures, asked.side)


if __name__ == "__main__":
    main()
