"""Maps in files: folders of EXR, PNG or JPEG images, one a map, with their encodings in ``material.json``.

:func:`load_maps` reads our own folders and those of the field; :func:`save_maps` writes ours.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import ConfigError, MapsError, MapsWarning
from ..io import files, images
from ..io.entry import entry
from ..io.json import error_text, load
from .maps import CHANNELS, COLOURS, LOWEST_Z, SVBRDF, Bsdf

# How the fields' files are encoded, by the names that material.json and --encoding use.
ENCODINGS: dict[str, dict[str, str]] = {
    "linear": dict.fromkeys(("diffuse", "specular", "roughness", "base_color", "metallic"), "linear"),
    "gamma 2.2": dict.fromkeys(("diffuse", "specular", "roughness", "base_color"), "gamma 2.2")
    | {"metallic": "linear"},
    "srgb": dict.fromkeys(COLOURS, "srgb") | {"roughness": "linear", "metallic": "linear"},
}
DETAIL, FORMER_DETAIL = "detail", "look"
MAP_FOLDERS = "maps", DETAIL, FORMER_DETAIL  # of a fit: expected values, and a plausible draw
SHORT_NAMES = {"diffuse": "dif", "specular": "spe", "roughness": "rgh", "normal": "nom"}

# Normals of published maps point into the surface at up to 0.2 % of the texels: noise of networks, empty
# corners.
FEW = 0.01  # share of the texels at which that is mended; a map with more is in another convention
RAISED = 1 / 255  # their z: the lowest above 0 that an 8-bit file holds


@entry()
def load_maps(folder: str | Path, bsdf: Bsdf | None = None, encoding: str | None = None) -> SVBRDF:
    """Read a folder of maps.

    Understood: our own (EXR preferred over PNG), four images named diffuse, specular, roughness, normal (png,
    jpg, exr) or base_color, metallic, roughness, normal; the short names dif, spe, rgh, nom; and one strip
    ``tex.png`` of diffuse, normal, roughness, specular side by side (MaterialGAN). A folder that has
    ``maps/`` inside stands for that.

    Args:
        folder: the folder.
        bsdf: which set to read where both are there; left out: what material.json says, else ``principled``
            when base_color and metallic are there.
        encoding: ``linear``, ``gamma 2.2`` or ``srgb`` for 8- and 16-bit files; left out: what material.json
            says, else gamma 2.2, the field's habit. EXR is linear; normals are (n + 1) / 2, +Y up.

    Warns:
        MapsWarning: normals that point into the surface, up to 1 % of them, were lifted just above it.

    Raises:
        MapsError: naming what is missing or wrong.
    """
    folder = Path(folder)
    if (folder / "maps").is_dir():
        folder = folder / "maps"
    if not folder.is_dir():
        raise MapsError("a folder of maps", f"no folder at {folder}",
                        "give the folder that holds diffuse, specular, ...")
    stated, codes = read_material_json(folder), encodings(folder, encoding)
    usual: Bsdf = ("principled" if _find(folder, "base_color") and _find(folder, "metallic")
                   else "roughconductor")
    bsdf = bsdf or stated.get("bsdf") or usual
    if bsdf == "roughconductor" and not _find(folder, "diffuse") and (folder / "tex.png").is_file():
        return _from_strip(folder / "tex.png").check()

    maps = {}
    for name, channels in CHANNELS[bsdf].items():
        path = _find(folder, name)
        if path is None:
            raise MapsError(f"{name}.exr, {name}.png or {name}.jpg", f"none in {folder}",
                            f"a {bsdf} material needs {', '.join(CHANNELS[bsdf])}")
        maps[name] = read_map(path, name, channels, codes)
    sizes = {tuple(m.shape[:2]) for m in maps.values()}
    if len(sizes) > 1 or len(set(*sizes)) > 1:
        raise MapsError("square maps of one size", f"sizes {sorted(sizes)} in {folder}",
                        "resize them to one square size")
    return SVBRDF(bsdf, maps).check()


def read_material_json(folder: Path) -> dict:
    """What ``material.json`` in a folder says, or an empty dict where there is none."""
    path = Path(folder) / "material.json"
    if not path.is_file():
        return {}
    try:
        stated = load(path)
        if stated.get("bsdf", "principled") not in list(CHANNELS):
            raise ValueError(f"its bsdf is none of {list(CHANNELS)}")
        codes = stated.get("encoding", {})
        if not isinstance(codes, dict) or not all(isinstance(code, str) for code in codes.values()):
            raise ValueError("its encoding is no object of texts")
    except (OSError, ValueError) as reason:
        raise MapsError("a valid material.json", f"{path}: {error_text(reason)}",
                        "mend it, or delete it for gamma 2.2") from None
    return stated


def encodings(folder: str | Path, encoding: str | None = None) -> dict[str, str]:
    """How the 8- and 16-bit files of a map folder are encoded, by map; see :func:`load_maps`."""
    folder = Path(folder)
    stated = read_material_json(folder / "maps" if (folder / "maps").is_dir() else folder)
    if encoding is not None and encoding not in ENCODINGS:
        raise ConfigError(f"an encoding of {list(ENCODINGS)}", repr(encoding), "choose one of these")
    codes = ENCODINGS[encoding or "gamma 2.2"]
    return codes if encoding else codes | stated.get("encoding", {})


def _find(folder: Path, name: str) -> Path | None:
    there = {entry.name.lower(): entry for entry in folder.iterdir() if entry.is_file()}
    wanted = [stem + suffix for stem in (name, SHORT_NAMES.get(name)) if stem
              for suffix in (".exr", ".png", ".jpg", ".jpeg")]
    return next((there[file] for file in wanted if file in there), None)


def read_map(path: Path, name: str, channels: int, codes: dict[str, str]) -> Tensor:
    """One map from its file, linear, H x W x ``channels``; ``codes`` as :func:`encodings` gives them.

    Raises:
        MapsError: no image, or one that is not finite.
    """
    image = images.read_image(path, MapsError)
    if not torch.isfinite(image).all():
        raise MapsError("finite values", f"NaN or infinity in {path}", "mend or re-export the map")
    if image.shape[2] != channels:
        image = image.mean(dim=2, keepdim=True).expand(*image.shape[:2], channels)
    if name == "normal":
        return _lifted(F.normalize(image * 2 - 1, dim=-1), path)
    if path.suffix.lower() != ".exr":
        transfer = codes.get(name, "linear").replace(" ", "")
        image = color.decode(image, transfer)  # type: ignore[arg-type]
    # 8-bit files can hold a roughness of exactly 0: half a step up is what the writer rounded away at most.
    return image.clamp_min(1 / 512) if name == "roughness" and path.suffix.lower() != ".exr" else image


def _from_strip(path: Path) -> SVBRDF:
    strip = images.read_image(path, MapsError)
    side = strip.shape[0]
    if strip.shape[1] != 4 * side:
        raise MapsError("a strip of four square maps", f"{path} of {strip.shape[1]} x {side}",
                        "give diffuse, normal, roughness, specular side by side")
    diffuse, normal, roughness, specular = strip.split(side, dim=1)
    return SVBRDF("roughconductor", {
        "diffuse": color.decode(diffuse), "specular": color.decode(specular),
        "roughness": color.decode(roughness.mean(dim=2, keepdim=True)).clamp_min(1 / 512),
        "normal": _lifted(F.normalize(normal * 2 - 1, dim=-1), path)})


def _lifted(normal: Tensor, path: Path) -> Tensor:
    """Unit normals, H x W x 3; a few that point into the surface are lifted, with a warning."""
    under = normal[..., 2:] < LOWEST_Z
    count, texels = int(under.sum()), under.numel()
    if not 0 < count <= FEW * texels:
        return normal
    warnings.warn(f"{path}: {count} of {texels} normals ({count / texels:.2%}) point into the surface; "
                  "lifted just above it", MapsWarning, stacklevel=2)
    raised = torch.cat((normal[..., :2], torch.full_like(normal[..., 2:], RAISED)), dim=-1)
    return torch.where(under, F.normalize(raised, dim=-1), normal)


@entry()
def save_maps(svbrdf: SVBRDF, folder: str | Path) -> SVBRDF:
    """Write float32 EXR masters (linear), 16-bit PNGs (colours sRGB, the rest linear), material.json.

    Normals are (n + 1) / 2 in both. A principled material also gets its diffuse and specular maps, for tools
    that want those.

    Returns:
        The material as :func:`load_maps` reads it: its normals have made a round trip.
    """
    folder = Path(folder)
    svbrdf = svbrdf.detach()
    both = dict(svbrdf.as_roughconductor().maps) | dict(svbrdf.maps)
    for name, value in both.items():
        linear = (value + 1) / 2 if name == "normal" else value
        images.write_exr(folder / f"{name}.exr", linear)
        images.write_png(folder / f"{name}.png", color.encode(linear, "srgb") if name in COLOURS else linear,
                         bits=16)
    encoding = {name: code for name, code in ENCODINGS["srgb"].items() if name in both}
    files.write_json(folder / "material.json", {
        "bsdf": svbrdf.bsdf, "size": svbrdf.resolution, "encoding": encoding | {"normal": "(n+1)/2, +Y up"},
        "note": "encoding of the PNG files; EXR files are linear"})
    stored = {name: value.float() for name, value in svbrdf.maps.items()}
    return SVBRDF(svbrdf.bsdf, stored | {"normal": F.normalize((stored["normal"] + 1) / 2 * 2 - 1, dim=-1)})
