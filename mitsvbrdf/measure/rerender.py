"""A material rendered in the views of a capture, and its error: the measure of every fit."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF, finite
from ..material.resample import sampled
from ..render import Renderer
from ..views import Views
from .metrics import of_all, photo_rmse

PIXELS = 2**22  # most pixels that are rendered together


def rerender(renderer: Renderer, svbrdf: SVBRDF, views: Views,
             capture: Capture) -> tuple[Tensor, float, list[float]]:
    """A capture's photos re-rendered: linear images, RMSE of all, RMSE of each (display values)."""
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    return images, *photo_rmse(images, capture.stored, capture.transfer, capture.measured)


class Rerendered(NamedTuple):
    """A capture's photos re-rendered, batch by batch."""

    total: float  # RMSE of all, in display values; NaN if an image is not finite
    each: list[float]  # RMSE of each photo; NaN if its image is not finite
    sample: Tensor  # linear images, N x S x S x 3: every k-th pixel
    images: Tensor | None  # all pixels, N x R x R x 3; None if there is more than one batch


def rerendered(renderer: Renderer, svbrdf: SVBRDF, views: Views, capture: Capture, side: int = 1
               ) -> Rerendered:
    """Re-render photos in these views. Samples have ``side`` pixels a side or somewhat more."""
    each, samples, parts = list[float](), list[Tensor](), batches(len(views), svbrdf.resolution)
    for part in parts:
        shown = capture if len(part) == len(capture) else capture.pick([capture.index[k] for k in part])
        images, _, errors = rerender(renderer, svbrdf, views.pick(part), shown)
        each += [error if finite(image) else math.nan for image, error in zip(images, errors)]
        samples.append(sampled(images.movedim(-1, 1), min(side, svbrdf.resolution)).movedim(1, -1))
        whole = images if len(parts) == 1 else None
        del images  # frees memory before the next batch
    return Rerendered(of_all(each, capture.measured), each, torch.cat(samples), whole)


def rerender_errors(renderer: Renderer, svbrdf: SVBRDF, views: Views,
                    capture: Capture) -> tuple[float, list[float]]:
    """The errors of :func:`rerender` without the images; NaN if an image is not finite."""
    return rerendered(renderer, svbrdf, views, capture)[:2]


def batches(count: int, resolution: int) -> list[range]:
    """Ranges of ``count`` views to render together; large images one by one."""
    most = max(1, PIXELS // resolution**2)
    return [range(first, min(first + most, count)) for first in range(0, count, most)]
