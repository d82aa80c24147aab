"""Where the model cuts a value off, and whether a cut acts: what the verdict ``clamped`` names.

The other cuts change no value or gradient of the sweeps; the page on stability lists all of them.
"""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from ...color import TOE
from ...render.analytic import MIN_ALPHA
from ...render.bsdf import F0_RANGE
from ...render.needs import CONSTANT_FRESNEL_DEGREES, half_angle_bound
from .sweeps import Case

Acts = Callable[[Case, Tensor], bool]


def _smoother_than(bsdf: str) -> Acts:
    return lambda case, radiance: case.svbrdf.bsdf == bsdf and bool(
        (case.svbrdf["roughness"].double() ** 2 <= MIN_ALPHA[bsdf]).any())


def _index_cut(case: Case, radiance: Tensor) -> bool:
    if case.svbrdf.bsdf != "roughconductor" or half_angle_bound(case.views) <= CONSTANT_FRESNEL_DEGREES:
        return False
    f0 = case.svbrdf["specular"]
    return bool(((f0 < F0_RANGE[0]) | (f0 > F0_RANGE[1])).any())


# By name, as a verdict has it: whether the cut changes a value or gradient of a case of this radiance.
CLAMPS: dict[str, Acts] = {
    # D is 1 / (pi alpha^2) at its peak: without an end it overflows float32 at r = 1e-10, and one rounding of
    # the normal is worth 6e-8 / alpha of it. Below, the image stays as it is and roughness has gradient 0.
    f"alpha >= {MIN_ALPHA['roughconductor']:g}": _smoother_than("roughconductor"),
    # The plugin's own end. Below, only the diffuse lobe answers to roughness.
    f"alpha >= {MIN_ALPHA['principled']:g}": _smoother_than("principled"),
    # The refractive index is infinite at F0 = 1, its slope at F0 = 0. Beyond, F is proportional to F0.
    f"index for F0 in [{F0_RANGE[0]:g}, {F0_RANGE[1]:g}]": _index_cut,
    # The power curve is vertical at 0: below the toe it is its chord, of slope 1282.
    "toe of gamma 2.2": lambda case, radiance: case.transfer == "gamma2.2" and bool((radiance < TOE).any()),
    # A burnt-out photo value says at least this bright: gradient 0 where the rendering is brighter still.
    "burnt-out photos": lambda case, radiance: case.transfer is not None and bool((radiance >= 1).any()),
}
