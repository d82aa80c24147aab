"""A capture at the resolution of a phase: what the generator sees, and the start that it adds to."""

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
from .pictures import WHOLE, Window


class Conditioning:
    """What one phase of the training works on: its photos, area-averaged to the side of the maps.

    Args:
        start: the material to start from, at full size; None: zeros as the input of Tanh.
        carried: what earlier phases added to the start, before Tanh, by map: C x r x r, of any side r.
    """

    def __init__(self, task: FitTask[GanConfig], capture: Capture, resolution: int, streams: Streams,
                 start: SVBRDF | None, carried: Mapping[str, Tensor]) -> None:
        same = resolution == capture.resolution
        self.fixed = {name: area_averaged(value, resolution) for name, value in task.fixed.items()}
        self.capture = capture.averaged(resolution)
        self.guess = area_averaged(task.guess, resolution)
        self.start = (before_tanh(to_raw(start if same else start.resized(resolution), streams)) if start
                      else {})
        self.carried = {name: enlarged(value, resolution) for name, value in carried.items()}
        self.condition = condition_of(self.capture, self.guess)

    def units(self, change: Mapping[str, Tensor], window: Window = WHOLE) -> dict[str, Tensor]:
        """Maps in (-1, 1), C x R x R: Tanh of the sum of start, carried change and ``change`` of a crop."""
        found = {}
        for name, value in change.items():
            for known in (self.start, self.carried):
                value = value + known[name][:, *window] if known else value
            found[name] = torch.tanh(value)
        return found


def condition_of(capture: Capture, guess: Tensor) -> Tensor:
    """Input of a generator of all photos, 1 x C x R x R in -1 to 1: photos, clipped pixels, the guess."""
    photos = capture.photos.permute(0, 3, 1, 2)
    clipped = (photos >= CLIPPED).any(dim=1).float()
    return torch.cat((photos.flatten(0, 1), clipped, color.encode(guess).permute(2, 0, 1)))[None] * 2 - 1


def level(change: dict[str, Tensor]) -> dict[str, Tensor]:
    """The change without its mean tilt, which would hide the flash offset: the patch lies flat in z = 0."""
    if "normal" not in change:
        return change
    return change | {"normal": change["normal"] - change["normal"].mean(dim=(1, 2), keepdim=True)}


def with_flash_at(views: Views, offset: Tensor) -> Views:
    """The views with all lights moved sideways by x and y in patch sides; the offset may carry gradients."""
    whole = torch.cat((offset, torch.zeros(1, dtype=torch.float64))) * views.size
    return replace(views, light=views.light + whole)
