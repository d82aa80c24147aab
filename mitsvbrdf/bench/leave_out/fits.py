"""Each part of a fit measured by fits with it and without it: one record of a benchmark's file for a part and
a scene.

The two fits of a pair take turns in one process, so that a ratio of their seconds is fair where seconds are
not.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ...fit import FitConfig
from ...fit.methods import method_name
from ...io.profile import profiling
from ...io.timing import in_turns
from ...render import Renderer
from ..jobs import check_finite
from ..methods import Fitted, fit, settings_of
from .parts import Part
from .scenes import Scene

SUITE = "leave-out"
# Seconds of a fit: those that its size does not change, and those of each texel.
SECONDS = {"hierarchical": (3.5, 0.0023), "hybrid": (8.0, 0.0018), "gan": (16.0, 0.0007)}


@dataclass(frozen=True)
class PairJob:
    """A part of a fit on one scene.

    Args:
        part: to leave out.
        scene: what is fitted.
        repeats: turns.
        renderer: carries the gradients.
    """

    part: Part
    scene: Scene
    repeats: int
    renderer: Renderer

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": SUITE, "method": self.part.name, **self.scene.key}

    @property
    def settings(self) -> dict:
        """What else shapes the record: the settings of both fits."""
        return {side: settings_of(config) for side, config in self._sides().items()}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"{self.part.name}, {self.scene.task.name}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return self.part.of

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        texels = self.scene.task.photos.resolution**2
        own = [SECONDS[method_name(config)] for config in self._sides().values()]
        return self.repeats * sum(fixed + each * texels for fixed, each in own)

    def _sides(self) -> dict[str, FitConfig]:
        """The settings with the part and those without it."""
        config, other = self.part.config, self.part.other
        return {"with": other, "without": config} if self.part.put_in else {"with": config, "without": other}

    def run(self, report: Callable[[float], None] = lambda share: None) -> dict:
        """The figures, after a step of each that warms up:
        :class:`mitsvbrdf.bench.records.LeaveOutRecord`.
        """
        sides = self._sides()
        for config in sides.values():
            fit(self.scene.task.photos, self.renderer, replace(config, budget=None, iterations=1))
        turns = in_turns({side: partial(self._fit, side) for side in sides}, self.repeats, 0, report)
        errors = {side: self.scene.task.errors(each[0][0]) for side, each in turns.items()}
        for each in errors.values():
            check_finite(each)
        usual = "without" if self.part.put_in else "with"
        return {"part": self.part.what, "says": [self.part.what, *self.part.says], "of": self.part.of,
                "put_in": self.part.put_in, "photos": len(self.scene.task.photos),
                "seconds": {side: [fitted.wall for fitted, _ in each] for side, each in turns.items()},
                "spent": turns[usual][0][1], "errors": errors}

    def _fit(self, side: str) -> tuple[Fitted, dict[str, float]]:
        """A fit and its seconds by part of it."""
        config, photos, part = self._sides()[side], self.scene.task.photos, self.part
        less = (side == "with") == part.put_in  # the program's own way is the other
        with profiling() as profile, changed(
            *part.table) if less and part.table else contextlib.nullcontext():
            fitted = fit(part.photos(photos) if less and part.photos else photos, self.renderer, config)
        return fitted, profile.totals()


def pair_jobs(listed: Sequence[Part], chosen: Sequence[Scene], repeats: int,
              renderer: Renderer) -> list[PairJob]:
    """Every part on every scene of its kinds, in the order of the scenes.

    Args:
        listed: parts to leave out.
        chosen: scenes to fit.
        repeats: turns of each pair.
        renderer: carries the gradients.
    """
    return [PairJob(part, scene, repeats, renderer) for scene in chosen for part in listed
            if scene.kind in part.kinds]


@contextlib.contextmanager
def changed(table: dict, changes: Mapping) -> Iterator[None]:
    """A table with other entries for a while."""
    before = dict(table)
    table.update(changes)
    try:
        yield
    finally:
        table.update(before)
