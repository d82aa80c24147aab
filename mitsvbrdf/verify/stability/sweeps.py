"""The configurations of a stability run: ten small sweeps, each from harmless to extreme."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...material.corner_cases import random_material
from ...material.maps import CHANNELS, SVBRDF, Bsdf, flat
from ...render.analytic import MIN_ALPHA
from ...views import Views, nine_view_grid, texel_positions

CASE_SIDE = 16  # texels along a side of most materials: 256 texels, each a case of its own
TAKEN_APART_SIDE = 64  # larger materials are compared without limits and condition numbers

GRID = nine_view_grid()
# camera and light are 15 to 20 degrees from the half vector
APART = Views.of(GRID.camera, GRID.camera + torch.tensor([1.5, -0.3, 0.1]), GRID.intensity)

# Known errors of Mitsuba's plugins above rounding of a normal. Renderer -> (largest relative L2, cause).
Known = Mapping[str, tuple[float, str]]


def _mitsuba(bound: float, why: str) -> Known:
    return dict.fromkeys(("mitsuba", "mitsuba-scene"), (bound, why))


# Measured 3e-5 at 85 degrees, where n.v = 3e-4 in one texel of 256.
HORIZON = _mitsuba(3e-4, "Mitsuba forms G / (4 n.v) from its parts, whose derivative loses 6e-8 / n.v")
# Measured 1.8e-3, in the gradient of F0.
OPPOSITE = _mitsuba(1e-2,
                    "Mitsuba adds the directions to camera and light in float32, and they all but cancel")
# Measured 4e-6 at 0.02 sides.
HIT = {
    "mitsuba-scene": (2e-5, "the distance to the light is measured from a hit that is rounded to 6e-8 sides")}


@dataclass(frozen=True)
class Case:
    """One configuration.

    Its results must be finite, and as exact as float32 and its conditioning allow, except with ``refused`` or
    ``known``.
    """

    sweep: str  # key of SWEEPS
    label: str  # what is special about it
    value: float | None  # x in the sweep's plot; None: not plotted
    svbrdf: SVBRDF  # the material, float32; valid unless ``refused``
    views: Views  # camera and light positions; valid unless ``refused``
    texels: Tensor | None = None  # R x R, bool: which texels are compared; None for all
    # if given, gradients are those of the photometric loss, on photos of a slightly different material with
    # this transfer function; else those of the product of the image with fixed random numbers
    transfer: color.Transfer | None = None
    refused: bool = False  # whether maps or views are invalid, and must raise an error
    known: Known = field(default_factory=dict)  # renderer -> (largest relative error allowed, its cause)

    def display(self, radiance: Tensor) -> Tensor:
        """What a fit sees: display values. With a transfer function, they are clipped as in photos."""
        return color.encode(radiance) if self.transfer is None else color.to_display(radiance, self.transfer)

    @property
    def small(self) -> bool:
        """Whether the float32 limit and condition numbers are computed, too."""
        return self.svbrdf.resolution <= TAKEN_APART_SIDE


def material(bsdf: Bsdf = "roughconductor", side: int = CASE_SIDE, normal: Tensor | None = None,
             **values: float | tuple | Tensor) -> SVBRDF:
    """Random maps: F0 0.02 to 0.92, roughness 0.15 to 0.95, normals tilted by about 8 degrees. ``values``
    replace maps: map name to a number, colour or map.
    """
    maps = dict(random_material(bsdf, side, slope=0.1).maps)
    if "specular" in maps:
        maps["specular"] = 0.02 + 0.9 * maps["specular"]
    maps |= {name: torch.as_tensor(value, dtype=torch.float32).expand_as(maps[name]).clone()
             for name, value in values.items() if name in maps}
    return SVBRDF(bsdf, maps | ({} if normal is None else {"normal": normal.float()}))


def aimed(bsdf: Bsdf, views: Views, roughness: float) -> SVBRDF:
    """Normals within about three alpha of a view's half vector: every texel is in a highlight."""
    rng = torch.Generator().manual_seed(1)
    v = views.in_patch_sides()
    index = torch.arange(CASE_SIDE * CASE_SIDE).reshape(CASE_SIDE, CASE_SIDE) % len(v)
    camera, light = (F.normalize(place[index] - texel_positions(CASE_SIDE), dim=-1)
                     for place in (v.camera, v.light))
    away = (3 * max(roughness**2, MIN_ALPHA[bsdf])
            * torch.randn(CASE_SIDE, CASE_SIDE, 3, generator=rng, dtype=torch.float64) / 2)
    normal = F.normalize(F.normalize(camera + light, dim=-1) + away.clamp(-0.5, 0.5), dim=-1)
    return material(bsdf, roughness=roughness, normal=normal)


