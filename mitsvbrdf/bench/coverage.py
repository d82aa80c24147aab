"""``python -m mitsvbrdf.bench.coverage -o docs/results``: how often the truth lies in the intervals that a
fit states.

Made materials, each with several seeds, are photographed with sensor noise and fitted by the default method;
each texel's error is compared with the standard deviation stated for it (:mod:`mitsvbrdf.fit.confidence`).
``coverage.json`` has the figures, ``coverage.md`` is written from it.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import tyro

from ..fit import HierarchicalConfig, fit_svbrdf
from ..fit.confidence import DETERMINED, numbers_of
from ..fit.result import FitResult
from ..io import files
from ..io.progress import say
from ..io.provenance import machine, versions
from ..io.tool import run_tool
from ..material.made import MATERIALS, make_material
from ..material.maps import SVBRDF
from ..measure.coverage import coverage
from ..render import make_renderer
from ..synth import photograph
from ..views import nine_view_grid

WANTED = 0.60, 0.76  # of the truths within one deviation; a normal distribution has 0.683
FAR = 1.96  # times the deviation below which a texel is called determined


def figures(result: FitResult, truth: SVBRDF) -> dict[str, dict]:
    """For each map fitted what :func:`~mitsvbrdf.measure.coverage.coverage` gives; the share of texels that
    are called ``determined``; and ``right``, how many of those are off by less than 1.96 times what that
    allows (None without any).

    Args:
        result: a fit.
        truth: the material that it saw, of its resolution.
    """
    found = {}
    for name, spread in result.deviations.items():
        side, channels = len(spread), spread.shape[-1]
        found_here, true = (numbers_of(name, material.resized(side)[name]) for material in (result.svbrdf,
                                                                                            truth))
        error = (found_here - true)[..., :channels]
        sure = spread.square().mean(dim=-1).sqrt() < DETERMINED
        off = error.square().mean(dim=-1).sqrt()[sure]
        found[name] = coverage(error, spread) | {"determined": float(sure.float().mean()),
                                                 "right": float((off < FAR * DETERMINED).float().mean())
                                                 if len(off) else None}
    return found


def page(record: Mapping) -> str:
    """The figures as Markdown."""
    rows = record["fits"]
    names = list(dict.fromkeys(name for row in rows for name in row["maps"]))
    low, high = WANTED
    lines = [
        "# Stated uncertainty, measured", "",
        "Written by `python -m mitsvbrdf.bench.coverage` from `coverage.json`.", "",
        f"{len(rows)} fits of the default method, {record['resolution']} px, nine views, 8 bits: made "
        "materials, seeds "
        f"{', '.join(map(str, record['seeds']))}, sensor noise of "
        f"{' and '.join(f'{n:g}' for n in record['noises'])} (linear). "
        "Counted are all texels and channels, in the numbers in which map errors are counted; every fit "
        "weighs the same.", "",
        "- *Within 68 %*: share of the truths at most one stated deviation from what was found; a true "
        "normal has 68 %. "
        f"Wanted: {low:.0%} to {high:.0%}. *Within 95 %*: 1.96 deviations.",
        f"- *Determined*: texels of a deviation below {DETERMINED:g}. *Right*: those of them off by less "
        "than "
        f"{FAR * DETERMINED:.3g}.",
        "- *Ranks*: where the truth lies in the normal that was stated, in ten equal bins, per cent; 10 "
        "each would be true. "
        "More at the ends: too sure; more in the middle: not sure enough; more at one end: biased.", "",
        "| map | RMSE | median deviation | within 68 % | within 95 % | determined | right | ranks |",
        "|---|---:|---:|---:|---:|---:|---:|---|"]
    for name in names:
        maps = [row["maps"][name] for row in rows if name in row["maps"]]
        ranks = " ".join(f"{100 * statistics.fmean(m['ranks'][k] for m in maps):.0f}"
                         for k in range(len(maps[0]["ranks"])))
        shares = [_mean(m[what] for m in maps) for what in ("within_68", "within_95", "determined", "right")]
        lines.append(f"| {name} | {_mean((m['rmse'] for m in maps), '.4f')} | "
                     f"{_mean((m['median_sd'] for m in maps), '.4f')} | "
                     f"{' | '.join(shares)} | {ranks} |")
    lines += ["", "## Within 68 %, by material and noise", "", f"| material | noise | {' | '.join(names)} |",
              "|---|---:" + "|---:" * len(names) + "|"]
    for material, noise in dict.fromkeys((row["material"], row["noise"]) for row in rows):
        here = [row["maps"] for row in rows if (row["material"], row["noise"]) == (material, noise)]
        lines.append(f"| {material} | {noise:g} | "
                     f"{' | '.join(_mean(m[name]['within_68'] for m in here) for name in names)} |")
    return "\n".join(lines) + "\n"


def _mean(values: Iterable[float | None], form: str = ".0%") -> str:
    known = [value for value in values if value is not None]
    return format(statistics.fmean(known), form) if known else "–"


def main(out: Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder to write.")],
         materials: Annotated[tuple[str, ...], tyro.conf.arg(help="Made materials.")] = tuple(MATERIALS),
         noises: Annotated[tuple[float, ...], tyro.conf.arg(help="Of the sensor, linear.")] = (0.003, 0.01),
         seeds: Annotated[tuple[int, ...], tyro.conf.arg(help="Of the materials.")] = (0, 1, 2),
         resolution: Annotated[int, tyro.conf.arg(help="Side of the maps in texels.")] = 64) -> int:
    """Fit made materials and count; both files are written after each fit."""
    files.check_output(out / "coverage.json", out / "coverage.md")
    renderer, camera, rows = make_renderer("mitsuba"), make_renderer("analytic"), list[dict]()
    record = {"schema_version": 1, "resolution": resolution, "noises": list(noises), "seeds": list(seeds),
              "fits": rows,
              "machine": machine(), "versions": versions()}
    for material, noise, seed in ((m, n, s) for m in materials for n in noises for s in seeds):
        truth = make_material(material, resolution, seed)
        result = fit_svbrdf(photograph(truth, nine_view_grid(), camera, noise, seed=seed), renderer,
                            HierarchicalConfig())
        if result.stopped == "interrupted":
            raise KeyboardInterrupt
        maps = figures(result, truth)
        rows.append({"material": material, "noise": noise, "seed": seed, "maps": maps})
        files.write_json(out / "coverage.json", record)
        files.write_bytes(out / "coverage.md", page(record).encode())
        say(f"{material}, noise {noise:g}, seed {seed}: within 68 % " + ", ".join(
            f"{name} {m['within_68']:.0%}" for name, m in maps.items()))
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.bench.coverage",
                      "interrupted; the files have each fit that was measured"))
