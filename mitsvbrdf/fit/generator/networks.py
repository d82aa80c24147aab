"""The networks: the paper's two-stream generator and patch discriminator, and the all-photos generator."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .. import losses
from ..method import descend
from ..parameters import STREAMS, Streams


@contextlib.contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Weights drawn in this block depend on the seed alone, and torch's own random numbers are left as they were."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def _block(layer: nn.Conv2d | nn.ConvTranspose2d, normalise: bool = True) -> nn.Sequential:
    # Group norm with one channel a group is instance norm; torch computes it several times faster on a CPU.
    norm = [nn.GroupNorm(layer.out_channels, layer.out_channels)] if normalise else []
    return nn.Sequential(layer, *norm, nn.LeakyReLU(0.2, inplace=True))


class TwoStreamGenerator(nn.Module):
    """The paper's generator (III.D): one encoder, two decoders, so that normals are not mistaken for diffuse features.

    Encoder: 5 convolutions (three of them halve the size). Decoder ``normal_roughness``: 1 convolution and 3
    deconvolutions; decoder ``diffuse_specular``: 3 deconvolutions. All but the last are followed by instance norm and
    leaky ReLU; the last by Tanh. Ours: three specular channels (the paper names its one channel a fault).

    Args:
        streams: which maps come out of which decoder, with how many channels; one without maps is not built.
        width: channels of the first convolution (64 in full size).
    """

    def __init__(self, streams: Streams = STREAMS["roughconductor"], width: int = 64) -> None:
        super().__init__()
        w = width
        self.streams = streams
        self.encoder = nn.Sequential(
            _block(nn.Conv2d(3, w, 7, padding=3, padding_mode="reflect")),
            _block(nn.Conv2d(w, 2 * w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(2 * w, 4 * w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(4 * w, 8 * w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(8 * w, 8 * w, 3, padding=1)))
        first, second = (sum(s.values()) for s in self.streams)
        self.normal_roughness = nn.Sequential(
            _block(nn.Conv2d(8 * w, 8 * w, 3, padding=1)), *self._upward(w, first)) if first else None
        self.diffuse_specular = nn.Sequential(*self._upward(w, second)) if second else None

    @staticmethod
    def _upward(w: int, channels: int) -> list[nn.Module]:
        return [_block(nn.ConvTranspose2d(8 * w, 4 * w, 4, stride=2, padding=1)),
                _block(nn.ConvTranspose2d(4 * w, 2 * w, 4, stride=2, padding=1)),
                nn.ConvTranspose2d(2 * w, channels, 4, stride=2, padding=1), nn.Tanh()]

    def forward(self, photo: Tensor) -> dict[str, Tensor]:
        """Maps in (-1, 1) by name, each C x R x R, of a photo 1 x 3 x R x R in display values."""
        code, size = self.encode(photo), photo.shape[-1]
        return self.decode(0, code, size) | self.decode(1, code, size)

    def encode(self, photo: Tensor) -> Tensor:
        """The features both decoders start from."""
        return self.encoder(pad_to_multiple(photo * 2 - 1, 8))

    def decode(self, stream: int, code: Tensor, size: int) -> dict[str, Tensor]:
        """The maps of one stream (0: normal and roughness, 1: diffuse and specular), cut to ``size``."""
        decoder = (self.normal_roughness, self.diffuse_specular)[stream]
        if decoder is None:
            return {}
        maps = decoder(code)[0, :, :size, :size]
        return dict(zip(self.streams[stream], maps.split(list(self.streams[stream].values()))))


class PatchDiscriminator(nn.Module):
    """The paper's discriminator (III.D): 5 convolutions, the first four with instance norm and leaky ReLU, then Sigmoid.

    Returns the probability of being a photo for each patch, N x 1 x r x r, for images N x 3 x R x R in display values.
    """

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        w = width
        self.layers = nn.Sequential(
            _block(nn.Conv2d(3, w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(w, 2 * w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(2 * w, 4 * w, 4, stride=2, padding=1)),
            _block(nn.Conv2d(4 * w, 8 * w, 3, padding=1)),
            nn.Conv2d(8 * w, 1, 3, padding=1), nn.Sigmoid())

    def forward(self, image: Tensor) -> Tensor:
        """The probabilities of an image's patches."""
        return self.layers(pad_to_multiple(image * 2 - 1, 16))

    def learn(self, photos: Tensor, renderings: Tensor, optimizer: torch.optim.Optimizer) -> float:
        """One step towards telling photos from renderings; returns the loss before it, NaN where no step was made."""
        loss = losses.discriminator(self(photos), self(renderings))
        return float(loss.detach()) + descend(loss, optimizer)


