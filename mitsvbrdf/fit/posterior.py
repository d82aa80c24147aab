"""The numbers that each texel may have, given the photos: mixtures of normal distributions.

Roughness moves both ways, in growing steps, from the numbers that explain a texel's own photos best. At each
step the solver finds the other numbers again. The steps follow the valley where specular and roughness trade
off (a tail of GGX shows only F0 alpha^2). At a step, the other numbers are normally distributed
(Gauss-Newton). The step has weight exp(-chi^2 / 2): a profile likelihood needs no prior. At a clipped value,
only a rendering that is too dark counts. Noise: errors of equally bright pixels, scaled to the texel's.

If the fit uses look-alikes, they give each basis material a mean and a deviation of its shared numbers
(expectation-maximisation). These are only as certain as from one texel per photo, because texels under one
light have similar errors. For a share of the texels, the strangers, only their own photos count.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..color import QUANTIZATION_NOISE
from ..material.maps import COLOURS, SVBRDF
from ..render import Renderer
from .hierarchical.relief import STEEPEST
from .hierarchical.solver import Observations, TexelSolver
from .parameters import ROUGHNESS_RANGE

GRID = 64  # most texels a side whose mixture is found
FLAT = 1 / 12  # variance of a number known only to be between 0 and 1
NODES = 8  # steps of roughness each way, to its bound
BOUNDS = {"roughness": ROUGHNESS_RANGE, "normal": (-STEEPEST, STEEPEST)}  # else 0 to 1
WEAK, FIXED = 1e-3, 1e12  # precisions of numbers that are free, and of a roughness that is held
LIFTED = 0.05  # darker colours get the derivatives of this one: linear^(1/2.2) is steep at 0
BRIGHTNESSES = 12  # groups of equally many pixels, by brightness; each has its own noise
LEAST_FREE = 0.05  # least share of a texel's values that counts for the noise, after its unknowns
CONTRADICTED = 2.0  # distance of an answer that look-alikes contradict, in their deviations
ROUNDS, COMMON = 10, 20.0  # of expectation-maximisation; number of texels that the common deviation is worth


def step_of(side: int, most: int = GRID) -> int:
    """The smallest k for which every k-th of ``side`` texels gives ``most`` texels or fewer."""
    return math.ceil(side / most)


class Mixture(NamedTuple):
    """M texels of J components each: U numbers x (M x J x U), covariance M x J x U x U, weight M x J."""

    x: Tensor
    covariance: Tensor
    weight: Tensor


class BrightnessNoise(NamedTuple):
    """Variance of display values for each group of brightness; ``steps``: limits between the groups."""

    steps: Tensor
    variance: Tensor

    def weights(self, photos: Tensor, measured: Tensor | None) -> Tensor:
        """1 / variance of pixels, N x R x R, 0 where they are not measured."""
        found = (1 / self.variance)[torch.bucketize(color.shown(photos).mean(dim=-1), self.steps)]
        return (found if measured is None else measured * found).contiguous()


def lifted(x: Tensor, names: list[str]) -> Tensor:
    """The numbers (U x ...) at which derivatives are taken: colours are at least :data:`LIFTED`."""
    return torch.stack([plane.clamp_min(LIFTED) if name in COLOURS else plane
                        for name, plane in zip(names, x)])


def vague(names: list[str]) -> Tensor:
    """Precision, U, of numbers that are known only to be in their range."""
    return torch.tensor([(0.25 if name == "normal" else 1) / FLAT for name in names])


def refused(missed: Tensor, values: Tensor) -> Tensor:
    """Whether photos contradict an answer with chi^2 ``missed`` over this number of ``values``."""
    return missed > values + 5 * (2 * values).sqrt()


class OwnPhotos:
    """The photos of R x R texels in fitted views, and what they determine. ``known``: the fit's answer."""

    def __init__(self, known: SVBRDF, capture: Capture, renderer: Renderer, fixed: dict[str, Tensor],
                 grey_specular: bool) -> None:
        self.capture, self.renderer, grey = capture, renderer, grey_specular and "specular" not in fixed
        self.solver = TexelSolver(known.bsdf, fixed, grey, renderer.variant or "llvm_ad_rgb")
        self.names = self.solver.unknowns.names
        self.low, self.high = torch.tensor([BOUNDS.get(name, (0.0, 1.0)) for name in self.names]).T
        self.answer = self.solver.numbers(known).clamp(self.low[:, None, None], self.high[:, None, None])
        self.values = capture.usable.sum(dim=(0, 3)).float()
        self.photos = Observations(capture.photos, capture.views, capture.transfer, 1.0)
        self.best, unknowns = self.answer, len(self.names)
        for _ in range(3):  # the first noise comes from the errors of the answer
            self.noise = self._noise(self.best)
            self.photos = replace(self.photos, weights=self.noise.weights(capture.photos, capture.measured))
            self.best, self.least = self._solved(self.best, 10)
        self.noise2 = ((self.least + unknowns) / self.values.clamp_min(unknowns)).double().flatten()
        self.refused = refused(self._solved(self.answer, 0)[1], self.values)

    def _solved(self, x: Tensor, steps: int, held: int | None = None) -> tuple[Tensor, Tensor]:
        """The numbers after some steps, U x R x R, with number ``held`` fixed, and chi^2, R x R."""
        x = x.contiguous()
        precision = torch.full_like(x, WEAK)
        if held is not None:
            precision[held] = FIXED
        found = self.solver.solve(self.photos, x, torch.full_like(x[0], 0.01), x, precision, self.low,
                                  self.high, steps)
        return found.x, found.data

    def _noise(self, x: Tensor) -> BrightnessNoise:
        """The variance of the errors of equally bright pixels at the numbers ``x``."""
        capture = self.capture
        with torch.no_grad():
            images = self.renderer.render(self.solver.svbrdf(x), capture.views).to(x.dtype)
        error = color.encode(images, capture.transfer) - capture.photos
        free = (1 - len(self.names) / self.values.clamp_min(1)).clamp_min(LEAST_FREE)
        level = capture.photos.mean(dim=-1)
        parts = torch.linspace(0, 1, BRIGHTNESSES + 1)[1:-1]
        shown = level if capture.measured is None else level[capture.measured]
        steps = shown.flatten().quantile(parts) if shown.numel() else parts
        of = torch.bucketize(level, steps).flatten()
        square, count = (torch.zeros(BRIGHTNESSES).index_add_(0, of, value.sum(dim=-1).flatten())
                         for value in (capture.usable * error.square(), capture.usable * free[..., None]))
        return BrightnessNoise(steps, (square / count.clamp_min(1)).clamp_min(QUANTIZATION_NOISE**2))

    def _curvature(self, x: Tensor) -> Tensor:
        """The inverse covariance of texels' numbers, M x U x U, float64."""
        curve = self.solver.normal_equations(self.photos, lifted(x, self.names))[2].flatten(2).movedim(2, 0)
        return curve.double() / self.noise2[:, None, None] + torch.diag(vague(self.names).double())

    def mixture(self) -> Mixture:
        """The distribution of each texel's numbers, given its own photos."""
        free = torch.linalg.inv(self._curvature(self.best))
        if "roughness" not in self.names:
            return Mixture(self.best.flatten(1).T[:, None], free.float()[:, None], torch.ones(len(free), 1))
        lobe = self.names.index("roughness")
        deviation = free[:, lobe, lobe].clamp(1e-8, FLAT).sqrt().float().reshape(self.values.shape)
        chain = [(self.best, self.least)]
        for sign, end in ((-1, self.low[lobe]), (1, self.high[lobe])):
            x, reach = self.best, (end - self.best[lobe]).abs().clamp_min(1e-4)
            first = torch.minimum(deviation / 2, reach / NODES)
            for node in range(NODES):
                moved = (self.best[lobe] + sign * first * (reach / first) ** (node / (NODES - 1))
                         ).clamp(self.low[lobe], self.high[lobe])
                x, chi2 = self._solved(x.index_copy(0, torch.tensor([lobe]), moved[None]), 6, lobe)
                chain.insert(0 if sign < 0 else len(chain), (x, chi2))
        x = torch.stack([numbers.flatten(1).T for numbers, _ in chain], dim=1)
        chi2 = torch.stack([each.flatten() for _, each in chain], dim=1) / self.noise2[:, None].float()
        rest = torch.tensor([i for i in range(len(self.names)) if i != lobe], dtype=torch.long)
        covariance = _along(x, lobe)
        for node, (numbers, _) in enumerate(chain):
            covariance[:, node, rest[:, None], rest] += torch.linalg.inv(
                self._curvature(numbers)[:, rest[:, None], rest]).float()
        return Mixture(x, covariance, masses(x[..., lobe], -chi2 / 2))


