"""``docs/results/gan.md``: the tables of the paper's section IV beside the same columns measured here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...io import files
from ...report.charts import svg_file
from .. import summary
from ..commands import commands
from ..page import left_out_by, made_on, markdown, print_tables
from ..tables import Table
from ..variants import FULL, GAN_VARIANTS
from . import tables
from .plots import schedule_figure

NOT_RUN = "Not in these records: "

INTRODUCTION = (
    "The errors are RMSE of maps encoded to 0 to 1, counted as in the paper: diffuse and specular by gamma "
    "2.2, roughness as "
    "stored, normals as (n + 1) / 2. The columns are those of its tables 1 and 2. `gan` is the paper's "
    "method with "
    "ingredients of our own; `hierarchical` is the default method of this program.")
NOT_COMPARABLE = (
    "The materials of sets 4 and 5 are not published: these rows cannot be measured again, and no row below "
    "is on the same "
    "material. They stand here for their order of size.")
MEASURED = (
    "Photos are made of known maps, nine views, 8 bits, without noise. *Published maps* are those that the "
    "authors of a method "
    "recovered from photos of their own and published; their error is measured here, at the size of the "
    "fits, and their run "
    "time is not known. Guessed diffuse: the error of the guess that the fit of that row was given, `min` "
    "in the paper's rows, "
    "`robust` in the others. `gan-two-stage` has here the same seconds as the other rows, which is a small "
    "part of the paper's "
    "schedule; the schedule has its own section.")
PICTURES = (
    "From left to right: the input photo; diffuse, specular, roughness and normal; the guessed diffuse map; "
    "a rendering of the "
    "photo's view; and one lit from the side, as no photo was.")
START = (
    "`gan` starts at the robust guess, one specular level and one roughness for all texels, and flat "
    "normals. What it is worth "
    "is what it takes off the error of this start.")
GAME = ("The same method, budget, materials and seeds; without the adversarial loss, only the diffuse loss "
        "and the smoothness "
        "of specular and roughness are left.")
INGREDIENTS = ("`full` is `gan` as it was in these records. Counted are the materials, budgets and seeds "
               "that every row "
               "has. A fit keeps the state that met its photos best, which may be its start: such rows are "
               "equal.")
EARLIER = (" Rows of an earlier version: {}. Today's program does not know them, and refuses the command "
           "below that names "
           "them; what such a row puts in, `full` may have today.")
CAPTURES = (
    "RMSE in display values. Photos {} are left out of every fit and predicted with the flash offset it "
    "found. MaterialGAN, "
    "trained on a large data set, saw all nine photos, those two as well; a method *without them* did not.")
SCHEDULE = (
    "The paper's training: 10,000 iterations on one picture and 15,000 on the photos, or as many as each "
    "row says in the same "
    "proportion, at a size that a CPU can do. The paper states 3 hours a material on a P100 GPU for 20,000 "
    "iterations in one "
    "stage, and 2 hours for the second of two.")


def gan_page_files(path: Path | None) -> list[Path]:
    """The page and the picture that it may have beside it; nothing for None."""
    return [path, path.with_name(f"{path.stem}-schedule.svg")] if path else []


def write_gan_page(path: str | Path, record: Mapping) -> list[Path]:
    """Write the page, and its pictures beside it under the page's own name.

    Args:
        path: the page, e.g. ``docs/results/gan.md``.
        record: a :class:`mitsvbrdf.bench.records.Benchmark`; what it lacks is named in the end.

    Returns:
        Every file that was written, the page first.

    Raises:
        OutputError: a file cannot be written.
    """
    path, curve = gan_page_files(Path(path))
    drawing = schedule_figure(summary.usual(record))
    files.write_bytes(path, gan_page(record, curve.name).encode())
    if drawing is None:
        return [path]
    files.write_bytes(curve, svg_file(drawing))
    return [path, curve]


def gan_page(record: Mapping, curve: str) -> str:
    """The page as Markdown.

    Args:
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.
        curve: the file of the schedule's picture.
    """
    everything, record = record, summary.usual(record)
    start, schedule = tables.start_and_end(record), tables.schedule_tables(record)
    sections: dict[str, tuple[str, Sequence[Table | str]]] = {
        "What the paper prints": (NOT_COMPARABLE, tables.printed_tables(record)),
        "The same columns, measured here": (MEASURED, tables.measured_tables(record)),
        "Pictures": (PICTURES, _sheets(record)),
        "From the start to the end": (START, [start] if start else []),
        "With and without the adversarial loss": (GAME, tables.game_tables(record)),
        "Each ingredient": (INGREDIENTS + _earlier(record), tables.ingredient_tables(record)),
        "Real captures": (CAPTURES.format(left_out_by(record)), tables.capture_tables(record)),
        "The paper's full schedule": (SCHEDULE, [*schedule, f"![Errors against the iteration]({curve})"]
                                      if schedule else []),
        "Seconds of an iteration": ("", tables.step_tables(record))}
    lines = ["# The paper's tables, reproduced", "",
             f"Written by `mitsvbrdf bench --gan-page`, nothing by hand. {made_on(record)}", "", INTRODUCTION,
             ""]
    for heading, (text, found) in sections.items():
        if found:
            lines += [f"## {heading}", "", *([text, ""] if text else [])]
            lines += [line for part in found for line in ([part, ""] if isinstance(part, str)
                                                          else markdown(part))]
    missing = [heading.lower() for heading, (_, found) in sections.items() if not found]
    lines += [NOT_RUN + "; ".join(missing) + ".", ""] if missing else []
    lines += ["## How to reproduce", "", *(f"    {line}" for line in _commands(everything)), ""]
    return "\n".join(lines)


def print_gan(record: Mapping) -> None:
    """The tables of materials, of the adversarial loss, of ingredients and of iterations on the terminal,
    without spreads.
    """
    record = summary.usual(record)
    print_tables([*tables.measured_tables(record), *tables.game_tables(record),
                  *tables.ingredient_tables(record), *tables.step_tables(record)])


def _sheets(record: Mapping) -> list[str]:
    return [f"![Maps and renderings of {r['name']}]({r['file']})" for r in record["records"]
            if r["suite"] == "sheets"]


def _earlier(record: Mapping) -> str:
    """Which variants are none today, in a sentence."""
    known = {FULL, *GAN_VARIANTS}
    gone = dict.fromkeys(r["method"] for r in record["records"] if r["suite"] == "gan"
                         and r["method"] not in known)
    return EARLIER.format(", ".join(f"*{name}*" for name in gone)) if gone else ""


def _commands(record: Mapping) -> list[str]:
    return [*commands(record), "mitsvbrdf bench --suite none --gan-page gan.md"]
