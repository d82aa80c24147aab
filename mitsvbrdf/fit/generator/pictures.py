"""Input of the discriminator: photos or blends of two (paper, III.F), and renderings blended the same way."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...views import Views

Window = tuple[slice, slice]  # rows and columns of a crop
WHOLE = slice(None), slice(None)


@dataclass(frozen=True)
class Pictures:
    """Photos or blends of photos; :meth:`of` makes the same pictures from renderings."""

    shown: Tensor  # the pictures, P x 3 x R x R in display values
    index: Tensor  # rows of the K photos in the capture
    weights: Tensor  # P x K, weight of each photo in each picture, in linear light
    # renderings are clamped to these radiances: 0 and 1; at a masked pixel, both are the photo's radiance
    limits: tuple[Tensor, Tensor]  # K x R x R x 3 each
    window: Window  # the crop of the photos that the pictures show
    transfer: color.Transfer  # transfer function of the photos

    def of(self, rendered: Tensor) -> Tensor:
        """The same pictures, made from renderings of the K photos: linear K x R x R x 3, not yet clamped.

        Each rendering is clipped and masked like its photo, then blended: both are compared after the same
        measurement (Bora 2018, AmbientGAN).
        """
        return _displayed(rendered.clamp(*self.limits), self.weights, self.transfer)


class PictureSource:
    """Draws pictures from a capture: random crops with ``crop`` texels a side; 0: whole photos."""

    def __init__(self, capture: Capture, crop: int = 0) -> None:
        self.capture, self.crop = capture, crop
        self.linear = capture.linear
        least, highest = torch.zeros_like(self.linear), torch.ones_like(self.linear)
        if capture.measured is not None:
            least, highest = (torch.where(capture.measured[..., None], limit, self.linear)
                              for limit in (least, highest))
        self.limits = least, highest

    def draw(self, count: int, random: torch.Generator) -> Pictures:
        """``count`` pictures. Each is, with equal chance, one photo or a blend of two at random weights."""
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
        shown = _displayed(self.linear[index, *window], weights, self.capture.transfer)
        least, greatest = (limit[index, *window] for limit in self.limits)
        return Pictures(shown, index, weights, (least, greatest), window, self.capture.transfer)

    def _window(self, random: torch.Generator) -> Window:
        room = self.capture.resolution - self.crop
        if not self.crop or room <= 0:
            return WHOLE
        top, left = torch.randint(room + 1, (2,), generator=random).tolist()
        return slice(top, top + self.crop), slice(left, left + self.crop)


def _displayed(linear: Tensor, weights: Tensor, transfer: color.Transfer) -> Tensor:
    return color.encode(torch.einsum("pk,kijc->pcij", weights, linear), transfer)


def seen_through(window: Window, views: Views, resolution: int) -> Views:
    """Views of a crop as a patch of its own (middle, size); the whole has ``resolution`` texels a side."""
    if window == WHOLE:
        return views
    (top, bottom), (left, right) = ((each.start, each.stop) for each in window)
    middle = torch.tensor([(left + right) / 2 / resolution - 0.5, 0.5 - (top + bottom) / 2 / resolution, 0.0])
    shift = middle.to(views.camera) * views.size
    return replace(views.carried(-shift), size=views.size * (bottom - top) / resolution)
