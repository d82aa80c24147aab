"""``python -m mitsvbrdf.batch.planning.ways CAPTURES -o docs/results``: a batch against a loop of the shell,
in turns.

Captures go in groups; each group is fitted in every way before the next one begins, in an order that turns,
so that a slow hour of the machine hits all. ``batch-ways.json`` has the figures after each run;
``batch-ways.md`` is written from it.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ...errors import OutputError
from ...io import files
from ...io.json_files import load
from ...io.progress import say
from ...io.provenance import machine, versions
from ...io.tool import run_tool
from ..entries import entries

OURS = (sys.executable, "-m", "mitsvbrdf")
WAYS = {"two workers, one thread each": ("--workers", "2", "--threads", "1"),
        "one worker, two threads": ("--workers", "1", "--threads", "2"), "a loop of the shell": None}
LOOK_SECONDS = 0.5
GIB = 1 << 30


def run_in_a_way(way: str, captures: Sequence[str], folder: Path, resolution: int) -> dict:
    """Fit captures once, and tell how long it took and how much memory all of its processes held together at
    most.

    Raises:
        OutputError: a command failed.
    """
    options = WAYS[way]
    commands: list[tuple[str, ...]] = [
        (*OURS, "fit", capture, "-o", str(folder / f"{number}"), "--resolution", str(resolution))
        for number, capture in enumerate(captures)]
    if options is not None:
        commands = [(*OURS, "batch", *captures, "-o", str(folder / "library"), "--resolution",
                     str(resolution), *options)]
    began, peak = time.monotonic(), 0
    with (folder / "log.txt").open("w") as log:
        for command in commands:
            process = subprocess.Popen(command, stdout=log, stderr=log)
            while process.poll() is None:
                peak = max(peak, _held(process.pid))
                time.sleep(LOOK_SECONDS)
            if process.returncode:
                raise OutputError("fits that end well", f"exit code {process.returncode} of {way}",
                                  (folder / "log.txt").read_text())
    seconds = time.monotonic() - began
    records = [load(path) for path in folder.rglob("fit.json")]
    return {"way": way, "captures": len(captures), "seconds": round(seconds, 1),
            "per_hour": 3600 * len(captures) / seconds,
            "peak_bytes": peak, "error": statistics.mean(record["rerender_rmse"] for record in records)}


def _held(root: int) -> int:
    """Bytes that a process and all below it hold: the sum of their proportional shares."""
    parents, held = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                lines = (entry / "smaps_rollup").read_text().splitlines()
                held[int(entry.name)] = next(int(line.split()[1]) << 10 for line in lines
                                             if line.startswith("Pss:"))
            except (OSError, StopIteration):
                continue
    family = {root}
    while more := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= more
    return sum(held.get(pid, 0) for pid in family)


def measured(captures: Sequence[str], groups: int, resolution: int) -> Iterator[dict]:
    """One row a way and group."""
    for number in range(groups):
        chosen, names = captures[number::groups], list(WAYS)
        for way in names[number % len(names):] + names[:number % len(names)]:
            with tempfile.TemporaryDirectory(prefix="mitsvbrdf-ways-") as folder:
                yield run_in_a_way(way, chosen, Path(folder), resolution) | {"group": number}


def page(record: Mapping) -> str:
    """The figures as Markdown; ratios are to the shell's loop, in the median of the groups."""
    rows = record["rows"]
    lines = ["# A batch against a loop of the shell", "",
             "Written by `python -m mitsvbrdf.batch.planning.ways` from "
             "`batch-ways.json`: the default fit of "
             f"{sum(row['captures'] for row in rows if row['way'] == rows[0]['way'])} "
             f"captures at {record['resolution']} px, pages and start-up included, "
             f"{record['machine']['cores']} hardware "
             "threads. Groups of captures were fitted in each way in turn.", "",
             "| way | captures an hour | of the loop's (each group) | peak memory, GiB | mean RMSE |",
             "|---|---:|---:|---:|---:|"]
    loop = {row["group"]: row["per_hour"] for row in rows if row["way"] == list(WAYS)[-1]}
    for way in WAYS:
        mine = [row for row in rows if row["way"] == way]
        if not mine:
            continue
        count, seconds = sum(row["captures"] for row in mine), sum(row["seconds"] for row in mine)
        ratios = [row["per_hour"] / loop[row["group"]] for row in mine if row["group"] in loop]
        shown = (f"{statistics.median(ratios):.2f} ({', '.join(f'{ratio:.2f}' for ratio in ratios)})"
                 if ratios else "")
        error = sum(row["error"] * row["captures"] for row in mine) / count
        lines.append(f"| {way} | {3600 * count / seconds:.0f} | {shown} | "
                     f"{max(row['peak_bytes'] for row in mine) / GIB:.2f} | "
                     f"{error:.4f} |")
    return "\n".join([*lines, ""])


def main(captures: Annotated[Positional[list[str]], arg(metavar="CAPTURE", help="As of `mitsvbrdf batch`.")],
         out: Annotated[Path, arg(aliases=["-o"], help="Folder to write.")],
         groups: Annotated[int, arg(help="How often the ways take turns.")] = 3,
         resolution: int = 256) -> int:
    """Measure; both files are written after each run."""
    files.check_output(out / "batch-ways.json", out / "batch-ways.md")
    found = [os.path.realpath(entry.source) for entry in entries(captures)]
    record: dict = {"schema_version": 1, "machine": machine(), "versions": versions(),
                    "resolution": resolution, "rows": []}
    for row in measured(found, groups, resolution):
        say(str(row))
        record["rows"].append(row)
        files.write_json(out / "batch-ways.json", record)
        files.write_bytes(out / "batch-ways.md", page(record).encode())
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.batch.planning.ways",
                      "interrupted; the files have each run that was measured"))
