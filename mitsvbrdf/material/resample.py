"""Maps and photos at another size, by area averages and bilinear interpolation."""

from collections.abc import Callable
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor


def resized(images: Tensor, side: int, rows: int | None = None) -> Tensor:
    """Images (R x R x C, or N of them) in ``side`` pixels a side: area averages down, bilinear up.

    ``rows``: rows of the result, if the images are not square.
    """
    return (_averaged(images, rows or side, side) if side <= images.shape[-2]
            else _interpolated(images, (rows or side, side), mode="bilinear", align_corners=False))


def area_averaged(images: Tensor, side: int) -> Tensor:
    """Images (R x R x C, or N of them) area-averaged to ``side`` pixels a side; contiguous."""
    return images if images.shape[-2] == side else _averaged(images, side, side).contiguous()


def averaged_rows(part: Callable[[slice], Tensor], count: int, height: int, width: int = 0) -> Tensor:
    """Images of ``count`` rows, area-averaged to height x width (default: square); ``part`` returns rows."""
    found, width, (_, down) = list[Tensor](), width or height, _windows(count, height)
    for k in range(height):
        images = part(slice(k * count // height, -((k + 1) * -count // height)))
        if count % height == 0 == images.shape[-2] % width:
            found.append(_interpolated(images, (1, width), mode="area"))
            continue
        pixels, across = _windows(images.shape[-2], width)
        row = (images.double() * down[k, :images.shape[-3], None, None]).sum(dim=-3, keepdim=True)
        found.append((row[..., pixels, :] * across[..., None]).sum(dim=-2).to(images))
    return torch.cat(found, dim=-3)


def enlarged_rows(images: Tensor, side: int, rows: slice) -> Tensor:
    """Only these rows of the bilinear enlargement of images (N x R x R x C) to ``side`` pixels a side."""
    place = ((torch.arange(rows.start, rows.stop) + 0.5) * (images.shape[1] / side) - 0.5).clamp_min(0)
    above = place.long()
    below, share = (above + 1).clamp_max(images.shape[1] - 1), (place - above)[:, None, None]
    upper, lower = (_interpolated(images[:, at], (len(place), side), mode="bilinear", align_corners=False)
                    for at in (above, below))
    return (upper.double() * (1 - share) + lower * share).float()  # rounded as if enlarged as a whole


def enlarged(planes: Tensor, side: int) -> Tensor:
    """Planes (C x R x R) enlarged to ``side`` pixels a side, bilinear; contiguous."""
    return F.interpolate(planes[None], (side, side), mode="bilinear", align_corners=False)[0].contiguous()


def sampled(planes: Tensor, side: int) -> Tensor:
    """Every k-th row and column of planes (... x R x R), k = R // ``side``, at least 1; a copy."""
    step = max(1, planes.shape[-1] // side)
    return planes[..., step // 2::step, step // 2::step].clone(memory_format=torch.contiguous_format)


def _averaged(images: Tensor, height: int, width: int) -> Tensor:
    if images.shape[-3] % height == 0 == images.shape[-2] % width:
        return _interpolated(images, (height, width), mode="area")
    return averaged_rows(lambda rows: images[..., rows, :, :], images.shape[-3], height, width)


def _windows(count: int, size: int) -> tuple[Tensor, Tensor]:
    """The pixels in each of ``size`` area averages of ``count`` pixels, and their shares, size x k."""
    average = torch.arange(size)[:, None]
    first = average * count // size
    pixel = first + torch.arange(-(-count // size) + 1)
    end = torch.minimum((average + 1) * count, (pixel + 1) * size)
    shares = (end - torch.maximum(average * count, pixel * size)).clamp_min(0).double() / count
    return torch.where(shares > 0, pixel, first), shares


def _interpolated(images: Tensor, size: tuple[int, int], **how: Any) -> Tensor:
    planes = images.movedim(-1, -3)
    found = F.interpolate(planes if planes.dim() == 4 else planes[None], size, **how)
    return found.reshape(*planes.shape[:-2], *size).movedim(-3, -1)
