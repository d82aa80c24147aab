"""A benchmark as tables on the terminal and as a Markdown page with pictures; both show the record and its
summary.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table as Shown

from ..io import files
from ..io.progress import print_rich
from ..report.charts import svg_file
from . import summary
from .commands import commands
from .in_short import in_short, listed, plural
from .methods import method_table
from .plots import each_figure, methods_figure
from .published import BLIND
from .renderer_plots import renderers_figure
from .schema import USUAL_LEFT_OUT
from .suite_tables import capture_tables, renderer_tables, start_table
from .summary import ERRORS, KINDS
from .tables import Table, ablation_tables, each_map, each_one, equal_time, looks
from .times import equal_error, ladders, passing, wall_time

KNOWN = ("Photos made of known maps, 8 bits, without noise; the error of the maps is the mean of the four "
         "RMSEs, the error "
         "under new light is that of pictures lit from the side, 25 and 50 degrees off the upright, unlike "
         "any photo's flash. "
         "Published figures are on the publishers' own photos of the same maps.")
CAPTURED = "Photos {} are left out of every fit and predicted afterwards."
NOBODY = " {} did not see them either: their authors published what fits to photos 0 to 6 predict."
UNFAIR = (" Not comparable: *MaterialGAN, which saw them* was fitted to all nine photos, those left out as "
          "well.")
Picture = Callable[[str, Figure | None, str], list[str]]  # name, drawing, what it shows -> lines of Markdown


def print_benchmark(record: Mapping) -> None:
    """The tables at equal time, to equal error, of renderers and of the ablation, without spreads, on the
    terminal.
    """
    apart = summary.for_readers(record)
    start = start_table(record)
    print_tables([*(table for each in apart for table in (*equal_time(each), *equal_error(each))),
                  *renderer_tables(record),
                  *([start] if start else []), *(table for each in apart for table in ablation_tables(each)),
                  *capture_tables(record)])


def print_tables(tables: Sequence[Table]) -> None:
    """Tables on the terminal, without their spreads."""
    for table in tables:
        shown = Shown(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for number, head in enumerate(table.heads):
            shown.add_column(escape(head.replace("`", "")), justify="right" if number else "left",
                             no_wrap=number == 0)
        for row in table.rows:
            plain = [row[0].replace("`", ""), *(re.sub(r" \(.*?\)", "", cell) for cell in row[1:])]
            shown.add_row(*(f"[bold]{escape(c.strip('*'))}[/]" if c.startswith("**") else escape(c)
                            for c in plain))
        print_rich(escape(table.title))
        print_rich(shown)


def page_files(path: Path | None) -> list[Path]:
    """The page and every picture that it may have beside it; nothing for None."""
    if path is None:
        return []
    names = ["methods", "methods-wall", "renderers", "material"]
    there = path.parent.glob(f"{glob.escape(path.stem)}-capture-*.svg")  # of whatever photos were left out
    return [path, *(path.with_name(f"{path.stem}-{name}.svg") for name in names), *sorted(there)]


def write_benchmark_page(path: str | Path, record: Mapping) -> list[Path]:
    """Write a Markdown page, and its pictures beside it under the page's own name.

    Args:
        path: the page, e.g. ``docs/benchmark.md``.
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.

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

    head = [f"# Benchmark: error against run time, {machine_of(record)}", "",
            "Written by `mitsvbrdf bench --page`, nothing by hand.", ""]
    whole = picture("methods", methods_figure(record), "Error against the seconds of the loop, all methods")
    wall = picture("methods-wall", methods_figure(record, wall=True), "Error against seconds on the wall, "
                                                                      "all methods")
    whole += folded("The same by the clock on the wall", wall)
    sections = [line for protocol in summary.for_readers(record) for line in _methods(protocol, picture)]
    lines = [*head, *in_short(record), *whole, *sections, *_start(record), *_renderers(record, picture),
             *_ablation(record), *_capture(record), *_how(record)]
    files.write_bytes(path, "\n".join(lines).encode())
    for name, data in pictures.items():
        files.write_bytes(path.with_name(name), data)
    return [path, *(path.with_name(name) for name in pictures)]


