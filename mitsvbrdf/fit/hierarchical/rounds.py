"""``hierarchical``, the default: every texel solved by itself, tied to the texels that look like it.

A texel has nine unknowns and some nine grey values. On its own it explains its photos by whatever fits:
unseen highlights stay open, and errors of the model are burnt in. So texels are solved (:mod:`.solver`),
share specular and roughness with those that look alike (:mod:`.sharing`), and camera and flash are refined
(:mod:`.view_corrections`), in turns. A neighbour's better estimate becomes a start (:mod:`.starts`;
PatchMatch, Barnes et al. 2009).

What a first free fit leaves unexplained tells simulated photos from real ones (:mod:`.stages`). Real photos
are explained at 64 px, where texels must agree; at full size each texel may leave that as far as the photos
ask for (:mod:`.texel_prior`, :mod:`.cross_validation`). Texels of simulated photos share lobes that are
learned from all of them (:mod:`.shared_lobes`), or have none where none is needed (:mod:`.specular_test`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial

import torch
from torch import Tensor

from ...io.profile import profiled
from ...material.maps import SVBRDF
from ...material.resample import enlarged
from ...render import make_renderer
from ...render.needs import Omitted
from ...views import Views
from ..config import HierarchicalConfig
from ..method import Method
from ..start import robust_start
from ..task import FitTask
from .cross_validation import AGREED, NOISES, in_turn, least_as_good, prediction_errors, steps_of_turns
from .evidence import SEARCH_STEPS
from .observations import ROBUST_END, ObservationModel
from .omitted import omitted_stages
from .scales import Scale, Scales
from .shared_lobes import SharedLobes
from .solver import Observations, Solved
from .specular_test import Search, decision_work, explained_without, may_be_omitted, without_lobe
from .stages import NOISE, Stage, Stages, unexplained
from .starts import LESS, other_starts, stepped
from .texel_prior import LEAST_PRECISION, TexelEstimate
from .time_budget import FAR_STEPS, LAST_STEPS, OTHER_STEPS, ROUND_STEPS, STEPS, TimeBudget
from .view_corrections import LEVELLED, REFINED, ViewCorrections


class Hierarchical(Method[HierarchicalConfig]):
    """Rounds of the hierarchical fit.

    Args:
        task: what to fit. Its renderer draws the comparison; the solver runs Mitsuba's BSDF whatever it is.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    measured_every = 6  # rounds; measuring a full-size material costs more than a coarse round
    latest_is_best = True  # the photos seen are explained best by maps that burn highlights in

    def __init__(self, task: FitTask[HierarchicalConfig]) -> None:
        super().__init__(task)
        self.task, capture, config = task, task.capture, task.config
        self.variant = task.renderer.variant or "llvm_ad_rgb"
        self.corrections = ViewCorrections(capture, task.refined, self.fits_offset)
        self.search = Search.of(Scales(capture, task.guess, self.fixed, config, self.variant))
        self.scales, self.prior = self.search
        self.scale = self.scales.of(Stage.ALONE)
        self.stages = Stages(config.multi_start and "roughness" in self.prior.unknowns.shapes, config.exact)
        self.stages.believe(config.noise or NOISE)
        seen = ObservationModel(self.stages, self.corrections, config)
        self.observations, self.without_burn_in = seen.observations, seen.without_burn_in
        self.lobes = SharedLobes(self.prior)
        self.budget = TimeBudget(config.budget, self.stages, capture.resolution**2)
        self.closed: TexelEstimate | None = None  # what the present answer ends in, once it was asked for
        self.cut = False  # whether the time left was too short for the whole of the latest round
        self.answer = self.start()

    def start(self) -> TexelEstimate:
        """The robust start with a vague prior around it."""
        solver, capture, guess = self.scale.solver, self.scale.capture, self.scale.guess
        return self.prior.vague(solver.numbers(robust_start(capture, guess, solver.bsdf, solver.fixed)))

    def step(self, progress: float) -> dict[str, float]:
        """One round of the present stage or the first of the next; without time for one, the last steps."""
        stages = self.stages
        self.budget.begin(progress)
        if stages.over(progress, short=not self.budget.in_time(ROUND_STEPS * self.scale.texels)):
            self._begin_next_stage()
        if stages.tied and stages.stage == Stage.FINE and not self.budget.in_time(self.scale.texels):
            self._closed(more=1)
            return {}
        self.closed = None
        stages.begin_round()
        with profiled("solver"):
            cost = self._search() if stages.stage == Stage.MULTI_START and not self.lobes else self.solve()
        self._move_views()
        with profiled("sharing"):
            self.answer = self._tied(self.scale, self.observations(self.scale, self.answer), self.answer)
        if self.cut:
            stages.repeat_round()
        return {"cost": float(cost)}

    def _begin_next_stage(self) -> None:
        if self.stages.stage == Stage.ALONE:
            self.stages.judge(unexplained(self.preview(), self.corrections.applied(self.views),
                                          self.scale.capture, make_renderer("mitsuba", self.variant)))
            self._leave_lobe_out()
        in_time = self.budget.in_time(SEARCH_STEPS * self.scale.texels, beside=STEPS)
        stage = self.stages.next(in_time)
        hurried = not self.stages.finished or self.stages.stage == Stage.ALONE and not in_time
        self.corrections.leave(self.stages.stage, self.stages.rounds, self.stages.tied)
        if stage == Stage.TOGETHER:
            self.scale = self.scales.of(stage)
            self.answer = self.start()
        if stage == Stage.FINE:
            turns = steps_of_turns(len(self.capture)) * self.scales.of(Stage.ALONE).texels
            hurried = hurried or not (self.stages.exact
                                      or self.budget.in_time(turns, beside=ROUND_STEPS - STEPS))
            self.scale, self.answer = self._at_full_size(learn=not hurried)
        self.stages.enter(stage, hurried)

    def _leave_lobe_out(self) -> None:
        """Omit the search for a specular lobe if the first stage is finished and the photos need none."""
        stages, found = self.stages, None
        asked = stages.exact and stages.finished and may_be_omitted(self.task)
        if asked and self.budget.in_time(decision_work(self.search.scales)):
            with profiled("solver"):
                found = explained_without(self.answer, self.search, self.lobeless, stages.unexplained[1],
                                          self.observations)
        if found:
            stages.matte, (self.scale, self.answer), (self.scales, self.prior) = True, found, self.lobeless

    @cached_property
    def lobeless(self) -> Search:
        """The search without a lobe."""
        return without_lobe(self.search)

    def _at_full_size(self, learn: bool = False) -> tuple[Scale, TexelEstimate]:
        """The present answer enlarged; tied texels are free, and learn how far to believe their photos."""
        fine = self.scales.of(Stage.FINE)
        if self.lobes:
            return fine, self.lobes.enlarged(self.answer, fine)
        if self.stages.exact:
            return fine, self.prior.enlarge(self.answer, self.scale, fine, False)
        if learn and self.config.noise is None and in_turn(len(self.capture)):
            with profiled("noise"):
                self.stages.believe(self._noise_of_detail(fine))
        return self.scales.of(Stage.FINE, free=True), self._freed(self.answer, fine)

    def _freed(self, answer: TexelEstimate, fine: Scale) -> TexelEstimate:
        return self.prior.free(self.prior.enlarge(answer, self.scale, fine, True))

    def _noise_of_detail(self, fine: Scale) -> float:
        """The noise of photos of a phone at full size, by which each is predicted well from the others."""
        turns, scale, starts = in_turn(len(self.capture)), self.scale, dict[int, TexelEstimate]()
        every = self.observations(scale, self.answer)
        for photo in turns:
            others, answer = every.without(photo), self.answer
            for _ in range(AGREED):
                answer = self._tied(scale, others, answer._replace(
                    x=stepped(scale.solver, others, answer, self.prior, STEPS).x))
            free, some = self._freed(answer, fine), self.scales.sampled
            starts[photo] = TexelEstimate(some(free.x), some(free.mean), some(free.precision), free.spread)
        sharp = self.scales.of(Stage.ALONE)
        photos = replace(self.observations(sharp, self.answer), robust=ROBUST_END * NOISE, noise=NOISE,
                         weights=sharp.capture.measured)
        return NOISES[least_as_good(prediction_errors(photos, sharp.solver, self.prior, starts, NOISES))]

    def _search(self) -> Tensor:
        """Learn the noise of exact photos and the lobes that texels share; returns the mean cost."""
        self.answer, cost = self.lobes.search(
            self.scale, self.answer, lambda: replace(self.observations(self.scale, self.answer), robust=None),
            self.stages, make_renderer("mitsuba", self.variant), self.config.seed)
        return cost

    @property
    def done(self) -> bool:
        """Whether another round would change little."""
        return self.stages.settled

    def solve(self) -> Tensor:
        """Solve every texel, then try other starts where they lead to less; returns the mean cost."""
        fine, turn, lobes = self.stages.stage == Stage.FINE, self.stages.rounds, self.lobes
        steps = self.budget.steps(STEPS, self.budget.to_come) if fine else STEPS
        others = FAR_STEPS if lobes else OTHER_STEPS
        self.cut, (answer, cost) = steps < STEPS, self._scored(self.answer, steps)
        starts = lobes.starts(answer, turn) if lobes else other_starts(self.prior, turn)
        for start in starts if self.config.neighbours else ():
            if fine and not self.budget.in_time(others * self.scale.texels):
                self.cut = True
                break
            other, its = self._scored(start(answer), others)
            better = its < cost * (1 - LESS)
            answer, cost = answer.where(better, other), torch.where(better, its, cost)
        last = (lobes.tried * others + LAST_STEPS) * self.scale.texels
        if lobes and self.stages.settled and not self.cut and self.budget.in_time(last):
            answer = lobes.averaged(answer, cost, partial(self._scored, steps=others))
            answer, _ = self._scored(answer, LAST_STEPS)
        self.answer = answer
        return cost.mean()

    def _scored(self, answer: TexelEstimate, steps: int) -> tuple[TexelEstimate, Tensor]:
        """An answer after some steps, and the cost of each texel."""
        found = self._stepped(self.scale, answer, steps)
        answer, cost = answer._replace(x=found.x), found.data + found.prior
        if len(answer.lobe):
            cost += self.lobes.improbability(self.scale, self.observations(self.scale, answer), answer)
        return answer, cost

    def _move_views(self) -> None:
        """Move camera and flash if this round does so; the patch as a whole is flat (in z = 0)."""
        stage, rounds, sloped = self.stages.stage, self.stages.rounds, len(self.prior.slopes) > 0
        if not self.corrections.may_move(self.stages.tied):
            return
        if rounds in LEVELLED.get(stage, ()) and self.corrections.fits_offset and sloped:
            self.answer, slope = self.prior.levelled(self.answer)
            self.corrections.level(slope)
        work = self.corrections.work * self.scale.texels
        if rounds in REFINED.get(stage, ()) and self.corrections.begun(self.budget.in_time(work, "views")):
            with profiled("views"), self.budget.timed("views", work):
                if sloped and stage != Stage.FINE:
                    self.answer, _ = self.prior.levelled(self.answer)
                self.corrections.refine(self.preview(), self.scale.capture)

    def _tied(self, scale: Scale, photos: Observations, answer: TexelEstimate) -> TexelEstimate:
        """The answer with the prior of the next round, from what texels are seen to be."""
        prior, precision = self.prior, answer.precision + LEAST_PRECISION
        variance = scale.solver.variances(photos, answer.x, precision)
        if scale.free:
            return prior.loosen(answer, variance)
        if self.lobes:
            fine = self.stages.stage == Stage.FINE
            answer = answer if fine else self.lobes.learn_anew(scale, photos, answer)
            return prior.with_relief(answer, variance, tied=False)
        return prior.share(answer, variance, scale.member, len(photos.views), self.stages.tied,
                           lambda planes: self.without_burn_in(planes, scale, answer))

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present maps at full size, of tied texels with the freedom that they have in the end."""
        x = enlarged(self._closed() if self.stages.tied else self.answer.x, self.capture.resolution)
        views, solver = self.corrections.applied(self.views), self.scales.solver(x.shape[-1])
        return solver.svbrdf(x).map(Tensor.contiguous), views

    def preview(self) -> SVBRDF:
        """The present answer as it is, at the size of the present stage."""
        return self.scale.solver.svbrdf(self.answer.x)

    def _closed(self, more: int = 0) -> Tensor:
        """The answer with what the photos burnt in taken out, and the diffuse map that belongs to it.

        Before the last stage: of an answer as if that stage began now. Steps that cannot end in time are left
        out.

        Args:
            more: steps to take where the answer has been closed already.
        """
        scale, answer, prior, steps = self.scale, self.closed or self.answer, self.prior, more
        if self.closed is None:
            if self.stages.stage != Stage.FINE:
                scale, answer = self._at_full_size()
                steps = self.budget.steps(LAST_STEPS, self.budget.to_come + LAST_STEPS)
                answer = answer._replace(x=self._stepped(scale, answer, steps).x)
            x = answer.x.clone()
            x[prior.shared] = prior.bounded(self.without_burn_in(x[prior.shared], scale, answer),
                                            prior.shared)
            answer, steps = prior.fixed_but_diffuse(answer._replace(x=x)), self.budget.steps(LAST_STEPS)
        self.closed = answer._replace(x=self._stepped(scale, answer, steps).x) if steps else answer
        return self.closed.x

    def _stepped(self, scale: Scale, answer: TexelEstimate, steps: int) -> Solved:
        with self.budget.timed("solver", steps * answer.x[0].numel()):
            return stepped(scale.solver, self.observations(scale, answer), answer, self.prior, steps)

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the view changes, N x 7, and of the flash offset; None if not refined."""
        return self.corrections.deviations

    @property
    def omitted(self) -> list[Omitted]:
        """What these photos did not need."""
        return omitted_stages(self.task, self.stages, bool(self.corrections.skipped))

    def state(self) -> dict[str, Tensor]:
        """The states of its parts."""
        parts = self.answer._asdict(), *(part.state() for part in (self.stages, self.corrections, self.lobes,
                                                                   self.budget))
        return {name: value.clone() for part in parts for name, value in part.items()}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        self.answer = TexelEstimate(**{name: state[name].clone() for name in TexelEstimate._fields})
        self.closed = None
        for part in (self.stages, self.corrections, self.budget):
            part.load_state(state)
        self.scales, self.prior = self.lobeless if self.stages.matte else self.search
        stage = self.stages.stage
        self.scale = self.scales.of(stage, free=self.stages.tied and stage == Stage.FINE)
        self.lobes.load_state(state, self.scale)
