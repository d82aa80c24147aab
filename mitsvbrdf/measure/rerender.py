"""A material rendered for the photos of a capture, and its error: what every fit is judged by."""

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views
from .metrics import photo_rmse


def rerender(renderer: Renderer, svbrdf: SVBRDF, views: Views,
             capture: Capture) -> tuple[Tensor, float, list[float]]:
    """A capture's photos re-rendered: linear images, RMSE of all, RMSE of each (display values)."""
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    return images, *photo_rmse(images, capture.photos, capture.transfer, capture.measured)
