"""The networks: the paper's two-stream generator and patch discriminator, and the all-photos generator."""

import contextlib
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...io.signals import PROCESS
from .. import losses
from ..losses import Game
from ..method import descend
from ..parameters import STREAMS, Streams


@contextlib.contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Weights drawn in this block depend on the seed alone; torch's random state stays as it was."""
    with PROCESS, torch.random.fork_rng(devices=[]):  # all threads share torch's random state
        torch.manual_seed(seed)
        yield


def block(layer: nn.Conv2d | nn.ConvTranspose2d) -> nn.Sequential:
    """A layer, instance norm, and leaky ReLU."""
    # Group norm with one channel a group is instance norm; torch computes it several times faster on a CPU.
    norm = nn.GroupNorm(layer.out_channels, layer.out_channels)
    return nn.Sequential(layer, norm, nn.LeakyReLU(0.2, inplace=True))


class TwoStreamGenerator(nn.Module):
    """The paper's generator (III.D): one encoder; two decoders keep normals and diffuse features apart.

    Encoder: 5 convolutions (three of them halve the size). Decoder ``normal_roughness``: 1 convolution and 3
    deconvolutions; decoder ``diffuse_specular``: 3 deconvolutions. Instance norm and leaky ReLU follow every
    layer except a decoder's last. There, :mod:`.conditioning` applies Tanh, to the output or to the sum of a
    start and the output. A decoder without maps is not built. With ``change`` the last layers begin at zero,
    because their output is a change to a start (ours).
    """

    def __init__(self, streams: Streams = STREAMS["roughconductor"], width: int = 64,
                 change: bool = False) -> None:
        super().__init__()
        w = width
        self.streams = streams
        self.encoder = nn.Sequential(block(nn.Conv2d(3, w, 7, padding=3, padding_mode="reflect")),
            block(nn.Conv2d(w, 2 * w, 4, stride=2, padding=1)),
            block(nn.Conv2d(2 * w, 4 * w, 4, stride=2, padding=1)),
            block(nn.Conv2d(4 * w, 8 * w, 4, stride=2, padding=1)),
            block(nn.Conv2d(8 * w, 8 * w, 3, padding=1)))
        first, second = (sum(s.values()) for s in self.streams)
        self.normal_roughness = nn.Sequential(
            block(nn.Conv2d(8 * w, 8 * w, 3, padding=1)), *self._upward(w, first)) if first else None
        self.diffuse_specular = nn.Sequential(*self._upward(w, second)) if second else None
        if change:
            self.begin_change()

    def begin_change(self) -> None:
        """Set the last layers to zero, so that the output is no change."""
        for decoder in (self.normal_roughness, self.diffuse_specular):
            if decoder is not None:
                zero(decoder[-1])

    @staticmethod
    def _upward(w: int, channels: int) -> list[nn.Module]:
        return [block(nn.ConvTranspose2d(8 * w, 4 * w, 4, stride=2, padding=1)),
                block(nn.ConvTranspose2d(4 * w, 2 * w, 4, stride=2, padding=1)),
                nn.ConvTranspose2d(2 * w, channels, 4, stride=2, padding=1)]

    def encode(self, photo: Tensor) -> Tensor:
        """Features of a photo 1 x 3 x R x R in display values: the input of both decoders."""
        return self.encoder(pad_to_multiple(photo * 2 - 1, 8))

    def decode(self, stream: int, code: Tensor, size: int) -> dict[str, Tensor]:
        """Unbounded maps of stream 0 (normal, roughness) or 1 (the others): map name to C x size x size."""
        decoder = (self.normal_roughness, self.diffuse_specular)[stream]
        if decoder is None:
            return {}
        maps = decoder(code)[0, :, :size, :size]
        return dict(zip(self.streams[stream], maps.split(list(self.streams[stream].values()))))


