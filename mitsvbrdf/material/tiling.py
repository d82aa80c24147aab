"""A material whose edges meet: opposite borders are laid over one another and cut along the line where they
differ least.

Source: Efros and Freeman 2001, "Image quilting for texture synthesis and transfer".
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import MapsError
from .maps import COLOURS, SVBRDF
from .resample import area_averaged

COARSE = 128  # texels a side at which overlaps are compared, at most
NARROWEST, WIDEST = 8, 2  # overlaps that are tried: the side over these, and all between
# times as different as neighbours, in the mean, opposite borders of a seamless material may be
EDGES_MEET = 1.5
FEATHER = 16  # the part of the overlap over which the two sides blend at the cut


def seamless(svbrdf: SVBRDF) -> tuple[SVBRDF, float]:
    """The material with edges that meet left to right and top to bottom, all maps cut along the same lines.

    The overlap is the one whose best cuts differ least, so that tiles and weaves end where they began; it is
    the same both ways, and a square stays a square. What is seamless already comes back as it is.

    Args:
        svbrdf: of any resolution, which it keeps.

    Returns:
        The material, and which part of its side it now shows.

    Raises:
        MapsError: fewer than 16 texels a side.
    """
    size = svbrdf.resolution
    if size < 2 * NARROWEST:
        raise MapsError(f"{2 * NARROWEST} texels a side or more, to make edges meet", str(size),
                        "leave it as it is")
    layers = torch.cat([value.double() for value in svbrdf.maps.values()], dim=-1)
    overlap = _overlap(_looks(layers, svbrdf))
    if not overlap:
        return svbrdf, 1.0
    for _ in range(2):  # columns, then rows
        layers = _joined(layers, _looks(layers, svbrdf), overlap).transpose(0, 1)
    maps = {}
    for name, value in zip(svbrdf.maps, _split(layers, svbrdf)):
        value = value.to(svbrdf[name].dtype).contiguous()
        maps[name] = F.normalize(value, dim=-1) if name == "normal" else value
    return SVBRDF(svbrdf.bsdf, maps).resized(size), 1 - overlap / size


def _split(layers: Tensor, svbrdf: SVBRDF) -> tuple[Tensor, ...]:
    return layers.split([value.shape[-1] for value in svbrdf.maps.values()], dim=-1)


def _looks(layers: Tensor, svbrdf: SVBRDF) -> Tensor:
    """The layers with colours as they are seen: differences of these are what an eye notices."""
    return torch.cat([color.encode(value) if name in COLOURS else value
                      for name, value in zip(svbrdf.maps, _split(layers, svbrdf))], dim=-1)


def _difference(looks: Tensor, overlap: int) -> Tensor:
    """Squared difference of the first columns from the last ones, H x overlap."""
    return (looks[:, :overlap] - looks[:, -overlap:]).square().sum(dim=-1)


def _overlap(looks: Tensor) -> int:
    """How many columns and rows to lay over one another; 0 where the edges meet."""
    size = len(looks)
    both = looks, looks.transpose(0, 1)
    if all(_meet(each) for each in both):
        return 0
    side = min(COARSE, size)
    coarse = [area_averaged(each, side) for each in both]
    tried = range(side // NARROWEST, side // WIDEST + 1)
    best = min(tried, key=lambda overlap: sum(_closed_cut(_difference(each, overlap))[1] for each in coarse))
    return round(best * size / side)


def _meet(looks: Tensor) -> bool:
    """Whether the last column goes on in the first as columns do elsewhere."""
    usual = (looks[:, 1:] - looks[:, :-1]).square().sum(dim=-1).mean()
    return float(_difference(looks[:, [0, -1]], 1).mean()) <= EDGES_MEET**2 * float(usual)


def _joined(layers: Tensor, looks: Tensor, overlap: int) -> Tensor:
    """H x W x C, narrower by the overlap: the last column goes on in the first."""
    error = _difference(looks, overlap)
    coarser = -(-overlap // COARSE)
    cut = coarser * _closed_cut(F.avg_pool2d(error[None, None], coarser, ceil_mode=True)[0,
                                                                                         0])[0].to(error.dtype)
    cut = F.interpolate(cut[None, None], scale_factor=coarser, mode="linear")[0, 0, :len(error), None]
    # share of the left border's texels
    first = (torch.arange(overlap) + 0.5 - cut) / max(1.0, overlap / FEATHER) + 0.5
    first = first.clamp(0, 1)[..., None]
    first[:, 0], first[:, -1] = 0, 1  # what the last column goes on in, and what the rest goes on from
    return torch.cat((first * layers[:, :overlap] + (1 - first) * layers[:, -overlap:],
                      layers[:, overlap:-overlap]), dim=1)


def _closed_cut(error: Tensor) -> tuple[Tensor, float]:
    """The path of least error from top to bottom that moves by at most one column a row and ends where it
    began.

    Returns:
        The column of each row, and the mean error.
    """
    width = error.shape[1]
    # by start and present column
    cost = torch.where(torch.eye(width, dtype=torch.bool), error[0], float("inf"))
    came = []
    for row in error[1:]:
        padded = F.pad(cost, (1, 1), value=float("inf"))
        least, step = torch.stack((padded[:, :-2], padded[:, 1:-1], padded[:, 2:])).min(dim=0)
        came.append(step.to(torch.int8) - 1)
        cost = least + row
    start = int(cost.diagonal().argmin())
    path = [start]
    for steps in reversed(came):
        path.append(path[-1] + int(steps[start, path[-1]]))
    return torch.tensor(path[::-1]), float(cost[start, start]) / len(error)
