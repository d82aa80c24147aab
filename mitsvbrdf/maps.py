"""The material value type: an SVBRDF as named maps, checked once, with loading and saving.

Maps are linear tensors of shape R x R x C, row 0 at the top. Two parameter sets exist, named after the Mitsuba
plugins that shade them; :data:`CHANNELS` lists their maps.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from . import color, files
from .errors import ConfigError, MapsError

Bsdf = Literal["roughconductor", "principled"]

CHANNELS: dict[str, dict[str, int]] = {
    "roughconductor": {"diffuse": 3, "specular": 3, "roughness": 1, "normal": 3},
    "principled": {"base_color": 3, "metallic": 1, "roughness": 1, "normal": 3},
}
COLOURS = ("diffuse", "specular", "base_color")

UNIT = 1e-3  # how far a normal's length may be from 1
LOWEST_Z = 1e-5  # 89.9994 degrees; 16-bit files reach 1.5e-5. Closer to the plane, float32 shading frames have no digits left

# F0 of Mitsuba's `principled` dielectric part with its default `specular` = 0.5 (eta = 1.5).
DIELECTRIC_F0 = 0.04

# How the fields' files are encoded, by the names that material.json and --encoding use.
ENCODINGS: dict[str, dict[str, str]] = {
    "linear": dict.fromkeys(("diffuse", "specular", "roughness", "base_color", "metallic"), "linear"),
    "gamma 2.2": dict.fromkeys(("diffuse", "specular", "roughness", "base_color"), "gamma 2.2") | {"metallic": "linear"},
    "srgb": dict.fromkeys(COLOURS, "srgb") | {"roughness": "linear", "metallic": "linear"},
}
SHORT_NAMES = {"diffuse": "dif", "specular": "spe", "roughness": "rgh", "normal": "nom"}


@dataclass(frozen=True)
class SVBRDF:
    """A spatially varying material.

    Args:
        bsdf: ``roughconductor`` (diffuse + specular lobe) or ``principled`` (base colour, metallic).
        maps: linear tensors R x R x C under the names of :data:`CHANNELS`: colours and metallic in [0, 1], roughness
            in (0, 1] (GGX alpha = roughness^2), normal as unit vectors, +Y up, z > 0.
    """

    bsdf: Bsdf
    maps: Mapping[str, Tensor]

    def __post_init__(self) -> None:
        if self.bsdf not in CHANNELS:
            raise ConfigError(f"a BSDF of {get_args(Bsdf)}", repr(self.bsdf), "choose one of these")
        wanted = CHANNELS[self.bsdf]
        if set(self.maps) != set(wanted):
            raise MapsError(f"the maps {sorted(wanted)}", str(sorted(self.maps)), "give exactly these")
        size = self.maps["normal"].shape[0]
        for name, channels in wanted.items():
            if tuple(self.maps[name].shape) != (size, size, channels):
                raise MapsError(f"{name} of shape {(size, size, channels)}", str(tuple(self.maps[name].shape)),
                                "all maps are square, of one size, height x width x channels")

    def __getitem__(self, name: str) -> Tensor:
        return self.maps[name]

    def __repr__(self) -> str:
        return f"SVBRDF({self.bsdf}, {self.resolution} px)"

    @property
    def resolution(self) -> int:
        """Texels along a side."""
        return self.maps["normal"].shape[0]

    def map(self, function) -> SVBRDF:
        """The same material with ``function`` applied to each map tensor."""
        return SVBRDF(self.bsdf, {name: function(value) for name, value in self.maps.items()})

    def to(self, dtype: torch.dtype) -> SVBRDF:
        """The same material in another float type."""
        return self.map(lambda t: t.to(dtype))

    def detach(self) -> SVBRDF:
        """The same material, cut off from the gradient graph."""
        return self.map(Tensor.detach)

    def check(self) -> SVBRDF:
        """Itself, when every value is finite and in range; else MapsError naming map, texel and value."""
        for name, value in self.maps.items():
            bad = ~torch.isfinite(value)
            if bad.any():
                raise MapsError("finite values", f"{int(bad.sum())} NaN or infinite in {name}, first at "
                                f"(row, column, channel) {tuple(bad.nonzero()[0].tolist())}", "mend or re-export the map")
            if name == "normal":
                if (value[..., 2] <= 0).any():
                    raise MapsError("normals with z > 0", "normals that point into the surface",
                                    "check that blue is z and the map is +Y up, tangent space")
                length = value.norm(dim=-1)
                if not bool(((length - 1).abs() <= UNIT).all()):
                    raise MapsError("unit normals", f"lengths from {float(length.min()):.4g} to {float(length.max()):.4g}",
                                    "normalise them")
                if value[..., 2].min() < LOWEST_Z:
                    raise MapsError(f"normals with z >= {LOWEST_Z:g}", f"z = {float(value[..., 2].min()):.3g}",
                                    "such a texel can hardly be seen: tilt it less, or leave it out")
            elif value.min() < 0 or value.max() > 1:
                raise MapsError(f"{name} in [0, 1]", f"[{value.min():.4g}, {value.max():.4g}]", "check its encoding")
        if self.maps["roughness"].min() <= 0:
            raise MapsError("roughness > 0", "0", "raise it to 0.01 or more: a perfect mirror shows no light at a point")
        return self

    def as_roughconductor(self) -> SVBRDF:
        """Diffuse and specular maps of a principled material (exact at normal incidence but for Burley's diffuse)."""
        if self.bsdf == "roughconductor":
            return self
        base, metallic = self["base_color"], self["metallic"]
        return SVBRDF("roughconductor", {
            "diffuse": base * (1 - metallic), "specular": base * metallic + DIELECTRIC_F0 * (1 - metallic),
            "roughness": self["roughness"], "normal": self["normal"]})

    def resized(self, resolution: int) -> SVBRDF:
        """The material at another resolution: area average when shrinking, bilinear when growing; unit normals."""
        if resolution == self.resolution:
            return self
        mode = "area" if resolution < self.resolution else "bilinear"

        def scale(value: Tensor) -> Tensor:
            chw = value.permute(2, 0, 1)[None]
            size = (resolution, resolution)
            out = F.interpolate(chw, size, mode=mode) if mode == "area" else F.interpolate(
                chw, size, mode=mode, align_corners=False)
            return out[0].permute(1, 2, 0)

        maps = {name: scale(value) for name, value in self.maps.items()}
        maps["normal"] = F.normalize(maps["normal"], dim=-1)
        return SVBRDF(self.bsdf, maps)

    def _repr_html_(self) -> str:
        """The maps as small pictures, for notebooks."""
        from .report.notebook import svbrdf_html
        return svbrdf_html(self)


def flat(resolution: int, bsdf: Bsdf = "roughconductor", dtype: torch.dtype = torch.float32, **values: float) -> SVBRDF:
    """A constant material with an up-pointing normal.

    Args:
        values: a value for each map but the normal, e.g. ``diffuse=0.5``; left out: 0.5 for colours and roughness, 0.04
            specular, 0 metallic.
    """
    defaults = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5, "base_color": 0.5, "metallic": 0.0}
    maps = {}
    for name, channels in CHANNELS[bsdf].items():
        if name == "normal":
            maps[name] = torch.tensor([0.0, 0.0, 1.0], dtype=dtype).expand(resolution, resolution, 3).clone()
        else:
            maps[name] = torch.full((resolution, resolution, channels), values.get(name, defaults[name]), dtype=dtype)
    return SVBRDF(bsdf, maps)


