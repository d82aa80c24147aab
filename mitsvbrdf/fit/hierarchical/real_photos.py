"""Stages of real photos: texels are tied, then free as far as photos ask for, and lose burn-in."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from ...io.profile import profiled
from .cross_validation import AGREED, NOISES, in_turn, least_as_good, prediction_errors, steps_of_turns
from .observations import ROBUST_END, ObservationModel
from .scales import Scale
from .solver import Observations
from .specular_test import Search
from .stages import NOISE, Stage
from .starts import stepped, variances
from .texel_prior import TexelEstimate
from .time_budget import LAST_STEPS, ROUND_STEPS, STEPS


class RealPhotos:
    """What is special about photos of a phone.

    Args:
        search: all unknowns.
        seen: the photos.
    """

    def __init__(self, search: Search, seen: ObservationModel) -> None:
        (self.scales, self.prior), self.seen = search, seen
        self.photos = len(self.scales.of(Stage.ALONE).capture)
        self.closed: TexelEstimate | None = None  # what the present answer ends in, once it was asked for

    def next_prior(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> TexelEstimate:
        """The answer with the prior of the next round, from what texels are seen to be."""
        variance = variances(scale.solver, photos, answer)
        if scale.free:
            return self.prior.loosen(answer, variance)
        return self.prior.share(answer, variance, scale.member, len(photos.views), True,
                                lambda planes: self.seen.without_burn_in(planes, scale, answer))

    @property
    def may_learn(self) -> bool:
        """Whether there is time to learn how far to believe the photos."""
        turns = steps_of_turns(self.photos) * self.scales.of(Stage.ALONE).texels
        return self.seen.budget.in_time(turns, beside=ROUND_STEPS - STEPS)

    def at_full_size(self, answer: TexelEstimate, scale: Scale) -> tuple[Scale, TexelEstimate]:
        """A tied answer enlarged; texels are free to leave it."""
        fine = self.scales.of(Stage.FINE, free=True)
        return fine, self.prior.enlarge(answer, scale, fine, tied=True)

    def learn_noise(self, tied: TexelEstimate, scale: Scale, hurried: bool) -> None:
        """Learn the noise at full size, by which each photo is predicted well from the others, if in time."""
        turns = in_turn(self.photos)
        if hurried or self.seen.config.noise is not None or not turns:
            return
        with profiled("noise"):
            self.seen.stages.believe(self._noise(tied, scale, turns))

    def _noise(self, tied: TexelEstimate, scale: Scale, turns: range) -> float:
        sharp = self.scales.of(Stage.ALONE)
        starts, every = dict[int, TexelEstimate](), self.seen.observations(scale, tied)
        for photo in turns:
            others, answer = every.without(photo), tied
            for _ in range(AGREED):
                answer = self.next_prior(scale, others, answer._replace(
                    x=stepped(scale.solver, others, answer, self.prior, STEPS).x))
            starts[photo] = self.prior.enlarge(answer, scale, sharp, tied=True)
        photos = replace(self.seen.observations(sharp, tied), robust=ROBUST_END * NOISE, noise=NOISE,
                         weights=sharp.capture.measured)
        return NOISES[least_as_good(prediction_errors(photos, sharp.solver, self.prior, starts, NOISES))]

    def close(self, answer: TexelEstimate, scale: Scale, more: int = 0) -> Tensor:
        """An answer with what the photos burnt in taken out, and the diffuse map that belongs to it.

        Before the last stage: of an answer as if that stage began now. Steps that cannot end in time are left
        out.

        Args:
            answer: with tied texels, or free ones.
            scale: of it.
            more: steps to take where the answer has been closed already.

        Returns:
            The unknowns, U x R x R.
        """
        seen, prior, steps = self.seen, self.prior, more
        if self.closed is None:
            if seen.stages.stage != Stage.FINE:
                scale, answer = self.at_full_size(answer, scale)
                steps = seen.budget.steps(LAST_STEPS, seen.budget.to_come + LAST_STEPS)
                answer = answer._replace(x=seen.stepped(scale, answer, prior, steps).x)
            x, of = answer.x.clone(), prior.shared
            x[of] = prior.bounded(seen.without_burn_in(x[of], scale, answer), of)
            answer, steps = prior.fixed_but_diffuse(answer._replace(x=x)), seen.budget.steps(LAST_STEPS)
        else:
            answer = self.closed
        self.closed = answer._replace(x=seen.stepped(scale, answer, prior, steps).x) if steps else answer
        return self.closed.x
