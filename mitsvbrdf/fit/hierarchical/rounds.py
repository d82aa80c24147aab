"""``hierarchical``, the default: every texel is solved by itself, and tied to texels that look like it.

A texel has nine unknowns and about nine nearly grey values, one per photo. Solved alone, it overfits: lobes
without a seen highlight stay undetermined, and maps absorb errors of the model (burn-in). So three steps
alternate: texels are solved (:mod:`.solver`), they share specular and roughness with texels that look alike
(:mod:`.sharing`), and camera and flash are refined (:mod:`.view_corrections`). A neighbour's better estimate
becomes a start (:mod:`.starts`; PatchMatch, Barnes et al. 2009).

The errors of a first free fit distinguish simulated photos from real ones (:mod:`.stages`). Real photos are
fitted at 64 px first, where look-alikes are tied. At full size, a texel may leave its 64 px value as far as
its photos require (:mod:`.texel_prior`, :mod:`.cross_validation`). Texels of simulated photos share lobes
learned from all texels (:mod:`.shared_lobes`), or have no lobe if none is needed (:mod:`.specular_test`).
"""

from dataclasses import replace

import torch
from torch import Tensor

from ...capture import Capture
from ...material.maps import SVBRDF
from ...material.resample import enlarged, sampled
from ...render import make_renderer
from ...render.needs import Needs, Omitted
from ...views import Views, strips
from ..config import HierarchicalConfig
from ..method import Method
from ..start import robust_start
from ..task import FitTask
from .evidence import SEARCH_STEPS
from .exact_photos import ExactPhotos
from .observations import ObservationModel
from .omitted import omitted_stages
from .real_photos import RealPhotos
from .scales import Scales
from .scoring import Scoring
from .shared_lobes import TRIED, SharedLobes
from .specular_test import Search
from .stages import EXACT, MOVED, NOISE, ROUNDS, Stage, Stages, unexplained
from .starts import other_starts
from .texel_prior import TexelEstimate, TexelPrior
from .time_budget import FAR_STEPS, LAST_STEPS, OTHER_STEPS, ROUND_STEPS, STEPS, TimeBudget
from .view_corrections import LEVELLED, REFINED, ViewCorrections

MIXED = 2.0  # structure of errors, averages / single pixels: above this, averages do not follow the model
SHOWN = 256  # texels a side of a preview of a larger material, up to twice as many


