"""Views: positions of camera and light, and the intensity of the light.

Conventions (docs/conventions.md): the patch is a square of side ``size`` in the plane z = 0, x right, y up,
with its centre at the origin. Camera and light are at z > 0. All lengths have one unit.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from .errors import CaptureError, ConfigError, NotFiniteError
from .kinds import check_fields

FIELD_OF_VIEW = 60.0  # degrees across the long side, if EXIF states none; phones' wide cameras: 60 to 70

Falloff = Literal["inverse-square", "none"]

# Distances, in patch sides, that float32 and traced rays can represent. Larger ones probably mean a size in
# another unit. At I / d^2 = 1e12 the steepest highlight (alpha 1e-4) and its gradients stay below 1e30.
NEAREST, FARTHEST = 1e-3, 1e6
BRIGHTEST = 1e12

ALL = slice(None)
STRIP = 2**16  # texels that are processed together, so that intermediate results stay in the cache


@dataclass(frozen=True)
class View:
    """The geometry of one photo: camera and light position (x, y, z), radiant intensity (r, g, b)."""

    camera: tuple[float, float, float]
    light: tuple[float, float, float]
    intensity: tuple[float, float, float]


@dataclass(frozen=True)
class Views:
    """A set of views of one patch.

    Args:
        camera: N x 3, float, positions with z > 0.
        light: N x 3, float, positions with z > 0.
        intensity: N x 3, float, radiant intensity I of each light (rgb); irradiance is I cos / d^2.
        size: side of the patch, in the unit of the positions.
        falloff: ``inverse-square``, or ``none`` for the paper's light without attenuation. With ``none``, the
            irradiance factor is I / |light|^2 everywhere, that of the patch centre.

    Raises:
        CaptureError: wrong shapes, or no view. :meth:`check` checks the values.
        ConfigError: unknown falloff.
    """

    camera: Tensor
    light: Tensor
    intensity: Tensor
    size: float = 1.0
    falloff: Falloff = "inverse-square"

    def __post_init__(self) -> None:
        check_fields(self, "size", "falloff")
        for name in ("camera", "light", "intensity"):
            value = getattr(self, name)
            if not isinstance(value, Tensor) or not value.is_floating_point():
                raise CaptureError(f"{name} as a float tensor",
                                   repr(getattr(value, "dtype", type(value).__name__)),
                                   "use Views.of(camera, light, intensity), which takes lists and arrays")
            if value.ndim != 2 or value.shape[1] != 3 or value.shape[0] != self.camera.shape[0]:
                raise CaptureError(f"{name} of N x 3 with N = {self.camera.shape[0]}",
                                   f"shape {tuple(value.shape)}",
                                   "give one row of three numbers for each photo")
        if not len(self):
            raise CaptureError("one view or more", "none", "give one row of three numbers for each photo")
        if self.falloff not in get_args(Falloff):
            raise ConfigError(f"falloff of {get_args(Falloff)}", repr(self.falloff), "choose one of these")

    @classmethod
    def of(cls, camera: Any, light: Any = None, intensity: Any = 1.0, size: float = 1.0,
           falloff: Falloff = "inverse-square") -> Views:
        """Views from lists, arrays or tensors, checked: finite, z > 0, intensity >= 0 and no light black.

        Args:
            camera: N x 3.
            light: N x 3. Default: at the camera.
            intensity: a number, 3 numbers, N x 3, or N x 1 for white lights.

        Raises:
            CaptureError: wrong shapes, or wrong values (:meth:`check`); it names the first wrong row.
        """
        try:
            camera, light, power = (torch.as_tensor(camera if values is None else values, dtype=torch.float64)
                                    for values in (camera, light, intensity))
            if any(values.ndim > 2 or values.shape[-1:] != (3,) for values in (camera, light)):
                raise ValueError(f"shapes {tuple(camera.shape)} and {tuple(light.shape)}")
            camera, light = camera.reshape(-1, 3).clone(), light.reshape(-1, 3).clone()
            power = power.expand(len(camera) if power.ndim < 2 or len(power) == 1 else len(power), 3)
            size = float(size)
        except (TypeError, ValueError, RuntimeError) as error:
            raise CaptureError("rows of three numbers", str(error), "check the calibration") from None
        views = cls(camera, light, power.clone(), size, falloff)
        views.check()
        return views

    def check(self) -> None:
        """Raise CaptureError unless every number is finite and physically possible.

        Cameras and lights are at least :data:`NEAREST` patch sides above the plane. No coordinate exceeds
        :data:`FARTHEST` sides. At the patch point nearest to a light, its I / d^2 is at most
        :data:`BRIGHTEST`.
        """
        if not (self.size > 0 and torch.isfinite(torch.tensor(self.size))):
            raise CaptureError("a patch size > 0", str(self.size), "check im_size / image_size")
        self.check_finite()
        for name in ("camera", "light"):
            for row, position in enumerate(getattr(self, name).tolist()):
                if position[2] <= 0:
                    raise CaptureError("cameras and lights above the plane (z > 0)",
                                       f"{name} {row} at {position}",
                                       "z points from the material toward the camera; check signs and "
                                       "column order")
        for row, power in enumerate(self.intensity.tolist()):
            if min(power) < 0 or max(power) == 0:
                raise CaptureError("a light intensity >= 0, not all 0", f"light {row} with {power}",
                                   "check light_pow")
        sides = self.to(torch.float64).in_patch_sides()  # ratios to the side, and to d^2, have no unit
        for name in ("camera", "light"):
            for row, position in enumerate(getattr(sides, name).tolist()):
                if position[2] < NEAREST or max(map(abs, position)) > FARTHEST:
                    at = ", ".join(f"{x:.3g}" for x in position)
                    raise CaptureError(f"cameras and lights {NEAREST:g} to {FARTHEST:g} patch sides away",
                                       f"{name} {row} at ({at}) sides",
                                       "give the patch size in the unit of the positions")
        beside = torch.cat(((sides.light[:, :2].abs() - 0.5).clamp_min(0), sides.light[:, 2:]), dim=1)
        brightness = sides.intensity.amax(dim=1) / beside.square().sum(dim=1)
        if not bool((brightness <= BRIGHTEST).all()):
            raise CaptureError(f"a light of at most {BRIGHTEST:g} times its squared distance to the patch",
                               f"light {int(brightness.argmax())} with {float(brightness.max()):.3g}",
                               "check light_pow and the patch size")

    def check_finite(self) -> None:
        """Raise NotFiniteError if a number is NaN or infinite; the message has its row."""
        what_of = {"camera": "positions", "light": "positions", "intensity": "light intensities"}
        for name, what in what_of.items():
            for row, numbers in enumerate(getattr(self, name).tolist()):
                if not all(map(math.isfinite, numbers)):
                    raise NotFiniteError(f"finite {what}", f"{name} {row} at {numbers}",
                                         "check the calibration for NaN")

    def __len__(self) -> int:
        return self.camera.shape[0]

    def __iter__(self) -> Iterator[View]:
        for camera, light, intensity in zip(self.camera.tolist(), self.light.tolist(),
                                            self.intensity.tolist()):
            yield View(tuple(camera), tuple(light), tuple(intensity))

    def carried(self, shift: Tensor) -> Views:
        """The views with cameras and lights moved together by ``shift``, N x 3 or 3, in the unit of the
        positions. A point that moves with them keeps its lighting.
        """
        moved = replace(self, camera=self.camera + shift, light=self.light + shift)
        if self.falloff == "inverse-square":
            return moved
        # Without falloff, the irradiance factor is I / |light|^2 everywhere, and |light| has changed.
        nearer = moved.light.square().sum(dim=1) / self.light.square().sum(dim=1)
        return replace(moved, intensity=self.intensity * nearer[:, None])

    def pick(self, index: Sequence[int] | Tensor) -> Views:
        """The views with these numbers (from 0), in this order.

        Raises:
            CaptureError: no number, or one that does not exist or is no whole number.
        """
        rows = whole_numbers(index)
        if not rows or min(rows) < 0 or max(rows) >= len(self):
            raise CaptureError(f"positions from 0 to {len(self) - 1}", str(rows or "none"),
                               "check which views are picked")
        return replace(self, camera=self.camera[rows], light=self.light[rows], intensity=self.intensity[rows])

    def in_patch_sides(self) -> Views:
        """The same views and radiance with the patch side as unit of length (size = 1)."""
        s = self.size
        return replace(self, camera=self.camera / s, light=self.light / s, intensity=self.intensity / s**2,
                       size=1.0)

    def to(self, dtype: torch.dtype) -> Views:
        """The same views with tensors of this dtype."""
        return replace(self, camera=self.camera.to(dtype), light=self.light.to(dtype),
                       intensity=self.intensity.to(dtype))


def shift_lights(views: Views, flash_offset: tuple[float, float] | None) -> Views:
    """The views with every light moved sideways by (x, y) patch sides; None: unchanged."""
    if flash_offset is None:
        return views
    return replace(views, light=views.light + views.light.new_tensor([*flash_offset, 0.0]) * views.size)


def texel_positions(resolution: int, dtype: torch.dtype = torch.float64, rows: slice = ALL) -> Tensor:
    """Centres of the texels of an R x R map on a patch of side 1: R x R x 3, row 0 at the top, z = 0.

    ``rows``: the rows of the map to return; default: all.
    """
    step = (torch.arange(resolution, dtype=dtype) + 0.5) / resolution - 0.5
    y, x = torch.meshgrid(-step[rows], step, indexing="ij")
    return torch.stack((x, y, torch.zeros_like(x)), dim=-1)


def strips(resolution: int) -> list[slice]:
    """Slices of the rows of an R x R map, each of one row or at most :data:`STRIP` texels, to save memory."""
    rows = max(1, STRIP // resolution)
    return [slice(first, min(first + rows, resolution)) for first in range(0, resolution, rows)]


def half_angles(views: Views, resolution: int, rows: slice = ALL) -> Tensor:
    """Angles (rad) between (0, 0, 1) and the half vector of each view at each texel: N x R x R, float64."""
    views = views.in_patch_sides().to(torch.float64)
    position, angles = texel_positions(resolution, rows=rows), []
    for camera, light in zip(views.camera.detach(), views.light.detach()):
        half = F.normalize(camera - position, dim=-1) + F.normalize(light - position, dim=-1)
        angles.append(torch.atan2(half[..., :2].norm(dim=-1), half[..., 2]))
    return torch.stack(angles)


def coverage_angle(views: Views, resolution: int) -> Tensor:
    """The smallest of the views' :func:`half_angles` at each texel: R x R, float64."""
    return torch.cat([half_angles(views, resolution, rows).amin(dim=0) for rows in strips(resolution)])