def _along(x: Tensor, lobe: int) -> Tensor:
    """The covariance of the piece of valley that each node stands for, M x J x U x U."""
    moved = x.diff(dim=1)
    wide = moved[..., lobe].clamp_min(1e-6)
    slope = (moved / wide[..., None]).clamp(-20, 20)
    slope = (torch.cat((slope[:, :1], slope), dim=1) + torch.cat((slope, slope[:, -1:]), dim=1)) / 2
    slope[..., lobe] = 1
    square = torch.cat((wide[:, :1], wide), dim=1) * torch.cat((wide, wide[:, -1:]), dim=1) / 6
    return square[..., None, None] * slope[..., :, None] * slope[..., None, :]


def masses(places: Tensor, log_density: Tensor) -> Tensor:
    """Probabilities of nodes, M x J, rows of sum 1. ``places`` rise; log density is linear between nodes."""
    logs = (log_density - log_density.amax(dim=1, keepdim=True)).double()
    rise = logs.diff(dim=1)
    fall = rise.abs().clamp_min(1e-4)  # whole, far: integrals of exp(-fall t), t exp(-fall t), 0 to 1
    whole, far = -torch.expm1(-fall) / fall, (1 - (1 + fall) * torch.exp(-fall)) / fall**2
    scale = places.diff(dim=1).clamp_min(0) * torch.maximum(logs[:, 1:], logs[:, :-1]).exp()
    right = scale * torch.where(rise > 0, whole - far, far)
    found = torch.nn.functional.pad(right, (1, 0)) + torch.nn.functional.pad(scale * whole - right, (0, 1))
    return (found / found.sum(dim=1, keepdim=True)).float()


