"""The fit of one photo of a material that repeats itself, by classes of texels (:mod:`.look_classes`).

The widths of lobes are checked: the maps, shifted and rendered, must resemble the photo (`repeats.unlike`).
"""

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..material.maps import SVBRDF
from ..views import Views
from .checkpoint import Held
from .config import HierarchicalConfig
from .hierarchical.sharing import basis_materials
from .look_classes import CLASSES, LookClasses, Pixels, material
from .method import Method, cosine
from .repeats import unlike
from .task import FitTask

# Roughness and F0 of starts: LOOKS with the diffuse colours of pixels, METALS with diffuse colour BLACK.
LOOKS = (0.2, 0.04), (0.4, 0.04), (0.7, 0.04)
METALS, BLACK = ((0.3, 0.1), (0.25, 0.3), (0.25, 0.7), (0.45, 0.5)), 0.02
# Reliefs of classes: those of metals differ, else equal classes would have equal gradients and stay equal.
ALIKE, APART = (0.1,) * CLASSES, tuple(0.1 * 2.0 ** (k - CLASSES // 2) for k in range(CLASSES))
TRIED, STEPS, ITERATIONS = 50, 80, 10  # Adam's steps from a start, from the best one, in a step of the method
AGAIN = 3  # likeliest starts: they descend once more before one is chosen, as first descents are not reliable
FEW, SOME, MANY = 512, 1024, 1536  # pixels of a descent: from all starts, from the likeliest, from the best
NODES, MORE, MOST = 16, 24, 64  # nodes (samples) a pixel: in descents from all starts, later ones, at the end
RATES = 0.06, 0.04, 0.03  # Adam's step sizes: for all starts, for the likeliest and for the best one
BEFOREHAND = 1e-3  # weight of the log prior, beside the log likelihood of a pixel
STATIONARY = 1.0  # weight of how uneven texels are, beside the log likelihood of a pixel
UNLIKELIEST = -60.0  # least log likelihood of a pixel, for pixels that no class explains
CHUNK = 2048  # pixels at once
WORST = 1e30  # cost of a start that was not tried, or is not finite
# Lobes are widened by a factor times the variance of slopes. A factor above 0 is used if the error of shifted
# maps is then less than LESS times that of factor 0. Factor 2: slopes have longer tails than normal numbers.
WIDER, LESS = (0.0, 1.0, 2.0), 0.5


def nodes(pixels: int, count: int, seed: int) -> Tensor:
    """Evenly spread normal numbers, M x J x 3; the numbers of each pixel are rotated by its own angle."""
    even = torch.quasirandom.SobolEngine(3, scramble=True, seed=seed).draw(count).clamp(1e-4, 1 - 1e-4)
    x, y, z = torch.special.ndtri(even).T
    turn = (torch.arange(pixels) * math.pi * (3 - math.sqrt(5)))[:, None]
    return torch.stack((x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos(),
                        z.expand(pixels, -1)), dim=-1)


class OnePhoto(Method[HierarchicalConfig]):
    """Gradient descent to the likeliest classes: from each start, from the likeliest ones, from the best one.

    It also finds place and light power of a view that is not stated, or the place of one to be refined.
    """

    measured_every = 10**6  # steps: maps are computed once, at the end
    latest_is_best = True

    def __init__(self, task: FitTask[HierarchicalConfig]) -> None:
        super().__init__(task)
        self.pixels, told = Pixels.of(task.capture), task.capture.calibrated
        self.held = task.config.holds_views or told and not task.config.refines_views, told
        self.begun = task.start()
        self.tried = self._starts()
        self.costs, self.done_steps = torch.full((len(self.tried),), WORST), 0
        self._descend_from(self.tried[0])

    def _starts(self) -> Tensor:
        """The starts, a row each: numbers of classes that look like pixels away from the highlight."""
        flat = LookClasses.start(torch.full((CLASSES, 3), 0.5), *LOOKS[0], ALIKE)
        half, white = LookClasses(flat, self.views, True).lit(self.pixels.at)
        aside = half.norm(dim=1) > half.norm(dim=1).median()
        looks = color.encode((self.pixels.shown / white).clamp(0, 1))[aside]
        found = basis_materials(F.pad(looks, (0, 2)).contiguous(), CLASSES, self.config.seed)[:, :3]
        found = torch.cat((found, found[-1:].expand(CLASSES - len(found), -1)))
        return torch.stack([LookClasses.start(colours, *lobe, relief) for colours, lobes, relief in (
            (found, LOOKS, ALIKE), (torch.full_like(found, BLACK), METALS, APART)) for lobe in lobes])

    def _descend_from(self, numbers: Tensor) -> None:
        self.numbers = numbers.clone().requires_grad_()
        self.optimizer = torch.optim.Adam([self.numbers], betas=(0.9, 0.99))

    @property
    def last(self) -> int:
        """Number of steps made in the last descent; less than 0 while starts are tried."""
        return self.done_steps - len(self.tried) - AGAIN

    @property
    def done(self) -> bool:
        """Whether the last descent has ended."""
        return self.last >= STEPS // ITERATIONS

    def step(self, progress: float) -> dict[str, float]:
        """Descend from the next start, again from one of the likeliest, or further from the best one."""
        again = self.done_steps - len(self.tried)
        if self.last >= 0:
            cost = self._descents(ITERATIONS, self.last * ITERATIONS, STEPS, self.pace * RATES[2], MANY, MORE)
        elif again >= 0:
            cost = self._try(again, AGAIN, RATES[1], SOME, MORE)
        else:
            cost = self._try(self.done_steps, len(self.tried), RATES[0], FEW, NODES)
        self.done_steps += 1
        return {"cost": cost}

    def _try(self, k: int, of: int, rate: float, pixels: int, many: int) -> float:
        """Descend from start ``k``; after the last of the starts, sort them: the likeliest first."""
        self._descend_from(self.tried[k])
        cost = self._descents(TRIED, 0, TRIED, rate, pixels, many)
        if math.isnan(cost):  # such a start is skipped
            cost = WORST
            self._descend_from(self.tried[k])
        self.tried[k], self.costs[k] = self.numbers.detach(), cost
        if k + 1 == of:
            order = self.costs[:of].argsort(stable=True)
            self.tried[:of], self.costs[:of] = self.tried[order], self.costs[order]
            self._descend_from(self.tried[0])
        return cost

    def _descents(self, count: int, first: int, of: int, rate: float, pixels: int, many: int) -> float:
        """Descend; returns a pixel's mean cost in the last steps: -log likelihood, unevenness, prior.

        Each step lowers all unevenness, also that by chance, so that texels vary no more than they must. The
        mean omits the part by chance: else a lobe that hardly shows, whose texels do not vary, would be best.
        """
        total, costs = len(self.pixels.at), []
        for k in range(first, first + count):
            random = torch.Generator().manual_seed(self.config.seed * 1000 + k)
            some = self.pixels.pick(torch.randint(total, (pixels,), generator=random))
            classes = LookClasses(self.numbers, self.views, *self.held)
            found = classes.posterior(some, nodes(pixels, many, k))
            likely = found.likely.flatten(1).logsumexp(dim=1).clamp_min(UNLIKELIEST).mean()
            uneven, chance = classes.uneven(found, some.at)
            cost = STATIONARY * uneven - likely - BEFOREHAND * classes.prior()
            self.optimizer.param_groups[0]["lr"] = rate * cosine(k / of, 0.05)
            self.optimizer.zero_grad()
            cost.backward()
            if self.numbers.grad is None or not torch.isfinite(self.numbers.grad).all():
                return math.nan
            self.optimizer.step()
            costs.append(float((cost - STATIONARY * chance).detach()))
        return sum(costs[-10:]) / len(costs[-10:])

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The maps from the present classes; the robust start until all starts were tried."""
        if self.last < -AGAIN:
            return self.begun, self.views
        numbers = self.numbers.detach() if self.last >= 0 else self.tried[0]
        classes, parts = LookClasses(numbers, self.views, *self.held), []
        with torch.no_grad():
            for some in torch.arange(len(self.pixels.at)).split(CHUNK):
                found = classes.posterior(self.pixels.pick(some), nodes(len(some), MOST, self.config.seed))
                parts.append((classes.texels(found, classes.specular), classes.lost(found)))
        texels, lost = (torch.cat(part) for part in zip(*parts))
        views = self.views.carried(classes.moved.double() * self.views.size)
        views = replace(views, intensity=views.intensity * float(classes.power.exp()))
        return self._widened(texels, lost, views), views

    def _widened(self, texels: Tensor, lost: Tensor, views: Views) -> SVBRDF:
        """The material of texels; at the end, with lobes widened if the maps then suit the photo better."""
        side = self.capture.resolution
        found = [material(texels, wider * lost, side) for wider in WIDER[:None if self.done else 1]]
        misses = [unlike(svbrdf, views, self.capture, self.renderer) for svbrdf in found]
        least = min(range(len(found)), key=misses.__getitem__)
        return found[least if misses[least] < LESS * misses[0] else 0]

    @property
    def parts(self) -> dict[str, Held]:
        """The present numbers, the starts with their costs, and Adam's averages."""
        return {"numbers": self.numbers, "tried": self.tried, "costs": self.costs, "adam": self.optimizer}

    def state(self) -> dict[str, Tensor]:
        """The state of the parts, and the number of steps done."""
        return super().state() | {"done": torch.tensor(self.done_steps)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        self._descend_from(self.numbers.detach())  # without averages
        super().load_state(state)
        self.done_steps = int(state["done"])
