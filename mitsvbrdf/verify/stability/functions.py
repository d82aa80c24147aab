"""What the package's other public functions make of a configuration: nothing may come out that is not
finite.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ... import color
from ...capture import Capture, guess_diffuse
from ...fit.losses import diffuse, edge_weights, photometric, tilt, total_variation
from ...fit.parameters import to_raw, to_svbrdf
from ...fit.start import robust_start
from ...material.maps import SVBRDF
from ...measure.metrics import image_error, map_rmse, photo_rmse
from ...views import Views
from .conditioning import disturbed

Found = dict[str, Callable[[], object]]


def not_finite(svbrdf: SVBRDF, views: Views, radiance: Tensor, transfer: color.Transfer) -> dict[str, int]:
    """How many numbers that are not finite come out of each function, by name.

    Args:
        svbrdf: the material, float32.
        views: camera and light positions.
        radiance: what they show, N x R x R x 3.
        transfer: how photos encode light.
    """
    return {name: sum(int((~torch.isfinite(t)).sum()) for t in _tensors(function()))
            for name, function in _functions(svbrdf.detach(), views, radiance.detach().float(),
                                             transfer).items()}


def _functions(svbrdf: SVBRDF, views: Views, radiance: Tensor, transfer: color.Transfer) -> Found:
    photos, near = color.to_display(radiance, transfer), disturbed(svbrdf)
    capture = Capture(photos, views, transfer)
    guess = guess_diffuse(capture, "min")
    return {
        "encode": lambda: color.encode(radiance, transfer), "decode": lambda: color.decode(photos, transfer),
        "guess_diffuse, min": lambda: guess, "guess_diffuse, mean-blur": lambda: guess_diffuse(capture,
                                                                                               "mean-blur"),
        "guess_diffuse, robust": lambda: guess_diffuse(capture, "robust"),
        "robust_start": lambda: robust_start(capture, guess, svbrdf.bsdf).maps,
        "resized, smaller": lambda: svbrdf.resized(max(1, svbrdf.resolution // 2)).maps,
        "resized, larger": lambda: svbrdf.resized(2 * svbrdf.resolution).maps,
        "to_svbrdf of to_raw": lambda: to_svbrdf(svbrdf.bsdf, to_raw(svbrdf)).maps,
        "photometric": lambda: photometric(radiance, photos, transfer), "diffuse": lambda: diffuse(svbrdf,
                                                                                                   guess),
        "total_variation": lambda: total_variation(svbrdf, edge_weights(guess)), "tilt": lambda: tilt(svbrdf),
        "map_rmse": lambda: map_rmse(near, svbrdf), "photo_rmse": lambda: photo_rmse(radiance, photos,
                                                                                     transfer)[0],
        "image_error": lambda: image_error(radiance, radiance.double())}


def _tensors(value: object) -> list[Tensor]:
    values = value.values() if isinstance(value, dict) else [value]
    return [torch.as_tensor(v) for v in values]
