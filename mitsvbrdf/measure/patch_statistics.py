"""How alike the small patches of two sets of pictures are, whatever lies where: of highlights that nobody
photographed, a plausible draw has the right statistics and the wrong pixels.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..errors import MapsError

SIDE = 7  # pixels of a patch
PROJECTIONS, SEED = 256, 0  # of the figures that are published


def patches_of(pictures: Tensor, chosen: Tensor, side: int = SIDE) -> Tensor:
    """The square patches around chosen pixels, those that lie wholly inside their picture.

    Args:
        pictures: N x H x W x C.
        chosen: N x H x W, bool: middles of the patches.
        side: of a patch in pixels, odd.

    Returns:
        M x (side^2 C), row by row of each patch, channels last.

    Raises:
        MapsError: shapes that differ, or an even side.
    """
    if pictures.shape[:3] != chosen.shape or side % 2 == 0:
        raise MapsError("a choice for each pixel, and an odd side",
                        f"{tuple(chosen.shape)} beside {tuple(pictures.shape)}, "
                        f"side {side}", "give one bool for each pixel")
    windows = pictures.unfold(1, side, 1).unfold(2, side, 1)  # N x h x w x C x side x side
    rim = side // 2
    inside = chosen[:, rim:chosen.shape[1] - rim, rim:chosen.shape[2] - rim]
    return windows[inside].permute(0, 2, 3, 1).flatten(1)


def sliced_wasserstein(first: Tensor, second: Tensor, projections: int = PROJECTIONS,
                       seed: int = SEED) -> float:
    """Sliced Wasserstein-1 distance of two sets of vectors: the mean, over directions, of that of their
    projections.

    Args:
        first: M x D.
        second: M x D: as many, so the distance of two projections is the mean difference of their sorted
            values.
        projections: how many directions, drawn evenly from the unit sphere.
        seed: of the directions.

    Returns:
        The distance in the unit of the vectors' entries; NaN of no vectors.

    Raises:
        MapsError: shapes that differ.

    Source: Rabin et al. 2011, "Wasserstein Barycenter and Its Application to Texture Mixing"; Bonneel et al.
    2015.
    """
    if first.shape != second.shape or first.ndim != 2:
        raise MapsError("two sets of as many vectors M x D",
                        f"{tuple(first.shape)} and {tuple(second.shape)}",
                        "take both at the same pixels")
    random = torch.Generator().manual_seed(seed)
    directions = F.normalize(torch.randn(projections, first.shape[1], generator=random, dtype=torch.float64),
                             dim=1)
    sorted_first, sorted_second = ((x.double() @ directions.T).sort(dim=0).values for x in (first, second))
    return float((sorted_first - sorted_second).abs().mean())


def highlights(photos: Tensor, rendered: Tensor, matte: Tensor, side: int = SIDE) -> Tensor:
    """Where light is reflected rather than scattered: the brighter of photo and rendering is over twice the
    diffuse part.

    All in linear light, averaged over the channels and over the patch around each pixel, so that noise
    decides nothing.

    Args:
        photos: N x H x W x 3, the real ones; clipped at 1.
        rendered: N x H x W x 3, of the same views.
        matte: N x H x W x 3, rendered of the diffuse map alone.
        side: of the patch in pixels, odd.

    Returns:
        N x H x W, bool.
    """
    mean = [F.avg_pool2d(x.clamp(max=1).mean(dim=-1)[:, None], side, 1, side // 2, count_include_pad=False)[:,
                                                                                                            0]
            for x in (photos, rendered, matte)]
    return torch.maximum(mean[0], mean[1]) > 2 * mean[2]
