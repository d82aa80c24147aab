"""``mitsvbrdf stability``: test the renderers at the ends of every range; write tables and JSON."""

from typing import Annotated, Literal

from rich.table import Table
from tyro.conf import arg

from ..io import files
from ..io.progress import figures_table, print_rich, progress_bar, say, say_written
from ..render import RENDERERS, make_renderer
from ..verify.stability import SWEEPS
from ..verify.stability import stability as run
from .options import JsonFile, Overwrite, Variant, check_new_files

Sweep = Literal["roughness", "tilt", "distance", "colour", "intensity", "clipped", "flat", "resolution",
                "views", "stiff"]
VERDICT_COLOURS = {"exact": "green", "clamped": "dim", "degraded": "yellow", "limited": "yellow",
                   "refused": "dim", "wrong": "bold red", "not finite": "bold red"}


def stability(
    renderer: Annotated[Literal["all", "analytic", "mitsuba", "mitsuba-scene"],
                        arg(help="Which renderer to examine.")] = "all",
    only: Annotated[tuple[Sweep, ...], arg(help="Run only these sweeps.")] = (),
    json_file: JsonFile = None, variant: Variant = "llvm_ad_rgb", overwrite: Overwrite = False,
) -> int:
    """Sweep every parameter to the ends of its range, and give a verdict on each renderer.

    Each case compares image and gradients with float64. The JSON file also has condition numbers. All
    sweeps take about two minutes. The exit code is 1 when a value is not finite or a verdict is worse than
    expected. docs/results/stability.md explains the verdicts and every clamp.
    """
    check_new_files(json_file, overwrite=overwrite)
    renderers = [make_renderer(name, variant) for name in (RENDERERS if renderer == "all" else (renderer,))]
    with progress_bar("stability") as report:
        record = run(renderers, only or tuple(SWEEPS), report)
    if json_file:
        files.write_json(json_file, record)
    for key, title in record["sweeps"].items():
        print_rich(_table(title, [row for row in record["rows"] if row["sweep"] == key], record["renderers"]))
    say("Each cell: the verdict, and the relative L2 error of the image or the worst gradient. rounding:\n"
        "what one float32 rounding of the normals changes. exact: image within 1e-6, gradients within 1e-5.\n"
        "docs/results/stability.md explains the other verdicts.")
    say_written(json_file)
    for found in record["violations"]:
        say(f"worse than expected: {found['sweep']}, {found['label']}, {found['renderer']}: {found['what']}")
    count = len(record["violations"])
    say(f"{count} worse than expected" if count else "everything finite, and no verdict worse than expected")
    return 1 if count else 0


def _table(title: str, rows: list[dict], renderers: list[str]) -> Table:
    """A row a case: verdict and largest error of each renderer, and the effect of one rounding."""
    table = figures_table(title, [*renderers, "rounding"])
    for row in rows:
        cells = [(found["verdict"], _largest(found.get("errors", {}))) for found in row["renderers"].values()]
        table.add_row(row["label"], *(f"[{VERDICT_COLOURS[word]}]{word}[/]{error}" for word, error in cells),
                      _largest(row["limit"]))
    return table


def _largest(errors: dict[str, float | None]) -> str:
    values = [value for value in errors.values() if value is not None]
    return f" {max(values):.0e}" if values and len(values) == len(errors) else ""
