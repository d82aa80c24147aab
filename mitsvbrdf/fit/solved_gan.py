"""``gan`` from solved maps: a map changes only if held-out patches of photos are then predicted better.

The default method solves twice: from all photos, and from all but held-out patches (at each texel, one photo
is held out). The game (adversarial training) of :mod:`.generator.detail` starts at the second answer, without
these patches. Its changes stay within bounds from the deviations of the maps. Every :data:`BEAT` steps, each
set of maps is tested: does its change improve the prediction of the patches by the second answer? The result
is the first answer plus the change that helped most, if the photos stay explained. Often none helps.
"""

import itertools
import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..capture import Capture
from ..capture.rectify import filled
from ..color import to_display
from ..material.maps import SVBRDF
from ..measure.rerender import rerender_errors
from ..render.needs import Omitted
from ..views import Views
from .checkpoint import Part, part, state_of
from .confidence import deviations
from .config import HierarchicalConfig
from .detail_config import DetailConfig
from .gan_config import FEWEST, GanConfig
from .generator.bounded import Bounded
from .generator.detail import DetailTraining
from .generator.highlight_discriminator import PATCH
from .hierarchical import Hierarchical
from .method import Method
from .omitted import TOO_LITTLE
from .one_photo import OnePhoto
from .task import FitTask

BLOCKS = 16  # patches along a side; in each, one photo is held out
WITHOUT = 0.5  # largest share of the time left that solving without the patches may take
SURE = 3.0  # standard errors by which patches must be predicted better for a change to be kept
# Largest factor by which a change may raise the error of all photos: a change that improves a bad second
# answer may spoil the first one.
WORSE = 1.1
BEAT = 20  # steps of the game from one test of its changes to the next
VIEWS = "camera", "light", "intensity"
SHARED = "bsdf", "guess", "seed", "fix", "grey_specular", "flash_offset"  # settings of both methods
GAME, ENDED = 2, 3  # stages after solving with all photos (0) and without the patches (1)


def solver_of(task: FitTask[HierarchicalConfig]) -> Method:
    """The default method; for one photo of a material that repeats itself, the fit by look classes."""
    return OnePhoto(task) if task.of_looks else Hierarchical(task)


