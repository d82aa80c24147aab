"""The variational generator that the paper names as future work (IV.C): one material for all photos,
whichever comes first.

An encoder shared by all photos says of each what its maps may be (a normal distribution of a code, at every
level); the product of these and of a standard normal is the material's (a product of experts: Wu and Goodman
2018; of levels: Sonderby et al. 2016). Training draws codes, the result takes the mean (Kingma and Welling
2014). The decoders see codes and the guess.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ... import color
from ...capture import Capture
from ...color import CLIPPED
from ...views import geometry
from ..parameters import Streams
from .networks import block, pad_to_multiple, zero

# of condition_of, before the guess: rgb, where it is clipped, and the half vector's two angles
PHOTO_CHANNELS = 6

SURE = -4.0  # log variance that a photo's say begins with: codes drawn are near their mean


def condition_of(capture: Capture, guess: Tensor) -> Tensor:
    """Input of the generator, N x 9 x R x R: photo, clipped pixels, highlight positions, the guess."""
    photos = capture.photos.permute(0, 3, 1, 2) * 2 - 1
    clipped = (capture.photos >= CLIPPED).any(dim=-1).float()[:, None] * 2 - 1
    flat = angles(capture)
    own = color.encode(guess).permute(2, 0, 1).expand(len(photos), -1, -1, -1) * 2 - 1
    return torch.cat((photos, clipped, flat, own), dim=1)


def angles(capture: Capture) -> Tensor:
    """Where highlights would lie on a flat patch, N x 2 x R x R: the half vector's x and y over a tenth."""
    half = geometry(capture.views, capture.resolution)[1]
    return 10 * half[..., :2].permute(0, 3, 1, 2).float()


class VariationalGenerator(nn.Module):
    """From any number of photos, in any order, to one change to the start.

    Args:
        streams: which maps come out of which decoder, with how many channels; one without maps is not built.
        width: channels of the finest level.
        change: whether the last layers begin at zero, because what they put out is a change to a start.
    """

    def __init__(self, streams: Streams, width: int = 16, change: bool = True) -> None:
        super().__init__()
        self.streams = [stream for stream in streams if stream]
        self.widths = [width, 2 * width, 4 * width, 6 * width]
        self.photos, self.guess = self._encoder(PHOTO_CHANNELS, of_all), self._encoder(3, block)
        self.posterior = nn.ModuleList(nn.Conv2d(w, 2 * w, 1) for w in self.widths)
        for layer, width_here in zip(self.posterior, self.widths):
            nn.init.constant_(layer.bias[width_here:], SURE)  # type: ignore[index]
        self.up = nn.ModuleList(self._decoder(sum(s.values())) for s in self.streams)
        self.divergence = torch.zeros(())
        if change:
            self.begin_change()

    def begin_change(self) -> None:
        """Set the last layers to zero: what is put out is no change."""
        zero(list(decoder.children())[-1] for decoder in self.up)

    def _encoder(self, inputs: int, layer: Callable[[nn.Conv2d], nn.Sequential]) -> nn.ModuleList:
        return nn.ModuleList([layer(nn.Conv2d(inputs, self.widths[0], 3, padding=1))] + [
            layer(nn.Conv2d(a, b, 4, stride=2, padding=1)) for a, b in zip(self.widths, self.widths[1:])])

    def _decoder(self, channels: int) -> nn.ModuleList:
        widths = self.widths
        layers = [block(nn.Conv2d(2 * at + (below or 0), at, *((1,) if at == widths[0] else (3, 1, 1))))
                  for at, below in zip(widths[::-1], [None, *widths[:0:-1]])]
        return nn.ModuleList([*layers, nn.Conv2d(widths[0], channels, 1)])

    def forward(self, condition: Tensor, random: torch.Generator | None = None) -> dict[str, Tensor]:
        """Changes by name, each C x R x R; :attr:`divergence` is then what the code costs.

        Args:
            condition: of :func:`condition_of`, N x 9 x R x R.
            random: draws the codes; None takes their means.
        """
        size = condition.shape[-1]
        shown = pad_to_multiple(condition, 8)
        photos, guess = shown[:, :PHOTO_CHANNELS], shown[:1, PHOTO_CHANNELS:]
        levels, costs = [], []
        for see, look, tell in zip(self.photos, self.guess, self.posterior):
            photos, guess = see(photos), look(guess)
            mean, variance = product_of_experts(*tell(photos).float().chunk(2, dim=1))
            noise = torch.randn(mean.shape, generator=random) if random else torch.zeros(())
            costs.append(divergence(mean, variance))
            levels.append(torch.cat(((mean + variance.sqrt() * noise).to(guess.dtype), guess), dim=1))
        self.divergence = torch.stack(costs).mean()
        out: dict[str, Tensor] = {}
        for decoder, stream in zip(self.up, self.streams):
            coarsest, *layers, last = decoder.children()
            x = coarsest(levels[-1])
            for layer, level in zip(layers, levels[-2::-1]):
                x = layer(torch.cat((F.interpolate(x, scale_factor=2.0, mode="nearest"), level), dim=1))
            out |= dict(zip(stream, last(x)[0, :, :size, :size].split(list(stream.values()))))
        return out


class OverAll(nn.GroupNorm):
    """Instance norm over all photos together, N x C x r x r: which of them is brighter stays."""

    def forward(self, x: Tensor) -> Tensor:  # noqa: D102
        return super().forward(x.transpose(0, 1).flatten(1, 2)[None]).unflatten(2,
                                                                                (len(x), -1))[0].transpose(0,
                                                                                                           1)


def of_all(layer: nn.Conv2d) -> nn.Sequential:
    """A convolution of each photo, instance norm over all of them, and leaky ReLU."""
    return nn.Sequential(layer, OverAll(layer.out_channels, layer.out_channels),
                         nn.LeakyReLU(0.2, inplace=True))


def product_of_experts(means: Tensor, log_variances: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance, 1 x C x r x r, of the product of N normal distributions and a standard one."""
    precisions = torch.exp(-log_variances.clamp(-8, 8))
    variance = 1 / (1 + precisions.sum(dim=0, keepdim=True))
    return variance * (precisions * means).sum(dim=0, keepdim=True), variance


def divergence(mean: Tensor, variance: Tensor) -> Tensor:
    """Kullback-Leibler divergence of a normal distribution from the standard one, in nats a number."""
    return (mean.square() + variance - 1 - variance.log()).mean() / 2