def nine_view_grid(distance: float = 2.0, spread: float = 0.4) -> Views:
    """Nine co-located views on a 3 x 3 grid at one height, in patch sides: a plausible hand-held capture.

    A white diffuse texel at the foot point of the light has radiance 1 (intensity = pi distance^2).
    """
    wobble = torch.tensor([[0.0, 0.0], [0.9, -0.8], [-0.8, 0.9], [-1.0, -0.9], [0.9, 1.0], [0.1, -0.9],
                           [-0.1, 0.9], [-0.9, 0.1], [1.0, -0.1]], dtype=torch.float64)
    camera = torch.cat((spread * wobble, torch.full((9, 1), distance, dtype=torch.float64)), dim=1)
    return Views.of(camera, intensity=torch.pi * distance**2)


def default_views(count: int, field_of_view: float = FIELD_OF_VIEW, share: float = 1.0) -> Views:
    """The default geometry of photos without calibration: camera and light together above the centre.

    Args:
        field_of_view: degrees across the photo's long side.
        share: the patch side as a share of that long side.

    Returns:
        ``count`` equal views, in patch sides. A white diffuse texel at the patch centre has radiance 1.
    """
    distance = 0.5 / (share * math.tan(math.radians(field_of_view) / 2))
    return Views.of([[0.0, 0.0, distance]] * count, intensity=math.pi * distance**2)


