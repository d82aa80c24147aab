"""``mitsvbrdf synth``: photos of known maps: rectified ones, or raw ones of a simulated phone."""

import functools
from dataclasses import fields
from pathlib import Path
from typing import Annotated, cast

from tyro.conf import OmitArgPrefixes, Positional, arg

from .. import color
from ..capture import write_capture
from ..errors import ConfigError
from ..fit.config import check_seed
from ..io import results
from ..io.progress import say
from ..material.maps import SVBRDF
from ..render import RendererName, make_renderer
from ..synth import photograph
from ..synth.phone import HandheldPhone, Spoil
from ..synth.photos import write_handheld
from ..synth.traced import HandheldRenderer
from . import options

RECTIFIED_SIDE, MADE_SIDE = 256, 1024  # defaults of --resolution
PHONE = HandheldPhone()


def synth(
    material: Positional[options.Material], out: options.Out, phone: OmitArgPrefixes[HandheldPhone] = PHONE,
    handheld: Annotated[bool, arg(help=(
        "Take raw photos with a simulated phone, for `mitsvbrdf capture`: OUT/IMG_0001.jpg and so on, and "
        "the truth in OUT/truth. The options of the phone need --handheld."))] = False,
    spoil: Annotated[str, arg(metavar="KIND,KIND,...", help=(
        "With --handheld: add photos of the kinds blurred, finger, noflash, duplicate, rotated, unrelated."))
        ] = "",
    encoding: options.MapEncoding = (), normal: options.MapNormal = "auto",
    views: options.ViewSource = "builtin:grid",
    resolution: Annotated[int | None, arg(help=(
        "Side of the photos in pixels. With --handheld: side of built-in maps. Default: 256, with "
        "--handheld 1024."))] = None,
    noise: Annotated[float, arg(help=(
        "Standard deviation of the sensor noise of rectified photos, in linear radiance."))] = 0.0,
    renderer: RendererName = "mitsuba", transfer: color.Transfer = "gamma2.2",
    variant: options.Variant = "llvm_ad_rgb", overwrite: options.Overwrite = False,
) -> int:
    """Take photos of known maps: rectified photos with their calibration, or raw photos of a simulated phone.

    Rectified photos have 8 bits, are clipped and optionally noisy. Raw photos (--handheld) have the phone's
    distortion, vignetting, noise, JPEG and EXIF, and no calibration. --sheet lays a sheet of tags around the
    material.
    """
    check_seed(phone.seed)
    options.keep_apart_from_maps(material, out)
    if handheld:
        unused = {"--views": views != "builtin:grid", "--noise": noise != 0,
                  "--renderer": renderer != "mitsuba", "--transfer": transfer != "gamma2.2"}
        if given := [name for name, is_given in unused.items() if is_given]:
            raise ConfigError("options of the phone beside --handheld", ", ".join(given),
                              "leave these out; --grain is the phone's noise")
        phone.check()
        svbrdf = options.material_of(material, MADE_SIDE if resolution is None else resolution, encoding,
                                     normal)
        return _handheld(svbrdf, options.name_of(material), out, phone, spoil, variant, overwrite)
    given = [f"--{f.name.replace('_', '-')}" for f in fields(phone)
             if getattr(phone, f.name) != f.default and f.name != "seed"] + ["--spoil"] * bool(spoil)
    if given:
        raise ConfigError("--handheld beside options of the phone", ", ".join(given),
                          "add --handheld, or leave these out")
    if not 0 <= noise <= 1:
        raise ConfigError("--noise from 0 to 1", str(noise), "give the standard deviation, e.g. 0.003")
    options.keep_apart(Path(views), out)
    resolution = RECTIFIED_SIDE if resolution is None else resolution
    svbrdf = options.material_of(material, resolution, encoding, normal)
    engine = make_renderer(renderer, variant)
    names, lit = options.views_of(views, "inverse-square")
    if svbrdf.resolution < resolution:
        say(f"the maps have {svbrdf.resolution} px, and so do the photos")
    svbrdf = svbrdf.resized(min(resolution, svbrdf.resolution))
    with results.output_folder(out, overwrite) as folder:
        write_capture(photograph(svbrdf, lit, engine, noise, phone.seed, transfer), folder)
    say(f"wrote {len(names)} photos and capture.json to {out}")
    return 0


def _handheld(svbrdf: SVBRDF, name: str, out: Path, phone: HandheldPhone, spoil: str, variant: str,
              overwrite: bool) -> int:
    kinds = cast(tuple[Spoil, ...], tuple(kind.strip() for kind in spoil.split(",") if kind.strip()))

    def report(done: int, count: int) -> None:
        if done % 3 == 0 or done == count:
            say(f"took {done} of {count} photos")

    with results.output_folder(out, overwrite) as folder:
        truth = write_handheld(svbrdf, phone, functools.partial(HandheldRenderer, variant=variant), folder,
                               kinds, material=name, report=report)
    sheet = f" with the sheet of {phone.sheet:g} cm" if phone.sheet else ""
    say(f"wrote {len(truth['rig']['poses'])} photos{sheet} to {out}, and the truth to {out}/truth")
    return 0