class Hierarchical(Method[HierarchicalConfig]):
    """Rounds of the hierarchical fit.

    Args:
        task: what to fit. Its renderer draws the comparison; the solver always runs Mitsuba's BSDF.

    Raises:
        BackendError: Mitsuba, the variant or libLLVM is missing.
    """

    measured_every = 6  # rounds; 1 for exact photos at full size: samples are quick, no older planes are kept
    latest_is_best = True  # the maps that explain the photos seen best have burnt-in highlights

    def __init__(self, task: FitTask[HierarchicalConfig]) -> None:
        super().__init__(task)
        self.task, capture, config = task, task.capture, task.config
        self.variant = task.renderer.variant or "llvm_ad_rgb"
        self.corrections = ViewCorrections(capture, task.refined, self.fits_offset)
        search = Search.of(Scales(capture, task.guess, self.fixed, config, self.variant))
        self.scale = search.scales.of(Stage.ALONE)
        self.stages = Stages(config.multi_start and "roughness" in search.prior.unknowns.shapes, config.exact)
        self.stages.detail = torch.tensor(config.noise or NOISE)
        self.budget = TimeBudget(config.budget, self.stages, capture.resolution**2)
        self.seen = ObservationModel(self.stages, self.corrections, config, self.budget)
        self.exact, self.real = ExactPhotos(task, search, self.seen), RealPhotos(search, self.seen)
        self.engine = make_renderer("mitsuba", self.variant, Needs())
        self.cut = False  # whether the time left was too short for the whole of the latest round
        self.answer = self.start()

    @property
    def scales(self) -> Scales:
        """Photos and solvers at the sizes of the stages."""
        return self.exact.present.scales

    @property
    def prior(self) -> TexelPrior:
        """The prior of the texels."""
        return self.exact.prior

    @property
    def photos(self) -> ExactPhotos | RealPhotos:
        """The special steps of real photos, once they are known to be real; else those of exact photos."""
        return self.real if self.stages.tied else self.exact

    def start(self) -> TexelEstimate:
        """The robust start (:func:`.robust_start`) with a wide prior around it."""
        solver, capture, guess = self.scale.solver, self.scale.capture, self.scale.guess
        return self.prior.vague(solver.numbers(robust_start(capture, guess, solver.bsdf, solver.fixed)))

    def step(self, progress: float) -> dict[str, float]:
        """A round of the present stage, or the first one of the next; the last steps if time is short."""
        stages = self.stages
        self.budget.begin(progress)
        if stages.over(progress, short=not self.budget.in_time(ROUND_STEPS * self.scale.texels)):
            self._begin_next_stage()
        if stages.tied and stages.stage == Stage.FINE and not self.budget.in_time(self.scale.texels):
            self.real.close(self.answer, self.scale, more=1)
            return {}
        self.real.closed = None
        self.measured_every = 1 if stages.exact and stages.stage == Stage.FINE else type(self).measured_every
        stages.begin_round()
        if stages.stage == Stage.MULTI_START and not self.exact.lobes:
            self.exact.lobes, self.answer, cost = SharedLobes.searched(
                self.prior, self.scale, self.answer, self.seen, make_renderer("mitsuba", self.variant))
        else:
            cost = self.solve()
        self._move_views()
        self.answer = self.photos.next_prior(self.scale, self.seen.observations(self.scale, self.answer),
                                             self.answer)
        if self.cut:
            stages.rounds -= 1
        return {"cost": float(cost)}

    def _begin_next_stage(self) -> None:
        if self.stages.stage == Stage.ALONE:
            self.stages.unexplained = self.unexplained()
            if found := self.exact.omit_lobe(self.answer):
                self.scale, self.answer = found
        in_time = self.budget.in_time(SEARCH_STEPS * self.scale.texels, beside=STEPS)
        stage = self.stages.next(in_time)
        hurried = not self.stages.finished or self.stages.may_search and not in_time
        self.corrections.leave(self.stages.stage, self.stages.rounds, self.stages.tied)
        if stage == Stage.TOGETHER:
            self.scale = self.scales.of(stage)
            self.answer = self.start()
        if stage == Stage.FINE:
            if self.stages.tied:
                self.scale, self.answer, hurried = self.real.learn(self.answer, self.scale, hurried,
                                                                   self.engine)
                self.capture = self.real.seen_through(self.capture)
            self.scale, self.answer = self.photos.at_full_size(self.answer, self.scale)
        self.stages.enter(stage, hurried)

    def unexplained(self) -> Tensor:
        """Structure and RMSE of the present errors (:func:`.stages.unexplained`)."""
        return unexplained(self.preview(), self.corrections.applied(self.views), self.scale.capture,
                           make_renderer("mitsuba", self.variant))

    def averages_mix(self) -> bool:
        """Whether single pixels of shrunk photos follow the model, but averages do not; runs a coarse fit."""
        pixels = self.task.capture.of_single()
        if pixels is None or not self.stages.known:
            return False
        alone = Hierarchical(replace(self.task, capture=pixels, own_guess=None))
        for _ in range(ROUNDS[Stage.ALONE]):
            alone.step(0.0)
        structure = float(alone.unexplained()[0])
        return structure < EXACT and MIXED * structure < float(self.stages.unexplained[0])

    def end(self) -> None:
        """Free the planes of texels."""
        del self.answer, self.scale
        self.real.closed = self.exact.lobes = None

    @property
    def done(self) -> bool:
        """Whether another round would change little."""
        return self.stages.settled

    @property
    def cut_short(self) -> bool:
        """Whether a stage or the cross-validation lacked time."""
        return self.stages.hurried or self.stages.early

    def solve(self) -> Tensor:
        """Solve every texel, then try other starts and keep those that cost less; returns the mean cost."""
        fine, turn, lobes = self.stages.stage == Stage.FINE, self.stages.rounds, self.exact.lobes
        steps = self.budget.steps(STEPS, self.budget.to_come) if fine else STEPS
        others = FAR_STEPS if lobes else OTHER_STEPS
        scoring, self.cut, before = self._scoring(), steps < STEPS, self.answer.x
        self.answer = self.answer.copy()  # a saved state may hold the planes
        cost = scoring.scored(self.answer, 0)[1] if lobes else None  # steps lower only a part of the cost
        self.answer, cost = scoring.scored(self.answer, steps, cost=cost)
        moved = sum(int(((self.answer.x[:, rows] - before[:, rows]).abs().amax(dim=0) > MOVED).sum())
                    for rows in strips(before.shape[-1])) / cost.numel()
        del before
        first = cost.mean()
        starts = lobes.starts(self.answer, turn) if lobes else other_starts(self.prior, turn)
        for start in starts if self.config.neighbours and self.stages.others else ():
            if fine and not self.budget.in_time(others * self.scale.texels):
                self.cut = True
                break
            self.answer, cost = scoring.scored(self.answer, others, start, cost)
        if lobes and fine and self.config.neighbours and not self.cut:
            self.answer, cost = scoring.searched_further(self.answer, cost, lobes.further_starts)
        if not self.cut:
            self.stages.moved(moved)
            self.stages.saved(float((first - cost.mean()) / first))
        last = (TRIED * others + LAST_STEPS) * self.scale.texels
        if lobes and self.stages.settled and not self.cut and not self.budget.in_time(last):
            self.stages.hurried = True
        elif lobes and self.stages.settled and not self.cut:
            self.stages.closing = True
            scoring = self._scoring()
            self.answer, cost = scoring.scored(self.answer, others)
            if self.config.neighbours:
                self.answer, cost = scoring.searched_further(self.answer, cost, lobes.further_starts)
            self.answer = scoring.averaged(lobes, self.answer, cost, others)
        return cost.mean()

    def _scoring(self) -> Scoring:
        photos = self.seen.observations(self.scale, self.answer)
        return Scoring(self.scale, photos, self.prior, self.exact.lobes, self.budget)

    def _move_views(self) -> None:
        """Level the normals (mean slopes 0), and move camera and flash, in the rounds that do so."""
        stage, rounds, sloped = self.stages.stage, self.stages.rounds, len(self.prior.slopes) > 0
        if not self.corrections.may_move(self.stages.tied):
            return
        if rounds in LEVELLED.get(stage, ()) and self.corrections.fits_offset and sloped:
            self.answer, slope = self.prior.levelled(self.answer)
            self.corrections.level(slope)
        work = self.corrections.work * self.scale.texels
        refined = (self.stages.last - 1,) if stage == Stage.FINE else REFINED.get(stage, ())
        if rounds in refined and self.corrections.begun(self.budget.in_time(work, "views")):
            with self.budget.timed("views", work):
                if sloped and stage != Stage.FINE:
                    self.answer, _ = self.prior.levelled(self.answer)
                self.corrections.refine(self.scale.solver.svbrdf(self.answer.x), self.scale.capture,
                                        self.engine)

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present maps at full size, and the views. Tied texels are first freed as in the last stage
        (:meth:`.RealPhotos.close`). At the end, other texels that are still coarse take steps at full size.
        """
        x, full = self.answer.x, self.capture.resolution
        if self.stages.tied:
            x = self.real.close(self.answer, self.scale)
        elif self.ended and x.shape[-1] < full:
            scale, answer = self.exact.at_full_size(self.answer, self.scale)
            x = self.seen.stepped(scale, answer, self.prior, self.budget.steps(STEPS)).x
        if self.ended:
            self.real.closed = None
        x = enlarged(x, full) if x.shape[-1] < full else x
        views, solver = self.corrections.applied(self.views), self.scales.solver(x.shape[-1])
        return solver.svbrdf(x), views

    def glimpse(self) -> tuple[SVBRDF, Views, Capture] | None:
        """The present maps and views, and every k-th pixel; None at full size if ``measured_every`` > 1."""
        full = self.scale.capture.resolution == self.capture.resolution
        if full and self.measured_every > 1:
            return None
        sharp = self.capture.sampled(SHOWN) if full else self.scales.captures[Stage.ALONE]
        return self.preview().resized(sharp.resolution), self.corrections.applied(self.views), sharp

    def preview(self) -> SVBRDF:
        """The material of the present answer; of every k-th texel, if the answer is large."""
        x = sampled(self.answer.x, SHOWN)
        return self.scales.solver(x.shape[-1]).svbrdf(x)

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the view changes, N x 7, and of the flash offset; None if not refined."""
        return self.corrections.deviations

    @property
    def omitted(self) -> list[Omitted]:
        """The parts of the method that were omitted for these photos, with reasons."""
        return omitted_stages(self.task, self.stages, bool(self.corrections.skipped))

    def state(self) -> dict[str, Tensor]:
        """The present answer and the states of the fit's parts."""
        parts = *(part.state() for part in (self.stages, self.corrections, self.exact, self.real,
                                            self.budget)),
        copies = {name: value.clone() for part in parts for name, value in part.items()}
        # the planes of an answer are large, and nothing writes into them: they are not copied
        return self.answer._asdict() | {"precision": self.answer.once()} | copies

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        planes = {name: state[name] for name in TexelEstimate._fields}
        planes["precision"] = planes["precision"].expand(-1, *planes["x"].shape[1:])
        self.answer = TexelEstimate(**planes)
        self.real.closed = None
        for part in (self.stages, self.corrections, self.real, self.budget):
            part.load_state(state)
        self.capture = self.real.seen_through(self.capture)
        stage = self.stages.stage
        self.scale = self.scales.of(stage, free=self.stages.tied and stage == Stage.FINE)
        self.exact.load_state(state, self.scale)
