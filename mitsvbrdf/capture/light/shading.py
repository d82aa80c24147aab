"""Find flash, power, vignetting and exposures from the shading of photos with known poses.

A diffuse point of albedo rho, seen through a lens of transmission T, has in the photo the radiance

    L = rho / pi * I * exp(e) * cos / d^2 * T(pixel)

with I the flash's radiant intensity, e the logarithm of the photo's exposure, d the distance to the flash and
cos the cosine of the angle from flat normal to flash. The logarithm of L is linear in all unknowns except
vignetting and the flash's position. White paper has one known albedo. Each texel of a material has an albedo,
the same in all photos; all texels share one GGX lobe. Variable projection (Golub and Pereyra 1973) eliminates
the albedo, so photos are compared with each other. Positive errors are mostly highlights: weights fall fast
with positive errors, and slowly with negative ones (iteratively reweighted least squares). Paper has no lobe;
points near its mirror direction have low weights.

Residuals of neighbouring points are correlated. The noise, and how many points count as one, are measured on
the residuals, as in :mod:`mitsvbrdf.calibrate.refine`. If a material is hardly diffuse, both are large, and
the priors decide.
"""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import median

from ... import color
from ...material.maps import USUAL_ALBEDO
from ..lens import Array
from ..rig import Rig
from .samples import Samples, material_samples, paper_samples
from .solve import Shading, solve_light

# albedo of white office paper; 0.75 to 0.9, ISO 2470 brightness without optical brighteners
PAPER_ALBEDO, PAPER_SD = 0.8, math.log(0.9 / 0.75) / math.sqrt(12)  # sd of its natural logarithm
MOST_ALBEDO = 0.8
# A photo has another white balance if the natural logarithm of its colour differs from the median photo's by
# TINTED, and by SURELY deviations over texels (18 real materials: up to 2.0). It needs LEAST_COLOURED points.
TINTED, SURELY, LEAST_COLOURED = 0.03, 3.0, 20
# the lobe's usual F0, sd of its logarithm; dielectrics have 0.04, but one lobe for all gives 0.005 to 0.06
LOBE_F0 = 0.03, 0.6


def shading_of_paper(rig: Rig, photos: Mapping[str, np.ndarray], transfer: color.Transfer,
                     white: Callable[[Array], np.ndarray], depth: float = 0.0) -> Shading:
    """Flash, its power and colour, vignetting and exposures from white paper around the material.

    ``photos``: H x W x 3 as stored (integers, or float in [0, 1]), in the lens's size, or in that size
    divided by a whole number; photos without a pose are ignored. ``white``: for points of the world (K x 2),
    whether bare paper is there. The paper's albedo is the same in all channels, so its colour in the photos
    is that of the flash. CaptureError: no photo shows white paper that is neither clipped nor dark.
    """
    seen = {name: paper_samples(photos[name], rig.lens, pose, white, depth, transfer)
            for name, pose in rig.poses.items() if name in photos}
    found = solve_light(rig, Samples.of(rig, seen, "white paper", glossy=False))
    notes, tint = [f"paper is taken to be white with an albedo of {PAPER_ALBEDO:g}"], tint_of(found.samples)
    colour = _colours(found.samples, without=tint)[1] if tint else found.colour
    intensity = np.exp(found.level + colour) * math.pi / PAPER_ALBEDO
    if tint:
        notes.append(_said(tint, "the paper", "taken out"))
    return replace(found.shading(intensity, math.hypot(found.level_sd, PAPER_SD), tuple(notes)), tint=tint)


def tint_of(samples: Samples) -> dict[str, Array]:
    """Photos whose white balance differs from that of most photos: a dict, name to factors of rgb."""
    own, usual, spread = _colours(samples)
    return {name: np.exp(colour - usual) for name, colour in own.items()
            if (np.abs(colour - usual) > np.maximum(TINTED, SURELY * spread[name])).any()}


def _colours(samples: Samples, without: Collection[str] = ()) -> tuple[dict, Array, dict]:
    """Each photo's colour (a dict), the usual colour (their median), and each photo's deviation over texels.

    A colour is the log of rgb over their mean, relative to texels' medians. Deviations on paper are 0.
    """
    count = samples.texel.max() + 1
    one = count == 1  # paper, which is the same everywhere
    own, spread, base = {}, {}, np.zeros((count, 3))
    if not one:
        base = np.column_stack([median(channel, samples.texel, np.arange(count))
                                for channel in samples.colour.T])
    for number, name in enumerate(samples.names):
        at = samples.photo == number
        if at.sum() >= LEAST_COLOURED:
            colours = samples.colour[at] - base[samples.texel[at]]
            own[name] = np.median(colours, axis=0)
            spread[name] = (not one) * 1.4826 * np.median(np.abs(colours - own[name]), axis=0)
    kept = [colour for name, colour in own.items() if name not in without]
    return own, np.median(kept, axis=0) if kept else np.zeros(3), spread


def _said(tint: Mapping[str, Array], where: str, done: str) -> str:
    listed = ", ".join(f"{name} ({', '.join(f'{factor - 1:+.0%}' for factor in rgb)})"
                       for name, rgb in tint.items())
    return (f"white balance differs in {listed} in red, green, blue, as {where} shows: {done}; lock it for "
            "comparable photos")


def shading_of_material(rig: Rig, photos: Mapping[str, np.ndarray], transfer: color.Transfer) -> Shading:
    """Flash, vignetting and exposures from a material that looks the same from everywhere, except highlights.

    Radiance does not separate albedo from power. But most materials are dielectrics: the power is chosen such
    that the lobe's F0 and the median albedo are most probable together (:data:`LOBE_F0`,
    :data:`~mitsvbrdf.material.maps.USUAL_ALBEDO`), with at most one texel in a hundred whiter than paper. A
    metal is mistaken for a dielectric under a brighter flash. The flash is assumed to be white.

    ``photos``: rectified to the patch, R x R x 3 display values in [0, 1] with their vignetting; NaN beyond
    the photo. CaptureError: all photos are clipped or dark everywhere.
    """
    seen = {name: material_samples(photos[name], rig.lens, pose, rig.size, transfer)
            for name, pose in rig.poses.items() if name in photos}
    found = solve_light(rig, Samples.of(rig, seen, "the material", glossy=True))
    # median and 99th percentile of the albedo, for an intensity of 1
    middle, most = math.pi * np.exp(np.nanpercentile(found.albedo, (50, 99)))
    by_albedo, by_lobe = 1 / USUAL_ALBEDO[1] ** 2, 1 / (LOBE_F0[1] ** 2 + float(found.deviations.log_f0) ** 2)
    power = (by_albedo * math.log(middle / USUAL_ALBEDO[0])
             + by_lobe * math.log(math.pi * found.lobe / LOBE_F0[0]))
    intensity = max(math.exp(power / (by_albedo + by_lobe)), most / MOST_ALBEDO)
    tint = tint_of(found.samples)
    notes = ["how bright the flash is cannot be told from these photos; it is taken to be such that "
             f"highlights reflect {math.pi * found.lobe / intensity:.1%} of it and the median albedo is "
             f"{middle / intensity:.2f}"]
    if tint:
        notes.append(_said(tint, "the material", "not taken out; white paper would tell it surely"))
    return found.shading(np.full(3, intensity), 1 / math.sqrt(by_albedo + by_lobe), tuple(notes))
