"""The type of a material: an SVBRDF as named maps. Names, shapes and types are checked once, at creation.

Maps are linear tensors of shape R x R x C, row 0 at the top. Two parameter sets exist, named after the
Mitsuba plugins that shade them; :data:`CHANNELS` lists their maps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import ConfigError, MapsError, NotFiniteError
from ..kinds import check_fields, kinds_checked
from .resample import resized

TITLES = {"diffuse": "Diffuse", "specular": "Specular", "roughness": "Roughness", "normal": "Normal",
          "base_color": "Base colour", "metallic": "Metallic"}

Bsdf = Literal["roughconductor", "principled"]


class _ByBsdf(dict[Bsdf, dict[str, int]]):
    def __missing__(self, bsdf: object) -> dict[str, int]:
        raise ConfigError(f"a BSDF of {get_args(Bsdf)}", repr(bsdf), "choose one of these")


CHANNELS = _ByBsdf({  # number of channels of each map; an unknown BSDF raises ConfigError
    "roughconductor": {"diffuse": 3, "specular": 3, "roughness": 1, "normal": 3},
    "principled": {"base_color": 3, "metallic": 1, "roughness": 1, "normal": 3},
})
COLOURS = ("diffuse", "specular", "base_color")

UNIT = 1e-3  # how far a normal's length may be from 1
# Tilt 89.9994 degrees. 16-bit files reach z = 1.5e-5. At lower z, float32 shading frames have no digits left.
LOWEST_Z = 1e-5

# F0 of Mitsuba's `principled` dielectric part with its default `specular` = 0.5 (eta = 1.5).
DIELECTRIC_F0 = 0.04
# A prior, used if the brightness of the light is unknown: median of the diffuse albedo, and standard
# deviation of its natural logarithm. Ten known materials have albedos of 0.001 to 0.22.
USUAL_ALBEDO = 0.12, 1.2
WHITEST = 0.95  # 99 % of the texels have a lower diffuse albedo


@dataclass(frozen=True)
class SVBRDF:
    """A spatially varying material.

    Args:
        bsdf: ``roughconductor`` (diffuse + specular lobe) or ``principled`` (base colour, metallic).
        maps: linear tensors R x R x C under the names of :data:`CHANNELS`: colours and metallic in [0, 1],
            roughness in (0, 1] (GGX alpha = roughness^2), normal as unit vectors, +Y up, z > 0. Other names,
            shapes or types raise MapsError; :meth:`check` tests the values.
    """

    bsdf: Bsdf
    maps: Mapping[str, Tensor]

    def __post_init__(self) -> None:
        check_fields(self)
        wanted = CHANNELS[self.bsdf]
        if set(self.maps) != set(wanted):
            raise MapsError(f"the maps {sorted(wanted)}", str(sorted(self.maps)), "give exactly these")
        for name, value in self.maps.items():
            if not isinstance(value, Tensor) or not value.is_floating_point():
                raise MapsError(f"{name} as a float tensor",
                                repr(getattr(value, "dtype", type(value).__name__)),
                                "make it one with torch.as_tensor(...).float()")
        size = self.maps["normal"].shape[0] if self.maps["normal"].ndim else 0
        if not size:
            raise MapsError("maps of 1 x 1 texels or more", "maps without a texel", "check how they were cut")
        for name, channels in wanted.items():
            if tuple(self.maps[name].shape) != (size, size, channels):
                raise MapsError(f"{name} of shape {(size, size, channels)}",
                                str(tuple(self.maps[name].shape)),
                                "all maps are square, of one size, height x width x channels")

    def __getitem__(self, name: str) -> Tensor:
        return self.maps[name]

    def __repr__(self) -> str:
        return f"SVBRDF({self.bsdf}, {self.resolution} px)"

    @property
    def resolution(self) -> int:
        """Texels along a side."""
        return self.maps["normal"].shape[0]

    @kinds_checked
    def map(self, function: Callable[[Tensor], Tensor]) -> SVBRDF:
        """The same material with ``function`` applied to each map tensor."""
        return SVBRDF(self.bsdf, {name: function(value) for name, value in self.maps.items()})

    @kinds_checked
    def to(self, dtype: torch.dtype) -> SVBRDF:
        """The same material in another float type."""
        return self.map(lambda t: t.to(dtype))

    def detach(self) -> SVBRDF:
        """The same material, cut off from the gradient graph."""
        return self.map(Tensor.detach)

    def check_finite(self) -> None:
        """Raise NotFiniteError if a value is NaN or infinite; the message has map and texel."""
        for name, value in self.maps.items():
            if not finite(value):
                bad = ~torch.isfinite(value)
                raise NotFiniteError("finite values", f"{int(bad.sum())} NaN or infinite in {name}, first at "
                                     f"(row, column, channel) {tuple(bad.nonzero()[0].tolist())}",
                                     "mend or re-export the map")

    def check(self) -> SVBRDF:
        """The same material. MapsError: a value is not finite or out of range; the message has the map."""
        self.check_finite()
        for name, value in self.maps.items():
            if name == "normal":
                z = value[..., 2]
                if under := int((z <= 0).sum()):
                    raise MapsError("normals with z > 0",
                                    f"{under} of {z.numel()} that point into the surface",
                                    "check that blue is z and the map is +Y up, tangent space")
                length = value.norm(dim=-1)
                if not bool(((length - 1).abs() <= UNIT).all()):
                    raise MapsError("unit normals", f"lengths from {float(length.min()):.4g} to "
                                    f"{float(length.max()):.4g}", "normalise them")
                if z.min() < LOWEST_Z:
                    raise MapsError(f"normals with z >= {LOWEST_Z:g}", f"z = {float(z.min()):.3g}",
                                    "tilt them less: such texels can hardly be seen")
            elif value.min() < 0 or value.max() > 1:
                raise MapsError(f"{name} in [0, 1]", f"[{value.min():.4g}, {value.max():.4g}]",
                                "check its encoding")
        if self.maps["roughness"].min() <= 0:
            raise MapsError("roughness > 0", "0", "raise it to 0.01 or more: a perfect mirror shows no "
                                                  "light at a point")
        return self

    def as_roughconductor(self) -> SVBRDF:
        """The material as ``roughconductor``. With light at the camera, only Burley's factor is lost."""
        if self.bsdf == "roughconductor":
            return self
        base, metallic = self["base_color"], self["metallic"]
        return SVBRDF("roughconductor", {
            "diffuse": base * (1 - metallic), "specular": base * metallic + DIELECTRIC_F0 * (1 - metallic),
            "roughness": self["roughness"], "normal": self["normal"]})

    @kinds_checked
    def resized(self, resolution: int) -> SVBRDF:
        """The material resized: area average down, bilinear up; unit normals. ConfigError: below 1 texel."""
        if resolution < 1:
            raise ConfigError("a resolution of 1 or more", str(resolution), "ask for e.g. 256")
        if resolution == self.resolution:
            return self
        maps = {name: resized(value, resolution) for name, value in self.maps.items()}
        maps["normal"] = F.normalize(maps["normal"], dim=-1)
        return SVBRDF(self.bsdf, maps)