def markdown(table: Table | None, level: str = "###") -> list[str]:
    """A table as lines of Markdown under its title, in bold without a ``level``; none for None."""
    if table is None:
        return []
    lines = [f"{level} {table.title}" if level else f"**{table.title}**", ""]
    lines += [f"| {' | '.join(table.heads)} |", "|---" + "|---:" * (len(table.heads) - 1) + "|"]
    lines += [f"| {' | '.join(row)} |" for row in table.rows]
    return [*lines, "", *([table.note, ""] if table.note else [])]


def made_on(record: Mapping) -> str:
    """On what machine, with which versions and settings the records were made, in sentences."""
    m, v, s = record["machine"], record["versions"], record["settings"]
    model = m.get("model") or m.get("cpu")
    memory = f", {m['memory_gib']} GiB" if m.get("memory_gib") else ""
    packages = ", ".join(f"{name} {v[name]}" for name in ("mitsuba", "drjit", "torch", "python")
                         if v.get(name))
    code = ", ".join([s["code"], *(f"of `{name}` {digits}" for name, digits in codes(record).items())])
    sizes = " and ".join(map(str,
                             sorted({r["config"]["resolution"] if r["suite"] == "schedule"
                                     else s["resolution"] for r in record["records"]}) or [s["resolution"]]))
    return (f"Machine: {model}, {m['cores']} cores{memory}, {m['system']}. Versions: {packages}, "
            f"{m.get('libllvm') or 'libLLVM unknown'}; code {code}. Fits: {sizes} px, through "
            f"`{s['renderer']}`"
            + (f", seeds {', '.join(map(str, record['seeds']))}" if record["seeds"] else "") + "."
            + _at_a_time(record))


def machine_of(record: Mapping) -> str:
    """The processor's name, short."""
    name = record["machine"].get("model") or record["machine"].get("cpu")
    return str(name or "a processor unknown").replace("(R)", "").removesuffix(" Processor")


def codes(record: Mapping) -> dict[str, str]:
    """The digits of each method's own code, by its name, where the records state them; all where these are of
    several.
    """
    # presets have their method's
    names = {type(config).__name__: name for name, config in reversed(method_table().items())}
    stated = dict.fromkeys((each["class"], each["code"]) for each in configs_of(record) if "code" in each)
    found: dict[str, list[str]] = {}
    for kind, digits in stated:
        if kind in names:
            found.setdefault(names[kind], []).append(digits)
    return {name: " and ".join(all_digits) for name, all_digits in found.items()}


def configs_of(record: Mapping) -> list[Mapping]:
    """The settings of all fits by a method's code alone; of pairs of fits both. Other suites have code of
    their own besides.
    """
    both = [each for r in record["records"] for each in ((r["config"],) if "budget" in r
                                                         else r["config"].values())]
    return [each for each in both if isinstance(each, Mapping) and "class" in each]


def _at_a_time(record: Mapping) -> str:
    """How many jobs shared the machine, where any did."""
    shared = [r["workers"] for r in record["records"] if r.get("workers", 1) > 1]
    if not shared:
        return ""
    least, most = min(shared), max(shared)
    at_a_time = most if least == most else f"{least} to {most}"
    return (f" {len(shared)} of {len(record['records'])} records were made {at_a_time} at a time "
            "(`--workers`): their "
            "times are those of a shared machine.")


def left_out_by(protocol: Mapping) -> str:
    """The numbers of the photos that fits of real captures did not see, in words, of one of
    :func:`summary.views`.
    """
    return listed([str(i) for i in protocol["left_out"]])


def _methods(protocol: Mapping, picture: Picture) -> list[str]:
    """The section of the known materials, or of the real captures of which the same photos were left out."""
    lines: list[str] = []
    for kind in KINDS:
        fits = summary.of(protocol["records"], "methods", kind)
        if not fits:
            continue
        names = summary.names(fits)
        heading, text = ("Known materials", KNOWN) if kind == "material" else _of_captures(protocol, names)
        lines += [f"## {heading}", "", f"{text} {plural(len(names), KINDS[kind])}: {', '.join(names)}.", ""]
        for table in equal_time(protocol):
            lines += markdown(table)
        lines += picture(_picture_of(kind, protocol.get("left_out", ())), each_figure(protocol, kind),
                         "Errors, one by one")
        lines += [line for table in (*([each_map(protocol)] if kind == "material" else []),
                                     *equal_error(protocol))
                  for line in markdown(table)]
        each = [each_one(protocol, kind, error, title) for error, title in ERRORS[kind].items()]
        passed = passing(protocol) if kind == "capture" else None
        rest = [looks(protocol, kind), *ladders(protocol), *wall_time(protocol)]
        for title, tables in ((f"Each {kind}", [*each, passed]),
                              ("How different pictures look, seconds to other errors, seconds on the wall",
                               rest)):
            lines += folded(title, [line for table in tables for line in markdown(table, "")])
    return lines


