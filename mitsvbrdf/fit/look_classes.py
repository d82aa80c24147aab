"""Look classes: the texels of a material that repeats itself, found from one photo of it.

A stationary material has the same distribution of texels at each place (Aittala et al. 2015, 2016; Zhao et
al. 2020). The flash lights each place under another half angle, so all pixels together show the distribution
under all half angles of the photo. The distribution is a mixture of a few classes. A class has one specular
colour, diffuse colours and roughnesses around a mean, and normals around the flat one. The classes maximise
the marginal likelihood of the pixels: an average over all values that a pixel may have. A texel is then its
mean over classes, normals, roughnesses and colours, given its pixel (empirical Bayes; Robbins 1956).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..capture import Capture
from ..color import CLIPPED
from ..io.layout import Layout
from ..material.maps import SVBRDF
from ..views import Views, texel_positions
from .hierarchical.lobes import KINDS, METAL

CLASSES = 5  # if a photo needs fewer, some classes look alike
NOISE = 0.01  # of display values: 8 bits, and details that a few classes do not explain
TAIL = 0.15  # relative growth of a slope per squared deviation: slopes have longer tails than normal numbers
MODEL = 0.03  # error of the model of a lobe, as a share of the lobe
PARTS = Layout(diffuse=(CLASSES, 3), lightness=(CLASSES,), tint=(CLASSES,), specular=(CLASSES, 3),
               roughness=(CLASSES,), worn=(CLASSES,), relief=(CLASSES,), share=(CLASSES,), place=(3,),
               power=())
RANGES = {"lightness": (0.02, 1.0), "tint": (0.004, 0.2), "worn": (0.02, 0.6), "relief": (0.005, 1.0)}
BEGUN = {"lightness": 0.15, "tint": 0.02, "worn": 0.1}
# Standard deviations of priors: roughness from the mean of all classes; channels of specular from their mean;
# log of a relief (mean, deviation); place of the camera in patch sides and log of its height; log of power.
ROUGHNESS, TINT, RELIEF, PLACE, POWER = 0.15, 0.05, (-2.0, 1.0), 0.15, 0.7
SURE = 16.0  # weight of two log priors: place and power of the flash, and F0 (a dielectric's or any other)
BRIGHT, DARK = 1e-4, 1e-5  # least linear colour of a class, and of a texel
TINY = 1e-12  # least variance of a log; least radiance of white, in a channel without light
RINGS, EVEN = 8, 0.02  # rings of equal half angle; deviation of texels that is too small to be visible


class Pixels(NamedTuple):
    """M pixels of a photo."""

    at: Tensor  # places (x, y) of their texels on the patch, M x 2
    shown: Tensor  # linear radiance, M x 3
    noise: Tensor  # its standard deviation, M x 3
    clipped: Tensor  # True: the radiance of the channel may be higher, M x 3

    @staticmethod
    def of(capture: Capture) -> Pixels:
        """All pixels of the first photo."""
        photo = capture.photos[0].flatten(0, 1)
        level = photo.clamp(0.02, 1 - NOISE)
        above, below = (color.decode(level + by, capture.transfer) for by in (NOISE, -NOISE))
        return Pixels(texel_positions(capture.resolution)[..., :2].flatten(0, 1).float(),
                      capture.linear[0].flatten(0, 1), (above - below) / 2, photo >= CLIPPED)

    def pick(self, index: Tensor) -> Pixels:
        """The pixels with these indices."""
        return Pixels(*(part[index] for part in self))


class Posterior(NamedTuple):
    """For M pixels, K classes and J nodes (sample points): log likelihood, and values of the texel."""

    likely: Tensor  # M x K x J
    slopes: Tensor  # n_x / n_z and n_y / n_z of the normals, M x K x J x 2
    roughness: Tensor  # M x K x J
    diffuse: Tensor  # mean of the diffuse colour, linear, M x K x J x 3


class LookClasses:
    """K look classes, made of the unbounded numbers of :data:`PARTS`; each value is in its range.

    ``lightness`` is the relative deviation of diffuse colours along their mean. Further deviations: ``tint``
    of each channel in linear^(1/2.2), ``worn`` of the log of roughness, ``relief`` of a normal's slopes.
    ``place`` and ``power`` are changes of the capture's view; 0 if they are held fixed.
    """

    def __init__(self, numbers: Tensor, views: Views, held: bool, power_held: bool = False) -> None:
        part = PARTS.unpack(numbers)
        self.diffuse, self.specular = (color.decode(torch.sigmoid(value)) for value in (part.diffuse,
                                                                                      part.specular))
        self.roughness = 0.05 + 0.95 * torch.sigmoid(part.roughness)
        self.lightness, self.tint, self.worn, self.relief = (
            getattr(part, name).exp().clamp(low, high) for name, (low, high) in RANGES.items())
        self.share = torch.log_softmax(part.share, dim=-1)
        self.views = views.in_patch_sides().to(torch.float32)
        self.place: Tensor = torch.zeros(3) if held else part.place
        self.power: Tensor = torch.zeros(()) if held or power_held else part.power
        self.moved = torch.cat((self.place[:2], self.views.camera[0, 2:] * self.place[2:].expm1()))

    @staticmethod
    def start(looks: Tensor, roughness: float, f0: float, relief: Sequence[float]) -> Tensor:
        """Numbers of K classes with these diffuse colours (linear^(1/2.2), K x 3) and one common lobe."""
        level, width = f0 ** (1 / 2.2), (roughness - 0.05) / 0.95
        return torch.from_numpy(PARTS.pack(
            diffuse=torch.logit(looks.clamp(0.02, 0.97)).numpy(), specular=math.log(level / (1 - level)),
            roughness=math.log(width / (1 - width)),
            relief=np.log(relief), **{name: math.log(value) for name, value in BEGUN.items()})).float()

    def lit(self, at: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes of half vectors, M x 2, and radiance of white texels that face the half vectors, M x 3."""
        texel = torch.cat((at, torch.zeros_like(at[:, :1])), dim=1)
        light, camera = (place[0] + self.moved - texel for place in (self.views.light, self.views.camera))
        reach = light.square().sum(dim=1, keepdim=True) if self.views.falloff == "inverse-square" else (
            self.views.light.square().sum())
        half = F.normalize(F.normalize(light, dim=1) + F.normalize(camera, dim=1), dim=1)
        white = self.views.intensity * self.power.exp() * F.normalize(light, dim=1)[:, 2:] / reach
        return half[:, :2] / half[:, 2:], (white / half[:, 2:] / math.pi).clamp_min(TINY)

    def posterior(self, pixels: Pixels, nodes: Tensor) -> Posterior:
        """The posterior of M pixels at nodes M x J x 3: standard normal numbers of slopes and log roughness.

        A narrow lobe explains a pixel by slopes on a thin ring around the half vector. Few nodes are on that
        ring, so a node represents its surroundings, in which the lobe is linear in these numbers.
        """
        q, white = self.lit(pixels.at)
        q, noise = q[:, None, None], (pixels.noise / white)[:, None, None]
        wide = nodes.shape[1] ** (-1 / 3)  # standard deviations
        nodes = nodes * math.sqrt(1 - wide**2)  # with surroundings, variance 1 as before
        tail = 1 + TAIL * nodes[..., :2].square().sum(dim=-1)[:, None]
        slopes = (nodes[:, None, :, :2] * tail[..., None]) * self.relief[None, :, None, None]
        worn = (nodes[:, None, :, 2] * self.worn[:, None]).exp()
        roughness = (self.roughness[:, None] * worn).clamp(0.05, 1)
        length = (1 + slopes.square().sum(-1)) * (1 + q.square().sum(-1))
        cosine = ((1 + (slopes * q).sum(-1)) / length.sqrt()).clamp_min(1e-3)
        sine2 = ((slopes - q).square().sum(-1)
                 + (slopes[..., 0] * q[..., 1] - slopes[..., 1] * q[..., 0]) ** 2) / length
        alpha2 = roughness**4
        broad = alpha2 * cosine**2 + sine2
        lobe = alpha2 * cosine / (broad * (cosine + (alpha2 + (1 - alpha2) * cosine**2).sqrt())) ** 2
        # variance of the log of the lobe around a node: of slopes, and of roughness
        slope2 = 16 * sine2 / length * (wide * tail * self.relief[:, None] / broad) ** 2
        rough2 = 16 * (wide * self.worn[:, None] * (1 - 2 * alpha2 * cosine**2 / broad)) ** 2
        cosine, mean = cosine[..., None], self.diffuse[:, None]
        glossy = lobe[..., None] * self.specular[:, None]
        off = (pixels.shown / white)[:, None, None] - cosine * mean - glossy
        off = torch.where(pixels.clipped[:, None, None] & (off < 0), 0.0, off)
        tint = (2.2 * self.tint[:, None, None] * mean.clamp_min(BRIGHT) ** (1.2 / 2.2)) ** 2
        # detached: otherwise a model of exact photos would shrink its lobe to shrink this noise
        own = cosine**2 * tint + noise**2 + (MODEL * glossy.detach()) ** 2
        # two further normal numbers, of lightness and of the lobe, are integrated out
        light, shine = (cosine * self.lightness[:, None, None] * mean,
                        glossy * (slope2 + rough2 + TINY).sqrt()[..., None])
        pull, push = ((by * off / own).sum(-1) for by in (light, shine))
        one, two = (1 + (by**2 / own).sum(-1) for by in (light, shine))
        both = (light * shine / own).sum(-1)
        worth = one * two - both**2
        lighter, shinier = (two * pull - both * push) / worth, (one * push - both * pull) / worth
        chi2 = (off**2 / own).sum(-1) - pull * lighter - push * shinier
        likely = (-(chi2 + own.log().sum(-1) + worth.log()) / 2 + self.share[:, None]
                  - white.log().sum(-1)[:, None, None])  # density of the radiance, not of its ratio to white
        left = off - light * lighter[..., None] - shine * shinier[..., None]
        gain = self.lightness[:, None, None] * mean * lighter[..., None] + cosine * tint * left / own
        return Posterior(likely - math.log(nodes.shape[1]), slopes, roughness, (mean + gain).clamp(0, 1))

    def prior(self) -> Tensor:
        """Log of the prior probability of the numbers."""
        encoded = color.encode(self.specular.clamp_min(BRIGHT))
        level, (mean, spread, tint, share) = encoded.mean(dim=1), KINDS[0]
        colour = (encoded - level[:, None]).square().sum(dim=1) / 2
        usual = (math.log(share / spread / math.sqrt(2 * math.pi) * (TINT / tint) ** 2)
                 - ((level - mean) / spread) ** 2 / 2 - colour / tint**2)
        between = ((METAL - level).clamp_min(0) / KINDS[1][1]) ** 2 / 2  # few materials have such an F0
        specular = SURE * torch.logaddexp(usual, math.log(1 - share) - colour / TINT**2 - between)
        apart = (self.roughness - (self.share.exp() * self.roughness).sum()) / ROUGHNESS
        rough = (self.relief.log() - RELIEF[0]) / RELIEF[1]
        each = specular - apart**2 / 2 - rough**2 / 2
        return each.sum() - SURE * ((self.place / PLACE).square().sum() + (self.power / POWER) ** 2) / 2

    @staticmethod
    def texels(found: Posterior, specular: Tensor) -> Tensor:
        """Means of texels: diffuse and specular as linear^(1/2.2), roughness, unit normals; M x 10."""
        weight = torch.softmax(found.likely.flatten(1), dim=1).reshape(found.likely.shape)
        normal = F.normalize(F.pad(found.slopes, (0, 1), value=1.0), dim=-1)
        each, diffuse = weight[..., None], color.encode(found.diffuse.clamp_min(DARK))
        return torch.cat(((each * diffuse).sum((1, 2)),
                          weight.sum(dim=2) @ color.encode(specular), (weight * found.roughness).sum(
                              (1, 2))[:, None], (each * normal).sum((1, 2))), dim=1)

    @staticmethod
    def lost(found: Posterior) -> Tensor:
        """Posterior variance of each texel's slopes, which its mean lacks; averaged over both axes, M."""
        weight = torch.softmax(found.likely.flatten(1), dim=1).reshape(found.likely.shape)[..., None]
        mean = (weight * found.slopes).sum((1, 2))
        return ((weight * found.slopes**2).sum((1, 2)) - mean**2).mean(dim=1)

    def uneven(self, found: Posterior, at: Tensor) -> tuple[Tensor, Tensor]:
        """How much texels differ between rings of equal half angle; how much they do so by chance if the
        material is stationary.

        Each is the variance of the rings' means / the variance of texels, summed over a texel's numbers.
        """
        texels = self.texels(found, self.specular)
        rings = texels[self.lit(at)[0].norm(dim=1).argsort()].tensor_split(RINGS)
        between, variance = torch.stack([ring.mean(dim=0) for ring in rings]).var(dim=0), texels.var(dim=0)
        own = variance + EVEN**2
        return (between / own).sum(), (variance / own).sum() * RINGS / len(at)


def material(texels: Tensor, lost: Tensor, side: int) -> SVBRDF:
    """The material of texels M x 10 (means); its lobes are widened by the variance ``lost`` of slopes, M.

    Source: Toksvig 2005, "Mipmapping Normal Maps".
    """
    planes = torch.cat((texels[:, :7].clamp(0, 1), texels[:, 7:]), dim=1).reshape(side, side, -1)
    roughness = (planes[..., 6:7] ** 4 + 2 * lost.reshape(side, side, 1)) ** 0.25
    return SVBRDF("roughconductor", {
        "diffuse": color.decode(planes[..., :3]), "specular": color.decode(planes[..., 3:6]),
        "roughness": roughness.clamp(0, 1), "normal": F.normalize(planes[..., 7:], dim=-1)})
