"""Make a material seamless: opposite borders overlap, and are cut where they differ least.

Source: Efros and Freeman 2001, "Image quilting for texture synthesis and transfer".
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import MapsError
from .maps import COLOURS, SVBRDF
from .resample import area_averaged

COARSE = 128  # overlaps are compared at this many texels a side, or fewer
NARROWEST, WIDEST = 8, 2  # overlaps of side / NARROWEST to side / WIDEST are tried
# A material is seamless up to this ratio: difference of opposite borders / difference of their neighbours.
# Tiles cut in the middle of their grout reach 1.1, borders that do not fit have 1.6 and more.
EDGES_MEET = 1.5
BESIDE = 16  # neighbours within side / BESIDE of the border are compared
LEAST_STEP = 1 / 255  # differences below one 8-bit step count as one step
FEATHER = 16  # overlap / FEATHER is the width over which the two sides blend at the cut


def seamless(svbrdf: SVBRDF) -> tuple[SVBRDF, float]:
    """Make edges meet left to right and top to bottom; all maps are cut along the same lines.

    The overlap is the one with the least differences along its cuts, so periods of tiles and weaves stay
    whole. It is the same in both directions. A seamless material is not changed. Returns the material at its
    old resolution, and the share of its side that remains. MapsError: fewer than 16 texels a side.
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
    """How visible the edges of a repeated material are; 1: no more than borders of texels near them.

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
    """The layers with colours encoded: equal differences then are about equally visible."""
    return torch.cat([_look(name, value) for name, value in zip(svbrdf.maps, _split(layers, svbrdf))], dim=-1)


def _look(name: str, value: Tensor) -> Tensor:
    return color.encode(value) if name in COLOURS else value


def _difference(looks: Tensor, overlap: int) -> Tensor:
    """Squared difference of the first columns from the last ones, H x overlap."""
    return (looks[:, :overlap] - looks[:, -overlap:]).square().sum(dim=-1)


def _overlap(looks: Tensor) -> int:
    size = len(looks)
    both = looks, looks.transpose(0, 1)
    side = min(COARSE, size)
    coarse = [area_averaged(each, side) for each in both]
    tried = range(side // NARROWEST, side // WIDEST + 1)
    best = min(tried, key=lambda overlap: sum(_closed_cut(_difference(each, overlap))[1] for each in coarse))
    return round(best * size / side)


def _joined(layers: Tensor, looks: Tensor, overlap: int) -> Tensor:
    """The layers (H x W x C), narrower by the overlap; their last column continues in the first."""
    error = _difference(looks, overlap)
    coarser = -(-overlap // COARSE)
    cut = coarser * _closed_cut(F.avg_pool2d(error[None, None], coarser, ceil_mode=True)[0, 0])[0].to(
        error.dtype)
    cut = F.interpolate(cut[None, None], scale_factor=coarser, mode="linear")[0, 0, :len(error), None]
    # share of the left border's texels
    first = (torch.arange(overlap) + 0.5 - cut) / max(1.0, overlap / FEATHER) + 0.5
    first = first.clamp(0, 1)[..., None]
    first[:, 0], first[:, -1] = 0, 1  # first column: right border only; last: left border only
    return torch.cat((first * layers[:, :overlap] + (1 - first) * layers[:, -overlap:],
                      layers[:, overlap:-overlap]), dim=1)


def _closed_cut(error: Tensor) -> tuple[Tensor, float]:
    """The downward path of least mean error that ends in its start column: its columns, and that error."""
    width = error.shape[1]
    cost = torch.where(torch.eye(width, dtype=torch.bool), error[0], float("inf"))  # start x column
    came = []  # the step into each row: -1, 0 or 1 column
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
