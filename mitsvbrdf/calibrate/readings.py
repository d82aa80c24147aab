"""Readings of a calibration: what its numbers mean, and which reading agrees with the photos.

A file does not state where x and y point, or the units of lengths and light power. The photos show both. A
model of flat texels of one roughness explains them roughly if the reading is right. Under a wrong reading,
the model has highlights and shading elsewhere, and its error is much larger. For each reading, the best
diffuse colour and F0 of each texel and the best gain of each photo are found. Then errors are compared.
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

READING_SIDE = 16  # pixels a side of the averaged photos: relief averages out
LEAST_PHOTOS = 4  # with three photos and two unknowns a texel, wrong readings fitted better
ALPHAS = 0.05, 0.1, 0.2, 0.35, 0.6
DIM = 0.05  # errors are divided by radiance + DIM
GAINS = 0.8, 1.25  # limits of the change of a photo's gain in each of two rounds
# Another reading is better if its error is below this share of the stated reading's. With right calibrations
# (eighteen real captures, twenty known materials), the best other reading had 1.3 times the error or more.
CLEARLY = 0.87
HEIGHTS = 0.4, 20.0  # patch sides; real captures: 1.7 to 4.1. Outside, a side in another unit is tried
# Median reflectances (diffuse + F0): unusual below, unusual above, usual. The same materials: 0.02 to 1.0.
FAINT, BRIGHT, USUAL = 0.005, 3.0, 0.14
UNITS = 1e-6, 1e-4, 1e-3, 1e-2, 1e2, 1e3, 1e4, 1e6  # of light power, for other units of it or of length


@dataclass(frozen=True)
class Reading:
    """One meaning of the numbers of a calibration.

    Args:
        axes: where x and y of the positions point in the photos.
        side: of the patch, in the unit of the positions; None: as stated.
        light_factor: factor by which the stated light power is multiplied.

    Raises:
        ConfigError: unknown axes, or a number out of range.
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
        """The reading stated in the options of a command line, a dict; other options are ignored."""
        return cls(**{each.name: options[each.name] for each in fields(cls) if each.name in options})

    def of(self, capture: Capture) -> Capture:
        """The capture with its calibration read like this.

        Raises:
            ConfigError: the capture has no calibration.
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
    """Sentences on how photos contradict a calibration, and whether they contradict its light power."""

    said: tuple[str, ...]
    light: bool


def mean_radiance(capture: Capture, side: int) -> tuple[Tensor, Tensor]:
    """Mean linear grey of measured pixels (float64; 0 if half or fewer), and a mask: N x side x side each."""
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
    """Mean relative error of the best flat material of one roughness, and its median reflectance where seen.

    ``photos``: grey radiance, N x R x R. ``seen``: N x R x R, bool, measured and not clipped.
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
    """Weights >= 0, R x R x 2: the weighted sum of the two terms (N x R x R x 2) is nearest to the goal."""
    curve = torch.einsum("nijp,nijq->ijpq", terms, terms)
    slope = torch.einsum("nijp,nij->ijp", terms, goal)
    own = curve.diagonal(dim1=-2, dim2=-1).clamp_min(1e-30)
    both = torch.linalg.solve(curve + torch.diag_embed(1e-3 * own), slope)
    alone = (slope / own).clamp_min(0)
    alone = alone * (F.one_hot((slope**2 / own * (slope > 0)).argmax(dim=-1), 2))
    return torch.where((both >= 0).all(dim=-1, keepdim=True), both, alone)
