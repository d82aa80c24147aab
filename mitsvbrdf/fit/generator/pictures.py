"""What the discriminator compares: photos or blends of two (III.F), and the same of renderings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...color import CLIPPED
from ...views import Views, geometry

Window = tuple[int, int, int]  # top, left and side of a crop, in texels


@dataclass(frozen=True)
class Pictures:
    """Photos or blends, and how renderings of their views become pictures to compare with them.

    Args:
        shown: the pictures, P x 3 x R x R in display values.
        angles: where highlights would lie on a flat patch, P x 2 x R x R: ten times how far the half vector's
            cosine is from 1, and its sine.
        index: numbers of the K photos in the capture.
        weights: P x K, how much of each photo is in each picture, in linear light.
        limits: least and greatest radiance of renderings, K x R x R x 3 each: 1 at most where each photo is
            clipped, and exactly the photo's where that is masked.
        window: the crop of the photos that is shown.
        transfer: of the photos.
    """

    shown: Tensor
    angles: Tensor
    index: Tensor
    weights: Tensor
    limits: tuple[Tensor, Tensor]
    window: Window
    transfer: color.Transfer

    def of(self, rendered: Tensor) -> Tensor:
        """The same pictures of renderings of the views ``index``.

        Each view is clipped and masked as its photo was before it is blended, so that photos and renderings
        show the same physics (Bora 2018, AmbientGAN).

        Args:
            rendered: linear radiance K x R x R x 3, unclamped.

        Returns:
            P x 3 x R x R in display values, above 1 where a rendering is too bright and its photo is not
            clipped.
        """
        least, greatest = self.limits
        seen, bound = rendered.clamp(least, greatest), greatest < torch.inf
        if not bound.all():  # in memory as the photos are, else as rendered: the bits of sums hang on it
            seen = torch.where(bound, seen, rendered)
        return _displayed(seen, self.weights, self.transfer)


class PictureSource:
    """Draws pictures from a capture.

    Args:
        capture: photos and views.
        clipping: whether renderings are clipped where the photo is, and only there.
        crop: side of random crops, in texels; 0 takes the whole.
    """

    def __init__(self, capture: Capture, clipping: bool, crop: int = 0) -> None:
        self.capture, self.crop = capture, crop
        self.linear = color.decode(capture.photos, capture.transfer)
        half = geometry(capture.views, capture.resolution)[1]
        self.angles = torch.stack((10 * (1 - half[..., 2]), half[..., :2].norm(dim=-1)), dim=1)
        highest = torch.where(capture.photos < CLIPPED, torch.inf if clipping else 1.0, 1.0)
        least = torch.zeros_like(highest)
        if capture.measured is not None:
            least, highest = (torch.where(capture.measured[..., None], limit, self.linear)
                              for limit in (least, highest))
        self.limits = least, highest

    def draw(self, count: int, random: torch.Generator) -> Pictures:
        """With equal chance one photo, or two blended with a random weight, ``count`` times (III.F)."""
        photos = len(self.capture)
        order = torch.randperm(photos, generator=random).repeat(2 * count)
        coins = torch.rand(count, 2, generator=random).tolist()
        index: list[int] = []
        mixed = torch.zeros(count, 2 * count)
        for row, (coin, weight) in enumerate(coins):
            shares = (1.0,) if coin < 0.5 or photos == 1 else (weight, 1 - weight)
            for share in shares:
                mixed[row, len(index)] = share
                index.append(int(order[len(index)]))
        chosen = torch.tensor(index)
        return self._cut(chosen, mixed[:, :len(index)].contiguous(), self._window(random))

    def whole(self, photo: int = 0) -> Pictures:
        """One photo, whole."""
        return self._cut(torch.tensor([photo]), torch.ones(1, 1), (0, 0, self.capture.resolution))

    def _cut(self, index: Tensor, weights: Tensor, window: Window) -> Pictures:
        top, left, side = window
        rows, columns = slice(top, top + side), slice(left, left + side)
        angles = torch.einsum("pk,kcij->pcij", weights, self.angles[index][..., rows, columns])
        shown = _displayed(self.linear[index, rows, columns], weights, self.capture.transfer)
        least, greatest = (limit[index, rows, columns] for limit in self.limits)
        return Pictures(shown, angles, index, weights, (least, greatest), window, self.capture.transfer)

    def _window(self, random: torch.Generator) -> Window:
        whole = self.capture.resolution
        if not 0 < self.crop < whole:
            return 0, 0, whole
        top, left = torch.randint(whole - self.crop + 1, (2,), generator=random).tolist()
        return top, left, self.crop


def _displayed(linear: Tensor, weights: Tensor, transfer: color.Transfer) -> Tensor:
    return color.encode(torch.einsum("pk,kijc->pcij", weights, linear), transfer)


def seen_through(window: Window, views: Views, resolution: int) -> Views:
    """Views of a crop of the patch: around its middle, with its side as the size.

    Args:
        window: the crop, in texels.
        views: of the whole patch.
        resolution: texels along its side.
    """
    top, left, side = window
    if side == resolution:
        return views
    middle = torch.tensor([(left + side / 2) / resolution - 0.5, 0.5 - (top + side / 2) / resolution, 0.0])
    shift = middle.to(views.camera) * views.size
    return replace(views.carried(-shift), size=views.size * side / resolution)