class SolvedGan(Method[GanConfig]):
    """Rounds of the solver, then steps of the game. BackendError: Mitsuba or libLLVM is missing."""

    latest_is_best = True  # held-out patches decide, not the error of all photos

    def __init__(self, task: FitTask[GanConfig]) -> None:
        super().__init__(task)
        self.task, self.stage, self.began, self.steps = task, 0, 0.0, 0
        self.spared = spared(task.capture, task.config.seed)
        self.playable = len(task.capture) >= FEWEST and task.capture.resolution >= PATCH
        self.without = replace(task, capture=held_out(task.capture, self.spared), own_guess=None)
        longest = HierarchicalConfig().limited(task.capture.resolution).budget or math.inf
        self.solvers = [self._solver(task, task.config.budget and min(task.config.budget, longest))]
        self.answer: tuple[SVBRDF, Views] | None = None  # of all photos
        self.game: DetailTraining | None = None
        self.kept: dict[str, Tensor] = {}  # the best change so far, of the maps it improved
        self.gain = 0.0  # by which it reduced the patches' squared error

    def _solver(self, task: FitTask[GanConfig], budget: float | None = None) -> Method:
        config = HierarchicalConfig(budget=budget, **{name: getattr(self.config, name) for name in SHARED})
        return solver_of(FitTask(task.capture, task.renderer, config, None, task.estimated,
                                 task.light_doubted))

    def step(self, progress: float) -> dict[str, float]:
        """A round of the solver, or a step of the game."""
        if self.stage < GAME:
            share = self._share(progress)
            if not self.solvers[-1].done and share < 1:
                return self.solvers[-1].step(0.0 if self.stage else share)
            self._next_stage(progress)
        if self.stage != GAME or self.game is None:
            return {}
        losses = self.game.step((progress - self.began) / (1 - self.began))
        self.steps += 1
        if self.steps % BEAT == 0:
            self._judge()
        return losses

    def _share(self, progress: float) -> float:
        """The used share of the present solver's time; 0 if iterations limit the run."""
        if self.config.iterations or not self.config.budget:
            return 0.0
        if self.stage:
            return (progress - self.began) / (WITHOUT * (1 - self.began))
        return progress * self.config.budget / (self.solvers[0].config.budget or math.inf)

    def _next_stage(self, progress: float) -> None:
        solver = self.solvers[-1]
        solver.ended = True
        self.began, answer = min(progress, 0.99), solver.estimate()
        if self.stage == 0:
            self.answer = answer
            self._see_as_solved()
            self.stage = 1 if self.playable else ENDED
            if self.stage == 1:
                self.solvers.append(self._solver(self.without))
        elif not solver.done:
            self.stage = ENDED  # any change would improve an unsettled answer
        else:
            assert isinstance(solver, Hierarchical)  # there are several photos
            spread = deviations(*answer, solver.task, solver.scales.basis)[0]
            self._begin_game(Bounded.of(*answer, spread, DetailConfig.reach, DetailConfig.certain))

    def _see_as_solved(self) -> None:
        """Use the photos with the response curve that the first solver found."""
        self.capture = self.solvers[0].capture
        self.without = replace(self.without, capture=self.without.capture.but(transfer=self.capture.transfer))

    def _begin_game(self, bounded: Bounded) -> None:
        self.stage = GAME
        self.game = DetailTraining(bounded, self.without.capture, self.renderer,
                                   DetailConfig(seed=self.config.seed))

    def _judge(self) -> None:
        """Keep the present change of the fewest maps that improve the prediction of the patches enough."""
        assert self.game
        solved = self.game.bounded
        with torch.no_grad():
            change = self.game.change()

        def errors(*names: str) -> Tensor:
            return self._errors(solved.moved({name: change[name] for name in names}), solved.views)

        plain = errors()
        sets = [names for count in range(1, len(change) + 1)
                for names in itertools.combinations(change, count)]
        gains = {names: plain - errors(*names) for names in sets}
        sure = [names for names in sets if float(gains[names].mean()) > SURE * standard_error(gains[names])]
        if not sure:
            return
        best = max(sure, key=lambda names: float(gains[names].mean()))
        less = {names: gains[best] - gains[names] for names in sure}
        fewest = next(names for names in sure if float(less[names].mean()) <= standard_error(less[names]))
        gain, kept = float(gains[fewest].mean()), {name: change[name] for name in fewest}
        if gain > self.gain and self._seen(kept) <= WORSE * self._seen({}):
            self.gain, self.kept = gain, kept

    def _seen(self, kept: dict[str, Tensor]) -> float:
        """Re-rendering error of all photos, by the first answer plus the change ``kept``."""
        assert self.answer and self.game
        svbrdf, views = self.answer
        changed = Bounded(svbrdf, views, self.game.bounded.bounds).moved(kept) if kept else svbrdf
        return rerender_errors(self.renderer, changed, views, self.capture)[0]

    def _errors(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """Mean squared error, in display values, of each patch in the photo that is held out there."""
        with torch.no_grad():
            images = self.renderer.render(svbrdf, views)
        error = (to_display(images, self.capture.transfer) - self.capture.photos) * self.spared[..., None]
        square = error.square().sum(dim=0).mean(dim=-1)
        return F.adaptive_avg_pool2d(square[None, None].float(), min(BLOCKS, len(square))).flatten()

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The solved maps, with the change of the maps that the game improved."""
        if self.answer is None:
            self.solvers[0].ended = self.ended
            return self.solvers[0].estimate()
        svbrdf, views = self.answer
        if not (self.kept and self.game):
            return self.answer
        return Bounded(svbrdf, views, self.game.bounded.bounds).moved(self.kept).map(Tensor.contiguous), views

    def preview(self) -> SVBRDF | None:
        """The present maps of the first solver; None after it has ended."""
        return self.solvers[0].preview() if self.answer is None else None

    @property
    def done(self) -> bool:
        """Whether the run has ended without a game."""
        return self.stage == ENDED

    @property
    def cut_short(self) -> bool:
        """Whether the answer from all photos has not settled."""
        return self.stage > 0 and not self.solvers[0].done or self.solvers[0].cut_short

    def cut_step(self) -> None:
        """Halve the step sizes of the game."""
        if self.game:
            self.game.cut_step()

    @property
    def omitted(self) -> list[Omitted]:
        """What the first solver omitted, and the maps that the game did not improve."""
        if self.game:
            why = ("it predicts held-out photos no better, or all photos worse" if self.steps >= BEAT else
                   "the run ended before it was judged") + ": the map stays as solved"
            found = [Omitted(f"the game's change of {name}", why) for name in self.game.bounded.bounds
                     if name not in self.kept]
        else:
            why = "no time was left for it, or the run was stopped" if self.playable else TOO_LITTLE
            found = [Omitted("the game", f"{why}; the maps stay as solved")]
        return self.solvers[0].omitted + found

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """The deviations of the first solver's views."""
        return self.solvers[0].views_deviation

    def state(self) -> dict[str, Tensor]:
        """Stage and counters, the solvers, the answers, and the game."""
        parts: dict[str, Part] = {f"solver{k}": solver.state() for k, solver in enumerate(self.solvers)}
        parts["at"] = torch.tensor([self.stage, self.steps, self.began, self.gain], dtype=torch.float64)
        if self.answer:
            parts["answer"] = _tensors(*self.answer)
        if self.game:
            solved = self.game.bounded
            parts |= {"solved": _tensors(solved.svbrdf, solved.views), "bound": solved.bounds,
                      "game": self.game.state(), "kept": self.kept}
        return state_of(parts)

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        self.stage, self.steps = (int(value) for value in state["at"][:2])
        self.began, self.gain = state["at"][2:].tolist()
        self.solvers = self.solvers[:1]
        self.solvers[0].load_state(part(state, "solver0."))
        if self.stage:
            self._see_as_solved()
        if part(state, "solver1."):
            self.solvers.append(self._solver(self.without))
            self.solvers[1].load_state(part(state, "solver1."))
        self.answer = self._answer(part(state, "answer.")) if self.stage else None
        self.kept, self.game = part(state, "kept."), None
        if self.stage == GAME:
            self._begin_game(Bounded(*self._answer(part(state, "solved.")), part(state, "bound.")))
            assert self.game
            self.game.load_state(part(state, "game."))

    def _answer(self, tensors: dict[str, Tensor]) -> tuple[SVBRDF, Views]:
        camera, light, intensity = (tensors.pop(name) for name in VIEWS)
        return (SVBRDF(self.config.bsdf, tensors),
                replace(self.capture.views, camera=camera, light=light, intensity=intensity))


def _tensors(svbrdf: SVBRDF, views: Views) -> dict[str, Tensor]:
    return {**svbrdf.maps, **{name: getattr(views, name) for name in VIEWS}}


def spared(capture: Capture, seed: int) -> Tensor:
    """A mask of held-out pixels, N x R x R: in each of :data:`BLOCKS` x BLOCKS patches, those of one photo.

    The numbers of patches of two photos differ by one at most. The seed decides the places.
    """
    side, random = min(BLOCKS, capture.resolution), torch.Generator().manual_seed(seed)
    order = torch.randperm(side * side, generator=random) % len(capture)
    place = torch.arange(capture.resolution) * side // capture.resolution
    photo = order.reshape(side, side)[place[:, None], place]
    held = photo == torch.arange(len(capture))[:, None, None]
    return held if capture.measured is None else held & capture.measured


def held_out(capture: Capture, pixels: Tensor) -> Capture:
    """The capture with these pixels (N x R x R) masked, and filled from the other photos."""
    measured = ~pixels if capture.measured is None else ~pixels & capture.measured
    shown = torch.where(measured[..., None], capture.photos, torch.nan)
    return replace(capture, photos=filled(list(shown.numpy()), warn=False)[0], measured=measured)


def standard_error(values: Tensor) -> float:
    """The standard error of the mean of values."""
    return float(values.std() / len(values)**0.5)