def geometry(views: Views, resolution: int, rows: slice = ALL) -> tuple[Tensor, Tensor, Tensor]:
    """Unit vectors to the light, half vectors and irradiance at flat texels: N x R x R x 3 each, float32.

    ``rows``: the rows of the map to return; default: all.
    """
    views, texels = views.in_patch_sides(), texel_positions(resolution, rows=rows)
    light, camera = (x[:, None, None] - texels for x in (views.light, views.camera))
    reach = light.norm(dim=-1, keepdim=True)
    if views.falloff == "none":
        reach = views.light.norm(dim=1)[:, None, None, None]
    light = F.normalize(light, dim=-1)
    half = F.normalize(light + F.normalize(camera, dim=-1), dim=-1)
    irradiance = views.intensity[:, None, None] * light[..., 2:] / reach**2
    return light.float(), half.float(), irradiance.float()


def whole_numbers(index: Sequence[int] | Tensor) -> list[int]:
    """An index as a list of whole numbers; CaptureError for text, fractions, booleans and the like."""
    try:
        numbers: list = index.tolist() if hasattr(index, "tolist") else list(index)
        if any(isinstance(number, bool) for number in numbers):
            raise TypeError
        return [operator.index(number) for number in numbers]
    except TypeError:
        raise CaptureError("whole numbers like [0, 1, 2]", repr(index), "give the photos by number") from None


def photo_numbers(text: str | None) -> list[int] | None:
    """The numbers in a text like ``0,1,2,5``; ConfigError for any other text. None stands for all photos."""
    try:
        return None if text is None else [int(part) for part in text.split(",")]
    except ValueError:
        raise ConfigError("photo numbers like 0,1,2,5", repr(text), "separate them by commas") from None
