"""Maps and photos at another size, by area averages and bilinear interpolation."""

from typing import Any

import torch.nn.functional as F
from torch import Tensor


def resized(images: Tensor, side: int) -> Tensor:
    """Images (R x R x C, or N of them) in ``side`` pixels a side: area averages down, bilinear up."""
    how = {"mode": "area"} if side <= images.shape[-2] else {"mode": "bilinear", "align_corners": False}
    return _interpolated(images, side, **how)


def area_averaged(images: Tensor, side: int) -> Tensor:
    """Images (R x R x C, or N of them) area-averaged to ``side`` pixels a side; contiguous."""
    return images if images.shape[-2] == side else _interpolated(images, side, mode="area").contiguous()


def enlarged(planes: Tensor, side: int) -> Tensor:
    """Planes (C x R x R) in ``side`` pixels a side, bilinear; contiguous."""
    return F.interpolate(planes[None], (side, side), mode="bilinear", align_corners=False)[0].contiguous()


def sampled(planes: Tensor, side: int) -> Tensor:
    """Every k-th row and column of planes (... x R x R), k the greatest that leaves ``side``."""
    step = max(1, planes.shape[-1] // side)
    return planes[..., step // 2::step, step // 2::step].contiguous()


def _interpolated(images: Tensor, side: int, **how: Any) -> Tensor:
    planes = images.movedim(-1, -3)
    found = F.interpolate(planes if planes.dim() == 4 else planes[None], (side, side), **how)
    return found.reshape(*planes.shape[:-2], side, side).movedim(-3, -1)
