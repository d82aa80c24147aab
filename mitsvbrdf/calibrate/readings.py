"""How the numbers of a calibration are meant, and whether its photos confirm them.

Nothing in a file says where x and y point, nor in which units lengths and light power are. The photos do.
Flat texels of one roughness explain the photos roughly under the right reading. Under a wrong one, highlights
and shading are expected elsewhere, and the error is much larger. Under each reading, each texel's diffuse
colour and F0, and each photo's gain, are the best ones; the errors that are left are compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Literal, NamedTuple, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..capture import Capture
from ..color import CLIPPED
from ..errors import LARGEST, ConfigError
from ..io.entry import entry
from ..kinds import check_fields
from ..views import Views, geometry

Axes = Literal["right-up", "right-down", "left-up", "left-down", "up-right", "up-left", "down-right",
               "down-left"]
WAYS = {"right": (1.0, 0.0), "left": (-1.0, 0.0), "up": (0.0, 1.0), "down": (0.0, -1.0)}

READING_SIDE = 16  # pixels a side that are looked at: relief averages out
LEAST_PHOTOS = 4  # with three, two numbers a texel leave one value free, and wrong readings fitted better
ALPHAS = 0.05, 0.1, 0.2, 0.35, 0.6
DIM = 0.05  # radiance from which on errors count relative to it
GAINS = 0.8, 1.25  # of a photo, in each of two rounds
# Error left by another reading, as a share of the error left by the stated one. Of eighteen real captures and
# twenty known materials with right calibrations the best other reading left 1.3 times as much and more.
CLEARLY = 0.87
HEIGHTS = 0.4, 20.0  # patch sides; of real captures 1.7 to 4.1. Beyond, a side in another unit is tried
# Median reflectances (diffuse + F0): unusual below, unusual above, usual. The same materials: 0.02 to 1.0.
FAINT, BRIGHT, USUAL = 0.005, 3.0, 0.14
UNITS = 1e-6, 1e-4, 1e-3, 1e-2, 1e2, 1e3, 1e4, 1e6  # factors on light power from other length or power units


@dataclass(frozen=True)
class Reading:
    """How the numbers of a calibration are meant.

    Args:
        axes: where x and y of the positions point in the photos.
        side: of the patch, in the unit of the positions; None: as stated.
        light_factor: factor by which the stated light power is multiplied.

    Raises:
        ConfigError: other axes, or a number out of range.
    """

    axes: Axes = "right-up"
    side: float | None = None
    light_factor: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.axes not in get_args(Axes):
            raise ConfigError(f"--axes of {', '.join(get_args(Axes))}", repr(self.axes), "choose one")
        for name, value in (("--side", self.side), ("--light-factor", self.light_factor)):
            if value is not None and not 1 / LARGEST <= value <= LARGEST:
                raise ConfigError(f"{name} above 0, at most {LARGEST:g}", f"{value:g}", "choose another one")

    @classmethod
    def told(cls, options: Mapping) -> Reading:
        """The reading that some of the options of a command line state."""
        return cls(**{each.name: options[each.name] for each in fields(cls) if each.name in options})

    def of(self, capture: Capture) -> Capture:
        """The capture with its calibration read like this.

        Raises:
            ConfigError: it has no calibration.
            CaptureError: impossible views, such as cameras too near for the side.
        """
        if self == Reading():
            return capture
        if not capture.calibrated:
            raise ConfigError("a calibration beside --axes, --side or --light-factor", "photos alone",
                              "omit these")
        views = self.of_views(capture.views)
        views.check()
        return capture.but(views=views)

    def of_views(self, views: Views) -> Views:
        """The views read like this."""
        turn = torch.eye(3, dtype=views.camera.dtype)
        turn[:2, :2] = torch.tensor([WAYS[way] for way in self.axes.split("-")])
        return replace(views, camera=views.camera @ turn, light=views.light @ turn,
                       intensity=views.intensity * self.light_factor, size=self.side or views.size)


class Doubts(NamedTuple):
    """What speaks against a calibration, in sentences, and whether its light power is doubted."""

    said: tuple[str, ...]
    light: bool


def mean_radiance(capture: Capture, side: int) -> tuple[Tensor, Tensor]:
    """Linear grey, float64: means of measured pixels, N x side x side; 0 and False where few are measured."""
    means = []
    for row in range(len(capture)):
        grey = color.decode(capture.photo(row).double(), capture.transfer).mean(dim=-1)
        told = torch.ones_like(grey) if capture.measured is None else capture.measured[row].double()
        means.append(F.adaptive_avg_pool2d(torch.stack((grey * told, told)), side))
    light, share = torch.stack(means, dim=1)
    return torch.where(share > 0.5, light / share, 0.0), share > 0.5


@entry()
def doubts(capture: Capture) -> Doubts | None:
    """How photos contradict a stated calibration; takes about a tenth of a second.

    None without a contradiction, with fewer than four photos, or without a stated calibration.
    """
    if capture.calibration != "given" or len(capture) < LEAST_PHOTOS:
        return None
    side = min(READING_SIDE, capture.resolution)
    light, seen = mean_radiance(capture, side)
    seen &= torch.cat([F.adaptive_max_pool2d(photo.amax(dim=-1)[None], side) < CLIPPED
                       for photo in map(capture.photo, range(len(capture)))])
    views = replace(capture.views.to(torch.float64), falloff="inverse-square")
    height = float(views.light[:, 2].median()) / views.size
    sides = [None, *(views.size * 10.0**k for k in range(-3, 4)
                     if not HEIGHTS[0] < height < HEIGHTS[1] and HEIGHTS[0] < height / 10.0**k < HEIGHTS[1])]
    left = {reading: _left(light, seen, reading.of_views(views))
            for reading in (Reading(axes, size) for size, axes in product(sides, get_args(Axes)))}
    best, said = min(left, key=lambda reading: left[reading][0]), []
    if left[best][0] < CLEARLY * left[Reading()][0]:
        x, y = best.axes.split("-")
        options = [f"--axes {best.axes}"] * (best.axes != "right-up")
        options += [f"--side {best.side:.6g}"] if best.side else []
        said.append(f"the photos contradict the stated places of cameras and lights, {height:.3g} patch "
                    f"sides away: with x {x}, y {y} and a side of {best.side or views.size:.6g} they are "
                    f"explained {left[Reading()][0] / max(left[best][0], 1e-9):.1f} times as well; try "
                    f"{' '.join(options)}")
    else:
        best = Reading()
    reflectance = left[best][1]
    if light_doubted := not FAINT < reflectance < BRIGHT:
        factor = min(UNITS, key=lambda unit: abs(math.log(max(reflectance, 1e-30) / USUAL / unit)))
        said.append(f"with the stated light power the material reflects {reflectance:.1g} of the light, as "
                    f"{'polished metal alone' if reflectance < 1 else 'no material'} does; for another unit "
                    f"try --light-factor {factor:g} (centimetres for metres: 0.0001, the reverse: 10000)")
    return Doubts(tuple(said), light_doubted) if said else None


def _left(photos: Tensor, seen: Tensor, views: Views) -> tuple[float, float]:
    """Mean relative error that the best flat material of one roughness leaves, and its median reflectance.

    Photos are grey radiance, N x R x R; ``seen``: where not clipped. The median is of texels seen.
    """
    light, half, irradiance = (x.double() for x in geometry(views, photos.shape[1]))
    bright, up = irradiance.mean(dim=-1) / math.pi, light[..., 2].clamp_min(1e-3)
    found = []
    for alpha in ALPHAS:
        lobe = (alpha / (1 + (alpha**2 - 1) * half[..., 2].square()) / up / 2).square()
        shares, gain = torch.stack((bright, bright * lobe), dim=-1), torch.ones(len(photos), 1, 1)
        for _ in range(3):
            weight = seen / (gain * photos + DIM)
            terms, goal = shares * weight[..., None], gain * photos * weight
            x = _non_negative(terms, goal)
            model = (terms * x).sum(dim=-1)
            ratio = torch.where(seen, model / goal.clamp_min(1e-6), torch.nan).flatten(1)
            error = (model - goal).abs().clamp_max(1)
            gain = gain * ratio.nanmedian(dim=1).values.nan_to_num(1).clamp(*GAINS)[:, None, None]
        found.append((float(error.mean()), float(x.sum(dim=-1)[seen.any(dim=0)].median().nan_to_num(USUAL))))
    return min(found)


def _non_negative(terms: Tensor, goal: Tensor) -> Tensor:
    """The two weights >= 0 of each texel, R x R x 2, with which terms, N x R x R x 2, add up to the goal."""
    curve = torch.einsum("nijp,nijq->ijpq", terms, terms)
    slope = torch.einsum("nijp,nij->ijp", terms, goal)
    own = curve.diagonal(dim1=-2, dim2=-1).clamp_min(1e-30)
    both = torch.linalg.solve(curve + torch.diag_embed(1e-3 * own), slope)
    alone = (slope / own).clamp_min(0)
    alone = alone * (F.one_hot((slope**2 / own * (slope > 0)).argmax(dim=-1), 2))
    return torch.where((both >= 0).all(dim=-1, keepdim=True), both, alone)