class PatchDiscriminator(nn.Module):
    """The paper's discriminator (III.D): 5 convolutions, four with instance norm and leaky ReLU.

    Its Sigmoid is part of the losses (:func:`mitsvbrdf.fit.losses.discriminator`). It sees a picture, and the
    channels ``told`` if there are any.
    """

    def __init__(self, width: int = 64, inputs: int = 3) -> None:
        super().__init__()
        w = width
        self.layers = nn.ModuleList([block(nn.Conv2d(inputs, w, 4, stride=2, padding=1)),
            block(nn.Conv2d(w, 2 * w, 4, stride=2, padding=1)),
            block(nn.Conv2d(2 * w, 4 * w, 4, stride=2, padding=1)),
            block(nn.Conv2d(4 * w, 8 * w, 3, padding=1)), nn.Conv2d(8 * w, 1, 3, padding=1)])

    def activations(self, image: Tensor, told: Tensor | None = None) -> list[Tensor]:
        """The output of each layer for display values N x 3 x R x R and channels ``told`` N x C x R x R.

        ``told`` is not rescaled. The last output is the logits of the patches.
        """
        x = pad_to_multiple(image * 2 - 1 if told is None else torch.cat((image * 2 - 1, told), dim=1), 16)
        found = []
        for layer in self.layers:
            x = layer(x)
            found.append(x)
        return found

    def learn(self, photos: Tensor, renderings: Tensor, optimizer: torch.optim.Optimizer, game: Game = "bce",
              told: Tensor | None = None) -> float:
        """One step of training. Returns the loss before the step; NaN if no step was made."""
        both = torch.cat((photos, renderings)), None if told is None else torch.cat((told, told))
        real, fake = self.activations(*both)[-1].chunk(2)
        loss = losses.discriminator(real, fake, game)
        return float(loss.detach()) + descend(loss, optimizer)


class AllPhotosGenerator(nn.Module):
    """Generator of hybrid, gan and detail: one encoder, two decoders with skips; the output changes a start.

    With ``change`` the last layers begin at zero, so that training begins at the start. ``inputs``: number of
    channels of the condition; ``width``: number of channels of the finest level.
    """

    def __init__(self, inputs: int, streams: Streams = STREAMS["roughconductor"], width: int = 16,
                 change: bool = True) -> None:
        super().__init__()
        self.streams = [stream for stream in streams if stream]
        widths = [width, 2 * width, 4 * width, 6 * width, 6 * width]
        self.down = nn.ModuleList([block(nn.Conv2d(inputs, width, 3, padding=1))] + [
            block(nn.Conv2d(a, b, 4, stride=2, padding=1)) for a, b in zip(widths, widths[1:])])
        self.up = nn.ModuleList(self._decoder(widths, sum(s.values())) for s in self.streams)
        if change:
            self.begin_change()

    def begin_change(self) -> None:
        """Set the last layers to zero, so that the output is no change."""
        for decoder in self.up:
            zero(list(decoder.children())[-1])

    def _decoder(self, widths: list[int], channels: int) -> nn.ModuleList:
        # The finest level only mixes channels (1 x 1): it has the most pixels, and its skip has already seen
        # the neighbouring pixels.
        layers = [block(nn.Conv2d(below + at, at, *((1,) if at == widths[0] else (3, 1, 1))))
                  for at, below in zip(widths[-2::-1], widths[:0:-1])]
        return nn.ModuleList([*layers, nn.Conv2d(widths[0], channels, 1)])

    def forward(self, condition: Tensor) -> dict[str, Tensor]:
        """The change before Tanh: map name to C x R x R. The condition is 1 x inputs x R x R."""
        size = condition.shape[-1]
        levels = [pad_to_multiple(condition, 16)]
        for layer in self.down:
            levels.append(layer(levels[-1]))
        out: dict[str, Tensor] = {}
        for decoder, stream in zip(self.up, self.streams):
            x, (*layers, last) = levels[-1], decoder.children()
            for layer, skip in zip(layers, levels[-2:0:-1]):
                x = layer(torch.cat((F.interpolate(x, scale_factor=2.0, mode="nearest"), skip), dim=1))
            maps = last(x)[0, :, :size, :size]
            out |= dict(zip(stream, maps.split(list(stream.values()))))
        return out


def zero(layer: nn.Module) -> None:
    """Set all weights of a layer to zero."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def pad_to_multiple(image: Tensor, factor: int) -> Tensor:
    """The image padded with its border to 2, 3, ... times ``factor``; instance norm needs at least 2."""
    bottom, right = (max(-(-side // factor), 2) * factor - side for side in image.shape[-2:])
    return F.pad(image, (0, right, 0, bottom), mode="replicate")


@contextlib.contextmanager
def frozen(module: nn.Module) -> Iterator[None]:
    """In this block gradients pass through the module, but none is computed for its weights."""
    module.requires_grad_(False)
    try:
        yield
    finally:
        module.requires_grad_(True)
