"""Maps and pictures at another size."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor


def resized(images: Tensor, size: int) -> Tensor:
    """N x R x R x C at another size: area average down, bilinear up."""
    how = {"mode": "area"} if size <= images.shape[1] else {"mode": "bilinear", "align_corners": False}
    return F.interpolate(images.permute(0, 3, 1, 2), (size, size), **how).permute(0, 2, 3, 1)


def averaged(images: Tensor, side: int) -> Tensor:
    """N x H x W x C at no more than so many pixels a side, by area averages."""
    side = min(side, images.shape[1])
    return F.adaptive_avg_pool2d(images.permute(0, 3, 1, 2), side).permute(0, 2, 3, 1)


def area_averaged(image: Tensor, side: int) -> Tensor:
    """R x R x C by area averages."""
    if image.shape[0] == side:
        return image
    return F.interpolate(image.permute(2, 0, 1)[None], (side, side), mode="area")[0].permute(1, 2, 0).contiguous()


def enlarged(planes: Tensor, side: int) -> Tensor:
    """C x R x R, interpolated to this side."""
    return F.interpolate(planes[None], (side, side), mode="bilinear", align_corners=False)[0].contiguous()
