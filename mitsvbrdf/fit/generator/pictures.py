"""What the discriminator compares: photos or blends of two (III.F), and the same of renderings."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...color import CLIPPED
from ...views import geometry


@dataclass(frozen=True)
class Pictures:
    """Photos or blends, and how renderings of their views become pictures to compare with them."""

    shown: Tensor  # the pictures, P x 3 x R x R in display values
    # where highlights would lie on a flat patch: ten times 1 - the half vector's cosine, and its sine
    angles: Tensor  # P x 2 x R x R
    index: Tensor  # numbers of the K photos in the capture
    weights: Tensor  # P x K, how much of each photo is in each picture, in linear light
    # least and greatest radiance of renderings: 1 at most where a photo is clipped, the photo's where masked
    limits: tuple[Tensor, Tensor]  # K x R x R x 3 each
    transfer: color.Transfer  # of the photos

    def of(self, rendered: Tensor) -> Tensor:
        """The same pictures of renderings of the views ``index``, linear K x R x R x 3, unclamped.

        Each view is clipped and masked as its photo was before it is blended, so that photos and renderings
        show the same physics (Bora 2018, AmbientGAN). Display values P x 3 x R x R are above 1 where a
        rendering is too bright and its photo is not clipped.
        """
        least, greatest = self.limits
        seen, bound = rendered.clamp(least, greatest), greatest < torch.inf
        if not bound.all():  # in memory as the photos are, else as rendered: the bits of sums hang on it
            seen = torch.where(bound, seen, rendered)
        return _displayed(seen, self.weights, self.transfer)


class PictureSource:
    """Draws pictures from a capture; ``clipping``: renderings are clipped where the photo is, only there."""

    def __init__(self, capture: Capture, clipping: bool) -> None:
        self.capture = capture
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
        return self._of(torch.tensor(index), mixed[:, :len(index)].contiguous())

    def whole(self, photo: int = 0) -> Pictures:
        """One photo, whole."""
        return self._of(torch.tensor([photo]), torch.ones(1, 1))

    def _of(self, index: Tensor, weights: Tensor) -> Pictures:
        angles = torch.einsum("pk,kcij->pcij", weights, self.angles[index])
        shown = _displayed(self.linear[index], weights, self.capture.transfer)
        least, greatest = (limit[index] for limit in self.limits)
        return Pictures(shown, angles, index, weights, (least, greatest), self.capture.transfer)


def _displayed(linear: Tensor, weights: Tensor, transfer: color.Transfer) -> Tensor:
    return color.encode(torch.einsum("pk,kijc->pcij", weights, linear), transfer)