@kinds_checked
def flat(resolution: int, bsdf: Bsdf = "roughconductor", dtype: torch.dtype = torch.float32,
         **values: float) -> SVBRDF:
    """A constant material with an up-pointing normal.

    Args:
        values: a value for each map but the normal, e.g. ``diffuse=0.5``. Default: 0.04 for specular, 0
            for metallic, else 0.5. Maps of the other BSDF are ignored. ConfigError: an unknown map.
    """
    defaults = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5, "base_color": 0.5, "metallic": 0.0}
    if unknown := set(values) - set(defaults):
        raise ConfigError(f"values for {', '.join(defaults)}", ", ".join(sorted(unknown)), "check the names")
    texel: Mapping[str, object] = defaults | values | {"normal": (0.0, 0.0, 1.0)}
    return SVBRDF(bsdf, {
        name: torch.tensor(texel[name], dtype=dtype).expand(resolution, resolution, channels).contiguous()
        for name, channels in CHANNELS[bsdf].items()})


def finite(value: Tensor) -> bool:
    """Whether all values of a tensor are finite; the test needs no further memory."""
    if not value.is_floating_point() or not value.numel():
        return True
    return bool(torch.stack(value.detach().aminmax()).isfinite().all())


def shown_map(name: str, value: Tensor) -> Tensor:
    """A map as display values: colours in sRGB, normals as (n + 1) / 2, the rest as it is."""
    if name == "normal":
        return (value + 1) / 2
    return color.to_display(value, "srgb") if name in COLOURS else value


def numbers_of(name: str, value: Tensor) -> Tensor:
    """A map as the numbers whose errors are measured: colours are encoded, normals are (x, y) in [0, 1]."""
    if name == "normal":
        return (value[..., :2] + 1) / 2
    return color.encode(value) if name in COLOURS else value


def map_of(name: str, numbers: Tensor) -> Tensor:
    """The inverse of :func:`numbers_of`."""
    if name == "normal":
        flat = numbers * 2 - 1
        return torch.cat((flat, (1 - flat.square().sum(dim=-1, keepdim=True)).clamp_min(1e-4).sqrt()), dim=-1)
    return color.decode(numbers) if name in COLOURS else numbers