def load_maps(folder: str | Path, bsdf: Bsdf | None = None, encoding: str | None = None) -> SVBRDF:
    """Read a folder of maps.

    Understood: our own (EXR preferred over PNG), four images named diffuse, specular, roughness, normal (png, jpg, exr)
    or base_color, metallic, roughness, normal; the short names dif, spe, rgh, nom; and one strip ``tex.png`` of diffuse,
    normal, roughness, specular side by side (MaterialGAN). A folder that has ``maps/`` inside stands for that.

    Args:
        folder: the folder.
        bsdf: which set to read where both are there; left out: what material.json says, else ``principled`` when
            base_color and metallic are there.
        encoding: ``linear``, ``gamma 2.2`` or ``srgb`` for 8- and 16-bit files; left out: what material.json says, else
            gamma 2.2, the field's habit. EXR is linear; normals are (n + 1) / 2, +Y up.

    Raises:
        MapsError: naming what is missing or wrong.
    """
    folder = Path(folder)
    if (folder / "maps").is_dir():
        folder = folder / "maps"
    if not folder.is_dir():
        raise MapsError("a folder of maps", f"no folder at {folder}", "give the folder that holds diffuse, specular, ...")
    stated, codes = read_material_json(folder), encodings(folder, encoding)
    if bsdf is None:
        principled = _find(folder, "base_color") and _find(folder, "metallic")
        bsdf = stated.get("bsdf") or ("principled" if principled else "roughconductor")
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
        raise MapsError("square maps of one size", f"sizes {sorted(sizes)} in {folder}", "resize them to one square size")
    return SVBRDF(bsdf, maps).check()


