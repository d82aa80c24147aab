"""``python -m mitsvbrdf.batch.planning.costs -o docs/results``: what one material costs: seconds, memory, and
bytes.

Fits as a worker of a batch does them: one thread, in a guard's child that is warm. ``batch-costs.json`` has
the figures, ``batch-costs.md`` is written from it, and :mod:`mitsvbrdf.batch.planning.simulate` takes seconds
and spread from it.
"""

from __future__ import annotations

import contextlib
import math
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro
from scipy.optimize import nnls

from ...capture import write_capture
from ...capture.photo import SUFFIXES
from ...errors import OutputError
from ...fit import HierarchicalConfig
from ...fit.options import FitOptions
from ...io import files
from ...io.progress import say
from ...io.provenance import machine, versions
from ...io.tool import run_tool
from ...material.made import MATERIALS, make_material
from ...render import make_renderer
from ...synth import photograph
from ...views import nine_view_grid
from ..asked import Asked
from ..entries import Entry
from ..identity import capture_files, identity
from ..places.place import WORK
from ..workers.guard import Guard

NOISE = 0.004  # of the made photos, linear
# texels a side at which captures are compared, and of the real one; how many real ones
SPREAD, REAL, FEW = 64, 256, 6
MIB = 1 << 20


def made_capture(folder: Path, material: str, side: int) -> Path:
    """Nine photos of a made material."""
    shots = photograph(make_material(material, side), nine_view_grid(), make_renderer("analytic"), NOISE)
    write_capture(shots, folder / f"{material}-{side}")
    return folder / f"{material}-{side}"


class Meter:
    """One warm child, and what its fits cost.

    Args:
        library: an empty folder for results.
    """

    def __init__(self, library: Path) -> None:
        self.library, self.guard, self._count = library, Guard(1, None, None), 0
        (library / WORK).mkdir(parents=True, exist_ok=True)

    def fit(self, capture: Path, resolution: int, pages: bool) -> dict:
        """Fit a capture with the default method.

        Returns:
            ``seconds`` of the wall clock and ``cpu_seconds`` of all threads; ``peak_bytes``; bytes that the
            child ``read`` and ``wrote``, of the ``capture``'s files and of the ``result``; how many ``files``
            the result has.

        Raises:
            OutputError: the fit failed.
        """
        asked = Asked(Entry(str(capture)), HierarchicalConfig(), replace(FitOptions(), resolution=resolution),
                      pages, ())
        known = identity(str(capture), asked.record, files.file_hash)
        self._count += 1
        name = f"m{self._count}"
        before = self._used()
        outcome = self.guard.run({"attempt": name, "name": name, "identity": known, "capture": str(capture),
                                  "library": str(self.library), "folder": os.getcwd(),
                                  "options": asked.record})
        after = self._used()
        if outcome["state"] != "done":
            raise OutputError(f"a fit of {capture}", f"{outcome['state']}: {outcome['reason']}",
                              "see what it says")
        result = [path.stat().st_size for path in (self.library / f"{name}-{known[:8]}").rglob("*")
                  if path.is_file()]
        inputs = capture_files(capture)
        return {"capture": capture.name, "resolution": resolution, "pages": "all" if pages else "none",
                "photos": sum(path.suffix.lower() in SUFFIXES for path in inputs),
                "seconds": outcome["seconds"],
                **{what: round(after[what] - before[what], 2) for what in after},
                "peak_bytes": outcome["peak_bytes"],
                "capture_bytes": sum(path.stat().st_size for path in inputs), "result_bytes": sum(result),
                "files": len(result)}

    def _used(self) -> dict[str, float]:
        """CPU seconds and bytes of the child until now; zeros while there is none."""
        used, tick = {"cpu_seconds": 0.0, "read": 0, "wrote": 0}, os.sysconf("SC_CLK_TCK")
        with contextlib.suppress(OSError):
            own = Path(f"/proc/{self.guard.child}")
            used["cpu_seconds"] = sum(map(int,
                                          (own / "stat").read_text().rpartition(")")[2].split()[
                                              11:15])) / tick
            counts = dict(line.split(": ") for line in (own / "io").read_text().splitlines())
            used |= {"read": int(counts["rchar"]), "wrote": int(counts["wchar"])}
        return used


def law(rows: Sequence[Mapping]) -> dict[str, float]:
    """``base`` and ``slope`` of CPU seconds = base + slope * photos * resolution^2, and its ``worst``
    relative error.

    Each row weighs the same whatever its size: errors are relative. Neither number is negative.
    """
    size = [row["photos"] * row["resolution"] ** 2 for row in rows]
    cost = [row["cpu_seconds"] for row in rows]
    base, slope = nnls([[1 / c, s / c] for s, c in zip(size, cost)], [1.0] * len(rows))[0]
    worst = max(abs((base + slope * s) / c - 1) for s, c in zip(size, cost))
    return {"base": float(base), "slope": float(slope), "worst": float(worst)}


