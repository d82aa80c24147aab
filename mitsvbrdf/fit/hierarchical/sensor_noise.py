"""The noise of exact photos at each brightness, measured on the errors of well-fitted texels.

Sensor noise is about the same everywhere in linear light, so bright display values have little noise. The
few bright pixels of a highlight determine a metal better than all dark pixels do.
"""

import torch
from torch import Tensor

from ...capture import Capture
from ...color import QUANTIZATION_NOISE, to_display
from ...material.maps import SVBRDF
from ...render import Renderer
from ...views import Views

STEPS = 16  # steps of brightness, with equally many pixels in each
NORMAL = 1.4826  # standard deviation of normal errors / median of their absolute values


def sensor_noise(svbrdf: SVBRDF, views: Views, capture: Capture, renderer: Renderer, unknowns: int) -> Tensor:
    """Brightness (mean display values) and standard deviation of display values there, 2 x :data:`STEPS`.

    Medians are taken, so a few texels with large errors do not matter. The least deviation is that of 8 bits.

    Args:
        svbrdf: the material that explains the photos best, R x R.
        capture: the photos, N x R x R.
        unknowns: number of unknowns of a texel; they absorb the noise of as many of its 3 N values.
    """
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    usable, values = capture.usable.all(dim=-1), 3 * len(capture)
    errors = (to_display(images, capture.transfer) - capture.photos)[usable].abs()
    bright = capture.photos[usable].mean(dim=-1)
    steps = bright.argsort().tensor_split(STEPS)
    widened = NORMAL * (values / max(values - unknowns, 1)) ** 0.5
    at, deviation = (torch.stack([values[step].median() for step in steps]) for values in (bright, errors))
    return torch.stack([at.nan_to_num(1), (widened * deviation).nan_to_num(0).clamp_min(QUANTIZATION_NOISE)])


def noise_at(bright: Tensor, sensor: Tensor) -> Tensor:
    """The standard deviation at some brightness, interpolated between the steps of :func:`sensor_noise`."""
    at, deviation = sensor
    above = torch.bucketize(bright, at).clamp(1, len(at) - 1)
    share = ((bright - at[above - 1]) / (at[above] - at[above - 1]).clamp_min(1e-6)).clamp(0, 1)
    return torch.lerp(deviation[above - 1], deviation[above], share)
