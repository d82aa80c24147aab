"""A capture at the resolution of a training phase: the generator's input, and the start that it changes."""

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
    """Data of one phase of the training: photos, guess and maps, area-averaged to its resolution.

    Args:
        start: the material to start from, at full size; None: start at 0, before Tanh.
        carried: the change by earlier phases, before Tanh: map name to C x r x r, with any r.
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
        """Maps of a crop in (-1, 1), C x R x R: Tanh of start + carried change + ``change``."""
        found = {}
        for name, value in change.items():
            for known in (self.start, self.carried):
                value = value + known[name][:, *window] if known else value
            found[name] = torch.tanh(value)
        return found


def condition_of(capture: Capture, guess: Tensor) -> Tensor:
    """Input of AllPhotosGenerator, 1 x C x R x R in [-1, 1]: photos, clipped pixels, diffuse guess."""
    photos = capture.photos.permute(0, 3, 1, 2)
    clipped = (photos >= CLIPPED).any(dim=1).float()
    return torch.cat((photos.flatten(0, 1), clipped, color.encode(guess).permute(2, 0, 1)))[None] * 2 - 1


def level(change: dict[str, Tensor]) -> dict[str, Tensor]:
    """The change without its mean tilt: the patch is flat in z = 0, and a tilt looks like a flash offset."""
    if "normal" not in change:
        return change
    return change | {"normal": change["normal"] - change["normal"].mean(dim=(1, 2), keepdim=True)}


def with_flash_at(views: Views, offset: Tensor) -> Views:
    """The views with all lights moved by ``offset`` (x, y in patch sides), through which gradients pass."""
    whole = torch.cat((offset, torch.zeros(1, dtype=torch.float64))) * views.size
    return replace(views, light=views.light + whole)
