"""The interface of a method to the loop, and code that methods share."""

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
    """Something that is trained step by step. Its whole running state is a dict of named tensors."""

    pace = 1.0  # factor of all step sizes

    @property
    def parts(self) -> dict[str, Held]:
        """A dict: name to each thing that steps change."""
        return {}

    def state(self) -> dict[str, Tensor]:
        """Everything that :meth:`load_state` needs to continue with identical results."""
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
    latest_is_best = False  # whether the result is the last state; False: the state with the lowest error
    ended = False  # whether no step follows, and only the result is still needed

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
        """One iteration; returns the unweighted losses before it. ``progress``: share of the run, 0 to 1."""

    @abstractmethod
    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present material and views, detached."""

    def end(self) -> None:  # noqa: B027
        """Free memory that only further steps would need."""

    @property
    def done(self) -> bool:
        """Whether further steps would change nothing."""
        return False

    @property
    def cut_short(self) -> bool:
        """Whether a part of the method, on which later parts build, has not settled."""
        return False

    def glimpse(self) -> tuple[SVBRDF, Views, Capture] | None:
        """A small sample of :meth:`estimate` with its photos, if the whole takes long; else None."""
        return None

    def preview(self) -> SVBRDF | None:
        """The present material at any resolution, if it costs nearly nothing; else None."""
        return None

    @property
    def omitted(self) -> list[Omitted]:
        """The parts that the method omitted, because it found while running that they were not needed."""
        return []

    @property
    def views_deviation(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the view changes, N x 7, and of the flash offset; None if not refined."""
        return None, None


def descend(total: Tensor, *optimizers: torch.optim.Optimizer) -> float:
    """One step of each optimiser down the gradient of ``total``, unless that gradient is not finite.

    Returns 0, or NaN if no step was made. The loop undoes a step whose losses contain NaN.
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
