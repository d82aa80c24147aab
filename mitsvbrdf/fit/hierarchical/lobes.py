"""Lobes that texels share: a mixture of Gaussians over specular, metallic and roughness.

Texels that look alike (:mod:`.sharing`) have the lobes in similar shares. Means, spreads and shares are
learned from the evidence of all texels by expectation-maximisation, with the full covariance of each texel
(extreme deconvolution; Bovy et al. 2011). If texels of a lobe show no highlight, many values explain them
equally well (:mod:`.evidence`); other texels then decide. Of many candidate lobes, only those with texels
stay (Kiefer and Wolfowitz 1956). The last lobe is wide: it is for texels that resemble no others.

Texels in the same photos have similar errors, so a small error of thousands of texels is no evidence.
Compared with prior knowledge, all texels of a lobe count as only N texels, for N photos. Prior knowledge:
most materials are dielectrics of F0 near 0.04, some are metals; anything else needs evidence.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from ...material.maps import DIELECTRIC_F0
from .evidence import Evidence
from .texel_prior import BOUNDS

CANDIDATES, MOST, FEWEST = 96, 24, 0.004  # candidates, most that are kept, least share of texels in those
TEXELS, SAME = 2.0, 0.5  # least texels of a lobe; lobes nearer than this (squared deviations) become one
WEIGHING, ROUNDS = 60, 16  # rounds of expectation-maximisation: of the candidates' shares, of everything
ANEW = 5  # the same, if the lobe of each texel is known
FIRST_SPREAD, LEAST_SPREAD = 0.05, 0.015  # standard deviation of texels from their lobe: at first, at least
WIDE = 0.5, 0.25  # mean and standard deviation of the last lobe's numbers
COMMON = 20.0  # the mean spread over all texels counts as this many texels in the spread of each lobe
# specular of dielectrics, metals and anything else in linear^(1/2.2): mean of the channels, deviation of this
# mean, deviation of the channels from it, and share
KINDS = ((DIELECTRIC_F0 ** (1 / 2.2), 0.03, 0.02, 0.6), (0.82, 0.1, 0.1, 0.2), (0.5, 0.25, 0.15, 0.2))
LIKE_OTHERS, NEAR = 0.8, 0.03  # probability that a lobe has another lobe's specular; deviation between them
METAL, RARE = 0.55, 0.1  # lobes of more specular are metals; prior share of a metal relative to other lobes
VAGUE = 1e-2  # prior precision of any number
NOBODY = 1e-12  # least share of a lobe


class Lobes(NamedTuple):
    """A mixture of Q lobes, Gaussians of S shared numbers; float64.

    Args:
        mean: Q x S.
        variance: of texels around the mean, Q x S.
        share: of the lobes in each basis material, K x Q; rows sum to 1.
    """

    mean: Tensor
    variance: Tensor
    share: Tensor

    def shares(self, member: Tensor) -> Tensor:
        """Shares of the lobes in M texels, M x Q; ``member``: shares of basis materials in them, M x K."""
        return (member @ self.share.to(member.dtype)).clamp_min(NOBODY)


class Posterior(NamedTuple):
    """Texels, if they have a given lobe; ``...`` is M for one lobe per texel, M x Q for all lobes.

    Args:
        cost: -2 log of the marginal likelihood, ...
        mean: of their numbers, ... x S.
        variance: ... x S.
        weight: precision of the lobe's mean if estimated from this texel alone, ... x S x S.
        says: that estimate of the mean, times the weight, ... x S.
    """

    cost: Tensor
    mean: Tensor
    variance: Tensor
    weight: Tensor
    says: Tensor


def posterior(found: Evidence, near: int, mean: Tensor, variance: Tensor) -> Posterior:
    """The :class:`Posterior` of M texels with given lobes, from the evidence around answer number ``near``.

    ``mean`` and ``variance`` are those of one lobe for all texels, S, or of each texel's lobe, M x S.
    """
    x, cost, slope, curve = (part[near] for part in found)
    off = mean - x
    precision = curve + torch.diag_embed(1 / variance)
    covariance = torch.linalg.inv(precision)
    right = off / variance - slope
    moved = (covariance @ right[..., None])[..., 0]
    part = curve @ covariance
    weight = curve - part @ curve
    return Posterior(cost + (off.square() / variance - right * moved).sum(dim=-1)
                     + variance.log().sum(dim=-1) + torch.linalg.slogdet(precision).logabsdet,
                     x + moved, covariance.diagonal(dim1=-2, dim2=-1), weight,
                     (weight @ x[..., None] + part @ slope[..., None])[..., 0] - slope)


class Learner:
    """Learns the lobes of M texels.

    Args:
        names: the map of each of the S numbers.
        member: shares of the basis materials in each texel, M x K.
    """

    def __init__(self, names: list[str], member: Tensor, photos: int) -> None:
        self.member, self.photos, self.width = member.double(), photos, names.index("roughness")
        self.count = self.member.sum(dim=0)
        self.low, self.high = torch.tensor([BOUNDS.get(name, (0.0, 1.0)) for name in names]).double().T
        self.specular = torch.tensor([name == "specular" for name in names])

    def each(self, found: Evidence, lobes: Lobes) -> Posterior:
        """The :class:`Posterior` of texels with each lobe, M x Q, from the answer of nearest roughness."""
        widths = found.x[:, 0, self.width].log()
        near = (lobes.mean[:, self.width, None].log() - widths).abs().argmin(dim=1)
        parts = [posterior(found, int(k), *lobe) for k, *lobe in zip(near, lobes.mean, lobes.variance)]
        return Posterior(*(torch.stack(part, dim=1) for part in zip(*parts, strict=True)))

    def learned(self, found: Evidence, seed: int) -> Lobes:
        """Learn lobes from two starts, the texels' own answers and dielectrics; returns the likelier result.

        If noise hides a lobe, the texels' own answers are random. ``seed`` selects the candidates.
        """
        best, texels = found.cost.argmin(dim=0), found.cost.shape[1]
        some = torch.randperm(texels, generator=torch.Generator().manual_seed(seed))[:CANDIDATES]
        mean = found.x[best[some], some].clamp(self.low, self.high)
        ends = [self._learned(found, mean)]
        if self.specular.any():
            ends.append(self._learned(found, mean.where(~self.specular, KINDS[0][0])))
        return max(ends, key=lambda end: end[1])[0]

    def _learned(self, found: Evidence, mean: Tensor) -> tuple[Lobes, float]:
        """The lobes learned from candidates with these means, and the log of their likelihood."""
        tried = Lobes(mean, torch.full_like(mean, FIRST_SPREAD**2), torch.empty(0))
        likely, share = -self.each(found, tried).cost / 2, torch.full_like(mean[:, 0], 1 / len(mean))
        for _ in range(WEIGHING):
            share = torch.softmax(likely + share.log(), dim=1).mean(dim=0).clamp_min(NOBODY)
        kept = share.argsort(descending=True)[:MOST]
        kept = kept[share[kept] >= min(FEWEST, float(share.max()))]
        share = torch.cat((share[kept], share[kept].amin()[None]))
        mean, spread = (torch.cat((values[kept], torch.full_like(values[:1], wide)))
                        for values, wide in ((mean, WIDE[0]), (tried.variance, WIDE[1]**2)))
        lobes = Lobes(mean, spread, (share / share.sum()).expand(len(self.count), -1))
        for _ in range(ROUNDS):
            seen = self.each(found, lobes)
            likely = (seen.cost.amin(dim=1, keepdim=True) - seen.cost).mul(0.5).exp()
            lobes = self._fewer(self._improved(lobes, seen, likely))
        cost = self.each(found, lobes).cost
        return lobes, float(torch.logsumexp(lobes.shares(self.member).log() - cost / 2, dim=1).sum())

    def moved(self, lobes: Lobes, found: Evidence, lobe: Tensor) -> Lobes:
        """The lobes, each learned again from the texels that have it, by the evidence around their answers.

        ``lobe`` is the number of each texel's lobe, M.
        """
        has = torch.nn.functional.one_hot(lobe, len(lobes.mean)).double()
        for _ in range(ANEW):
            own = posterior(found, 0, lobes.mean[lobe], lobes.variance[lobe])
            lobes = self._improved(lobes, Posterior(*(part[:, None] for part in own)), has)
        return lobes

    def _fewer(self, lobes: Lobes) -> Lobes:
        """The lobes without those that have no texels; equal lobes become one. The last lobe stays."""
        texels, last = self.count @ lobes.share, len(lobes.mean) - 1
        kept, share = [last], lobes.share.clone()
        for k in texels.argsort(descending=True).tolist():
            apart = ((lobes.mean[kept] - lobes.mean[k]).square() / lobes.variance[k]).sum(dim=1)
            if k != last and apart[1:].numel() and apart[1:].min() < SAME:
                share[:, kept[1 + int(apart[1:].argmin())]] += share[:, k]
            elif k != last and texels[k] > TEXELS:
                kept.append(k)
        kept = [*kept[1:], last]
        share = share[:, kept]
        return Lobes(lobes.mean[kept], lobes.variance[kept], share / share.sum(dim=1, keepdim=True))

    def _improved(self, lobes: Lobes, seen: Posterior, likely: Tensor) -> Lobes:
        """The lobes after a round of expectation-maximisation; ``likely``: likelihoods of lobes, M x Q."""
        mixed = lobes.shares(self.member) * likely
        total = mixed.sum(dim=1, keepdim=True)
        belongs = mixed / total
        texels = belongs.sum(dim=0)
        usual, coloured = texels / len(belongs) + NOBODY, bool(self.specular.any())
        if coloured:
            usual = usual * torch.where(lobes.mean[:, self.specular].mean(dim=1) > METAL, RARE, 1.0)
        told, count = (self.count / self.photos).clamp_min(1)[:, None], self.count[:, None]
        share = lobes.share * (self.member.T @ (likely / total)) + told * usual / usual.sum()

        weight = torch.einsum("mq,mqij->qij", belongs, seen.weight.expand(*belongs.shape, -1, -1))
        says = torch.einsum("mq,mqi->qi", belongs, seen.says.expand(*belongs.shape, -1))
        weight = weight + VAGUE * torch.eye(weight.shape[-1], dtype=weight.dtype)
        if coloured:
            hold, pull = self._usual(weight, says, texels)
            weight, says = weight + hold, says + pull
        mean = torch.linalg.solve(weight, says[..., None])[..., 0].clamp(self.low, self.high)
        off = ((seen.mean - mean).square() + seen.variance) * belongs[..., None]
        common = off.sum(dim=(0, 1)) / len(belongs)
        spread = ((off.sum(dim=0) + COMMON * common) / (texels[:, None] + COMMON)).clamp_min(LEAST_SPREAD**2)
        mean[-1], spread[-1] = lobes.mean[-1], lobes.variance[-1]
        return Lobes(mean, spread, share / (count + told))

    def _usual(self, weight: Tensor, says: Tensor, texels: Tensor) -> tuple[Tensor, Tensor]:
        """Prior of specular from KINDS and other lobes: precision, Q x S x S, and precision times mean."""
        of, count = self.specular, int(self.specular.sum())
        once = (texels / self.photos).clamp_min(1)[:, None, None]
        covariance = torch.linalg.inv(weight)[:, of][:, :, of] * once  # Q x C x C
        found = torch.linalg.solve(weight, says[..., None])[:, of, 0].clamp(0, 1)
        eye, alike = torch.eye(count).double(), torch.full((count, count), 1 / count).double()
        kinds = torch.stack([count * a**2 * alike + c**2 * (eye - alike) for _, a, c, _ in KINDS])
        level, *_, usual = torch.tensor(KINDS, dtype=weight.dtype).T
        mean = torch.cat((level[:, None].expand(-1, count), found))
        spread = torch.cat((kinds, covariance + NEAR**2 * eye))  # of K + Q sources
        others = (1 - torch.eye(len(texels)).double()) * texels
        others[:, -1] = 0
        others = LIKE_OTHERS * others / others.sum(dim=1, keepdim=True).clamp_min(1)
        prior = torch.cat(((1 - LIKE_OTHERS) * usual.expand(len(texels), -1), others), dim=1)  # Q x (K + Q)
        total = spread + covariance[:, None]  # Q x (K + Q) x C x C
        off = (found[:, None] - mean)[..., None]
        far = (off * torch.linalg.solve(total, off)).sum(dim=(2, 3)) + torch.linalg.slogdet(total).logabsdet
        likely = torch.softmax(prior.log() - far / 2, dim=1)
        precise = torch.linalg.inv(spread)
        hold, pull = weight.new_zeros(weight.shape), torch.zeros_like(says)
        at = of.nonzero()[:, 0]
        hold[:, at[:, None], at] = once * torch.einsum("qk,kij->qij", likely, precise)
        pull[:, at] = once[:, 0] * torch.einsum("qk,kij,kj->qi", likely, precise, mean)
        return hold, pull
