"""``mitsvbrdf crosscheck``: compare every renderer with float64; write tables, JSON and a page."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from rich.table import Table
from tyro.conf import Positional, arg

from ..errors import ConfigError
from ..io import files
from ..io.progress import figures_table, print_rich, progress_bar, say, say_written
from ..material.corner_cases import builtin_materials
from ..material.maps import Bsdf
from ..render import RENDERERS, make_renderer
from ..report.page import figure, seconds
from ..verify import crosscheck as checks
from ..views import shift_lights
from . import options


def crosscheck(
    maps: Positional[Annotated[str | None, arg(metavar="MAPS", help=(
        "A folder of maps, OUT of a fit, or builtin:NAME. Default: built-in materials and corner cases."))]
    ] = None,
    views: options.ViewSource = "builtin:grid", encoding: options.MapEncoding = (),
    normal: options.MapNormal = "auto",
    bsdf: Annotated[Literal["all", "roughconductor", "principled"],
                    arg(help="BSDF to render with. The maps are converted to it.")] = "all",
    renderer: Annotated[Literal["all", "mitsuba", "mitsuba-scene", "analytic"],
                        arg(help="Which renderer to compare.")] = "all",
    json_file: options.JsonFile = None,
    html_file: Annotated[Path | None, arg(
        name="html", help="Write a page with figures and error maps.")] = None,
    repeats: Annotated[int, arg(help="Timed passes of each configuration. Configurations take turns.")] = 5,
    resolution: Annotated[int | None, arg(
        help="Side of the maps. Larger maps are area-averaged. Default: 256; without MAPS 128.")] = None,
    variant: options.Variant = "llvm_ad_rgb", overwrite: options.Overwrite = False,
) -> int:
    """Compare every renderer and BSDF with the renderer analytic64 (float64): images, gradients, run time.

    The exit code is 1 if a stated tolerance is violated. docs/evaluation.md explains the figures.
    """
    if repeats < 1:
        raise ConfigError("--repeats of 1 or more", str(repeats), "try 5")
    options.check_side(resolution)
    options.check_new_files(json_file, html_file, overwrite=overwrite, read=[maps], photos=views)
    fit = options.fit_of_maps(maps)
    if maps is None:
        materials = builtin_materials(resolution or 128)
    else:
        svbrdf = options.material_of(maps, resolution or 256, encoding, normal)
        materials = {options.name_of(maps): svbrdf.resized(min(resolution or 256, svbrdf.resolution))}
    names, lit = options.views_of(views, fit.falloff)
    say(f"{len(names)} views of {views}")
    if offset := fit.flash_offset:
        say(f"with the flash offset of the fit, ({offset[0]:.3f}, {offset[1]:.3f}) patch sides")
    lit = shift_lights(lit, offset)
    bsdfs: list[Bsdf] = list(get_args(Bsdf)) if bsdf == "all" else [bsdf]
    renderers = [make_renderer(name, variant) for name in (RENDERERS if renderer == "all" else (renderer,))]
    error_maps: dict = {}
    command = {"maps": maps and Path(maps).name, "views": Path(views).name, "bsdf": bsdf,
               "renderer": renderer, "repeats": repeats, "resolution": resolution, "variant": variant}
    with progress_bar("crosscheck") as report:
        record = checks.crosscheck(materials, lit, bsdfs, renderers, repeats, names=names,
                                   transfer=fit.transfer or "gamma2.2", error_maps=error_maps, report=report,
                                   command=command)
    if json_file:
        files.write_json(json_file, record)
    if html_file:
        from ..report.crosscheck_page import write_crosscheck_page
        write_crosscheck_page(html_file, record, error_maps)
    _print(record)
    say_written(json_file, html_file)
    for found in record["violations"]:
        limit = f" (float32 limit {figure(found['limit'])})" if found["limit"] else ""
        say(f"exceeded: {found['material']} · {found['bsdf']} · {found['renderer']}: {found['what']} "
            f"{found['value']:.3g} > {figure(found['tolerance'])}{limit}")
    count = len(record["violations"])
    say(f"{count} figures exceed the stated tolerances" if count else "all stated tolerances hold")
    return 1 if count else 0


def _print(record: dict) -> None:
    for bsdf, how in dict.fromkeys(pair for m in record["materials"].values()
                                   for pair in m["converted"].items()):
        say(f"as {bsdf}: {how}")
    for texels, bsdf in dict.fromkeys((row["texels"], row["bsdf"]) for row in record["summary"]):
        rows = [row for row in record["summary"] if (row["texels"], row["bsdf"]) == (texels, bsdf)]
        print_rich(_table(record, texels, bsdf, rows))
    for each in checks.omitted(record):
        say(f"omitted by {each['by']}: {each['what']} ({each['why']})")


def _table(record: dict, texels: str, bsdf: str, rows: list[dict]) -> Table:
    """The summary of one BSDF and one class of texels: a row for each figure, a column for each renderer."""
    count = rows[0]["materials"]
    bound = f"{'>=' if texels == 'rough' else '<'} {record['rough_from']}"
    of = f", worst of {count} materials" if count > 1 else ""
    table = figures_table(f"{bsdf}, texels of roughness {bound}{of}",
                          ["tolerance", "float32 limit", *(row["renderer"] for row in rows)])
    stated = record["tolerances"] if texels == "rough" else {"image": {}, "gradients": {}}

    def add(label: str, tolerance: float | None, limit: float | None, values: list[float | None],
            form: Callable[[Any], str] = figure) -> None:
        cells = [f"[red]{form(v)}[/]" if tolerance and v is not None and v > tolerance else form(v)
                 for v in values]
        table.add_row(label, *(form(each) if each else "" for each in (tolerance, limit)), *cells)

    limit = rows[0]["limit"]  # the same in all rows
    for name in ("mean", "p99.9", "worst", "bias"):
        add(f"image, {name}", stated["image"].get(name), limit.get(name),
            [row["image"][name] for row in rows])
    add("gradient, L2", stated["gradients"].get("relative_l2"), limit["relative_l2"],
        [row["gradients"]["relative_l2"] for row in rows])
    add("1 - cosine", stated["gradients"].get("1 - cosine"), None,
        [None if row["gradients"]["cosine"] is None else 1 - row["gradients"]["cosine"] for row in rows])
    if texels == "rough" or all(row["texels"] == "smooth" for row in record["summary"]):
        add("display, worst", None, None, [row["display"] for row in rows])
        for way in ("forward", "backward"):
            add(way, None, None, [row["seconds"][way] for row in rows], seconds)
    return table
