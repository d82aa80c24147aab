"""``mitsvbrdf stability``: renderers at the ends of every range, fits that are asked too much; tables, JSON,
pages.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table
from tyro.conf import arg

from ..errors import ConfigError
from ..io import files
from ..io.progress import print_rich, progress_bar, say, say_written
from ..render import RENDERERS, RendererName, make_renderer
from .measuring import measure
from .options import Overwrite, Variant, check_new_files

Sweep = Literal["roughness", "tilt", "distance", "colour", "intensity", "clipped", "flat", "resolution",
                "views", "stiff"]
Method = Literal["hierarchical", "hybrid", "direct", "gan"]
VERDICT_COLOURS = {"exact": "green", "clamped": "dim", "degraded": "yellow", "limited": "yellow",
                   "refused": "dim",
                   "wrong": "bold red", "not finite": "bold red"}


def stability(
    renderer: Annotated[Literal["all", "analytic", "mitsuba", "mitsuba-scene"],
                        arg(help="What to examine; what the fits render with, mitsuba where it is left out.")] = "all",
    only: Annotated[tuple[Sweep, ...], arg(help="Some sweeps alone.")] = (),
    json_file: Annotated[Path | None, arg(name="json", help="Write all figures to this file; with --fits, "
                                                            "go on with the file "
                                                            "that is there, out/stability-fits.json.")] = None,
    html_file: Annotated[Path | None,
                         arg(name="html", help="Write a page with verdicts, figures and plots.")] = None,
    md: Annotated[Path | None, arg(help="Write the tables into this Markdown file, between its marks if it "
                                        "has them; with "
                                        "--fits the whole page, its picture beside it.")] = None,
    fits: Annotated[Literal["all", "quick", "none"] | None,
                    arg(help="Fit stiff scenes instead; quick: one seed, 5 s a fit; none: only make the "
                             "page anew.")] = None,
    methods: Annotated[tuple[Method, ...], arg(help="Of the fits; left out: all.")] = (),
    budget: Annotated[float | None, arg(help="Seconds of a fit at most; left out: 20.")] = None,
    resolution: Annotated[int, arg(help="Side of maps and photos in the fits.")] = 64,
    workers: Annotated[int | None, arg(help="Do so many fits at a time, on the workers of `mitsvbrdf "
                                            "batch`; their times are "
                                            "then those of a shared machine. Needs Ray.")] = None,
    anew: Annotated[bool, arg(help="Forget the fits that are there.")] = False,
    variant: Variant = "llvm_ad_rgb",
    overwrite: Overwrite = False,
) -> int:
    """Sweep every parameter to its ends: errors, gradients, conditioning, step sizes, and a verdict on each
    renderer.

    About two minutes for everything. Exit code 1 when a value that is not finite came out of a public
    function, or a verdict is worse than expected; docs/stability.md explains the verdicts and every clamp.

    --fits examines the methods instead: extreme materials, wrong calibration, photos that say little, several
    at once. Exit code 1 when a fit failed. Each fit is kept as soon as it is done: Ctrl-C loses one, and the
    same command goes on.
    """
    if fits is None:
        if methods or budget is not None or anew or workers is not None:
            raise ConfigError("--fits beside --methods, --budget, --workers and --anew", "no --fits",
                              "add --fits all, or quick")
        return _renderers(renderer, only, json_file, html_file, md, variant, overwrite)
    if only or html_file:
        raise ConfigError("--json and --md beside --fits", "--only or --html",
                          "leave them out: sweeps are of renderers")
    return _fits(fits, Path("out/stability-fits.json") if json_file is None else json_file, md, methods,
                 budget, resolution,
                 "mitsuba" if renderer == "all" else renderer, variant, workers, anew, overwrite)


def _fits(which: Literal["all", "quick", "none"], json_file: Path, md: Path | None,
          methods: tuple[Method, ...],
          budget: float | None, resolution: int, renderer: RendererName, variant: str, workers: int | None,
          anew: bool, overwrite: bool) -> int:
    """The fits of stiff scenes that the file lacks, the verdicts on all, and the page."""
    from ..bench.stiff.fits import SHAPING, StiffPlan
    from ..bench.stiff.page import failures, print_verdicts, stiff_page_files, write_stiff_page
    from ..bench.stiff.scenes import digest
    from ..bench.store import Store, read_benchmark

    check_new_files(*stiff_page_files(md), overwrite=overwrite, read=[json_file])
    files.check_output(json_file)
    lost: Mapping[str, str] | None = {}
    if which == "none":
        record = read_benchmark(json_file)
        if record["settings"].get("scenes") != digest():
            raise ConfigError("the fits of these scenes", f"others in {json_file}",
                              "run --fits all or quick, with --anew")
    else:
        plan = StiffPlan(which == "quick", methods, budget, resolution, renderer, variant)
        jobs, settings, _ = plan.jobs()
        store = Store(json_file, settings, anew, SHAPING)
        lost = measure(plan, jobs, store, workers)
        if lost is None:
            return 130
        record = store.content
    print_verdicts(record)
    if md:
        say_written(*write_stiff_page(md, record))
    failed = failures(record)
    for each in failed:
        say(f"failed: {each}")
    return int(bool(failed or lost))


def _renderers(renderer: Literal["all"] | RendererName, only: tuple[Sweep, ...], json_file: Path | None,
               html_file: Path | None, md: Path | None, variant: str, overwrite: bool) -> int:
    """The sweeps of the renderers."""
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
