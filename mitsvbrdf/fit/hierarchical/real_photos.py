"""Stages of real photos: texels are tied, then freed as far as photos require; burn-in is removed."""

from dataclasses import replace

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...render import Renderer
from . import response_curve
from .cross_validation import AGREED, NOISES, TURN, in_turn, least_as_good, prediction_errors, steps_of_turns
from .kernel import tiles
from .observations import ROBUST_END, ObservationModel
from .scales import Scale
from .solver import Observations
from .specular_test import Search
from .stages import NOISE, Stage
from .starts import stepped, variances
from .texel_prior import TexelEstimate
from .time_budget import LAST_STEPS, ROUND_STEPS, STEPS


class RealPhotos:
    """The steps that only real photos need."""

    def __init__(self, search: Search, seen: ObservationModel) -> None:
        (self.scales, self.prior), self.seen = search, seen
        self.photos = len(self.scales.of(Stage.ALONE).capture)
        self.curve: color.Curve | None = None  # the response curve, if one was found
        # result of :meth:`close` for the present answer: shared numbers, all numbers; None before the call
        self.closed: tuple[Tensor, Tensor] | None = None

    def next_prior(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> TexelEstimate:
        """The answer with the prior of the next round, which is learned from the present texels."""
        variance = variances(scale.solver, photos, answer)
        if scale.free:
            return self.prior.loosen(answer, variance)
        return self.prior.share(answer, variance, scale, len(photos.views), True,
                                lambda planes: self.seen.without_burn_in(planes, scale, answer))

    def _in_time(self, steps: int) -> bool:
        return self.seen.budget.in_time(steps * self.scales.of(Stage.ALONE).texels, "turns",
                                        beside=ROUND_STEPS - STEPS)

    def at_full_size(self, answer: TexelEstimate, scale: Scale) -> tuple[Scale, TexelEstimate]:
        """The full-size scale, and a tied answer enlarged to it; its texels may leave it."""
        fine = self.scales.of(Stage.FINE, free=True)
        return fine, self.prior.enlarge(answer, scale, fine, tied=True)

    def learn(self, tied: TexelEstimate, scale: Scale, hurried: bool,
              renderer: Renderer) -> tuple[Scale, TexelEstimate, bool]:
        """Learn the response curve and the noise at full size: those that predict held-out photos well.

        Returns:
            The scale, with the response curve if one was found; the answer; and whether the time was too
            short for the cross-validation.
        """
        steps = steps_of_turns(self.photos)
        hurried = hurried or steps > 0 and not self._in_time(steps)
        held_out, found = {} if hurried else self._held_out(tied, scale), None
        if not held_out:
            return scale, tied, hurried or steps > 0
        uncurved = color.parts(scale.capture.transfer)[1] is None
        if uncurved and self._in_time(steps + response_curve.WORK):
            found = response_curve.curved(scale, tied, self.seen.observations, self.prior, self.next_prior,
                                          renderer)
        if found and (other := self._held_out(found[1], found[0])):
            errors = torch.stack([self._errors(each, at) for each, at in
                                  ((held_out, scale), (other, found[0]))])
            if least_as_good(errors) == 1:
                (scale, tied), held_out = found, other
                self.curve = color.parts(scale.capture.transfer)[1]
                self.scales.see_through(scale.capture.transfer)
        unknown = self.seen.config.noise is None
        hurried = unknown and not self._in_time(steps - len(held_out) * TURN)
        if unknown and not hurried:
            self.seen.stages.detail = torch.tensor(self._noise(tied, scale, held_out))
        return scale, tied, hurried

    def seen_through(self, capture: Capture) -> Capture:
        """The capture with the response curve and a note; unchanged if no curve was found."""
        if self.curve is None or capture.transfer == self.curve.behind(capture.transfer):
            return capture
        told = ("the fit uses a response curve, with which it predicts held-out photos better: gamma "
                f"{self.curve.gamma:.2f}, shoulder {self.curve.shoulder:.2f} behind {capture.transfer}; the "
                "brightness of colours depends on it, and their deviations do not include that")
        return capture.but(transfer=self.curve.behind(capture.transfer), notes=(*capture.notes, told))

    def _held_out(self, tied: TexelEstimate, scale: Scale) -> dict[int, TexelEstimate]:
        """A dict: number of each held-out photo -> the answer from all other photos. It is empty if the fits
        take so long that the noise cannot be learned in time.
        """
        found, every = dict[int, TexelEstimate](), self.seen.observations(scale, tied)
        for photo in in_turn(self.photos):
            if found and not self._in_time(steps_of_turns(self.photos) - len(found) * TURN):
                return {}
            with self.seen.budget.timed("turns", TURN * scale.texels):
                others, answer = every.without(photo), tied
                for _ in range(AGREED):
                    answer = self.next_prior(scale, others, answer._replace(
                        x=stepped(scale.solver, others, answer, self.prior, STEPS).x))
            found[photo] = answer
        return found

    def _errors(self, held_out: dict[int, TexelEstimate], scale: Scale) -> Tensor:
        """Squared errors of each photo, predicted from the others: sum over channels, mean over pixels."""
        every = replace(self.seen.observations(scale, next(iter(held_out.values()))), noise=1.0, robust=None,
                        weights=scale.capture.measured)
        return torch.stack([scale.solver.normal_equations(every.pick([photo]), answer.x)[0].mean()
                            for photo, answer in held_out.items()])

    def _noise(self, tied: TexelEstimate, scale: Scale, held_out: dict[int, TexelEstimate]) -> float:
        sharp = self.scales.of(Stage.ALONE)
        starts = {photo: self.prior.enlarge(answer, scale, sharp, tied=True)
                  for photo, answer in held_out.items()}
        photos = replace(self.seen.observations(sharp, next(iter(starts.values()))), noise=NOISE,
                         robust=ROBUST_END * NOISE, weights=sharp.capture.measured)
        return NOISES[least_as_good(prediction_errors(photos, sharp.solver, self.prior, starts, NOISES))]

    def close(self, answer: TexelEstimate, scale: Scale, more: int = 0) -> Tensor:
        """The answer without burn-in, and with a diffuse map that is solved again for the other maps.

        Before the last stage, the answer is treated as if the last stage began now. Fewer steps are taken if
        time is short.

        Args:
            more: steps to take if :meth:`close` was called for this answer before.

        Returns:
            The unknowns, U x R x R.
        """
        seen, prior, steps, x = self.seen, self.prior, more, None
        if self.closed is None:
            if seen.stages.stage != Stage.FINE:
                scale, answer = self.at_full_size(answer, scale)
                steps = seen.budget.steps(LAST_STEPS, seen.budget.to_come + LAST_STEPS)
                answer = answer._replace(x=seen.stepped(scale, answer, prior, steps).x)
            shared = prior.bounded(seen.without_burn_in(answer.x[prior.shared], scale, answer), prior.shared)
            steps = seen.budget.steps(LAST_STEPS)
        else:
            shared, x = self.closed
        if x is None or steps:
            x = self._ended(answer, shared, scale, steps, x)
        self.closed = shared, x
        return x

    def _ended(self, answer: TexelEstimate, shared: Tensor, scale: Scale, steps: int,
               start: Tensor | None) -> Tensor:
        """The answer with ``shared`` numbers, S x R x R, after steps in which only the diffuse map may move.

        The steps begin at ``start``, U x R x R; None: at the answer with these shared numbers.
        """
        photos, found = self.seen.observations(scale, answer), torch.empty_like(answer.x)
        with self.seen.budget.timed("solver", steps * scale.texels):
            for rows in tiles(len(found[0])):
                part = answer.rows(rows)
                part = self.prior.fixed_but_diffuse(part._replace(
                    x=part.x.index_copy(0, self.prior.shared, shared[:, rows])))
                part = part if start is None else part._replace(x=start[:, rows])
                found[:, rows] = stepped(scale.solver, photos.of_rows(rows), part, self.prior, steps).x
        return found

    def state(self) -> dict[str, Tensor]:
        """The response curve: two numbers, or none."""
        return {"curve": torch.tensor(self.curve or (), dtype=torch.float64)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        if values := state["curve"].tolist():
            self.curve = color.Curve(*values)
            self.scales.see_through(self.curve.behind(self.scales.of(Stage.FINE).capture.transfer))
