"""A stability run as a page and as the table of docs/stability.md; both show the numbers of the record and
compute none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ..errors import OutputError
from ..io import files
from ..io.files import file_lock
from ..verify.stability.clamps import CLAMPS
from ..verify.stability.verdict import VERDICTS
from .charts import BSDF_MARKS, bounded_panel, svg
from .colours import CHART_FAINT
from .page import figure, write_page

BEGIN, END = "<!-- from here on written by mitsvbrdf stability --md -->", "<!-- up to here -->"
PLOTTED = {"roughness": "roughness", "distance": "distance, patch sides",
           "tilt": "degrees between normal and plane"}
EXPLAINED_APART = ("limited", "refused", "wrong", "not finite")


def write_stability_page(path: str | Path, record: dict) -> None:
    """One self-contained HTML file: verdicts in colour, errors against roughness, distance and tilt, every
    clamp.

    Args:
        path: the file to write or replace.
        record: of :func:`mitsvbrdf.verify.stability.stability`.

    Raises:
        OutputError: the file cannot be written.
    """
    plots = [(key, svg(errors_along(record, key))) for key in PLOTTED if key in record["sweeps"]]
    counts = {name: Counter(row["renderers"][name]["verdict"] for row in record["rows"])
              for name in record["renderers"]}
    write_page(path, "report/stability.html", title="Numerical stability of the renderers",
               record=record,
               plots=plots, clamps=CLAMPS, counts=counts, verdicts=VERDICTS, worst=worst_errors,
               largest=largest, condition=condition_text, step=step_text, because=because)


def errors_along(record: dict, sweep: str) -> Figure:
    """Image error, and gradient error of the worst map, along a sweep, with what one rounding of the normals
    makes.

    Tilt is shown as the angle that is left to the horizon, so that the last decades are told apart.
    """
    drawing = Figure(figsize=(9, 3.6), layout="constrained")
    panels = drawing.subplots(1, 2, sharex=True)
    rows = [row for row in record["rows"] if row["sweep"] == sweep and row["value"] is not None]
    colours = {name: matplotlib.colormaps["tab10"](i % 10) for i, name in enumerate(record["renderers"])}
    named: set[str] = set()
    for row in rows:
        x = max(90 - row["value"], 0.05) if sweep == "tilt" else row["value"]
        series: list[tuple[str, Any, str, Any]]
        series = [("one rounding of the normals", CHART_FAINT, "_",
                   (row["limit"]["image"], largest(row["limit"])))]
        series += [(f"{name}, {row['bsdf']}", colours[name], BSDF_MARKS[row["bsdf"]], worst_errors(figures))
                   for name, figures in row["renderers"].items()]
        for label, colour, marker, values in series:
            for panel, value in zip(panels, values):
                if value:
                    panel.plot(x, value, marker, color=colour, markersize=10 if marker == "_" else 4,
                               alpha=0.8, linestyle="none", label=None if label in named else label)
                    named.add(label)
    stated = record["tolerances"]
    for panel, title, bound in zip(panels, ("Image, relative L2", "Gradient of the worst map, relative L2"),
                                   (stated["image"], stated["gradient"])):
        bounded_panel(panel, title, bound)
        panel.set(xscale="log", yscale="log", xlabel=PLOTTED[sweep])
        if sweep == "tilt":
            panel.invert_xaxis()
    drawing.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return drawing


def write_stability_markdown(path: str | Path, record: dict) -> None:
    """Write the tables into a Markdown file: between the two marks where it has them, else as a new file.

    Raises:
        OutputError: the file is there but has no marks, or cannot be written.
    """
    text = "\n".join([BEGIN, *_markdown(record), END])
    with file_lock(Path(path)):
        before, after = around_tables(path)
        files.write_bytes(Path(path), (before + text + after).encode(errors="surrogateescape"))


def around_tables(path: str | Path) -> tuple[str, str]:
    """What stands before and after the two marks in a Markdown file; a title and nothing where there is no
    file.

    Raises:
        OutputError: the file is there but has no marks.
    """
    path = Path(path)
    if not path.is_file() or not path.stat().st_size:
        return "# Numerical stability\n\n", "\n"
    before, begin, rest = path.read_text(encoding="utf-8", errors="surrogateescape").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end or BEGIN in rest or END in before + after:
        raise OutputError(f"a file with the marks {BEGIN} and {END}", f"{path} without them",
                          "name a new file, or put them in")
    return before, after


def _markdown(record: dict) -> Iterator[str]:
    versions = ", ".join(f"{name} {record['versions'][name]}" for name in ("mitsuba", "drjit", "torch"))
    yield f"\nMeasured with {versions}. Errors: image / gradient of the worst map, relative L2."
    heads = ("", "condition", "one rounding", "float64", "step", *record["renderers"], "because")
    for key, title in record["sweeps"].items():
        yield f"\n### {title}\n"
        yield f"| {' | '.join(heads)} |"
        yield "|---" * len(heads) + "|"
        for row in record["rows"]:
            if row["sweep"] == key:
                cells = (condition_text(row), _pair((row["limit"].get("image"), largest(row["limit"]))),
                         figure(largest(row["fifty_digits"], None)), step_text(row),
                         *(_cell(figures) for figures in row["renderers"].values()), because(row))
                yield f"| {row['label']} | {' | '.join(cells)} |"
    yield "\n### Every clamp\n"
    yield "| cut | where | why |\n|---|---|---|"
    for clamp in CLAMPS:
        yield f"| {clamp.name} | {clamp.where} | {clamp.why} |"


def _cell(figures: dict) -> str:
    return figures["verdict"] + (f", {_pair(worst_errors(figures))}" if "errors" in figures else "")


def because(row: dict) -> str:
    """The clamps that act, and what makes a renderer worse than its conditioning; the same cause is said
    once.
    """
    causes: dict[str, list[str]] = {}
    for name, figures in row["renderers"].items():
        if figures["verdict"] in EXPLAINED_APART:
            why = figures["why"].rpartition(": ")[0] if figures["verdict"] == "limited" else figures["why"]
            causes.setdefault(why, []).append(name)
    said = [why if len(names) == len(row["renderers"]) else f"{', '.join(names)}: {why}"
            for why, names in causes.items()]
    return "; ".join([*row["clamps"], *said])


def worst_errors(figures: dict) -> tuple[float | None, float | None]:
    """The error of the image, and of the worst map's gradient; None for infinite or refused."""
    if "errors" not in figures:
        return None, None
    return figures["errors"]["image"], largest(figures["errors"])


def largest(errors: dict, image: str | None = "image") -> float | None:
    """The largest of errors by name, the image left out; None where one is infinite or there is none."""
    values = [value for name, value in errors.items() if name != image]
    return None if not values or None in values else max(values)


def condition_text(row: dict) -> str:
    """Median and worst condition number, or the rank where unknowns cannot be told apart."""
    found = row["condition"]
    if found is None:
        return "–"
    if found["median"] is None:
        return f"rank {found['rank']} of {found['unknowns']}"
    return f"{figure(found['median'])}, worst {'∞' if found['worst'] is None else figure(found['worst'])}"


def step_text(row: dict) -> str:
    """The largest step of float64, and by which factor the renderers' differ; a dash where it was not looked
    for.
    """
    if not any("step" in figures for figures in row["renderers"].values()):
        return "–"
    if row["step"] is None:
        return "∞"
    factors = sorted({figures["step"] / row["step"] for figures in row["renderers"].values()
                      if figures.get("step")} - {1.0}
                     if row["step"] else ())
    return figure(row["step"]) + (f" (x {', '.join(f'{f:g}' for f in factors)})" if factors else "")


def _pair(values: tuple[float | None, float | None]) -> str:
    return " / ".join(figure(value) for value in values)