def tilted(degrees: float, towards: float | None = None) -> Tensor:
    """Normals R x R x 3 at this angle to the normal of the patch. Even rows have azimuths along an axis, odd
    rows random ones. ``towards``: one azimuth for all normals, in degrees from x towards y.
    """
    angle = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    azimuth = 2 * torch.pi * torch.rand(CASE_SIDE, CASE_SIDE, generator=torch.Generator().manual_seed(2),
                                        dtype=torch.float64)
    quarter = torch.pi / 2
    azimuth[::2] = (azimuth[::2] / quarter).round() * quarter
    if towards is not None:
        azimuth = torch.deg2rad(torch.full_like(azimuth, towards))
    return torch.stack((angle.sin() * azimuth.cos(), angle.sin() * azimuth.sin(),
                        angle.cos().expand_as(azimuth)), dim=-1)


def _roughness() -> list[Case]:
    cases = [Case("roughness", f"{r:g}, {bsdf}{where}", r, aimed(bsdf, views, r), views)
             for r in (1e-4, 1e-3, 1e-2, 0.03, 0.1, 1.0) for bsdf in CHANNELS
             for where, views in (("", GRID), (", apart", APART))]
    return [*cases, Case("roughness", "0", None, material(roughness=0.0), GRID, refused=True)]


def _tilt() -> list[Case]:
    cases = [Case("tilt", f"{degrees:g} degrees, {bsdf}", degrees, material(bsdf, normal=tilted(degrees)),
                  APART, known=HORIZON) for degrees in (0, 45, 75, 85, 89, 89.9) for bsdf in CHANNELS]
    low = Views.of([[3.0, 0.2, 1.0], [3.0, -0.5, 0.4]], intensity=30.0)
    level = torch.tensor([1.0, 0.0, 0.0]).expand(CASE_SIDE, CASE_SIDE, 3)
    return [*cases,
            Case("tilt", "60 degrees, half facing away", None, material(normal=tilted(60)), low),
            Case("tilt", "85 degrees, all facing away", None, material(normal=tilted(85, 160)), low),
            Case("tilt", "89.999 degrees along x", None, material(normal=tilted(89.999, 0)), low,
                 known=HORIZON),
            Case("tilt", "90 degrees", None, material(normal=level), low, refused=True),
            Case("tilt", "normals of length 1e-9", None, material(normal=1e-9 * tilted(0)), GRID,
                 refused=True)]


def _distance() -> list[Case]:
    cases = []
    for z in (0.02, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4):
        beside = Views.of([[0.1, 0.2, z]], [[0.1 + 0.3 * z, 0.2, z]], 3 * z**2)
        cases += [Case("distance", f"{z:g} sides, {bsdf}", z, material(bsdf), beside,
                       known=HIT if z < 0.1 else {}) for bsdf in CHANNELS]
    for x in (10.0, 100.0, 1e3, 1e4):
        aside = Views.of([[x, 0.2, 1]], intensity=x**3)
        cases.append(Case("distance", f"{x:g} sides aside, 1 above", None, material(), aside))
    opposite = Views.of([[100.0, 0.1, 0.01]], [[-100.0, 0.1, 0.01]], 1e8)
    mirrors = material(roughness=0.05, normal=tilted(0))
    return [*cases, Case("distance", "low, on opposite sides", None, mirrors, opposite, known=OPPOSITE),
            *(Case("distance", f"{z:g} sides", None, material(), _unchecked(z), refused=True)
              for z in (-1.0, 1e-5, 1e8))]


def _unchecked(z: float = 1.0, intensity: float = 1.0) -> Views:
    place = torch.tensor([[0.0, 0.0, z]], dtype=torch.float64)
    return Views(place, place, torch.full((1, 3), intensity, dtype=torch.float64))