def measured(record: dict, captures: Sequence[Path], sides: Sequence[int], folder: Path) -> Iterator[str]:
    """Fill the record; yields a line after each fit."""
    meter = Meter(folder / "library")
    leather = made_capture(folder, "leather", SPREAD)
    record["cold"], record["warm"] = (meter.fit(leather, SPREAD, False) for _ in range(2))
    spread = [*(made_capture(folder, name, SPREAD) for name in MATERIALS), *captures]
    for capture in spread:
        record["spread_rows"].append(row := meter.fit(capture, SPREAD, False))
        yield str(row)
    logs = [math.log(row["cpu_seconds"]) for row in record["spread_rows"]]
    record["spread"] = statistics.stdev(logs) if len(logs) > 1 else 0.0
    for side in sides:
        sources = [made_capture(folder, "leather", side), *(captures[:1] if side == REAL else ())]
        for capture, pages in ((c, p) for c in sources for p in (False, True)):
            record["rows"].append(row := meter.fit(capture, side, pages))
            yield str(row)
            record["law"] = {pages: law(rows) for pages in ("none", "all")
                             if (rows := [row for row in record["rows"] if row["pages"] == pages])}
    meter.guard.close()


def page(record: Mapping) -> str:
    """The figures as Markdown."""
    lines = [
        "# What one material costs", "", "Written by `python -m mitsvbrdf.batch.planning.costs` from "
                                         "`batch-costs.json`.", "",
        "Fits of the default method as a worker of `mitsvbrdf batch` does them: one thread, in a child that "
        "is warm. "
        f"{record['machine']['cores']} hardware threads, with other work beside it: CPU seconds are what "
        "the fit used, seconds "
        "are the wall clock's and also hold the wait for a processor. *Capture* and *result* are the files "
        "that cross the "
        "network once where a library lies on a shared file system; the child also reads its result again "
        "to hash it, from the "
        "page cache.", "",
        "| capture | photos | side | pages | CPU s | s | peak MiB | capture MiB | result MiB | files |",
        "|---|---:|---:|---|---:|---:|---:|---:|---:|---:|"]
    for row in record["rows"]:
        numbers = [f"{row['cpu_seconds']:.1f}", f"{row['seconds']:.1f}", *(
            f"{row[name] / MIB:.{digits}f}" for name, digits in (("peak_bytes", 0), ("capture_bytes", 2),
                                                                 ("result_bytes", 2)))]
        lines.append(f"| {row['capture']} | {row['photos']} | {row['resolution']} | {row['pages']} | "
                     f"{' | '.join(numbers)} | "
                     f"{row['files']} |")
    lines += ["", "CPU seconds = base + slope x photos x side^2:", "",
              "| pages | base, s | slope, us | largest error |",
              "|---|---:|---:|---:|"]
    lines += [f"| {pages} | {found['base']:.2f} | {1e6 * found['slope']:.2f} | {found['worst']:.0%} |"
              for pages, found in record["law"].items()]
    seconds = sorted(row["cpu_seconds"] for row in record["spread_rows"])
    return "\n".join([*lines, "", f"{len(seconds)} captures at {SPREAD} px, no pages, take {seconds[0]:.1f} "
                                  "to "
                      f"{seconds[-1]:.1f} CPU seconds; the standard deviation of their logarithm is "
                      f"{record['spread']:.2f}. "
                      "A new child's first fit takes "
                      f"{record['cold']['cpu_seconds'] - record['warm']['cpu_seconds']:.1f} CPU "
                      "seconds more than the next one of the same capture: its start, imports and kernels.",
                      ""])


def main(out: Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder to write.")],
         sides: Annotated[tuple[int, ...], tyro.conf.arg(help="Resolutions in texels.")] = (64, 128, 256,
                                                                                            512),
         captures: Annotated[Path | None,
                             tyro.conf.arg(help="Folder of real captures; left out: captures/ in the folder "
                                                "that MITSVBRDF_DATA names, where it is set.")] = None) -> int:
    """Measure; both files are written after each fit."""
    files.check_output(out / "batch-costs.json", out / "batch-costs.md")
    data = captures or Path(os.environ.get("MITSVBRDF_DATA") or os.devnull) / "captures"
    real = sorted(path.parent for path in data.glob("*/capture.json"))
    record: dict = {"schema_version": 1, "machine": machine(), "versions": versions(), "law": {}, "rows": [],
                    "spread_rows": []}
    with tempfile.TemporaryDirectory() as folder:
        for line in measured(record, real[::math.ceil(len(real) / FEW) or 1], sides, Path(folder)):
            say(line)
            if record["rows"]:
                files.write_json(out / "batch-costs.json", record)
                files.write_bytes(out / "batch-costs.md", page(record).encode())
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.batch.planning.costs",
                      "interrupted; the files have each fit that was measured"))
