"""``mitsvbrdf render``: maps rendered for the views of a capture."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import MapsError
from ..io import images, results
from ..io.progress import say
from ..material.map_files import MAP_FOLDERS
from ..material.maps import SVBRDF
from ..measure.rerender import batches
from ..render import RendererName, make_renderer
from . import options


def render(
    maps: Positional[options.Material], out: options.Out, views: options.ViewSource = "builtin:grid",
    encoding: options.MapEncoding = (), normal: options.MapNormal = "auto",
    renderer: RendererName = "mitsuba",
    falloff: Annotated[options.FalloffOption, arg(
        help="Falloff of the light. auto: as in the fit.")] = "auto",
    transfer: Annotated[options.TransferOption,
                        arg(help="Transfer function of the PNG files. auto: as in the fit.")] = "auto",
    diffuse: Annotated[Literal["fitted", "guessed"],
                       arg(help="guessed: use the guessed diffuse map of the fit (paper IV.B).")] = "fitted",
    variant: options.Variant = "llvm_ad_rgb", overwrite: options.Overwrite = False,
    strict: options.Strict = False,
) -> int:
    """Render maps in the views of a capture, with the fit's flash offset: OUT/NN.png and NN.exr (linear)."""
    options.keep_apart(Path(views), out)
    options.keep_apart_from_maps(maps, out)
    svbrdf, fit = options.material_of(maps, 256, encoding, normal), options.fit_of_maps(maps)
    if diffuse == "guessed":
        folder = Path(maps).parent if Path(maps).name in MAP_FOLDERS else Path(maps)
        guessed = images.read_image(folder / "guess" / "diffuse.exr", MapsError)
        name = "diffuse" if svbrdf.bsdf == "roughconductor" else "base_color"
        svbrdf = SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {name: guessed})
    names, lit = options.views_of(views, fit.falloff if falloff == "auto" else falloff, fit)
    transfer = (fit.transfer or "gamma2.2") if transfer == "auto" else transfer
    engine = make_renderer(renderer, variant)
    with results.output_folder(out, overwrite) as folder:
        for part in batches(len(names), svbrdf.resolution):
            shown = engine.render(svbrdf, lit.pick(part))
            images.write_all([write for k, image in zip(part, shown) for write in images.linear_writes(
                folder / names[k], image, transfer)])
    say(f"wrote {len(names)} images of {options.name_of(maps)} to {out}")
    return 0
