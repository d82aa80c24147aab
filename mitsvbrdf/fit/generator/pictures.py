"""What the discriminator compares: photos or blends of two (III.F), and the same of renderings."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...color import CLIPPED
from ...views import Views, geometry

Window = tuple[slice, slice]  # rows and columns of a crop
WHOLE = slice(None), slice(None)


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
    window: Window  # the crop of the photos that is shown
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
    """Draws pictures from a capture, of random crops of so many texels a side; 0 takes the whole.

    ``clipping``: renderings are clipped where the photo is, only there.
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
        return self._of(torch.tensor(index), mixed[:, :len(index)].contiguous(), self._window(random))

    def whole(self, photo: int = 0) -> Pictures:
        """One photo, whole."""
        return self._of(torch.tensor([photo]), torch.ones(1, 1), WHOLE)

    def _of(self, index: Tensor, weights: Tensor, window: Window) -> Pictures:
        angles = torch.einsum("pk,kcij->pcij", weights, self.angles[index][..., *window])
        shown = _displayed(self.linear[index, *window], weights, self.capture.transfer)
        least, greatest = (limit[index, *window] for limit in self.limits)
        return Pictures(shown, angles, index, weights, (least, greatest), window, self.capture.transfer)

    def _window(self, random: torch.Generator) -> Window:
        room = self.capture.resolution - self.crop
        if not self.crop or room <= 0:
            return WHOLE
        top, left = torch.randint(room + 1, (2,), generator=random).tolist()
        return slice(top, top + self.crop), slice(left, left + self.crop)


def _displayed(linear: Tensor, weights: Tensor, transfer: color.Transfer) -> Tensor:
    return color.encode(torch.einsum("pk,kijc->pcij", weights, linear), transfer)


def seen_through(window: Window, views: Views, resolution: int) -> Views:
    """Views of a crop of a patch of so many texels a side: around its middle, with its side as the size."""
    if window == WHOLE:
        return views
    (top, bottom), (left, right) = ((each.start, each.stop) for each in window)
    middle = torch.tensor([(left + right) / 2 / resolution - 0.5, 0.5 - (top + bottom) / 2 / resolution, 0.0])
    shift = middle.to(views.camera) * views.size
    return replace(views.carried(-shift), size=views.size * (bottom - top) / resolution)
