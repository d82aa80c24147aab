"""What the loop asks of a method, and what methods share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Generic

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF
from ..render.needs import Omitted
from ..views import Views
from . import losses
from .checkpoint import Held, load_parts, state_of
from .task import Config, FitTask


class Trained:
    """What is advanced step by step. Its whole running state is named tensors."""

    pace = 1.0  # factor of all step sizes

    @property
    def parts(self) -> dict[str, Held]:
        """What steps change, by name."""
        return {}

    def state(self) -> dict[str, Tensor]:
        """Everything a later :meth:`load_state` needs to go on bit by bit."""
        return state_of(self.parts) | {"pace": torch.tensor(self.pace, dtype=torch.float64)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Continue from a saved state."""
        load_parts(self.parts, state)
        self.pace = float(state["pace"])

    def cut_step(self) -> None:
        """Halve the step sizes, after a step was undone."""
        self.pace /= 2


class Method(ABC, Trained, Generic[Config]):
    """One way to fit."""

    measured_every = 10  # steps; a fixed count, so that a resumed run keeps the same best result
    latest_is_best = False  # whether the result is the last state, not the one that explains photos best
    ended = False  # whether no step follows: only the result is asked for

    def __init__(self, task: FitTask[Config]) -> None:
        self.capture, self.renderer, self.config = task.capture, task.renderer, task.config
        self.views, self.fixed, self.unused = task.capture.views, task.fixed, task.unused
        self.fits_offset = task.why_no_flash_offset is None

    def compared(self, rendered: Tensor) -> Tensor:
        """Renderings (linear, N x R x R x 3); masked pixels get the photo's values, so they have no error."""
        measured = self.capture.measured
        return rendered if measured is None else torch.where(measured[..., None], rendered,
                                                             self.capture.linear.to(rendered))

    def summed(self, own: Mapping[str, Callable[[], Tensor]]) -> tuple[Tensor, dict[str, float]]:
        """The weighted sum of the losses that are computed, and the value of each."""
        terms = {name: loss() for name, loss in own.items() if name not in self.unused}
        return (losses.weighted(terms, self.config.weights),
                {name: float(value.detach()) for name, value in terms.items()})

    @abstractmethod
    def step(self, progress: float) -> dict[str, float]:
        """One iteration at this share (0 to 1) of the run; returns the unweighted losses before it."""

    @abstractmethod
    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present material and views, detached."""

    def end(self) -> None:  # noqa: B027
        """Free what only further steps would need."""

    @property
    def done(self) -> bool:
        """Whether going on would change nothing."""
        return False

    @property
    def cut_short(self) -> bool:
        """Whether a part of the method, on which later parts build, has not settled."""
        return False

    def glimpse(self) -> tuple[SVBRDF, Views, Capture] | None:
        """A small sample of :meth:`estimate` with its photos, while the whole takes long; else None."""
        return None

    def preview(self) -> SVBRDF | None:
        """The present material of any size, nearly for free; None stands for the latest measurement."""
        return None

    @property
    def omitted(self) -> list[Omitted]:
        """What the method found not to be needed while it ran."""
        return []

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the view changes, N x 7, and of the flash offset; None if not refined."""
        return None, None


def descend(total: Tensor, *optimizers: torch.optim.Optimizer) -> float:
    """One step of each optimiser down the gradient of ``total``, unless that gradient is not finite.

    Gives 0, or NaN where no step was made. The loop undoes a step whose losses contain NaN.
    """
    for optimizer in optimizers:
        optimizer.zero_grad(set_to_none=True)
    total.backward()
    gradients = [p.grad for o in optimizers for group in o.param_groups for p in group["params"]
                 if p.grad is not None]
    if not math.isfinite(float(torch.nn.utils.get_total_norm(gradients))):
        return math.nan
    for optimizer in optimizers:
        optimizer.step()
    return 0.0


def cosine(progress: float, floor: float = 0.02) -> float:
    """Falls from 1 to ``floor`` along half a cosine."""
    return floor + (1 - floor) * (1 + math.cos(math.pi * progress)) / 2