def read_material_json(folder: Path) -> dict:
    """What ``material.json`` in a folder says, or an empty dict where there is none."""
    path = Path(folder) / "material.json"
    if not path.is_file():
        return {}
    try:
        stated = json.loads(path.read_text())
        if not isinstance(stated, dict) or stated.get("bsdf", "principled") not in list(CHANNELS):
            raise ValueError(f"not an object, or its bsdf is none of {list(CHANNELS)}")
        codes = stated.get("encoding", {})
        if not isinstance(codes, dict) or not all(isinstance(code, str) for code in codes.values()):
            raise ValueError("its encoding is no object of texts")
    except ValueError as reason:
        raise MapsError("a valid material.json", f"{path}: {reason}", "mend it, or delete it for gamma 2.2") from None
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
    wanted = [stem + suffix for stem in (name, SHORT_NAMES.get(name)) if stem for suffix in (".exr", ".png", ".jpg", ".jpeg")]
    return next((there[file] for file in wanted if file in there), None)


def read_map(path: Path, name: str, channels: int, codes: dict[str, str]) -> Tensor:
    """One map from its file, linear, H x W x ``channels``; ``codes`` as :func:`encodings` gives them.

    Raises:
        MapsError: no image, or one that is not finite.
    """
    image = files.read_image(path, MapsError)
    if not torch.isfinite(image).all():
        raise MapsError("finite values", f"NaN or infinity in {path}", "mend or re-export the map")
    if image.shape[2] != channels:
        image = image.mean(dim=2, keepdim=True).expand(*image.shape[:2], channels)
    if name == "normal":
        return F.normalize(image * 2 - 1, dim=-1)
    if path.suffix.lower() != ".exr":
        transfer = codes.get(name, "linear").replace(" ", "")
        image = color.decode(image, transfer)  # type: ignore[arg-type]
    # 8-bit files can hold a roughness of exactly 0: half a step up is what the writer rounded away at most.
    return image.clamp_min(1 / 512) if name == "roughness" and path.suffix.lower() != ".exr" else image


def _from_strip(path: Path) -> SVBRDF:
    strip = files.read_image(path, MapsError)
    side = strip.shape[0]
    if strip.shape[1] != 4 * side:
        raise MapsError("a strip of four square maps", f"{path} of {strip.shape[1]} x {side}",
                        "give diffuse, normal, roughness, specular side by side")
    diffuse, normal, roughness, specular = strip.split(side, dim=1)
    return SVBRDF("roughconductor", {
        "diffuse": color.decode(diffuse), "specular": color.decode(specular),
        "roughness": color.decode(roughness.mean(dim=2, keepdim=True)).clamp_min(1 / 512),
        "normal": F.normalize(normal * 2 - 1, dim=-1)})


def save_maps(svbrdf: SVBRDF, folder: str | Path, **about: object) -> None:
    """Write a material: float32 EXR masters (linear), 16-bit PNGs (colours sRGB, the rest linear), material.json.

    Normals are (n + 1) / 2 in both. A principled material also gets its diffuse and specular maps, for tools that want
    those.

    Args:
        about: more fields for material.json.
    """
    folder = Path(folder)
    svbrdf = svbrdf.detach()
    both = dict(svbrdf.as_roughconductor().maps) | dict(svbrdf.maps)
    for name, value in both.items():
        linear = (value + 1) / 2 if name == "normal" else value
        files.write_exr(folder / f"{name}.exr", linear)
        files.write_png(folder / f"{name}.png", color.encode(linear, "srgb") if name in COLOURS else linear, bits=16)
    encoding = {name: code for name, code in ENCODINGS["srgb"].items() if name in both}
    files.write_json(folder / "material.json", {
        "bsdf": svbrdf.bsdf, "size": svbrdf.resolution, "encoding": encoding | {"normal": "(n+1)/2, +Y up"},
        "note": "encoding of the PNG files; EXR files are linear", **about})
