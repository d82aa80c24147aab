"""``hierarchical``, the default: every texel solved by itself, tied to the texels that look like it.

A texel has nine unknowns and some nine grey values to tell them by, so on its own it explains its photos by whatever fits:
highlights it never showed are left open, and what the model lacks is burnt in. Three things mend that, in turns:

1. each texel's few unknowns are solved by Levenberg-Marquardt through Mitsuba's BSDF, all at once in one kernel
   (:mod:`mitsvbrdf.render.least_squares`), and a neighbour's answer is taken over as a start where it leads to a lower cost
   (propagation, as in PatchMatch, Barnes et al. 2009);
2. specular and roughness are shared between texels that look alike (:mod:`mitsvbrdf.fit.sharing`);
3. where camera and flash stood is refined from the maps so far (:mod:`mitsvbrdf.fit.calibration`).

Photos of a simulation follow the model to the last digit, and then a texel can be trusted with everything; photos of a phone
do not. So the fit first lets every texel explain its photos freely. What is left unexplained then tells which kind they are.
Photos of a phone are first explained at 64 px, where texels must agree; at full size each may leave that answer by as much as
the photos were seen to ask for.

Texels that share a roughness also hold each other in a wrong one. Photos of a simulation, which can tell, are therefore
explained from three starts, whose lobes are of very different width, and the most probable answer is refined at full size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import replace

import torch
from torch import Tensor

from ... import color
from ...calibrate.refine import ITERATIONS, PRIORS, UNKNOWNS, refine_views
from ...capture import Capture
from ...color import CLIPPED
from ...material.maps import SVBRDF
from ...material.resample import area_averaged, enlarged
from ...render import make_renderer
from ...system.profile import profiled
from ...views import Views, coverage_angle, cubic, geometry
from ..config import HierarchicalConfig
from ..method import Method
from ..start import robust_start
from ..task import FitTask
from .appearance import appearance_of, basis_materials, membership
from .moved_views import DAMPED, FEW_STEPS, LEVELLED, TILTED
from .sharing import LEAST_SPREAD, NOBODY, shared
from .solver import Observations, TexelSolver
from .stages import (
    ALONE,
    COARSE,
    DAMPING,
    DEADLINE,
    EXACT,
    FINE,
    LAST_STEPS,
    OTHER_STEPS,
    REFINED,
    RIVALS,
    ROUNDS,
    STEPS,
    TIED_ROUNDS,
    TOGETHER,
    TRIAL,
)
from .ties import CHANCE, FREEDOM, FREEST, HELD, SHARED, TAIL_FLOOR, VAGUE

NOISE = 0.03  # of a real photo's display values: sensor, alignment, light that is no point, lobes that are no GGX
LEAST_NOISE = 0.004  # of any photo: one step of 8 bits
UNTOLD = 1.5  # times what a fit with as many unknowns leaves unexplained, there was noise
EASED = 0.75  # noise starts at NOISE and falls by this factor a round, so that no texel is caught early by a wrong highlight
ROBUST = 3.0  # errors beyond so many times the noise count by their size alone
ROBUST_END = 10.0  # the same at full size of photos of a phone, where no start is that far from its highlight any more

FOUND = ("x", "mean", "precision", "spread")  # what a start leads to
BOUNDS = {"roughness": (0.05, 1.0), "normal": (-3.0, 3.0), "specular": (0.05, 1.0)}  # else 0 to 1
LESS = 1e-3  # share of its cost that a texel must save to take another start
TILTS, GOLDEN = (0.15, 0.4, 0.8), math.pi * (3 - math.sqrt(5))  # slopes tried as starts, and the turn from one to the next


class Hierarchical(Method):
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
        capture, guess, config = task.capture, task.guess, task.config
        self.config = config
        self.unsure, self.known = task.refined == "always", task.refined != "never"
        self.variant = task.renderer.variant or "llvm_ad_rgb"
        self.full, self.guess = capture, guess
        self.few = capture.sampled(min(COARSE, capture.resolution))
        self.small = capture.averaged(min(COARSE, capture.resolution))
        self.solvers: dict[int, TexelSolver] = {}
        solver = self._solver(self.small.resolution)
        self.names = [name for name, count in solver.unknowns.items() for _ in range(count)]
        self.shares = torch.tensor([i for i, name in enumerate(self.names) if name in SHARED], dtype=torch.long)
        self.tilts = [i for i, name in enumerate(self.names) if name == "normal"]
        self.low, self.high = torch.tensor([BOUNDS.get(name, (0.0, 1.0)) for name in self.names]).T
        self.basis = basis_materials(appearance_of(self.small, area_averaged(guess, self.small.resolution)), config.materials, config.seed)
        self.change = torch.zeros(len(capture), len(UNKNOWNS), dtype=torch.float64)
        self.deviation, self.flash_deviation = torch.zeros_like(self.change), torch.zeros(2, dtype=torch.float64)
        self.stage = torch.tensor([ALONE, 0])  # which, and rounds of it done
        self.noise = torch.tensor(NOISE)
        self.unexplained = torch.full((2,), torch.nan)  # structure and RMSE of what the free fit leaves
        self.winner: dict[str, Tensor] = {}  # of the starts tried so far: what :meth:`_keep_better` keeps
        self._begin(self.few)

    # The run: stages of rounds.

    def step(self, progress: float) -> dict[str, float]:
        """One round of the present stage, or the first of the next."""
        stage, done = self.stage.tolist()
        while stage < FINE and (done >= ROUNDS[stage] or done and progress >= DEADLINE[stage]):
            stage, done = self._after(stage), 0
        self.stage = torch.tensor([stage, done + 1])
        if stage == RIVALS:
            self._next_start(done)
        self.noise = torch.tensor(self._noise(stage, done))
        with profiled("solver"):
            cost = self._solve()
        if stage == ALONE and done in LEVELLED and self.fits_views and self.fits_offset and self.tilts:
            self._level()
        if done in REFINED.get(stage, ()) and self.fits_views:
            with profiled("views"):
                self._refine_views()
        with profiled("sharing"):
            if stage == FINE and self.tied:
                self._loosen()
            else:
                self._share()
        return {"cost": float(cost)}

    @property
    def done(self) -> bool:
        """Whether another round would change little."""
        stage, done = self.stage.tolist()
        return stage == FINE and done >= (ROUNDS[FINE] if self.exact else TIED_ROUNDS)

    def _after(self, stage: int) -> int:
        """Set up the stage after this one, and name it."""
        if stage == ALONE:
            self.unexplained = self._unexplained()
            if not self.exact:
                self._begin(self.small)
                return TOGETHER
            if "roughness" in self.names:
                return RIVALS
        if stage == RIVALS:
            if int(self.stage[1]) == ROUNDS[RIVALS]:
                self._keep_better()
            self._take_winner()
        self._enlarge()
        if not self.exact:
            self._free()
        return FINE

    @property
    def exact(self) -> bool:
        """Whether the photos follow the model, as a simulation's do; False until that is known."""
        return bool(self.unexplained[0] < EXACT)

    @property
    def fits_views(self) -> bool:
        stated = not self.unsure and (self.exact or int(self.stage[0]) == ALONE)
        return self.config.calibrate is not False and self.known and not stated

    # Other starts. Texels that share a roughness hold each other in it, be it right or wrong: which of two answers a fit of all
    # of them ends in can hang on the last bits. A start whose lobe is far narrower or wider decides such cases by their cost.

    def _next_start(self, done: int) -> None:
        """Before the first round of a trial, keep what the one before it found, and begin anew."""
        trial, late = self._trial(done)
        if late:
            return
        self._keep_better()
        self._begin(self.few)
        lobe = self.names.index("roughness")
        self.x[lobe] = (self.x[lobe] / 2, (1 + self.x[lobe]) / 2)[trial - 1].clamp(*self._bounds(lobe))
        self.mean[lobe] = self.x[lobe]

    @staticmethod
    def _trial(done: int) -> tuple[int, int]:
        """Which start is tried after so many rounds of RIVALS, and the rounds it had."""
        return divmod(ROUNDS[ALONE] + done, TRIAL)

    def _keep_better(self) -> None:
        """Keep this answer where the photos make it more probable than those of the starts before.

        Compared is -2 log of the marginal likelihood (Laplace's approximation): the cost, and by how much the photos narrow the
        prior. The cost alone takes an answer that explains photos less well for a better one where its prior is narrower.
        """
        solver, evidence = self._solver(self.x.shape[-1]), self._evidence()
        found = solver.solve(evidence, self.x, torch.full_like(self.x[0], DAMPING), self.mean, self.precision, self.low,
                             self.high, 0)
        _, narrowed = solver.posterior(evidence, self.x, self.precision)
        cost = (found.data + found.prior + narrowed - self.precision.log().sum(dim=0)).mean()
        if not self.winner or cost < self.winner["cost"]:
            self.winner = {name: getattr(self, name) for name in FOUND} | {"cost": cost}

    def _take_winner(self) -> None:
        for name in FOUND if self.winner else ():
            setattr(self, name, self.winner[name])
        self.winner = {}

    def _noise(self, stage: int, done: int) -> float:
        if stage == RIVALS:
            done = self._trial(done)[1]
            stage, done = (ALONE, done) if done < ROUNDS[ALONE] else (FINE, done - ROUNDS[ALONE])
        if stage == ALONE:
            return max(LEAST_NOISE, NOISE * EASED**done)
        if self.exact:
            return max(LEAST_NOISE, UNTOLD * float(self.unexplained[1]), NOISE * EASED**(2 * done + 2))
        return NOISE

    def _begin(self, capture: Capture) -> None:
        """The robust start with a vague prior around it."""
        guess = area_averaged(self.guess, capture.resolution)
        solver = self._solver(capture.resolution)
        start = robust_start(capture, guess, self.config.bsdf, solver.held)
        self._look_at(capture, guess)
        x = solver.numbers(start)
        self.x = torch.minimum(torch.maximum(x, self.low[:, None, None]), self.high[:, None, None]).contiguous()
        self.mean = self.x.clone()
        self.precision = torch.stack([torch.full_like(x[0], VAGUE[name] ** -2.0) for name in self.names])
        self.spread = torch.tensor([VAGUE[self.names[i]] for i in self.shares])

    def _look_at(self, capture: Capture, guess: Tensor) -> None:
        self.capture = capture
        self.member: Tensor | None = membership(appearance_of(capture, guess), self.basis, self.config.likeness)

    def _enlarge(self) -> None:
        """Go on at full size; specular and roughness follow the look-alikes there (joint upsampling, Kopf et al. 2007)."""
        if self.capture.resolution == self.full.resolution:
            return
        side, coarse = self.full.resolution, self.member
        self._look_at(self.full, self.guess)
        x = enlarged(self.x, side)
        if self.tied and len(self.shares):
            alike = self.x[self.shares].flatten(1) @ coarse / coarse.sum(dim=0).clamp_min(NOBODY)
            off = self.x[self.shares] - (alike @ coarse.T).reshape(-1, *self.x.shape[1:])
            x[self.shares] = enlarged(off, side) + (alike @ self.member.T).reshape(-1, side, side)
            x[self.shares] = x[self.shares].clamp(*self._bounds(self.shares))
        self.x, self.mean, self.precision = x, enlarged(self.mean, side), enlarged(self.precision, side)

    def _free(self) -> None:
        """Let every texel leave its tied answer, which becomes its prior; the diffuse map as it likes."""
        self.mean = self.x.clone()
        self.precision = torch.stack([torch.full_like(plane, self._freedom(name)[0] ** -2.0)
                                      for plane, name in zip(self.x, self.names, strict=True)])
        self.member = None  # a number for each texel and basis material, which none is asked for any more

    def _freedom(self, name: str) -> tuple[float, float, float]:
        """Standard deviations of a map's texels around the tied answer: at first, at least and at most."""
        if name not in FREEDOM:
            return (VAGUE[name],) * 3
        first, least, most = (max(times * self.config.own, HELD**-0.5) for times in (*FREEDOM[name], FREEST))
        return first, least, most

    # A round.

    def _solve(self) -> Tensor:
        """Solve every texel, then try other starts where they lead to less; returns the mean cost."""
        evidence = self._evidence()
        cost = self._steps(evidence, self.x, STEPS)
        for start in self._other_starts(int(self.stage[1])) if self.config.neighbours else ():
            best = self.x
            found = self._steps(evidence, start, OTHER_STEPS)
            better = found < cost * (1 - LESS)
            self.x, cost = torch.where(better, self.x, best), torch.where(better, found, cost)
        return cost.mean()

    def _other_starts(self, turn: int) -> Iterator[Tensor]:
        """The answers of two neighbours, and two tilts of a texel of which nothing else is known; others each turn."""
        by = 1 if turn % 2 else -1
        for axis in (1, 2):
            yield torch.roll(self.x, by, axis).contiguous()
        if not self.tilts:
            return
        for half_turn in (0.0, math.pi):
            steep, along = TILTS[turn % len(TILTS)], GOLDEN * turn + half_turn
            start = self.x.clone()
            start[self.shares] = self.mean[self.shares]
            start[self.tilts[0]], start[self.tilts[1]] = steep * math.cos(along), steep * math.sin(along)
            yield start

    def _steps(self, evidence: Observations, x: Tensor, count: int) -> Tensor:
        """Move :attr:`x` from ``x``; returns each texel's cost."""
        found = self._solver(x.shape[-1]).solve(evidence, x, torch.full_like(x[0], DAMPING), self.mean, self.precision,
                                               self.low, self.high, count)
        self.x = found.x
        return found.data + found.prior

    def _evidence(self) -> Observations:
        noise, end = float(self.noise), self.tied and int(self.stage[0]) == FINE
        weights = self._trust(self.config.tails) if self.tied and not end and self.config.tails else None
        return Observations(self.capture.photos, self.refined(self.capture.views), self.capture.transfer, noise,
                        (ROBUST_END if end else ROBUST) * noise, weights)

    @property
    def tied(self) -> bool:
        """Whether texels are held to what their look-alikes said: photos of a phone, once they are known to be."""
        return int(self.stage[0]) != ALONE and not self.exact

    def _trust(self, reach: float) -> Tensor:
        """How much a photo's pixels count, N x R x R: less where the flash is seen far from its mirror direction.

        There GGX is least like real materials (their highlights have longer tails), and a small glow, which all texels without
        a highlight show, would be taken for roughness. 1 / (1 + tan^2 / (reach alpha)^2) of the angle between half vector and
        the flat normal.
        """
        _, half, _ = geometry(self.refined(self.capture.views), self.capture.resolution)
        sine2 = half[..., :2].square().sum(-1)
        roughness = self._roughness(self.mean)
        return (1 / (1 + sine2 / (1 - sine2) / (reach * roughness**2) ** 2)).clamp_min(TAIL_FLOOR)

    def _roughness(self, x: Tensor) -> Tensor:
        return self._solver(x.shape[-1]).svbrdf(x)["roughness"][..., 0]

    def _variances(self) -> Tensor:
        return self._solver(self.x.shape[-1]).variances(self._evidence(), self.x, self.precision + 1e-3)

    def _share(self) -> None:
        """What look-alikes say becomes the prior of specular and roughness; the relief seen becomes that of normals."""
        variance = self._variances()
        flat = [t[self.shares].flatten(1) for t in (self.x, variance, self.mean, self.precision)]
        if len(self.shares):
            mean, self.spread = shared([self.names[i] for i in self.shares], *flat, self.member, self.spread,
                                       typical=not self.tied)
            spread = self.spread.clamp_max(self.config.spread) if self.tied else self.spread
            self.mean, self.precision = self.mean.clone(), self.precision.clone()
            self.mean[self.shares] = self._independent(mean.reshape(-1, *self.x.shape[1:]))
            self.precision[self.shares] = (spread**-2.0)[:, None, None].expand(-1, *self.x.shape[1:])
        if self.tilts:
            relief = (self.x[self.tilts].square() + variance[self.tilts]).mean().sqrt().clamp_min(LEAST_SPREAD)
            self.mean[self.tilts] = 0
            self.precision[self.tilts] = (self.config.relief if self.tied else float(relief)) ** -2.0

    def _loosen(self) -> None:
        """How far texels went from their tied answer becomes how far they may go (expectation-maximisation)."""
        variance = self._variances()
        for name in sorted(set(self.names) & set(FREEDOM)):
            planes = [i for i, own in enumerate(self.names) if own == name]
            went = ((self.x[planes] - self.mean[planes]).square() + variance[planes]).mean().sqrt()
            self.precision[planes] = float(went.clamp(*self._freedom(name)[1:])) ** -2.0

    def _level(self) -> None:
        """Move the flash of all photos until the patch as a whole is flat.

        Normals that lean by a slope s show their highlights s z beside the place below the camera, as a flash 2 s z beside it
        does. A refinement with the maps frozen cannot find that: what their diffuse map has taken up holds the flash.
        """
        slope = self.x[self.tilts].mean(dim=(1, 2)).double()
        said = self.change[0, 3:5] - 2 * self.full.views.in_patch_sides().camera[:, 2].mean() * slope
        variance = torch.tensor(PRIORS[self.full.calibration].common_flash).double().square()
        self.change[:, 3:5] += DAMPED * (variance / (variance + TILTED**2) * said - self.change[0, 3:5])
        self.x[self.tilts] -= slope.float()[:, None, None]

    def _refine_views(self) -> None:
        """Where camera and flash stood, from the maps so far; the patch as a whole is flat (it lies in z = 0)."""
        if self.tilts and int(self.stage[0]) != FINE:
            self.x[self.tilts] -= self.x[self.tilts].mean(dim=(1, 2), keepdim=True)
        priors = PRIORS[self.full.calibration]
        priors = priors if self.fits_offset else replace(priors, common_flash=(0.0, 0.0))
        steps = FEW_STEPS if self.unsure else ITERATIONS
        found = refine_views(self._solver(self.x.shape[-1]).svbrdf(self.x), self.capture.views, self.capture, priors, steps)
        self.change, self.deviation = found.change, found.deviation
        self.flash_deviation = found.common_covariance.diagonal().sqrt()

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the changes of the views, N x 7, and of the common flash offset; None where not refined."""
        if not self.deviation.any():
            return None, None
        return self.deviation, self.flash_deviation if self.fits_offset else None

    # What comes out.

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present maps at full size, of tied texels with the freedom that they have in the end."""
        side = self.full.resolution
        if self.winner and int(self.stage[0]) == RIVALS:
            x = enlarged(self.winner["x"], side)
        elif self.tied:
            x = (self if int(self.stage[0]) == FINE else self._ahead())._closed()
        else:
            x = self.x if self.x.shape[-1] == side else enlarged(self.x, side)
        return self._solver(side).svbrdf(x).map(Tensor.contiguous), self.refined(self.views)

    def preview(self) -> SVBRDF:
        """The present answer as it is, at the size of the present stage."""
        return self._solver(self.x.shape[-1]).svbrdf(self.x)

    def _ahead(self) -> Hierarchical:
        """This fit as if its last stage began now."""
        ahead = copy(self)
        ahead._enlarge()
        ahead._free()
        ahead.stage = torch.tensor([FINE, 0])
        ahead._steps(ahead._evidence(), ahead.x, LAST_STEPS)
        return ahead

    def _closed(self) -> Tensor:
        """The answer with what the photos burnt in taken out, and the diffuse map that belongs to it."""
        x = self.x
        if len(self.shares):
            x = x.clone()
            x[self.shares] = self._independent(x[self.shares]).clamp(*self._bounds(self.shares))
        precision = torch.stack([torch.full_like(plane, HELD if name in FREEDOM else VAGUE[name] ** -2.0)
                                 for plane, name in zip(x, self.names, strict=True)])
        return self._solver(x.shape[-1]).solve(self._evidence(), x, torch.full_like(x[0], DAMPING), x, precision, self.low,
                                               self.high, LAST_STEPS).x

    def _independent(self, planes: Tensor) -> Tensor:
        """Maps S x R x R with a weaker cubic trend along the coverage angle, at the level of where the highlights were.

        A material knows nothing of where the camera stood; a map that follows it was taught by what the model lacks. As much
        of the trend stays as explains a share :data:`CHANCE` of a map's variance: that may be the material's own.
        """
        if not (self.tied and self.config.independent):
            return planes
        angle = coverage_angle(self.refined(self.capture.views), planes.shape[-1]).flatten()
        trend, trust = cubic(angle, planes.flatten(1)), self._trust(self.config.tails or 1.0).amax(dim=0).flatten()
        along = (trend - trend.mean(dim=1, keepdim=True)).square().mean(dim=1).clamp_min(1e-12)
        across = (planes.flatten(1).double().var(dim=1, correction=0) - along).clamp_min(0)
        kept = (CHANCE / (1 - CHANCE) * across / along).sqrt().clamp_max(1)
        trend = (1 - kept)[:, None] * trend
        level = (trust * trend).sum(dim=1, keepdim=True) / trust.sum()
        return planes - (trend - level).reshape(planes.shape).float()

    def _bounds(self, index: Tensor) -> tuple[Tensor, Tensor]:
        return self.low[index, None, None], self.high[index, None, None]

    def refined(self, views: Views) -> Views:
        """Views with the changes found so far."""
        camera, flash = self.change[:, :3] * views.size, self.change[:, 3:6] * views.size
        return replace(views, camera=views.camera + camera, light=views.light + camera + flash,
                       intensity=views.intensity * self.change[:, 6:].exp())

    def _unexplained(self) -> Tensor:
        """Structure and RMSE of the errors in display values, clipped pixels left out.

        Structure is the root of the mean product of neighbouring errors: sensor noise has none, a wrong model has.
        """
        photos, views = self.capture.photos, self.refined(self.capture.views)
        with torch.no_grad():
            images = make_renderer("mitsuba", self.variant).render(self._solver(self.x.shape[-1]).svbrdf(self.x), views)
        error = torch.where(photos < CLIPPED, color.to_display(images, self.capture.transfer) - photos, 0.0)
        alike = (error[:, 1:] * error[:, :-1]).mean() + (error[:, :, 1:] * error[:, :, :-1]).mean()
        return torch.stack(((alike / 2).clamp_min(0), error.square().mean())).sqrt()

    def _solver(self, side: int) -> TexelSolver:
        if side not in self.solvers:
            held = {name: area_averaged(value, side) for name, value in self.fixed.items()}
            self.solvers[side] = TexelSolver(self.config.bsdf, held, self.config.grey_specular, self.variant)
        return self.solvers[side]

    # Its state.

    def cut_step(self) -> None:
        """Nothing to halve: a step of Levenberg-Marquardt that is too long is refused by the solver."""

    def state(self) -> dict[str, Tensor]:
        return {name: getattr(self, name).clone() for name in
                (*FOUND, "change", "deviation", "flash_deviation", "stage", "noise")} | {
            "unexplained": self.unexplained.nan_to_num(-1.0)} | {
            f"winner.{name}": value for name, value in self.winner.items()}

    def load_state(self, state: dict[str, Tensor]) -> None:
        self.winner = {name.removeprefix("winner."): value for name, value in state.items() if name.startswith("winner.")}
        for name in state.keys() - {f"winner.{name}" for name in self.winner}:
            setattr(self, name, state[name].clone())
        self.unexplained = torch.where(self.unexplained < 0, torch.nan, self.unexplained)
        capture = {ALONE: self.few, RIVALS: self.few, TOGETHER: self.small, FINE: self.full}[int(self.stage[0])]
        self._look_at(capture, area_averaged(self.guess, capture.resolution))
        if self.tied and int(self.stage[0]) == FINE:
            self.member = None
