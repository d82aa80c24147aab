"""What is left out, as tables on the terminal and as docs/leave-out.md; both show the records and what is
reckoned of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ...io import files
from ...report.page import figure, seconds
from ..page import made_on, markdown, print_tables
from ..tables import Table
from .fits import SUITE as FITS
from .in_short import in_short
from .parts import REAL
from .renders import SUITE as RENDERS
from .verdict import COSTS, FLOOR, SAVES, default_fits, items

INTRO = """# What is left out, and what it saves

Written by `mitsvbrdf leave-out{fits} --md docs/leave-out.md`, nothing by hand. {made_on}
Seconds differ from machine to machine; their ratios less so, for with and without take turns in one process.

From material, views and task each render decides what it does not need (`mitsvbrdf/render/needs.py`); what is left out is
neither compiled nor handed over nor allocated. `fit --explain` lists it for a fit, `fit.json` keeps it. A map that wants a
gradient is never left out.
"""
OF_RENDERS = """## Of a scene

Nine co-located views of {renders_resolution} px, forward and backward; turns: {renders_repeats}, of their seconds the median.
"""
OF_RENDERS_NOTE = (
    "Ratios within 5 % of 1 are noise: those items cost nothing measurable here. Two results in float32 may "
    "differ by the "
    "rounding of both; the sixth column shows the largest error of each against the float64 twin. `light "
    "falloff` is no "
    "saving without a change: another light was asked for.")
OF_FITS = """## Of a fit

Fits of {resolution} px; turns of each pair: {repeats}. What a fit does not need depends on its photos, which it looks at
first; `fit --explain` says what is decided so and by what, `fit.json` what was left out and by which figure. *tied stage*
and *rival starts* put in stand for the whole fit of photos taken for the other kind.
"""
OF_PARTS = f"""### Each part left out, against the fit that has it

Scenes are those of the kind, errors are without it over with it, of several scenes the median and the worst. *By itself*: the
program leaves it out of such photos; it was put in to be measured. A part is *needed* where an error that decides (of maps,
under new light, of photos left out) grows by more than {COSTS - 1:.0%} on any scene; *not needed* where none does and at least
{1 - 1 / SAVES:.0%} of the seconds are saved. Errors below {FLOOR:g} count as {FLOOR:g}. *generator* compares `hybrid` with the
default. Verdicts are those of the fits named here, no more: a part is left out by itself only where a test on the photos
decides it.
"""
SPENT = ("setting up", "solver", "sharing", "views", "noise", "measuring", "uncertainty")
ERRORS = ("maps", "new light", "left out", "seen")


def print_leave_out(record: Mapping) -> None:
    """What is saved, on the terminal."""
    tables = []
    if renders := renders_table(record):
        tables.append(Table("Left out of a scene: largest relative difference, seconds with it over those "
                            "without",
                            ["what", "where", "difference", "with / without"],
                            [[row[0], row[1], row[3], row[-1]] for row in renders.rows]))
    if parts := parts_table(record):
        tables.append(Table("Left out of a fit: seconds with it over those without",
                            ["what", "method", "of", "ratio", "verdict"],
                            [[row[0], row[1].strip("`"), row[2], row[4], row[-1]] for row in parts.rows]))
    print_tables(tables)


def write_leave_out_page(path: str | Path, record: Mapping) -> None:
    """Write the page.

    Args:
        path: e.g. ``docs/leave-out.md``.
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.

    Raises:
        OutputError: it cannot be written.
    """
    settings = record["settings"]
    fits = " --fits" if any(r["suite"] == FITS for r in record["records"]) else ""
    lines = [INTRO.format(made_on=made_on(record), fits=fits)]
    if short := in_short(record):
        lines += ["## In short", "", *(f"- {line}" for line in short), ""]
    if renders := renders_table(record):
        lines += [OF_RENDERS.format(**settings), *_untitled(renders)]
    if parts := parts_table(record):
        lines += [OF_FITS.format(**settings), *markdown(scenes_table(record)), OF_PARTS, *_untitled(parts)]
    lines += ["## How to reproduce", "", f"    {command(record)}", "",
              "Each record is kept as soon as it is there: Ctrl-C loses one measurement, and the same "
              "command goes on.", ""]
    files.write_bytes(Path(path), "\n".join(lines).encode())


def command(record: Mapping) -> str:
    """The command that makes the record again."""
    settings, pairs = record["settings"], [r for r in record["records"] if r["suite"] == FITS]
    captures = ",".join(dict.fromkeys(r["name"] for r in pairs if r["kind"] == REAL))
    fits = (f" --fits --fit-resolution {settings['resolution']} --fit-repeats {settings['repeats']}"
            + (f" --captures {captures}" if captures else "")) if pairs else ""
    return (f"mitsvbrdf leave-out --resolution {settings['renders_resolution']} --repeats "
            f"{settings['renders_repeats']}{fits} "
            "--json leave-out.json --md leave-out.md")


def _untitled(table: Table) -> list[str]:
    return markdown(table)[2:]


def renders_table(record: Mapping) -> Table | None:
    """What leaving things out of a scene changes and saves; None without records of it."""
    rows = []
    for r in record["records"]:
        if r["suite"] == RENDERS:
            full, lean = (r["seconds"][name]["median"] for name in ("full", "lean"))
            rows.append([r["name"], r["where"], r["why"], figure(r["worst"]), figure(r["mean"]),
                         f"{figure(r['full_error'])}, {figure(r['lean_error'])}", seconds(full),
                         seconds(lean),
                         f"{full / lean:.2f}"])
    heads = ["left out", "where", "when", "largest difference", "mean", "full, lean against float64", "full",
             "lean",
             "full / lean"]
    return Table("Of a scene", heads, rows, OF_RENDERS_NOTE) if rows else None


def scenes_table(record: Mapping) -> Table:
    """The default fit of each scene."""
    rows = [[of["name"], of["kind"], str(of["photos"]), _quartiles(of["seconds"], seconds),
             *(f"{of['spent'].get(part, 0.0):.1f}" for part in SPENT)] for of in default_fits(record)]
    return Table("The default fit of each scene, and where its seconds go",
                 ["scene", "kind", "photos", "seconds (quartiles)", *SPENT], rows)


def parts_table(record: Mapping) -> Table | None:
    """What leaving parts out of fits costs and saves; None without records of it."""
    rows = []
    for item in items(record):
        rows.append([item["part"], f"`{item['of']}`", item["kind"] + (", by itself" if item["put_in"]
                                                                      else ""),
                     str(item["scenes"]), _quartiles(item["ratio"], "{:.2f}".format),
                     *(_error(item["errors"].get(name), item["scenes"]) for name in ERRORS), item["verdict"]])
    heads = ["left out", "method", "of", "scenes", "seconds, with / without (quartiles)", *ERRORS, "verdict"]
    return Table("Of a fit", heads, rows) if rows else None


def _error(ratio: Mapping | None, scenes: int) -> str:
    if ratio is None:
        return "–"
    return f"{ratio['median']:.3f}" + (f", {ratio['worst']:.3f}" if scenes > 1 else "")


def _quartiles(spread: Mapping, shown: Callable[[float], str]) -> str:
    if spread["repeats"] == 1:
        return shown(spread["median"])
    return f"{shown(spread['median'])} ({shown(spread['low'])} to {shown(spread['high'])})"
