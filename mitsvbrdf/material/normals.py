"""Read normals from files: find how vectors are stored, and whether y points up or down."""

import warnings
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ..errors import MapsError, MapsWarning
from .maps import LOWEST_Z

# In published maps, up to 0.2 % of the normals point into the surface: noise of networks, corners.
FEW = 0.01  # these are corrected up to this share of the texels; a map with more has another convention
RAISED = 1 / 255  # z of a corrected normal: the lowest z above 0 in an 8-bit file
GREY = 0.1  # in half the texels of a normal map, channels differ by more; straight up, by 0.5
LENGTH = 0.25  # largest median of |length - 1|; the worst of sixty published maps has 0.04
# The third channel is unused if its range is EMPTY or less, the range of x or y is above 4 EMPTY, and it is 0
# or lengths are off by more than SLOPPY on average (8-bit rounding of gentle slopes causes less).
EMPTY, SLOPPY = 2 / 255, 0.02

# With the right sign of y, the curl of the slopes is 0. A sign is proven if its curl has less than a quarter
# of the other curl's energy. For DirectX, nearly all blocks must agree, too.
PROVEN, AGREED, BLOCKS = 1 / 4, 0.9, 8
LEVEL = 1 / 255  # mean deviation of the slopes along y; if it is lower, the sign of y cannot be found
OVERRULE = "--encoding {} (or material.json)"  # how the user overrules a convention
BAND = 64  # rows that are processed together
STEEPEST = 0.05  # smallest z that slopes are computed with


def unit_normals(image: Tensor, path: Path, convention: str = "", way: str = OVERRULE) -> Tensor:
    """Unit normals, +Y up, H x W x 3, from the pixels of a file.

    The pixels are (n + 1) / 2, or signed vectors (EXR), or x and y alone. ``convention`` is ``gl`` or ``dx``
    if it is stated; else the curl decides. MapsError: no normals. MapsWarning: the curl finds DirectX, or
    does not decide; a few normals pointed into the surface and were raised. The image is overwritten.
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
    """Whether normals fit a surface only with y turned around; None: the slopes do not decide.

    The slopes p = dh/dx and q = dh/dy of heights h satisfy dp/dy = dq/dx. Small or nearly flat maps: False.
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
    """Unit normals, H x W x 3. If only a few point into the surface, they are raised, with a warning."""
    under = normal[..., 2:] < LOWEST_Z
    count, texels = int(under.sum()), under.numel()
    if not 0 < count <= FEW * texels:
        return normal
    warnings.warn(f"{path}: {count} of {texels} normals ({count / texels:.2%}) point into the surface; "
                  "lifted just above it", MapsWarning, stacklevel=2)
    raised = torch.cat((normal[..., :2], torch.full_like(normal[..., 2:], RAISED)), dim=-1)
    return torch.where(under, F.normalize(raised, dim=-1), normal)
