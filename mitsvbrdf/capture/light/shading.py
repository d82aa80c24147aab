"""From the shading of photos with known poses to flash, power, vignetting and exposures.

A diffuse point of albedo rho, seen through a lens of transmission T, sends to the photo the radiance

    L = rho / pi * I * exp(e) * cos / d^2 * T(pixel)

with I the flash's radiant intensity, e the logarithm of the photo's exposure, d the distance to the flash and
cos the cosine of the angle from flat normal to flash. The logarithm of L is linear in all unknowns but the
flash's place and vignetting. White paper has one known albedo everywhere. A material has an albedo in each
texel, the same in all photos, and one GGX lobe that all texels share. Albedo is eliminated (variable
projection, Golub and Pereyra 1973), so photos are compared with each other. Positive errors are mostly
highlights: their weights fall fast, those of negative errors slowly (iteratively reweighted least squares).
Paper has no lobe; points near its mirror direction count little.

Residuals of neighbouring points are correlated, so the noise, and how many points count as one, are measured
on the residuals, as in :mod:`mitsvbrdf.calibrate.refine`. Where a material is hardly diffuse at all, both are
large, and the priors decide.
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
# TINTED, and by SURELY deviations over texels (18 real ones: up to 2.0). It must show LEAST_COLOURED points.
TINTED, SURELY, LEAST_COLOURED = 0.03, 3.0, 20
# usual F0 of the lobe, sd of its logarithm; dielectrics have 0.04, but one lobe for all finds 0.005 to 0.06
LOBE_F0 = 0.03, 0.6


def shading_of_paper(rig: Rig, photos: Mapping[str, np.ndarray], transfer: color.Transfer,
                     white: Callable[[Array], np.ndarray], depth: float = 0.0) -> Shading:
    """Flash, its power and colour, vignetting and exposures from white paper around the material.

    Photos are pixels H x W x 3 as stored (integers, or float in [0, 1]), of the lens's size, or that
    divided by a whole number; those without a pose do not count. ``white`` says for points of the world (K x
    2) whether bare paper is there. The paper's albedo is the same in all channels, so its colour in the
    photos is the flash's. CaptureError: no photo shows white paper that is neither clipped nor dark.
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
    """White balance, as factors of rgb, by name, of photos that differ in it from most photos."""
    own, usual, spread = _colours(samples)
    return {name: np.exp(colour - usual) for name, colour in own.items()
            if (np.abs(colour - usual) > np.maximum(TINTED, SURELY * spread[name])).any()}


def _colours(samples: Samples, without: Collection[str] = ()) -> tuple[dict, Array, dict]:
    """Colours of photos relative to their texels' medians over photos, the usual colour, and deviations.

    Logarithms of rgb over their mean; the usual is a median over photos. Deviations over texels: 0 on paper.
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
    """A note on photos of another white balance."""
    listed = ", ".join(f"{name} ({', '.join(f'{factor - 1:+.0%}' for factor in rgb)})"
                       for name, rgb in tint.items())
    return (f"white balance differs in {listed} in red, green, blue, as {where} shows: {done}; lock it for "
            "comparable photos")


def shading_of_material(rig: Rig, photos: Mapping[str, np.ndarray], transfer: color.Transfer) -> Shading:
    """Flash, vignetting and exposures from a material that looks the same from everywhere but in highlights.

    Albedo alone does not tell the light's power, but most materials are dielectrics: the power is what makes
    the lobe's F0 and the median albedo most probable together (:data:`LOBE_F0`,
    :data:`~mitsvbrdf.material.maps.USUAL_ALBEDO`), with no more than one texel in a hundred whiter than
    paper. A metal is taken for a dielectric under a brighter flash. The flash is taken to be white.

    Photos are rectified to the patch, R x R x 3 display values in [0, 1] with their vignetting, NaN where one
    does not reach. CaptureError: no photo that is neither clipped nor dark.
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
