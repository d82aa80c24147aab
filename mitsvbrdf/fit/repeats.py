"""A test whether one photo shows a material that repeats itself."""

import itertools
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..capture import Capture
from ..color import to_display
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views, half_angles

# Numbers of rings of equal half angle and of blocks along a side of the photo. A photo passes if at most this
# share of the variance of ranks is between blocks, or if their lightness differs by at most this (relative).
RINGS, BLOCKS, BETWEEN, CONTRAST = 32, 4, 0.25, 0.05
PLACES = (-0.2, -0.1, 0.0, 0.1, 0.2)  # tried if the flash's place is unknown: sides from the middle
HARDLY_TOLD = "specular, roughness and normals are hardly determined; take more from other places"


class Repeats(NamedTuple):
    """The result of the test of one photo."""

    stationary: bool  # whether the photo counts as one of a material that repeats itself
    between: float  # share of the variance of lightness ranks between sixteenths of the photo, 0 to 1
    contrast: float  # relative difference of the lightness of these sixteenths
    asked: bool  # whether the user decided, not the test

    def said(self) -> str:
        """The sentence for users."""
        found = f"{self.between:.0%} of the variance of lightness ranks lies between sixteenths of the photo"
        found += (f", which differ by {self.contrast:.0%}" if self.contrast <= CONTRAST else
                  f" ({BETWEEN:.0%} or less counts as a pattern that repeats itself)")
        found = "as asked for" if self.asked else found
        if self.stationary:
            return (f"one photo, taken for that of a material that repeats itself: {found}; specular, "
                    "roughness and normals are those of classes of texels that look alike")
        return f"one photo, not taken for that of a material that repeats itself: {found}; {HARDLY_TOLD}"


def repeats(capture: Capture, asked: bool | None = None) -> Repeats:
    """Whether a photo counts as one of a material that repeats itself.

    On a flat patch, all pixels of a ring of equal half angle have the same light and the same lobe, so their
    ranks by lightness come from the material. The ranks of a stationary material are alike in all blocks of
    the photo. A flash of unknown place is assumed where the blocks become most alike. ``asked``: decision of
    the user; None: the test decides.
    """
    shifts = [(0.0, 0.0)] if capture.calibrated else list(itertools.product(PLACES, PLACES))
    between, contrast = min(_uneven(capture, torch.tensor([*shift, 0.0]).double()) for shift in shifts)
    found = between <= BETWEEN or contrast <= CONTRAST
    return Repeats(found if asked is None else asked, between, contrast, asked is not None)


def _uneven(capture: Capture, shift: Tensor) -> tuple[float, float]:
    """Share of the variance of ranks between blocks, and their contrast, with the flash moved (sides)."""
    light, side = capture.linear[0].mean(dim=-1).flatten(), capture.resolution
    rank, beside = torch.empty_like(light), torch.empty_like(light)
    half = half_angles(capture.views.carried(shift * capture.views.size), side)[0].flatten()
    for ring in half.argsort().tensor_split(RINGS):
        rank[ring[light[ring].argsort()]] = (torch.arange(len(ring)) + 0.5) / len(ring)
        beside[ring] = light[ring] / light[ring].median().clamp_min(1e-6) - 1
    share, differ = (F.adaptive_avg_pool2d(plane.reshape(1, side, side), BLOCKS) for plane in (rank, beside))
    return 12 * float((share - 0.5).square().mean()), float(differ.std())


def unlike(svbrdf: SVBRDF, views: Views, capture: Capture, renderer: Renderer) -> float:
    """RMSE, in display values, between the photo and renderings of the maps shifted by half a side.

    The sorted pixels of rings of equal half angle are compared. A stationary material looks alike in both.
    Highlights that are burnt into maps appear at wrong places in the renderings.
    """
    side, photo = capture.resolution, capture.photos[0].flatten(0, 1)
    rings = half_angles(views, side)[0].flatten().argsort().tensor_split(RINGS)
    errors = []
    for on in ((side // 2, 0), (0, side // 2), (side // 2, side // 2)):
        laid = SVBRDF(svbrdf.bsdf, {name: value.roll(on, (0, 1)) for name, value in svbrdf.maps.items()})
        with torch.no_grad():
            seen = to_display(renderer.render(laid, views), capture.transfer)[0].clamp(0, 1).flatten(0, 1)
        errors += [(seen[ring].sort(dim=0)[0] - photo[ring].sort(dim=0)[0]).square().sum() for ring in rings]
    return float((torch.stack(errors).sum() / (3 * photo.numel())).sqrt())