def with_look_alikes(own: Mixture, of: Tensor, member: Tensor, photos: int, answer: Tensor) -> Mixture:
    """The distribution of texels' numbers, given own photos and look-alikes, which share the numbers ``of``.

    ``member``: shares of K basis materials in the texels, M x K. ``photos``: their number. If look-alikes
    contradict a texel's ``answer``, M x U, it does not come from them: only the texel's own photos count.
    """
    x, weight = own.x[..., of], own.weight.clamp_min(1e-30).log()
    variance = own.covariance.diagonal(dim1=2, dim2=3)[..., of].clamp_min(1e-10)
    centre = (own.weight[..., None] * x).sum(dim=1)
    width = (own.weight[..., None] * (variance + (x - centre[:, None]).square())).sum(dim=1).clamp_max(FLAT)
    told = (1 - width / FLAT).square()
    mean = ((told * centre).T @ member + WEAK / 2) / (told.T @ member + WEAK)  # S x K
    tau2, strange = torch.full_like(mean, FLAT), torch.full_like(mean[0], 0.1)

    def prior(spread: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Shares of basis materials (M x K, by look and photos); their mean, variance, share of strangers."""
        whole = width[:, :, None] + spread
        part = torch.softmax(member.clamp_min(1e-30).log() - ((centre[:, :, None] - mean).square() / whole
                                           + whole.log()).sum(dim=1) / 2, dim=1)
        level = part @ mean.T
        return (part, level, (part @ (spread + mean.square()).T - level.square()).clamp_min(1e-8),
                part @ strange)

    for _ in range(ROUNDS):
        part, level, spread, share = prior(tau2)
        total = variance + spread[:, None]
        logs = weight - ((x - level[:, None]).square() / total + (2 * math.pi * total).log()).sum(dim=-1) / 2
        familiar = torch.sigmoid(logs.logsumexp(dim=1) + ((1 - share) / share).log())
        gain, likely = spread[:, None] / total, logs.softmax(dim=1)[..., None]
        each = level[:, None] + gain * (x - level[:, None])
        found = (likely * each).sum(dim=1)
        unsure = (likely * (spread[:, None] * (1 - gain) + (each - found[:, None]).square())).sum(dim=1)
        tells = (1 - unsure / spread).clamp(0, 1)
        told = tells * familiar[:, None]
        count = told.T @ part
        moment = (told * found).T @ part
        mean = (moment + 0.01 * mean) / (count + 0.01)
        square = (told * (found.square() + unsure)).T @ part + mean * (mean * count - 2 * moment)
        common = ((square.sum(dim=1) + 0.01 * FLAT) / (count.sum(dim=1) + 0.01))[:, None]
        tau2 = ((square + COMMON * common) / (count + COMMON)).clamp_min(1e-8)
        asked = tells.mean(dim=1)
        strange = ((((1 - familiar) * asked) @ part + 1) / (asked @ part + 10)).clamp(1e-3, 0.9)
    alike = (photos / part.sum(dim=0).clamp_min(1)).clamp_max(1)
    _, level, spread, share = prior(tau2 + 1 / (1 / FLAT + count / tau2 * alike))
    contradicted = ((answer[:, of] - level).square() > CONTRADICTED**2 * spread).any(dim=1)
    return _given(own, of, level, spread, torch.where(contradicted, 1 - 1e-6, share))


def _given(own: Mixture, of: Tensor, level: Tensor, spread: Tensor, share: Tensor) -> Mixture:
    """Texels whose numbers ``of`` are normal around ``level``, except a ``share`` that stays as it was."""
    whole = own.covariance[..., of[:, None], of] + spread.diag_embed()[:, None]
    gain = own.covariance[..., of] @ torch.linalg.inv(whole)
    off = level[:, None] - own.x[..., of]
    pull = torch.linalg.solve(whole, off[..., None])[..., 0]
    logs = own.weight.clamp_min(1e-30).log() - ((pull * off).sum(dim=-1) + torch.linalg.slogdet(whole)[1]
                                                + len(of) * math.log(2 * math.pi)) / 2
    familiar = torch.sigmoid(logs.logsumexp(dim=1) + ((1 - share) / share).log())[:, None]
    return Mixture(torch.cat((own.x + (gain @ off[..., None])[..., 0], own.x), dim=1),
                   torch.cat((own.covariance - gain @ own.covariance[..., of, :], own.covariance), dim=1),
                   torch.cat((logs.softmax(dim=1) * familiar, own.weight * (1 - familiar)), dim=1))


def half_width(mixture: Mixture, answer: Tensor, names: list[str], inside: float) -> Tensor:
    """The distance from the answer (M x U), 1e-4 to 1, within which numbers lie with probability ``inside``.

    Colours are normal in linear light. All numbers but slopes are within 0 and 1.
    """
    coloured = torch.tensor([name in COLOURS for name in names])
    slopes = torch.tensor([name == "normal" for name in names])

    def linear(number: Tensor) -> Tensor:
        return torch.where(slopes, number, torch.where(coloured, color.decode(number.clamp(0, 1)),
                                                       number.clamp(0, 1)))

    slope = torch.where(coloured, 2.2 * mixture.x.clamp(LIFTED, 1) ** 1.2, 1.0)
    sharp = (0.5**0.5) / (mixture.covariance.diagonal(dim1=2, dim2=3).clamp_min(1e-10).sqrt() * slope)
    centre = linear(mixture.x)
    most = torch.where(slopes, 1.0, torch.erf((1 - centre) * sharp))
    least = torch.where(slopes, -1.0, torch.erf(-centre * sharp))
    weight = mixture.weight[..., None] / (most - least).clamp_min(1e-6)
    low, high = torch.full_like(answer, math.log(1e-4)), torch.zeros_like(answer)
    for _ in range(12):
        middle = (low + high) / 2
        above, below = (torch.erf((linear(answer + side * middle.exp())[:, None] - centre) * sharp)
                        for side in (1, -1))
        more = (weight * (above.minimum(most) - below.maximum(least)).clamp_min(0)).sum(dim=1) < inside
        low, high = torch.where(more, middle, low), torch.where(more, high, middle)
    return ((low + high) / 2).exp()
