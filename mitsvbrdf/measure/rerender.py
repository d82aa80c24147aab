"""A material rendered for the photos of a capture, and how far it is from them: the error that every fit is
judged by.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views
from .metrics import photo_rmse


def rerender(renderer: Renderer, svbrdf: SVBRDF, views: Views, capture: Capture) -> tuple[Tensor, float,
                                                                                          list[float]]:
    """The material rendered for the capture's photos: linear images, RMSE over all, RMSE of each (display
    values).
    """
    with torch.no_grad():
        images = renderer.render(svbrdf, views)
    return images, *photo_rmse(images, capture.photos, capture.transfer)