class AllPhotosGenerator(nn.Module):
    """The hybrid's generator: an encoder over all photos at once, two decoders with skips, a change to a start out.

    The maps are ``start + change`` in raw numbers (:mod:`.parameters`); the last layers begin at zero, so training
    begins at the start.

    Args:
        inputs: channels of the conditioning image.
        streams: which maps come out of which decoder, with how many channels; one without maps is not built.
        width: channels of the finest level.
        normalise: instance norm, which helps a network that learns from one material alone. Without it levels get through,
            and what comes out of a crop does not depend on what lies around it further than the network sees.
    """

    def __init__(self, inputs: int, streams: Streams = STREAMS["roughconductor"], width: int = 16,
                 normalise: bool = True) -> None:
        super().__init__()
        self.normalise = normalise
        self.streams = [stream for stream in streams if stream]
        widths = [width, 2 * width, 4 * width, 6 * width, 6 * width]
        self.down = nn.ModuleList([_block(nn.Conv2d(inputs, width, 3, padding=1), normalise)] + [
            _block(nn.Conv2d(a, b, 4, stride=2, padding=1), normalise) for a, b in zip(widths, widths[1:])])
        self.up = nn.ModuleList(self._decoder(widths, sum(s.values())) for s in self.streams)

    def _decoder(self, widths: list[int], channels: int) -> nn.ModuleList:
        # The finest level only mixes channels (1 x 1): it has the most pixels, and its neighbours are in the skip already.
        layers = [_block(nn.Conv2d(below + at, at, *((1,) if at == widths[0] else (3, 1, 1))), self.normalise)
                  for at, below in zip(widths[-2::-1], widths[:0:-1])]
        last = nn.Conv2d(widths[0], channels, 1)
        for parameter in last.parameters():
            nn.init.zeros_(parameter)
        return nn.ModuleList([*layers, last])

    def forward(self, condition: Tensor) -> dict[str, Tensor]:
        """Changes by name, each C x R x R, for a conditioning image 1 x inputs x R x R."""
        return {name: change[0] for name, change in self.changes(condition).items()}

    def changes(self, conditions: Tensor) -> dict[str, Tensor]:
        """Changes by name, each N x C x R x R, for conditioning images N x inputs x R x R."""
        size = conditions.shape[-1]
        levels = [pad_to_multiple(conditions, 16)]
        for layer in self.down:
            levels.append(layer(levels[-1]))
        out: dict[str, Tensor] = {}
        for decoder, stream in zip(self.up, self.streams):
            x, (*layers, last) = levels[-1], decoder.children()
            for layer, skip in zip(layers, levels[-2:0:-1]):
                x = layer(torch.cat((F.interpolate(x, scale_factor=2.0, mode="nearest"), skip), dim=1))
            maps = last(x)[:, :, :size, :size]
            out |= dict(zip(stream, maps.split(list(stream.values()), dim=1)))
        return out


def pad_to_multiple(image: Tensor, factor: int) -> Tensor:
    """The image grown at the bottom and right, by repeating its border, to a multiple of ``factor``, at least twice it
    (instance norm needs more than one value a channel at the coarsest level).
    """
    bottom, right = (max(-(-side // factor), 2) * factor - side for side in image.shape[-2:])
    return F.pad(image, (0, right, 0, bottom), mode="replicate")
