"""Normals as files hold them: which numbers are vectors, and which way y points."""

import warnings
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ..errors import MapsError, MapsWarning
from .maps import LOWEST_Z

# Normals of published maps point into the surface at up to 0.2 % of the texels: networks' noise, corners.
FEW = 0.01  # share of texels up to which that is mended; a map with more has another convention
RAISED = 1 / 255  # the z they are given: the lowest above 0 that an 8-bit file holds
GREY = 0.1  # half the texels of a normal map have channels that differ by more: straight up by 0.5
LENGTH = 0.25  # largest median of |length - 1|; the worst of sixty published maps has 0.04
# The third channel is empty if it ranges over EMPTY at most, x or y over more than 4 EMPTY, and if it is 0 or
# lengths differ from 1 by more than SLOPPY on average, more than the rounding of gentle slopes to 8 bits.
EMPTY, SLOPPY = 2 / 255, 0.02

# The curl of slopes is 0 with the right sign of y. A sign is proven where the energy of its curl is less than
# a quarter of the other sign's; DirectX only if nearly all blocks agree, too.
PROVEN, AGREED, BLOCKS = 1 / 4, 0.9, 8
LEVEL = 1 / 255  # mean deviation of slopes along y below which its sign hardly shows
OVERRULE = "--encoding {} (or material.json)"  # how the user overrules a convention
BAND = 64  # rows that are looked at together
STEEPEST = 0.05  # smallest z that slopes are computed with


def unit_normals(image: Tensor, path: Path, convention: str = "", way: str = OVERRULE) -> Tensor:
    """Unit normals, +Y up, H x W x 3, of what a file holds.

    A file holds (n + 1) / 2, or signed vectors (EXR), or x and y alone. ``convention`` is ``gl`` or ``dx``
    where it is stated; else the curl decides. MapsError: no normals. MapsWarning: the curl found DirectX, or
    leaves it possible; a few normals were lifted. The image is overwritten.
    """
    normal = _vectors(image, path)
    for rows in normal.split(BAND):
        rows.copy_(F.normalize(rows, dim=-1))
    normal = _lifted(normal, path)
    if not convention and (found := directx_by_curl(normal)) is not False:
        done, other = ("turned around", "gl") if found else ("read as OpenGL's", "dx")
        why = "fit together that way" if found else "do not tell"
        warnings.warn(f"{path}: normals {'are' if found else 'may be'} DirectX's (+Y down): their slopes "
                      f"{why}; {done}; {way.format(f'normal={other}')} overrules", MapsWarning, stacklevel=2)
        convention = "dx" if found else "gl"
    return normal * normal.new_tensor([1, -1, 1]) if convention == "dx" else normal


def directx_by_curl(normal: Tensor) -> bool | None:
    """Whether normals fit a surface only with y turned around; None: the slopes do not tell.

    The slopes p = dh/dx and q = dh/dy of heights h satisfy dp/dy = dq/dx.
    """
    slopes = -normal[..., :2].float() / normal[..., 2:].float().clamp_min(STEEPEST)
    across, up = slopes[..., 1].diff(dim=1), -slopes[..., 0].diff(dim=0)  # dq/dx, dp/dy; rows go down
    if min(normal.shape[:2]) < 2 * BLOCKS or (slopes[..., 1] - slopes[..., 1].mean()).abs().mean() < LEVEL:
        return False
    across, up = across[1:] + across[:-1], up[:, 1:] + up[:, :-1]
    as_it_is, turned = (float((up - sign * across).square().sum(dtype=torch.float64)) for sign in (1, -1))
    if as_it_is < PROVEN * turned:
        return False
    blocks = torch.stack([block.sum() for row in (up * across).tensor_split(BLOCKS)
                          for block in row.tensor_split(BLOCKS, dim=1)])
    agreed = float(blocks.clamp_max(0).sum() / -blocks.abs().sum())
    return True if turned < PROVEN * as_it_is and agreed > AGREED else None


def _vectors(image: Tensor, path: Path) -> Tensor:
    pair = image.shape[2] == 2
    if image.shape[2] == 3:
        spread = image.amax(dim=2) - image.amin(dim=2)
        ranges = [float(channel.max() - channel.min()) for channel in image.unbind(dim=2)]
        pair = ranges[2] <= EMPTY < max(ranges[:2]) / 4 and (
            float(image[..., 2].max()) <= EMPTY or _off(image, _signed, torch.mean) > SLOPPY)
        if not pair and float(spread.median()) < GREY:
            image = image[..., :1]
    if image.shape[2] == 1:
        raise MapsError("a normal map", f"{path}, which is grey: a height, a bump, or another map",
                        "give the file of normals")
    if pair:
        signed = path.suffix.lower() == ".exr" and float(image[..., :2].median()) < 0.25
        flat = image[..., :2] if signed else image[..., :2] * 2 - 1
        up = (1 - flat.square().sum(dim=-1, keepdim=True)).clamp_min(RAISED**2).sqrt()
        return torch.cat((flat, up), dim=-1)
    shifted, error = True, _off(image, _signed)
    if path.suffix.lower() == ".exr" and (off := _off(image)) < error:
        shifted, error = False, off
    if error > LENGTH:
        raise MapsError("normals of length 1, as (n + 1) / 2", f"{path} with lengths off by {error:.2g}",
                        "give the file of normals")
    return image.mul_(2).sub_(1) if shifted else image


def _signed(stored: Tensor) -> Tensor:
    return stored * 2 - 1


def _off(image: Tensor, read: Callable[[Tensor], Tensor] = Tensor.detach,
         average: Callable[[Tensor], Tensor] = torch.median) -> float:
    lengths = torch.cat([read(rows).norm(dim=-1) for rows in image.split(BAND)])
    return float(average(lengths.sub_(1).abs_()))


def _lifted(normal: Tensor, path: Path) -> Tensor:
    """Unit normals, H x W x 3; a few that point into the surface are lifted, with a warning."""
    under = normal[..., 2:] < LOWEST_Z
    count, texels = int(under.sum()), under.numel()
    if not 0 < count <= FEW * texels:
        return normal
    warnings.warn(f"{path}: {count} of {texels} normals ({count / texels:.2%}) point into the surface; "
                  "lifted just above it", MapsWarning, stacklevel=2)
    raised = torch.cat((normal[..., :2], torch.full_like(normal[..., 2:], RAISED)), dim=-1)
    return torch.where(under, F.normalize(raised, dim=-1), normal)
