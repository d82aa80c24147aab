"""A material rendered for the photos of a capture, and its error: what every fit is judged by."""

import math

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views
from .metrics import of_all, photo_rmse

PIXELS = 2**24  # that are rendered together


def rerender(renderer: Renderer, svbrdf: SVBRDF, views: Views,
             capture: Capture) -> tuple[Tensor, float, list[float]]:
    """A capture's photos re-rendered: linear images, RMSE of all, RMSE of each (display values)."""
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    return images, *photo_rmse(images, capture.photos, capture.transfer, capture.measured)


def rerender_errors(renderer: Renderer, svbrdf: SVBRDF, views: Views,
                    capture: Capture) -> tuple[float, list[float]]:
    """The errors of :func:`rerender` without the images; NaN where one is not finite."""
    each = list[float]()
    for part in batches(len(views), svbrdf.resolution):
        shown = capture if len(part) == len(capture) else capture.pick([capture.index[k] for k in part])
        images, _, errors = rerender(renderer, svbrdf, views.pick(part), shown)
        each += [error if image.isfinite().all() else math.nan for image, error in zip(images, errors)]
    return of_all(each), each


def batches(count: int, resolution: int) -> list[range]:
    """Views that are rendered together, of so many: large images one by one."""
    most = max(1, PIXELS // resolution**2)
    return [range(first, min(first + most, count)) for first in range(0, count, most)]
