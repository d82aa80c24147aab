"""``mitsvbrdf stability``: renderers at the ends of every range; tables, JSON, pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table
from tyro.conf import arg

from ..errors import ConfigError
from ..io import files
from ..io.progress import print_rich, progress_bar, say, say_written
from ..render import RENDERERS, RendererName, make_renderer
from .options import Overwrite, Variant, check_new_files

Sweep = Literal["roughness", "tilt", "distance", "colour", "intensity", "clipped", "flat", "resolution",
                "views", "stiff"]
VERDICT_COLOURS = {"exact": "green", "clamped": "dim", "degraded": "yellow", "limited": "yellow",
                   "refused": "dim",
                   "wrong": "bold red", "not finite": "bold red"}


def stability(
    renderer: Annotated[Literal["all", "analytic", "mitsuba", "mitsuba-scene"],
                        arg(help="What to examine.")] = "all",
    only: Annotated[tuple[Sweep, ...], arg(help="Some sweeps alone.")] = (),
    json_file: Annotated[Path | None, arg(name="json", help="Write all figures to this file.")] = None,
    html_file: Annotated[Path | None,
                         arg(name="html", help="Write a page with verdicts, figures and plots.")] = None,
    md: Annotated[Path | None, arg(help="Write the tables into this Markdown file, between its marks if it "
                                        "has them.")] = None,
    variant: Variant = "llvm_ad_rgb",
    overwrite: Overwrite = False,
) -> int:
    """Sweep every parameter to its ends: errors, gradients, conditioning, step sizes, and a verdict on each
    renderer.

    About two minutes for everything. Exit code 1 when a value that is not finite came out of a public
    function, or a verdict is worse than expected; docs/stability.md explains the verdicts and every clamp.
    """
    from ..verify.stability import SWEEPS
    from ..verify.stability import stability as run

    check_new_files(json_file, html_file, overwrite=overwrite, read=[md])
    files.check_output(md)
    if md and (only or renderer != "all"):
        raise ConfigError("--md with every sweep and renderer", "--only or --renderer beside it",
                          "leave them out, or use --html: the page in the docs is replaced as a whole")
    if md:
        from ..report.stability_page import around_tables
        around_tables(md)  # refused now rather than after the work
    names: tuple[RendererName, ...] = RENDERERS if renderer == "all" else (renderer,)
    renderers = [make_renderer(name, variant) for name in names]
    with progress_bar("stability") as report:
        record = run(renderers, only or tuple(SWEEPS), report)
    if json_file:
        files.write_json(json_file, record)
    if html_file or md:
        from ..report.stability_page import write_stability_markdown, write_stability_page
        if html_file:
            write_stability_page(html_file, record)
        if md:
            write_stability_markdown(md, record)
    for key, title in record["sweeps"].items():
        print_rich(_table(title, [row for row in record["rows"] if row["sweep"] == key], record["renderers"]))
    say("Verdict, and relative L2 error of image or worst gradient, the larger; rounding: what one float32 "
        "rounding of "
        "the normals makes. exact: image within 1e-6, gradients within 1e-5; docs/stability.md explains the "
        "rest.")
    say_written(json_file, html_file, md)
    for found in record["violations"]:
        where = ", ".join(filter(None, (found["sweep"], found["label"], found["renderer"])))
        say(f"worse than expected: {where}: {found['what']}")
    count = len(record["violations"])
    say(f"{count} worse than expected" if count else "everything finite, and no verdict worse than expected")
    return 1 if count else 0


def _table(title: str, rows: list[dict], renderers: list[str]) -> Table:
    """Verdict and largest error of each renderer, beside what one rounding of the normals makes; fits 80
    columns.
    """
    from ..report.stability_page import largest

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("")
    for name in (*renderers, "rounding"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        cells = [f"[{VERDICT_COLOURS[found['verdict']]}]{found['verdict']}[/]{_figure(largest(found.get('errors', {}), None))}"
                 for found in row["renderers"].values()]
        table.add_row(row["label"], *cells, _figure(largest(row["limit"], None)))
    return table


def _figure(value: float | None) -> str:
    return "" if value is None else f" {value:.0e}"
