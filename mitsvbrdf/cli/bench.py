"""``mitsvbrdf bench``: error of the methods against run time."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import arg

from ..bench.run import method_table, run
from ..bench.table import Judged, judged, markdown, table
from ..bench.tasks import data_folder, find_tasks
from ..errors import ConfigError
from ..fit.methods import METHODS
from ..io import files
from ..io.progress import figures_table, print_rich, progress_bar, say, say_written
from ..render import RendererName, make_renderer
from .options import Overwrite, Variant, check_new_files, check_side, chosen

T = TypeVar("T")
Names = Annotated[str | None, arg(metavar="NAME,...")]


def bench(
    methods: Annotated[Names, arg(
        help="Methods, or presets like gan-two-stage. Default: the methods of `mitsvbrdf fit`.")] = None,
    materials: Annotated[Names, arg(help=(
        "Known materials: builtin:NAME, folders, or names in the data folder. none: no material. Default: "
        "all built-in ones and all in the data folder."))] = None,
    captures: Annotated[Names, arg(
        help="Real captures: folders, or names in the data folder. none: no capture. Default: all.")] = None,
    budgets: Annotated[str, arg(metavar="SECONDS,...", help="Time budgets of the fits.")] = "10,30,100",
    seeds: Annotated[str, arg(metavar="NUMBER,...", help="Seeds of the fits.")] = "0,1,2",
    resolution: Annotated[int, arg(help="Side of maps and photos in pixels.")] = 256,
    views: Annotated[str | None, arg(help=(
        "Views for the photos of known materials: a capture, or builtin:grid. Default: the capture "
        "cards-blue in the data folder, else builtin:grid."))] = None,
    held_out: Annotated[str, arg(
        metavar="NUMBER,...", help="Photos to hold out of real captures. Their error is measured.")] = "4,7",
    data: Annotated[Path | None, arg(
        help="Data folder: captures/, materials/. Default: environment variable MITSVBRDF_DATA.")] = None,
    json_file: Annotated[Path, arg(
        name="json", help="File of the measurements: one JSON object a line. New ones are appended.",
    )] = Path("out/bench.jsonl"),
    page: Annotated[Path | None, arg(
        help="Write the tables to this Markdown file, and their plot as an SVG file beside it.")] = None,
    renderer: Annotated[RendererName, arg(help="Renderer of the fits.")] = "mitsuba",
    variant: Variant = "llvm_ad_rgb",
    overwrite: Annotated[Overwrite, arg(help="Replace an earlier page; records stay.")] = False,
) -> int:
    """Measure error against run time: methods x materials and captures x budgets x seeds.

    The errors of known materials are those of maps and of images under new light. The error of real captures
    is that of held-out photos. The tables show the median over seeds.

    Each measurement is written when its fit ends. Ctrl-C loses one fit at most, and the same command
    continues. Run nothing else on the machine meanwhile. docs/evaluation.md explains the errors.
    """
    files.check_output(json_file, page)
    picture = page.with_suffix(".svg") if page else None
    check_new_files(page, picture, overwrite=overwrite, read=[json_file])
    check_side(resolution)
    times = _numbers("--budgets", budgets, float, lambda x: 0 < x < math.inf, "10,30")
    draws = _numbers("--seeds", seeds, int, lambda x: 0 <= x < 2**32, "0,1,2")
    unseen = sorted(_numbers("--held-out", held_out, int, lambda x: x >= 0, "4,7"))
    every = method_table()
    names = list(METHODS) if methods is None else chosen("--methods", methods, every)
    folder, engine = data_folder(data), make_renderer(renderer, variant)
    known, real = (None if asked is None else _split(asked) for asked in (materials, captures))
    todo = find_tasks(known, real, folder, resolution, unseen, views, engine)
    try:
        with progress_bar("measuring") as report:
            chosen_methods = {name: every[name] for name in names}
            records = run(chosen_methods, todo, times, draws, engine, json_file, report)
    except KeyboardInterrupt:
        say(f"interrupted: {json_file} has every fit that ended; the same command continues")
        return 130
    groups = list(judged(records))
    _print(groups)
    failed = [r for r in records if r["stopped"] == "failed"]
    for record in failed:
        say(f"failed: {record['method']}, {record['name']}, {record['budget']:g} s: {record['why']}")
    if not groups:  # every fit failed
        page = picture = None
    if page and picture:
        _write(page, picture, groups)
    say_written(json_file, page, picture)
    return int(bool(failed))


def _print(groups: list[Judged]) -> None:
    for group in groups:
        cells = table(group)
        shown = figures_table(group.title, list(cells.columns))
        for name, row in cells.iterrows():
            shown.add_row(*(cell.replace("**", "").replace("`", "") for cell in (str(name), *row)))
        print_rich(shown)


def _write(page: Path, picture: Path, groups: list[Judged]) -> None:
    from ..bench.plot import plot, svg

    files.write_bytes(picture, svg(plot(groups)))
    text = f"# Error against run time\n\n![Error against seconds]({picture.name})\n\n{markdown(groups)}"
    files.write_bytes(page, text.encode())


def _split(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _numbers(option: str, text: str, kind: Callable[[str], T], valid: Callable[[T], bool],
             example: str) -> list[T]:
    try:
        numbers = list(dict.fromkeys(map(kind, _split(text))))
    except ValueError:
        numbers = []
    if not numbers or not all(map(valid, numbers)):
        raise ConfigError(f"{option} like {example}", repr(text), "separate numbers by commas")
    return numbers
