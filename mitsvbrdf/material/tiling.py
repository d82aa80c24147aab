"""A material whose edges meet: opposite borders overlap and are cut where they differ least.

Source: Efros and Freeman 2001, "Image quilting for texture synthesis and transfer".
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import MapsError
from .maps import COLOURS, SVBRDF
from .resample import area_averaged

COARSE = 128  # texels a side at which overlaps are compared, at most
NARROWEST, WIDEST = 8, 2  # overlaps that are tried: the side over these, and all between
# Opposite borders of a seamless material differ at most so many times as much as neighbours beside them.
# Tiles that end amid their grout reach 1.1, borders that do not belong together 1.6 and more.
EDGES_MEET = 1.5
BESIDE = 16  # the side over this: how far from the border neighbours count
LEAST_STEP = 1 / 255  # differences below one step of 8 bits count as one
FEATHER = 16  # overlap / FEATHER is the width over which the two sides blend at the cut


def seamless(svbrdf: SVBRDF) -> tuple[SVBRDF, float]:
    """The material with edges that meet left to right and top to bottom, all maps cut along the same lines.

    The overlap is the one whose best cuts differ least, so that tiles and weaves end where they began. It is
    the same both ways, so a square stays a square. A seamless material comes back as it is. Returns the
    material at its resolution and the share of its side that is left. MapsError: fewer than 16 texels a side.
    """
    size = svbrdf.resolution
    if size < 2 * NARROWEST:
        raise MapsError(f"{2 * NARROWEST} texels a side or more, to make edges meet", str(size),
                        "leave it as it is")
    if seam(svbrdf) <= EDGES_MEET:
        return svbrdf, 1.0
    layers = torch.cat([value.double() for value in svbrdf.maps.values()], dim=-1)
    overlap = _overlap(_looks(layers, svbrdf))
    for _ in range(2):  # columns, then rows
        layers = _joined(layers, _looks(layers, svbrdf), overlap).transpose(0, 1)
    maps = {}
    for name, value in zip(svbrdf.maps, _split(layers, svbrdf)):
        value = value.to(svbrdf[name].dtype).contiguous()
        maps[name] = F.normalize(value, dim=-1) if name == "normal" else value
    return _enlarged(SVBRDF(svbrdf.bsdf, maps), size), 1 - overlap / size


def seam(svbrdf: SVBRDF) -> float:
    """How visible the edges of a repeated material are: at 1, no more than the texels beside them.

    RMS difference across opposite borders, divided by that of neighbours near them; worst map and edge.
    """
    worst = 0.0
    for name, value in svbrdf.maps.items():
        looks = _look(name, value.double())
        for each in (looks, looks.transpose(0, 1)):
            steps = (each - each.roll(1, dims=1)).square().sum(dim=-1).mean(dim=0)
            near = max(2, len(steps) // BESIDE)
            beside = torch.cat((steps[1:near], steps[1 - near:])).mean().clamp_min(LEAST_STEP**2)
            worst = max(worst, float((steps[0] / beside).sqrt()))
    return worst


def _enlarged(svbrdf: SVBRDF, size: int) -> SVBRDF:
    """Enlarge a material whose edges meet: bilinear, across the edges too."""
    at = (torch.arange(size, dtype=torch.float64) + 0.5) * svbrdf.resolution / size - 0.5
    low, share = at.floor().long(), (at - at.floor())[:, None, None]
    maps = {}
    for name, value in svbrdf.maps.items():
        fine = value.double()
        for _ in range(2):  # rows, then columns
            fine = torch.lerp(fine[low % len(fine)], fine[(low + 1) % len(fine)], share).transpose(0, 1)
        fine = F.normalize(fine, dim=-1) if name == "normal" else fine
        maps[name] = fine.to(value.dtype).contiguous()
    return SVBRDF(svbrdf.bsdf, maps)


def _split(layers: Tensor, svbrdf: SVBRDF) -> tuple[Tensor, ...]:
    return layers.split([value.shape[-1] for value in svbrdf.maps.values()], dim=-1)


def _looks(layers: Tensor, svbrdf: SVBRDF) -> Tensor:
    """The layers with colours encoded, so that differences are as an eye notices them."""
    return torch.cat([_look(name, value) for name, value in zip(svbrdf.maps, _split(layers, svbrdf))], dim=-1)


def _look(name: str, value: Tensor) -> Tensor:
    return color.encode(value) if name in COLOURS else value


def _difference(looks: Tensor, overlap: int) -> Tensor:
    """Squared difference of the first columns from the last ones, H x overlap."""
    return (looks[:, :overlap] - looks[:, -overlap:]).square().sum(dim=-1)


def _overlap(looks: Tensor) -> int:
    """How many columns and rows to lay over one another."""
    size = len(looks)
    both = looks, looks.transpose(0, 1)
    side = min(COARSE, size)
    coarse = [area_averaged(each, side) for each in both]
    tried = range(side // NARROWEST, side // WIDEST + 1)
    best = min(tried, key=lambda overlap: sum(_closed_cut(_difference(each, overlap))[1] for each in coarse))
    return round(best * size / side)


def _joined(layers: Tensor, looks: Tensor, overlap: int) -> Tensor:
    """The layers (H x W x C) narrower by the overlap: the last column continues in the first."""
    error = _difference(looks, overlap)
    coarser = -(-overlap // COARSE)
    cut = coarser * _closed_cut(F.avg_pool2d(error[None, None], coarser, ceil_mode=True)[0, 0])[0].to(
        error.dtype)
    cut = F.interpolate(cut[None, None], scale_factor=coarser, mode="linear")[0, 0, :len(error), None]
    # share of the left border's texels
    first = (torch.arange(overlap) + 0.5 - cut) / max(1.0, overlap / FEATHER) + 0.5
    first = first.clamp(0, 1)[..., None]
    first[:, 0], first[:, -1] = 0, 1  # first only the right border, last only the left one
    return torch.cat((first * layers[:, :overlap] + (1 - first) * layers[:, -overlap:],
                      layers[:, overlap:-overlap]), dim=1)


def _closed_cut(error: Tensor) -> tuple[Tensor, float]:
    """The closed path of least error downward, at most one column a row: its columns, its mean error."""
    width = error.shape[1]
    cost = torch.where(torch.eye(width, dtype=torch.bool), error[0], float("inf"))  # by start and column
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