def _colour() -> list[Case]:
    red = (1.0, 1e-6, 0.0)
    cases = [Case("colour", f"albedo {name}", None, material(diffuse=value), GRID)
             for name, value in (("0", 0.0), ("1e-6", 1e-6), ("1", 1.0), ("(1, 1e-6, 0)", red))]
    for where, views in (("", GRID), (", apart", APART)):
        cases += [Case("colour", f"F0 {name}{where}", None, material(specular=value), views)
                  for name, value in (
            ("0", 0.0), ("1e-6", 1e-6), ("1e-3", 1e-3), ("0.99", 0.99), ("1", 1.0), ("(1, 1e-6, 0)", red))]
    cases += [Case("colour", f"base colour {name}", None, material("principled", base_color=value), APART)
              for name, value in (("0", 0.0), ("1", 1.0), ("(1, 1e-6, 0)", red))]
    cases += [Case("colour", f"metallic {value:g}", None, material("principled", metallic=value), APART)
              for value in (0.0, 1e-6, 1.0)]
    return [*cases, Case("colour", "albedo -0.1", None, material(diffuse=-0.1), GRID, refused=True),
            Case("colour", "F0 1.1", None, material(specular=1.1), GRID, refused=True)]


def _intensity() -> list[Case]:
    cases = [Case("intensity", f"{i:g}", i, material(), Views.of(APART.camera, APART.light, i))
             for i in (1e-8, 1e-4, 1.0, 1e4, 1e8)]
    return cases + [Case("intensity", f"{i:g}", None, material(), _unchecked(intensity=i), refused=True)
                    for i in (0.0, 1e20, float("inf"))]


def _clipped() -> list[Case]:
    return [Case("clipped", f"exposure {times:g}, {transfer}", times, material(),
                 Views.of(GRID.camera, intensity=GRID.intensity * times), transfer=transfer)
            for times in (1e-6, 1.0, 10.0, 1e3) for transfer in ("gamma2.2", "srgb", "linear")]


def _flat() -> list[Case]:
    return [Case("flat", "grey", None, flat(CASE_SIDE), GRID),
            Case("flat", "black", None, flat(CASE_SIDE, diffuse=0.0), APART),
            Case("flat", "mirror", None, flat(CASE_SIDE, diffuse=0.0, specular=1.0, roughness=0.02), GRID),
            Case("flat", "principled", None, flat(CASE_SIDE, "principled"), APART)]


def _resolution() -> list[Case]:
    above = Views.of([[0.1, 0.2, 2.0]], [[0.4, 0.2, 2.0]], 12.0)
    return [Case("resolution", f"{side} px", side, material(side=side), above)
            for side in (2, 16, 128, 512, 2048)]


def _views() -> list[Case]:
    rng = torch.Generator().manual_seed(3)
    around = torch.cat((torch.rand(64, 2, generator=rng) * 2 - 1, 1 + torch.rand(64, 1, generator=rng)),
                       dim=1).double()
    lights = around + torch.tensor([0.3, 0.0, 0.0])
    return [Case("views", f"{n}, {bsdf}", n, material(bsdf), Views.of(around[:n], lights[:n], 8.0))
            for n in (1, 2, 9, 64) for bsdf in CHANNELS]


def _stiff() -> list[Case]:
    spot = texel_positions(CASE_SIDE).norm(dim=-1) < 0.2
    mirror = aimed("roughconductor", GRID, 0.02)["normal"]
    mixed = material(roughness=torch.where(spot[..., None], 0.02, 0.8),
                     normal=torch.where(spot[..., None], mirror, material()["normal"]))
    return [Case("stiff", name, None, mixed, GRID, texels)
            for name, texels in (("both", None), ("the mirror-like spot", spot), ("the matte rest", ~spot))]


SWEEPS: dict[str, tuple[str, Callable[[], list[Case]]]] = {
    "roughness": ("Roughness, every texel in the highlight of a view", _roughness),
    "tilt": ("Normals tilted, or pointing away", _tilt),
    "distance": ("Distance of camera and light, in patch sides; and to the side until the view grazes",
                 _distance),
    "colour": ("Albedo, F0, base colour and metallic at the ends of their range", _colour),
    "intensity": ("Radiant intensity of the light", _intensity),
    "clipped": ("Photos from black to burnt out: gradients of the photometric loss", _clipped),
    "flat": ("Constant maps", _flat),
    "resolution": ("Texels along a side", _resolution),
    "views": ("Number of views", _views),
    "stiff": ("A mirror-like spot in a matte surface: gradients many decades apart", _stiff),
}
