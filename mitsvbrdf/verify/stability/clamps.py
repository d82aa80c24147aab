"""Every place between the maps and the loss where something is cut off, with the reason; what a verdict calls
clamped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ...color import CLIPPED, TOE, decode
from ...fit.hierarchical.ties import BOUNDS
from ...fit.parameters import MAX_SLOPE, ROUGHNESS_RANGE
from ...render.analytic import MIN_ALPHA
from ...render.bsdf import F0_RANGE
from ...render.needs import CONSTANT_FRESNEL_DEGREES, half_angle_bound
from ...views import BRIGHTEST, FARTHEST, NEAREST
from .sweeps import Case

LEAST_F0 = float(decode(torch.tensor(BOUNDS["specular"][0])))  # bounds are of display values


@dataclass(frozen=True)
class Clamp:
    """One cut.

    Args:
        name: as it stands in a verdict.
        where: file and constant.
        why: what it is for, and what it does to values and gradients.
        acts: whether it changes a value or gradient of a configuration that was rendered to this radiance;
            None for those that stand before or after what the sweeps render.
    """

    name: str
    where: str
    why: str
    acts: Callable[[Case, Tensor], bool] | None = None


def _smoother_than(bsdf: str) -> Callable[[Case, Tensor], bool]:
    return lambda case, radiance: case.svbrdf.bsdf == bsdf and bool(
        (case.svbrdf["roughness"].double() ** 2 <= MIN_ALPHA[bsdf]).any())


def _index_cut(case: Case, radiance: Tensor) -> bool:
    if case.svbrdf.bsdf != "roughconductor" or half_angle_bound(case.views) <= CONSTANT_FRESNEL_DEGREES:
        return False
    f0 = case.svbrdf["specular"]
    return bool(((f0 < F0_RANGE[0]) | (f0 > F0_RANGE[1])).any())


CLAMPS = (
    Clamp(f"alpha >= {MIN_ALPHA['roughconductor']:g}", "`render/analytic.py`, `MIN_ALPHA`; Mitsuba's "
                                                       "`roughconductor`",
          "D is 1 / (pi alpha^2) at its peak: without an end it overflows float32 at r = 1e-10, and one "
          "rounding of the normal "
          f"is worth 6e-8 / alpha of it. Below r = {MIN_ALPHA['roughconductor'] ** 0.5:g} the image stays "
          "as it is there, the "
          "gradient of roughness is 0.", _smoother_than("roughconductor")),
    Clamp(f"alpha >= {MIN_ALPHA['principled']:g}", "`render/bsdf.py`, `MIN_ALPHA_PRINCIPLED`; Mitsuba's "
                                                   "`principled`",
          f"The plugin's own end, above the other. Below r = {MIN_ALPHA['principled'] ** 0.5:.4f} only the "
          "diffuse lobe still "
          "answers to roughness.", _smoother_than("principled")),
    Clamp(f"index for F0 in [{F0_RANGE[0]:g}, {F0_RANGE[1]:g}]", "`render/bsdf.py`, `F0_RANGE`",
          "Away from the camera F follows a refractive index, which is infinite at F0 = 1, and whose slope "
          "is infinite at "
          "F0 = 0. Beyond these ends F is proportional to F0, and keeps a slope. Where the light is at the "
          "camera F is F0 "
          "and nothing is cut.", _index_cut),
    Clamp("toe of gamma 2.2", "`color.py`, `TOE`",
          f"The power curve is vertical at 0. Below {TOE:g} (2/3 of an 8-bit step) it is its chord: the "
          "slope is at most 1282.",
          lambda case, radiance: case.transfer == "gamma2.2" and bool((radiance < TOE).any())),
    Clamp("burnt-out photos", "`color.py`, `CLIPPED`",
          f"A photo value from {CLIPPED} on says at least this bright: gradient 0 where the rendering is "
          "brighter still.",
          lambda case, radiance: case.transfer is not None and bool((radiance >= 1).any())),
    Clamp("facing away", "`render/analytic.py`, `lit`",
          "A texel whose normal points away from camera or light is black with gradient 0. Where n.v = 0 "
          "the radiance jumps; "
          "where n.l = 0 it does not."),
    Clamp("constant F", "`render/needs.py`, `CONSTANT_FRESNEL_DEGREES`",
          f"Up to {CONSTANT_FRESNEL_DEGREES} degrees of half angle F is F0, which changes it by less than "
          "4e-7."),
    Clamp("D cos below 1e-20", "Mitsuba's microfacet distribution",
          "Counts as 0, with gradient 0: far below what an image shows."),
    Clamp("views that are taken", "`views.py`, `NEAREST`, `FARTHEST`, `BRIGHTEST`",
          f"Cameras and lights closer than {NEAREST:g} or further than {FARTHEST:g} patch sides, or I / d^2 "
          "above "
          f"{BRIGHTEST:g}, are refused: float32 would overflow, and a patch size in another unit is the "
          "likely cause."),
    Clamp("what a fit can reach",
          "`fit/hierarchical/ties.py`, `BOUNDS`; others: `fit/parameters.py`, `ROUGHNESS_RANGE`, "
          "`MAX_SLOPE`, `to_raw`",
          f"Roughness {ROUGHNESS_RANGE[0]} to {ROUGHNESS_RANGE[1]:g}. Normals up to a slope of "
          f"{BOUNDS['normal'][1]:g} along "
          f"an axis with `hierarchical`, {MAX_SLOPE} with other methods. F0 of {LEAST_F0:.2g} or more with "
          "`hierarchical`, or 0 where no lobe is needed. Starts of other methods are moved just inside, "
          "where tanh and the "
          "logistic function still have a slope."),
)
