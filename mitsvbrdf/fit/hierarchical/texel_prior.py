"""What is assumed of texels before their photos are used: bounds, a prior, and ties to other texels."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import NamedTuple

import torch
from torch import Tensor

from ...material.resample import enlarged
from ..config import HierarchicalConfig
from ..parameters import ROUGHNESS_RANGE
from .scales import Scale
from .sharing import LEAST_SPREAD, NOBODY, shared
from .unknowns import Unknowns

SHARED = ("specular", "metallic", "roughness")
BOUNDS = {"roughness": ROUGHNESS_RANGE, "normal": (-3.0, 3.0), "specular": (0.05, 1.0)}  # else 0 to 1
# Standard deviations of the first prior; that of the diffuse map never changes.
VAGUE = {"diffuse": 0.5, "base_color": 0.5, "specular": 0.1, "metallic": 0.3, "roughness": 0.1, "normal": 0.1}
KEPT = 2**20  # largest number of texels whose shares of basis materials are kept in memory
LEAST_PRECISION = 1e-3  # added to the precision of the prior when variances are computed
FIXED = 1e-4  # standard deviation of a number that must not move
# How far a texel may leave its tied answer at full size, in units of config.detail_spread: standard
# deviations at first and at least.
FREEDOM = {"normal": (0.5, 0.17), "roughness": (0.5, 0.5), "specular": (1.0, 1.0), "metallic": (1.0, 1.0)}
FREEST = 2.5  # the same, at most


class TexelEstimate(NamedTuple):
    """The present estimate of the texels, and the prior that led to it.

    Args:
        x: the unknowns, U x R x R.
        mean: of the prior, U x R x R; with lobes, index of the diffuse mean, 1 x R x R, 16 bits.
        precision: of the prior, U x R x R; with lobes, only that of slopes, 1 x R x R.
        spread: standard deviation of the shared unknowns around those of look-alikes, S.
        lobe: number of each texel's shared lobe, R x R, 8 bits; empty without lobes.
    """

    x: Tensor
    mean: Tensor
    precision: Tensor
    spread: Tensor
    lobe: Tensor = torch.empty(0, dtype=torch.uint8)

    @property
    def _changed(self) -> tuple[str, ...]:
        """Names of the planes that are written texel by texel; with lobes also those of the prior."""
        return ("x", "mean", "precision", "lobe") if len(self.lobe) else ("x",)

    def where(self, better: Tensor, other: TexelEstimate) -> TexelEstimate:
        """This estimate, with the texels of ``other`` where ``better``, R x R."""
        return self._replace(**{name: torch.where(better, getattr(other, name), getattr(self, name))
                                for name in self._changed})

    def rows(self, rows: slice, down: int = 0, right: int = 0) -> TexelEstimate:
        """Some rows of texels, each replaced by its neighbour ``down`` above and ``right`` to the left.

        With lobes, the neighbour's prior is taken, too.
        """
        at = (torch.arange(rows.start, rows.stop) - down) % self.x.shape[1]

        def taken(name: str) -> Tensor:
            planes = getattr(self, name)
            if name not in self._changed or not (down or right):
                return planes[..., rows, :] if planes.dim() > 1 else planes
            return planes[..., at, :].roll(right, -1)

        return self._replace(**{name: taken(name) for name in ("x", "mean", "precision", "lobe")})

    def once(self) -> Tensor:
        """The precision of the prior; U x 1 x 1 if it is kept once for all texels."""
        return self.precision[:, :1, :1] if self.precision.stride(-1) == 0 else self.precision

    def put(self, rows: slice, part: TexelEstimate) -> None:
        """Write texels of some rows into these planes; with lobes, also their prior."""
        for name in self._changed:
            getattr(self, name)[..., rows, :] = getattr(part, name)

    def of_texels(self, texels: Tensor) -> TexelEstimate:
        """The texels at these places, row by row."""
        return self._replace(**{name: planes.flatten(-2)[..., texels] if planes.dim() > 1 else planes for
                                name, planes in zip(self._fields, self) if name != "spread"})

    def put_texels(self, texels: Tensor, part: TexelEstimate) -> None:
        """Like :meth:`put`, for texels at some places."""
        for name in self._changed:
            planes = getattr(self, name)
            planes[..., texels // planes.shape[-1], texels % planes.shape[-1]] = getattr(part, name)

    def copy(self) -> TexelEstimate:
        """The same texels, in planes that :meth:`put` may write into."""
        return self._replace(**{name: getattr(self, name).clone() for name in self._changed})


class TexelPrior:
    """Priors of texels: wide ones, those learned from look-alikes, and those around a tied answer."""

    def __init__(self, unknowns: Unknowns, config: HierarchicalConfig) -> None:
        self.unknowns, self.config = unknowns, config
        self.shared, self.slopes = unknowns.of(*SHARED), unknowns.of("normal")
        self.diffuse = unknowns.of("diffuse", "base_color")
        self.names = [unknowns.names[i] for i in self.shared]  # map of each shared unknown
        self.low, self.high = torch.tensor([BOUNDS.get(name, (0.0, 1.0)) for name in unknowns.names]).T
        self.lobes: tuple[Tensor, ...] = ()  # means, precisions, S x Q each; diffuse means of coarse texels

    def within(self, name: str, low: float, high: float) -> TexelPrior:
        """The same prior with other bounds of the numbers of a map."""
        other, of = copy(self), self.unknowns.of(name)
        other.low, other.high = (bound.index_fill(0, of, end) for bound, end in
                                 ((self.low, low), (self.high, high)))
        return other

    def bounded(self, values: Tensor, of: Tensor | slice = slice(None)) -> Tensor:  # noqa: B008
        """Values of some unknowns (default: all), clamped to their bounds."""
        return values.clamp(self.low[of, None, None], self.high[of, None, None])

    def _precision(self, x: Tensor, deviation: Callable[[str], float]) -> Tensor:
        """Precisions, U x R x R, from the standard deviation of each map; kept once for all texels."""
        each = torch.tensor([deviation(name) ** -2.0 for name in self.unknowns.names])
        return each[:, None, None].expand_as(x)

    def vague(self, x: Tensor) -> TexelEstimate:
        """The estimate ``x`` with a wide prior around it."""
        x = self.bounded(x).contiguous()
        spread = torch.tensor([VAGUE[name] for name in self.names])
        return TexelEstimate(x, x.clone(), self._precision(x, VAGUE.__getitem__), spread)

    def whole(self, answer: TexelEstimate) -> TexelEstimate:
        """Texels with the prior of all numbers, U x R x R; with lobes, an answer stores only a part of it."""
        if not len(answer.lobe):
            return answer
        x, of, lobe, (means, precisions, diffuse) = answer.x, self.shared, answer.lobe.long(), self.lobes
        mean, precision = torch.zeros_like(x), self._precision(x, VAGUE.__getitem__).clone()
        mean[of], precision[of] = means[:, lobe], precisions[:, lobe]
        mean[self.diffuse], precision[self.slopes] = diffuse[:, answer.mean[0].long()], answer.precision
        return answer._replace(mean=mean, precision=precision)

    def share(self, answer: TexelEstimate, variance: Tensor, scale: Scale, photos: int, tied: bool,
              corrected: Callable[[Tensor], Tensor] = Tensor.contiguous) -> TexelEstimate:
        """The answer with a new prior: look-alikes give that of shared unknowns, the relief that of normals.

        Args:
            variance: of the unknowns, given photos and prior, U x R x R.
            tied: whether the photos are real. If so, the relief is ``config.relief``, else learned.
            corrected: corrects the means of the shared unknowns, S x R x R.
        """
        spread, found = answer.spread, None
        if len(self.shared):
            of = slice(int(self.shared[0]), int(self.shared[-1]) + 1)
            x, unsure, mean, precision = (t[of].flatten(1) for t in (answer.x, variance, answer.mean,
                                                                     answer.precision))
            found = shared(self.names, x, unsure, mean, precision, scale.members(scale.texels <= KEPT),
                           spread, 0 if tied else photos)
            spread = found.spread
        mean, precision = answer.mean.clone(), answer.precision.clone()
        if found:
            mean[self.shared] = corrected(found.mean.reshape(-1, *answer.x.shape[1:]))
            nearest = found.tau.clamp_max(self.config.spread) if tied else found.tau
            precision[self.shared] = (nearest**-2.0).reshape(-1, *answer.x.shape[1:])
        if len(self.slopes):
            relief = (answer.x[self.slopes].square()
                      + variance[self.slopes]).mean().sqrt().clamp_min(LEAST_SPREAD)
            mean[self.slopes] = 0
            precision[self.slopes] = (self.config.relief if tied else float(relief)) ** -2.0
        return answer._replace(mean=mean, precision=precision, spread=spread)

    def enlarge(self, answer: TexelEstimate, coarse: Scale, fine: Scale, tied: bool) -> TexelEstimate:
        """An estimate at full size; tied texels are set free.

        Shared unknowns of tied texels follow look-alikes (joint upsampling, Kopf 2007).
        """
        side = fine.capture.resolution
        if side == coarse.capture.resolution and fine.capture is coarse.capture:
            return self.free(answer) if tied else answer
        if not tied:
            x, mean, precision = (enlarged(each, side) for each in answer[:3])
            return TexelEstimate(x, mean, precision, answer.spread)
        x, shared = answer.x, self.shared
        if len(shared):
            own = x[shared]
            alike = own.flatten(1) @ coarse.member / coarse.member.sum(dim=0).clamp_min(NOBODY)
            x = x.index_copy(0, shared, own - (alike @ coarse.member.T).reshape(own.shape))
        x = enlarged(x, side)
        if len(shared):
            fine.add_basis(x.flatten(1)[int(shared[0]):int(shared[-1]) + 1], alike)
            for k in shared:
                x[k].clamp_(self.low[k], self.high[k])
        return self.free(answer._replace(x=x))

    def free(self, answer: TexelEstimate) -> TexelEstimate:
        """Let every texel leave its tied answer, now the mean of its prior; the prior of diffuse is wide."""
        return answer._replace(mean=answer.x,
                               precision=self._precision(answer.x, lambda name: self._freedom(name)[0]))

    def loosen(self, answer: TexelEstimate, variance: Tensor) -> TexelEstimate:
        """Set the prior's deviations from the tied answer to the present ones (expectation-maximisation)."""
        each = answer.precision[:, 0, 0].clone()
        for name in sorted(set(self.unknowns.shapes) & set(FREEDOM)):
            of = self.unknowns.slices[name]
            went = (answer.x[of] - answer.mean[of]).square_().add_(variance[of]).mean().sqrt()
            each[of] = float(went.clamp(*self._freedom(name)[1:])) ** -2.0
        return answer._replace(precision=each[:, None, None].expand_as(answer.x))

    def fixed_but_diffuse(self, answer: TexelEstimate) -> TexelEstimate:
        """The answer with a prior around it that lets only the diffuse map move."""
        return answer._replace(mean=answer.x, precision=self._precision(
            answer.x, lambda name: FIXED if name in FREEDOM else VAGUE[name]))

    def _freedom(self, name: str) -> tuple[float, float, float]:
        """Standard deviations of a map's texels around the tied answer: at first, at least and at most."""
        if name not in FREEDOM:
            return (VAGUE[name],) * 3
        first, least, most = (max(times * self.config.detail_spread, FIXED)
                              for times in (*FREEDOM[name], FREEST))
        return first, least, most

    def levelled(self, answer: TexelEstimate) -> tuple[TexelEstimate, Tensor]:
        """The answer with mean slopes 0 of its normals, and the mean slopes (float64) that it had."""
        slope = answer.x[self.slopes].mean(dim=(1, 2))
        x = answer.x.clone()
        x[self.slopes] -= slope[:, None, None]
        return answer._replace(x=x), slope.double()
