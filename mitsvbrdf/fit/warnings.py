"""Warnings about a fit, in sentences: what was seen, and what it may mean."""

import statistics
from collections.abc import Iterator, Sequence

import torch.nn.functional as F
from torch import Tensor

from ..capture import Capture
from ..color import CLIPPED
from ..measure.burn_in import LOCAL_SIDE, burn_in, local_burn_in
from .confidence import DETERMINED, of_texels, shown_texels
from .config import HierarchicalConfig
from .fixed_maps import described
from .repeats import HARDLY_TOLD
from .result import Fit

# Comments beside the numbers: values of twelve real captures of nine photos (`hybrid`, `direct`, 64 px).
MUCH_CLIPPED = 0.05  # of the pixels; eleven had up to 0.015, one 0.08
ALIKE = 2 / 255  # display values, root mean square
DARK = 8 / 255  # display values, median
GAIN = 1.25  # photos over re-rendering, or the other way round; 0.93 to 1.01
USABLE = 0.1  # share of the pixels that must be neither dark nor clipped, to speak of a gain
# diffuse albedo, and the share of texels that may have it; ten had 0, two 0.3 and more
WHITE, WHITE_SHARE = 0.97, 0.1
WHITENS = {"diffuse", "base_color"}  # if one of these maps is fixed, white texels do not depend on the light
FAINT = 0.015  # F0, median; eleven had 0.0156 and more, one 0.013. Water has 0.02; no known material has less
# A median F0 above STRONG, unusual for a non-metal, is believed if a share HARDLY of texels is determined. Of
# eighteen fits to seven photos one had 0.31 (a fifth determined), the others 0.1 or less, or were determined.
STRONG, HARDLY = 0.1, 0.5
MORE_SHARE = 0.1  # of texels that reflect more than arrives; three of the eighteen had 0.28 to 0.55, others 0
ASIDE = 0.05  # patch sides from the middle that count as beside it
LOOKED_AT = 512  # px a side at which photos are checked
SAMPLED = 256  # px a side at which gains are checked
COARSE = 64  # px at which photos are compared; the closest two of the eighteen are 4.6 / 255 apart
UNSETTLED = "the fit ended before it had settled: give more seconds or iterations"
MIXED = ("single pixels of the photos follow the model, but their averages at {} px do not, so maps are off "
         "by more than their deviations: fit the photos at their full size (--resolution)")
WORSE = 2.5  # times the median error of a photo; 1.1 to 2.3
POOR = 0.1  # re-rendering RMSE
BURNT_IN = 0.3  # share of a map's variance that follows highlights; ten had up to 0.18, two woods 0.4 to 0.74
OVALS = 0.2  # the same for single highlights; known materials in the views of six captures have up to 0.13


def fit_warnings(result: Fit, capture: Capture) -> Iterator[str]:
    """Warnings about the photos, the calibration and the fit, one sentence each."""
    yield from about_photos(capture)
    if len(capture) == 1 and "repeats" not in result.record:  # else the sentence on repeats says more
        yield f"one photo: {HARDLY_TOLD}"
    shown = shown_texels(capture)
    yield from _light(result, capture, shown)
    yield from _implausible(result, shown)
    yield from _errors(result, capture)
    yield from _burnt_in(result)
    yield from _cut_short(result)
    yield from about_steps(result.undone)
    if result.stopped == "unstable":
        yield ("too many steps had to be undone, so the fit ended early: lower the learning rate or "
               "check the calibration")


def about_steps(undone: Sequence[dict]) -> Iterator[str]:
    """The warning about steps undone so far."""
    if undone:
        yield (f"{len(undone)} step{'s' if len(undone) > 1 else ''} undone; the first at iteration "
               f"{undone[0]['iteration']}: {undone[0]['reason']}")


def about_photos(capture: Capture) -> Iterator[str]:
    """Warnings about the photos by themselves."""
    capture = capture.sampled(min(LOOKED_AT, capture.resolution))
    photos = capture.photos
    clipped = float((photos >= CLIPPED).any(dim=-1).float().mean())
    if clipped > MUCH_CLIPPED:
        yield f"{clipped:.0%} of the pixels are clipped: highlights are only bounded from below; expose less"
    if float(photos.median()) < DARK:
        yield "the photos are nearly black: 8 bits leave few steps there; expose more"
    if float((photos - photos.mean(dim=(1, 2), keepdim=True)).square().mean().sqrt()) < ALIKE:
        yield "every photo is of one colour: it shows no texture, relief or highlight"
    if len(capture) > 1 and float((photos - photos.mean(dim=0)).square().mean().sqrt()) < ALIKE:
        yield ("the photos are all alike: no highlight moves, so specular, roughness and normals are "
               "hardly determined")
    else:
        yield from _twice(capture)


def _twice(capture: Capture) -> Iterator[str]:
    """Pairs of equal photos; of many copies, each is paired with the first."""
    small = F.adaptive_avg_pool2d(capture.photos.permute(0, 3, 1, 2),
                                  min(COARSE, capture.resolution)).flatten(1)
    named: set[int] = set()
    for first in range(len(capture)):
        for second in range(first + 1, len(capture)):
            if second not in named and float((small[first] - small[second]).square().mean().sqrt()) < ALIKE:
                named.add(second)
                yield (f"photos {capture.names[first]} and {capture.names[second]} are the same picture: "
                       "leave one out with --views, and take another from elsewhere")


