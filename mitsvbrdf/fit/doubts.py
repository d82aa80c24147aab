"""What a user should doubt about a fit, in sentences: what was seen, and what it may mean."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sized

from ..capture import Capture
from .losses import CLIPPED
from .result import FitResult

# Measured on twelve real captures of nine photos and the four made materials, fitted with `hybrid` and `direct`: clipped
# pixels up to ..., gains 0.97 to 1.04, worst photo up to 1.6 times the median; none of them warns without a reason.
CLIPPED_SHARE = 0.05  # of the pixels
ALIKE = 2 / 255  # display values, root mean square
DARK = 8 / 255  # display values, median
GAIN = 1.25  # photos over re-rendering, or the other way round
WHITE, WHITE_SHARE = 0.97, 0.1  # diffuse albedo, and the share of texels that may have it
FAINT = 0.008  # F0: water has 0.02, and nothing known less
WORSE = 2.0  # times the median error of a photo
POOR = 0.1  # re-rendering RMSE


def doubts(result: FitResult, capture: Capture) -> Iterator[str]:
    """Warnings about the photos, the calibration and the fit, one sentence each."""
    yield from _photos(capture)
    yield from _light(result, capture)
    yield from _errors(result, capture)
    if result.undone:
        first = result.undone[0]
        yield f"{_count(result.undone, 'step')} undone; the first at iteration {first['iteration']}: {first['reason']}"
    if result.restarts:
        yield f"the fit diverged and went back to its lowest loss {_count(result.restarts, 'time')}"
    if result.stopped == "unstable":
        yield "too many steps had to be undone, so the fit ended early: lower the learning rate or check the calibration"


def _photos(capture: Capture) -> Iterator[str]:
    photos = capture.photos
    clipped = float((photos >= CLIPPED).any(dim=-1).float().mean())
    if clipped > CLIPPED_SHARE:
        yield f"{clipped:.0%} of the pixels are clipped: highlights are only bounded from below; expose less"
    if float(photos.median()) < DARK:
        yield "the photos are nearly black: 8 bits leave few steps there; expose more"
    if float((photos - photos.mean(dim=(1, 2), keepdim=True)).square().mean().sqrt()) < ALIKE:
        yield "every photo is of one colour: it shows no texture, relief or highlight"
    if len(capture) == 1:
        yield "one photo: specular, roughness and normals are hardly determined; take more from other places"
    elif float((photos - photos.mean(dim=0)).square().mean().sqrt()) < ALIKE:
        yield "the photos are all alike: no highlight moves, so specular, roughness and normals are hardly determined"


def _light(result: FitResult, capture: Capture) -> Iterator[str]:
    photos, images = capture.linear, result.rerendered
    usable = (capture.photos < CLIPPED) & (capture.photos > DARK) & (images > 0)
    if usable.any():
        gain = float((photos[usable] / images[usable]).median())
        if not 1 / GAIN < gain < GAIN:
            how, times = ("darker", gain) if gain > 1 else ("brighter", 1 / gain)
            yield f"the re-rendering is {how} than the photos by {times:.2g}x: light power or distances may be off"
    material = result.svbrdf.as_roughconductor()
    white = float((material["diffuse"].amax(dim=-1) > WHITE).float().mean())
    if white > WHITE_SHARE:
        yield f"{white:.0%} of the diffuse map is as white as can be: the light may be stronger than stated"
    if float(material["specular"].median()) < FAINT and "specular" in result.deviations:
        yield ("specular is below that of any known material: the light may be weaker than stated, or the photos may "
               "show no highlight")


def _errors(result: FitResult, capture: Capture) -> Iterator[str]:
    if result.rerender_rmse > POOR:
        yield f"the photos are only met to {result.rerender_rmse:.2g}: fit longer, or check views, light and transfer function"
    if len(capture) > 2:
        typical = statistics.median(result.per_photo)
        for name, error in zip(capture.names, result.per_photo):
            if error > WORSE * max(typical, 0.01):
                yield f"photo {name} fits worse than the rest ({error:.2g}, median {typical:.2g}): its view may be off"


def _count(events: Sized, what: str) -> str:
    return f"{len(events)} {what}{'s' if len(events) > 1 else ''}"