def _of_captures(protocol: Mapping, names: Sequence[str]) -> tuple[str, str]:
    """Heading and words of a section of real captures."""
    numbers, published = left_out_by(protocol), protocol["published"]["capture"]
    whose = dict.fromkeys(who for name in names for who in published.get(name, {}))
    blind = [who.removesuffix(BLIND) for who in whose if who.endswith(BLIND)]
    text = CAPTURED.format(numbers) + (NOBODY.format(listed(blind)) if blind else "")
    return f"Real captures without photos {numbers}", text + (UNFAIR if len(blind) < len(whose) else "")


def folded(title: str, lines: Sequence[str]) -> list[str]:
    """Lines that a reader opens; without headings, whose sections would not end where the fold does."""
    return ["<details>", f"<summary>{title}</summary>", "", *lines, "</details>", ""] if lines else []


def _picture_of(kind: str, left_out: Sequence[int]) -> str:
    return "-".join([kind, *map(str, left_out)])


def _start(record: Mapping) -> list[str]:
    lines = markdown(start_table(record))
    text = ("Every process runs one command, `mitsvbrdf fit`; the seconds on the wall are what a user "
            "waits. All other seconds "
            "of this page are of a warm process, after kernels are compiled.")
    return ["## From the start of a process to its end", "", text, "", *lines] if lines else []


def _renderers(record: Mapping, picture: Picture) -> list[str]:
    tables = renderer_tables(record)
    if not tables:
        return []
    lines = ["## Renderers", "", "Made inlaid wood, the flash 0.1 patch sides beside the lens, against the "
                                 "float64 twin "
             "`analytic64`; all renderers in turn, median and quartiles.", "",
             *picture("renderers", renderers_figure(record), "Error against run time of the renderers")]
    return lines + [line for table in tables for line in markdown(table)]


def _ablation(record: Mapping) -> list[str]:
    lines = [line for each in summary.protocols(record) for table in ablation_tables(each)
             for line in markdown(table)]
    return ["## Each ingredient off", "", *lines] if lines else []


def _capture(record: Mapping) -> list[str]:
    lines = [line for table in capture_tables(record) for line in markdown(table)]
    text = ("Known materials are photographed by a simulated phone (`synth --handheld`: a lens, its flash "
            "beside it, noise, "
            "JPEG); what `capture` makes of the photos is held against the truth. Cameras: distance from "
            "the truth over that "
            "to the patch, root mean square, without a sheet after the best similarity. Rectification: "
            "pixels of 512. Maps: "
            "mean of the four RMSEs, beside that of a fit of the same photos with the true views. Real "
            "captures: views taken "
            "away and found again by the fit; lateral in patch sides, after the best scale and shift. Left "
            "out, whatever "
            f"`--left-out` says: photos {listed(list(map(str, USUAL_LEFT_OUT)))}, predicted by fits of the "
            "others with the "
            "views given, refined or held.")
    return ["## From a phone to maps", "", text, "", *lines] if lines else []


def _how(record: Mapping) -> list[str]:
    return ["## How to reproduce", "", made_on(record), "",
            "Every point is a fit of its own with its own budget, for schedules follow the budget; seconds "
            "are the loop's own, "
            "after kernels are compiled, without what comes before and after it. A fit that ended by itself "
            "so early that a "
            "longer budget changes nothing stands for the longer ones too. Methods take turns. The paper's "
            "presets, "
            "`gan-one-stage` and `gan-two-stage`, need 20,000 and 25,000 iterations, hours, whatever the "
            "budget: the suite "
            "`schedule` runs them to their end. Real captures, known materials and published numbers lie in "
            "the folder that "
            "`MITSVBRDF_DATA` names.", "",
            *(f"    {line}" for line in (*commands(record),
                                         "mitsvbrdf bench --suite none --page benchmark.md")), ""]