def _light(result: Fit, capture: Capture, shown: Tensor) -> Iterator[str]:
    small = capture.sampled(min(SAMPLED, capture.resolution))
    images = result.known["sample"]
    usable = small.usable & (small.photos > DARK) & (images > 0)
    if float(usable.float().mean()) > USABLE:
        gain = float((small.linear[usable] / images[usable]).median())
        if not 1 / GAIN < gain < GAIN:
            how, times = ("darker", gain) if gain > 1 else ("brighter", 1 / gain)
            yield (f"the re-rendering is {how} than the photos by {times:.2g}x: light power or "
                   "distances may be off")
    material = result.svbrdf.as_roughconductor()
    white = float((material["diffuse"].amax(dim=-1) > WHITE).float().mean())
    if white > WHITE_SHARE and not WHITENS & set(described(result.config.fix)):
        yield f"{white:.0%} of the diffuse map is as white as can be: the light may be stronger than stated"
    specular, spread = float(material["specular"].median()), result.deviations.get("specular")
    sure = None if spread is None else of_texels(spread)[shown] < DETERMINED
    if sure is not None and sure.float().mean() > 0.25 and 0 < specular < FAINT:
        yield (f"specular of {specular:.2g} is below that of any known material: the light may be "
               "weaker than stated")


def _implausible(result: Fit, shown: Tensor) -> Iterator[str]:
    material, fixed = result.svbrdf.as_roughconductor(), described(result.config.fix)
    spread = result.deviations.get("specular")
    if spread is not None and "specular" not in fixed:
        unsure = shown & (of_texels(spread) >= DETERMINED)
        level, share = float(material["specular"].median()), 1 - float(unsure[shown].float().mean())
        if level > STRONG and share < HARDLY:
            yield (f"median specular (F0) of {level:.2g}, {share:.0%} of it determined: a metal, or "
                   f"a guess. Add a photo with its highlight {_place(unsure)}, or use --fix specular=0.04 if "
                   "the material is no metal")
    if not {"specular", *WHITENS} & set(fixed):
        above = (material["diffuse"] + material["specular"]).amax(dim=-1) > 1
        more, white = float(above.float().mean()), above & (material["diffuse"].amax(dim=-1) > WHITE)
        if white.any() and more <= MORE_SHARE:
            yield (f"single texels ({int(white.sum())}) are white in the diffuse map and reflect more than "
                   "arrives: they are wrong, which happens on metal")
        if more > MORE_SHARE:
            yield (f"{more:.0%} of the texels reflect more than arrives (diffuse + specular above 1): the "
                   "light may be stronger than stated; if the material is no metal, try --fix specular=0.04")


def _place(mask: Tensor) -> str:
    """The place of a mask's centre on the patch, in words. Mask: R x R, row 0 at the top."""
    down, right = ((mask.nonzero().double().mean(dim=0) + 0.5) / len(mask) - 0.5).tolist()
    words = (["top" if down < 0 else "bottom"] * (abs(down) > ASIDE)
             + ["left" if right < 0 else "right"] * (abs(right) > ASIDE))
    return f"at the {' '.join(words)} of the patch" if words else "where none is yet"


def _errors(result: Fit, capture: Capture) -> Iterator[str]:
    if result.rerender_rmse > POOR:
        yield (f"the re-rendering RMSE of {result.rerender_rmse:.2g} is high: fit longer, or check views, "
               "light and transfer function")
    if len(capture) > 2:
        typical = statistics.median(result.per_photo)
        for name, error in zip(capture.names, result.per_photo):
            if error > WORSE * max(typical, 0.01):
                yield (f"photo {name} fits worse than the rest ({error:.2g}, median {typical:.2g}): its "
                       "view may be off")


def _burnt_in(result: Fit) -> Iterator[str]:
    fixed = described(result.config.fix)
    for name, share in burn_in(result.svbrdf, result.views).items():
        if share > BURNT_IN and name not in fixed:
            yield (f"{share:.0%} of the variance of the {name} map follows the photos' highlights: this "
                   "pattern may be theirs, not the material's")
    for name, share in local_burn_in(result.svbrdf, result.views).items():
        # with fewer texels, chance alone gives such shares
        if share > OVALS and name not in fixed and result.svbrdf.resolution >= LOCAL_SIDE:
            yield (f"the {name} map has ovals where single photos had their highlights ({share:.0%} of it): "
                   "they are hardly the material's; add photos with highlights elsewhere, and fit again")


def _cut_short(result: Fit) -> Iterator[str]:
    """The warning of a fit that ended too early; the schedules of other methods end with their budget."""
    if result.trace[-1]["iteration"] == 0:
        yield "no step was made, so the maps are the start of the fit: give more seconds"
    elif isinstance(result.config, HierarchicalConfig) and result.stopped in ("budget", "iterations",
                                                                              "interrupted"):
        yield UNSETTLED
