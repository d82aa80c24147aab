"""A benchmark as tables on the terminal and as a Markdown page with pictures; both show the record and its summary."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table as Shown

from ..pages.page import svg_file
from ..system import files
from ..system.progress import console
from . import summary
from .commands import commands
from .plots import methods_figure, renderers_figure, small_multiples
from .summary import ERRORS
from .tables import (
    Table,
    ablation_tables,
    at_time,
    capture_tables,
    count_of,
    each_map,
    each_one,
    equal_error,
    equal_time,
    judged,
    renderer_tables,
)
from .tasks import LEFT_OUT

Picture = Callable[[str, Figure | None, str], list[str]]  # name, drawing, what it shows -> lines of Markdown


def print_benchmark(record: Mapping) -> None:
    """The tables at equal time, to equal error, of renderers and of the ablation, without spreads, on the terminal."""
    tables = [*equal_time(record), *equal_error(record), *renderer_tables(record), *ablation_tables(record),
              *capture_tables(record)]
    print_tables(tables)


def print_tables(tables: Sequence[Table]) -> None:
    """Tables on the terminal, without their spreads."""
    with contextlib.suppress(BrokenPipeError):
        for table in tables:
            shown = Shown(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
            for number, head in enumerate(table.heads):
                shown.add_column(escape(head.replace("`", "")), justify="right" if number else "left", no_wrap=number == 0)
            for row in table.rows:
                plain = [row[0].replace("`", ""), *(re.sub(r" \(.*?\)", "", cell) for cell in row[1:])]
                shown.add_row(*(f"[bold]{escape(c.strip('*'))}[/]" if c.startswith("**") else escape(c) for c in plain))
            console.print(escape(table.title))
            console.print(shown)


def write_benchmark_page(path: str | Path, record: Mapping) -> list[Path]:
    """Write a Markdown page, and its pictures beside it under the page's own name.

    Args:
        path: the page, e.g. ``docs/benchmark.md``.
        record: a :class:`mitsvbrdf.bench.schema.Benchmark`.

    Returns:
        Every file that was written, the page first.

    Raises:
        OutputError: a file cannot be written.
    """
    path, pictures = Path(path), dict[str, bytes]()

    def picture(name: str, drawing: Figure | None, what: str) -> list[str]:
        if drawing is None:
            return []
        pictures[f"{path.stem}-{name}.svg"] = svg_file(drawing)
        return [f"![{what}]({path.stem}-{name}.svg)", ""]

    whole = picture("methods", methods_figure(record), "Error against run time of all methods")
    head = ["# Benchmark: error against run time", "",
            f"Written by `mitsvbrdf bench --page`, nothing by hand. {made_on(record)}", ""]
    lines = [*head, *_in_short(record), *whole, *_methods(record, picture), *_renderers(record, picture),
             *_ablation(record), *_capture(record), *_how(record)]
    files.write_bytes(path, "\n".join(lines).encode())
    for name, data in pictures.items():
        files.write_bytes(path.with_name(name), data)
    return [path, *(path.with_name(name) for name in pictures)]


def markdown(table: Table | None, level: str = "###") -> list[str]:
    """A table as lines of Markdown under its title; none for None."""
    if table is None:
        return []
    lines = [f"{level} {table.title}", "", f"| {' | '.join(table.heads)} |", "|---" + "|---:" * (len(table.heads) - 1) + "|"]
    lines += [f"| {' | '.join(row)} |" for row in table.rows]
    return [*lines, "", *([table.note, ""] if table.note else [])]


def made_on(record: Mapping) -> str:
    """On what machine, with which versions and settings the records were made, in sentences."""
    m, v, s = record["machine"], record["versions"], record["settings"]
    model = m.get("model") or m.get("cpu")
    memory = f", {m['memory_gib']} GiB" if m.get("memory_gib") else ""
    packages = ", ".join(f"{name} {v[name]}" for name in ("mitsvbrdf", "mitsuba", "drjit", "torch", "python") if v.get(name))
    return (f"Machine: {model}, {m['cores']} cores{memory}, {m['system']}. Versions: {packages}, "
            f"{m.get('libllvm') or 'libLLVM unknown'}; code {s['code']}. Fits: {s['resolution']} px, through `{s['renderer']}`"
            + (f", seeds {', '.join(map(str, record['seeds']))}" if record["seeds"] else "") + "." + _at_a_time(record))


def _at_a_time(record: Mapping) -> str:
    """How many jobs shared the machine, where any did."""
    shared = [r["workers"] for r in record["records"] if r.get("workers", 1) > 1]
    if not shared:
        return ""
    least, most = min(shared), max(shared)
    at_a_time = most if least == most else f"{least} to {most}"
    return (f" {len(shared)} of {len(record['records'])} records were made {at_a_time} at a time (`--workers`): their "
            "times are those of a shared machine.")


def _in_short(record: Mapping) -> list[str]:
    """Where the default method is lowest and where it is not, and against what was published: wins and losses alike."""
    lines = []
    for kind, error, title, fits in judged(record, "methods"):
        found, times = summary.curves(fits, error), summary.budgets(fits)
        default = next(iter(found), None)
        if default is None or len(found) < 2:
            continue
        lowest: dict[str, list[str]] = {}
        for budget in times:
            here = {name: p.median for name, points in found.items() if (p := at_time(points, budget))}
            if default in here:
                best = min(here, key=lambda name: here[name])
                beside = "" if best == default else f" ({here[best]:.4f}, `{default}` {here[default]:.4f})"
                lowest.setdefault(best, []).append(f"{budget:g} s{beside}")
        lines.append(f"- {title}, {count_of(kind, fits)}, lowest: "
                     + "; ".join(f"`{name}` at {_list(at)}" for name, at in lowest.items()) + ".")
    for kind, error, title, fits in judged(record, "methods"):
        lines += _beside_published(record, kind, error, title, fits)
    failed = summary.failures(record["records"])
    if failed:
        lines.append(f"- {len(failed)} fits failed: " + "; ".join(
            f"`{r['method']}` on {r['name']}, {r['budget']:g} s, seed {r['seed']} ({r['why']})" for r in failed) + ".")
    return ["## In short", "", *lines, ""] if lines else []


def _beside_published(record: Mapping, kind: str, error: str, title: str, fits: Sequence[Mapping]) -> list[str]:
    default = next(r["method"] for r in fits)
    only = summary.with_published(record["published"], kind, summary.names(fits), "MaterialGAN", error)
    longest = max(summary.budgets(fits))
    won: list[str] = []
    lost: list[str] = []
    for name in only:
        point = at_time(summary.curves(fits, error, [name]).get(default, []), longest)
        given = record["published"][kind][name]["MaterialGAN"][error]
        if point:
            (won if point.median < given else lost).append(name)
    if not won and not lost:
        return []
    text = f"lower on {len(won)} of {len(won) + len(lost)}" + (f" ({', '.join(won)})" if won else "")
    text += f", not on {', '.join(lost)}" if lost else ""
    return [f"- {title}, `{default}` after {longest:g} s against MaterialGAN as published: {text}."]


def left_out_by(record: Mapping) -> str:
    """The numbers of the photos that fits of real captures did not see, in words."""
    return _list([str(i) for i in record["settings"].get("left_out", LEFT_OUT)])


def _methods(record: Mapping, picture: Picture) -> list[str]:
    lines = []
    for kind, heading, text in (
            ("material", "## Known materials", "Photos made of known maps, 8 bits, without noise; the error of the maps is the "
             "mean of the four RMSEs, the error under new light is that of pictures lit from the side, 25 and 50 degrees off "
             "the upright, as no photo with a flash was."),
            ("capture", "## Real captures", f"Photos {left_out_by(record)} are left out of every fit and predicted afterwards. "
             "MaterialGAN, trained on a large data set, saw all nine, those two as well.")):
        fits = summary.of(record["records"], "methods", kind)
        if not fits:
            continue
        lines += [heading, "", text, ""]
        for table in equal_time({**record, "records": fits}) + equal_error({**record, "records": fits}):
            lines += markdown(table)
        lines += markdown(each_map(record)) if kind == "material" else []
        for error, title in ERRORS[kind].items():
            lines += markdown(each_one(record, kind, error, title))
            lines += picture(f"{kind}-{error.replace('_', '-')}", small_multiples(record, kind, error), f"{title}, one by one")
    return lines


def _renderers(record: Mapping, picture: Picture) -> list[str]:
    tables = renderer_tables(record)
    if not tables:
        return []
    lines = ["## Renderers", "", "Made inlaid wood, the flash 0.1 patch sides beside the lens, against the float64 twin "
             "`analytic64`; all renderers in turn, median and quartiles.", "",
             *picture("renderers", renderers_figure(record), "Error against run time of the renderers")]
    return lines + [line for table in tables for line in markdown(table)]


def _ablation(record: Mapping) -> list[str]:
    lines = [line for table in ablation_tables(record) for line in markdown(table)]
    return ["## Each ingredient off", "", *lines] if lines else []


def _capture(record: Mapping) -> list[str]:
    lines = [line for table in capture_tables(record) for line in markdown(table)]
    text = ("Known materials are photographed by a simulated phone (`synth --handheld`: a lens, its flash beside it, noise, "
            "JPEG); what `capture` makes of the photos is held against the truth. Cameras: distance from the truth over that "
            "to the patch, root mean square, without a sheet after the best similarity. Rectification: pixels of 512. Maps: "
            "mean of the four RMSEs, beside that of a fit of the same photos with the true views. Real captures: views taken "
            "away and found again by the fit; lateral in patch sides, after the best scale and shift. Left out: photos 4 and "
            "7, predicted by fits of the others with the views given, refined or held.")
    return ["## From a phone to maps", "", text, "", *lines] if lines else []


def _how(record: Mapping) -> list[str]:
    return ["## How to reproduce", "", "Every point is a fit of its own with its own budget, for schedules follow the budget; "
            "seconds are the loop's own, after kernels are compiled, without what comes before and after it (`wall` in the "
            "JSON has that too). Methods take turns. Real captures, known materials and published numbers lie in the folder "
            "that `MITSVBRDF_DATA` names.", "",
            *(f"    {line}" for line in (*commands(record), "mitsvbrdf bench --suite none --page benchmark.md")), ""]


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
