"""A capture at the resolution of a phase, and what the generator is shown and adds to there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...color import CLIPPED
from ...material.maps import SVBRDF
from ...material.resample import area_averaged, enlarged
from ...views import Views
from ..gan_config import GanConfig
from ..parameters import Streams, before_tanh, to_raw
from ..task import FitTask
from .pictures import Window


class Conditioning:
    """What one phase of the training works on.

    Args:
        task: guess and fixed maps.
        capture: the photos of the phase.
        resolution: side of the maps; the photos are area-averaged to it.
        streams: the channels of the maps to fit.
        start: the material to start from, at full size; None starts at zero before Tanh.
        carried: what an earlier phase added to the start, C x r x r for any r.
    """

    def __init__(self, task: FitTask[GanConfig], capture: Capture, resolution: int, streams: Streams,
                 start: SVBRDF | None, carried: Mapping[str, Tensor]) -> None:
        same = resolution == capture.resolution
        self.resolution, self.fixed = resolution, task.fixed
        self.capture = capture.averaged(resolution)
        self.guess = area_averaged(task.guess, resolution)
        self.start = (before_tanh(to_raw(start if same else start.resized(resolution), streams)) if start
                      else {})
        self.carried = {name: enlarged(value, resolution) for name, value in carried.items()}
        self.condition = condition_of(self.capture, self.guess)

    def units(self, change: Mapping[str, Tensor], window: Window | None = None) -> dict[str, Tensor]:
        """Maps in (-1, 1), C x R x R: Tanh of start, what was carried, and this change.

        Args:
            change: C x R x R, before Tanh, of the window.
            window: a crop; None is the whole.
        """
        top, left, side = window or (0, 0, self.resolution)
        cut = (slice(None), slice(top, top + side), slice(left, left + side))
        found = {}
        for name, value in change.items():
            for known in (self.start, self.carried):
                value = value + known[name][cut] if known else value
            found[name] = torch.tanh(value)
        return found

    def guess_in(self, window: Window) -> Tensor:
        """The guessed diffuse map of a crop."""
        return _cut(self.guess, window)

    def fixed_in(self, window: Window) -> dict[str, Tensor]:
        """The maps that are not fitted, of a crop."""
        return {name: _cut(area_averaged(value, self.resolution), window)
                for name, value in self.fixed.items()}


def condition_of(capture: Capture, guess: Tensor) -> Tensor:
    """Input of a generator of all photos, 1 x C x R x R in -1 to 1: photos, clipped pixels, the guess."""
    photos = capture.photos.permute(0, 3, 1, 2)
    clipped = (photos >= CLIPPED).any(dim=1).float()
    return torch.cat((photos.flatten(0, 1), clipped, color.encode(guess).permute(2, 0, 1)))[None] * 2 - 1


def level(change: dict[str, Tensor]) -> dict[str, Tensor]:
    """A change without a common tilt, which would hide the flash offset: the patch lies flat in z = 0."""
    if "normal" not in change:
        return change
    return change | {"normal": change["normal"] - change["normal"].mean(dim=(1, 2), keepdim=True)}


def with_flash_at(views: Views, offset: Tensor) -> Views:
    """The views with all lights moved sideways by x and y in patch sides; the offset may carry gradients."""
    whole = torch.cat((offset, torch.zeros(1, dtype=torch.float64))) * views.size
    return replace(views, light=views.light + whole)


def _cut(value: Tensor, window: Window) -> Tensor:
    top, left, side = window
    return value[top:top + side, left:left + side]
