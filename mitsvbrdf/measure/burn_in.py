"""Burn-in: how much of a map follows the highlights of the photos, measured without ground truth.

The coverage angle of a texel is the smallest angle between the flat normal (0, 0, 1) and its half vectors
over the photos of a fit. If it is small, a photo showed the texel's highlight. True maps do not depend on it.
Maps do if a fit put highlights into them or fell back to its start. Burn-in is the share R^2 of a map's
variance that a cubic in the coverage angle explains: 0 for maps that do not depend on it
(3 / (n - 1) on average for n texels of pure noise), 1 for maps that depend on nothing else. A material whose
own pattern resembles that of the highlights has some burn-in, too.

Each highlight leaves an oval as wide as the lobe. The coverage angle blurs these ovals; :func:`local_burn_in`
measures each of them. Fine texture adds variance, so burn-in is a little lower at higher resolution.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from .. import color
from ..material.maps import SVBRDF
from ..views import STRIP, Views, coverage_angle, half_angles, strips

# a map is constant if its standard deviation is below this share of its RMS: rounding alone gives 1e-7
CONSTANT_BELOW = 1e-6
LOCAL_SIDE = 64  # most texels a side in the search for ovals; larger maps are area-averaged
WIDTHS = 0.5, 1.0, 2.0  # of the bumps, in widths of the lobe
# offsets that fill the square evenly (Roberts 2018); 20 of them are farther than NEAR
ROLLS = 24
NEAR = 0.25  # smallest shift of a map that is used: |x| + |y|, in sides
SAME = 1e-3  # share of the largest singular value; below it, a bump is a combination of others


def burn_in(svbrdf: SVBRDF, views: Views) -> dict[str, float]:
    """Share of the variance of ``specular`` and ``roughness`` that the coverage angle explains.

    Args:
        svbrdf: the material, at the resolution to measure. A principled one is converted first.
        views: the views of the photos that the fit used.
    """
    angle = coverage_angle(views, svbrdf.resolution)
    return {name: explained_share(value, angle) for name, value in _looks(svbrdf).items()}


def local_burn_in(svbrdf: SVBRDF, views: Views) -> dict[str, float]:
    """How much of ``specular`` and ``roughness`` is in ovals of single highlights: a share, at most 1.

    Each photo that the fit used has three Gaussian bumps in the tangent of the half vector's angle, 0.5, 1
    and 2 times as wide as a lobe of the map's median roughness. R^2 is the share of a map's variance that
    all bumps together explain; R0^2 is the mean of R^2 for the map rolled sideways by 20 offsets. The measure
    is (R^2 - R0^2) / (1 - R0^2). Without burn-in it is near 0, as often below as above. Before, maps
    are area-averaged to 64 x 64 at most; a principled material is converted.
    """
    looks = _looks(svbrdf.detach().resized(min(LOCAL_SIDE, svbrdf.resolution)))
    maps = torch.stack([each.double() for each in looks.values()])
    here, rolled = oval_shares(maps, oval_patterns(views, maps.shape[-1], float(looks["roughness"].median())))
    elsewhere = rolled.mean(dim=0)
    return dict(zip(looks, ((here - elsewhere) / (1 - elsewhere)).tolist()))


def oval_patterns(views: Views, side: int, roughness: float) -> Tensor:
    """Orthonormal basis, of mean 0, of the bumps of :func:`local_burn_in`: P x side^2, P <= 3 N, float64."""
    widths = roughness * torch.tensor(WIDTHS, dtype=torch.float64)
    far = torch.tan(half_angles(views, side)).flatten(1)
    bumps = torch.exp(-(far[:, None] / widths[:, None]).square() / 2).flatten(0, 1)
    _, sizes, patterns = torch.linalg.svd(bumps - bumps.mean(dim=1, keepdim=True), full_matrices=False)
    return patterns[sizes > SAME * sizes[0]]


def oval_shares(maps: Tensor, patterns: Tensor) -> tuple[Tensor, Tensor]:
    """Share of the variance of each map (S x R x R) that patterns explain: S; and K x S for rolled maps."""
    side, off = maps.shape[-1], maps.double() - maps.double().mean(dim=(1, 2), keepdim=True)
    total, size = off.flatten(1).square().sum(dim=1), maps.double().flatten(1).square().sum(dim=1)
    constant = total <= CONSTANT_BELOW**2 * size

    def explained(values: Tensor) -> Tensor:
        return torch.where(constant, 0.0, (values.flatten(1) @ patterns.T).square().sum(dim=1) / total)

    offsets = (0.5 + torch.arange(1, ROLLS + 1)[:, None] * torch.tensor([0.7548776662, 0.5698402910])) % 1
    offsets = (offsets[torch.minimum(offsets, 1 - offsets).sum(dim=1) > NEAR] * side).int()
    return explained(off), torch.stack([explained(off.roll(tuple(by), (1, 2))) for by in offsets.tolist()])


def _looks(svbrdf: SVBRDF) -> dict[str, Tensor]:
    """The two maps that are measured, R x R: channel mean of specular as linear^(1/2.2), and roughness."""
    maps = svbrdf.detach().as_roughconductor()
    return {"specular": torch.cat([color.encode(maps["specular"][rows].double()).mean(dim=-1)
                                   for rows in strips(svbrdf.resolution)]),
            "roughness": maps["roughness"][..., 0]}


def explained_share(values: Tensor, angle: Tensor) -> float:
    """R^2 of the least-squares cubic in ``angle`` through ``values`` (same shape); 0 for constants."""
    y, x = values.flatten(), angle.flatten()
    mean, total, size, left = y.mean(dtype=torch.float64), 0.0, 0.0, 0.0
    for part, trend in zip(y.split(STRIP), cubic(x, y[None])):
        part = part.double()
        total += float((part - mean).square().sum())
        size += float(part.square().sum())
        left += float((part - trend[0]).square().sum())
    return 0.0 if total <= CONSTANT_BELOW**2 * size else min(max(1 - left / total, 0.0), 1.0)


def cubic(x: Tensor, values: Tensor) -> Iterator[Tensor]:
    """Least-squares cubics in x (M) through values (S x M), evaluated at x: S x M, float64, in strips."""
    x = x.double()
    middle = x.mean()
    scale = (x - middle).abs().max().clamp_min(1e-9)

    def powers(part: Tensor) -> Tensor:
        return torch.stack([((part - middle) / scale) ** k for k in range(4)])

    square, right = x.new_zeros(4, 4), x.new_zeros(4, len(values))
    for part, numbers in zip(x.split(STRIP), values.split(STRIP, dim=1)):
        square += powers(part) @ powers(part).T
        right += powers(part) @ numbers.double().T
    # gelsd: x may be constant
    found = torch.linalg.lstsq(square, right, driver="gelsd").solution
    return (found.T @ powers(part) for part in x.split(STRIP))
