"""What fits are compared with: guessed diffuse maps, the start they make, and maps that published methods
recovered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

from ...capture.guess import GuessMethod, guess_diffuse
from ...evaluate import evaluate_capture, evaluate_maps
from ...fit.start import robust_start
from ...material.map_files import load_maps
from ...material.maps import SVBRDF
from ...measure.metrics import map_rmse
from ...render import Renderer
from ..code import own_code
from ..published import METHOD_NAMES
from ..tasks import KnownMaterial, Task, novel_light_rmse

START = "the start"
SECONDS = 8.0  # a guess, only to say how long it will take


def guess_by(method: str) -> str:
    """Under what name the errors of a guessed diffuse map stand."""
    return f"guess {method}"


@dataclass(frozen=True)
class ReferenceJob:
    """The references of one known material or real capture.

    Args:
        task: what is fitted.
        renderer: draws the photos.
    """

    task: Task
    renderer: Renderer

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "references", **self.task.key}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return {"guesses": list(get_args(GuessMethod)), "code": own_code(__name__)}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"references, {self.task.name}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return "references"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        return SECONDS

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures: whose -> error -> value, of each guess, of the start with the default guess, of
        published maps.
        """
        photos = self.task.photos
        starts = {}
        for number, method in enumerate(get_args(GuessMethod)):
            starts[method] = robust_start(photos, guess_diffuse(photos, method), "roughconductor")
            report((number + 1) / (len(get_args(GuessMethod)) + 1))
        first = next(iter(starts.values()))  # the default method comes first
        if isinstance(self.task, KnownMaterial):
            guesses = {guess_by(method): {"diffuse": self._of_maps(maps)["diffuse"]}
                       for method, maps in starts.items()}
            found = guesses | {START: self._of_material(first) | {"photos": self._of_photos(first)["seen"]}}
            found |= {name: self._of_material(maps) for name, maps in peers(self.task).items()}
        else:
            found = {START: self._of_photos(first)}
        return {"errors": found}

    def _of_maps(self, maps: SVBRDF) -> dict[str, float]:
        assert isinstance(self.task, KnownMaterial)
        return (map_rmse(maps, self.task.truth) if self.task.folder is None
                else evaluate_maps(maps, self.task.folder))

    def _of_material(self, maps: SVBRDF) -> dict[str, float]:
        assert isinstance(self.task, KnownMaterial)
        return self._of_maps(maps) | {"novel_light": novel_light_rmse(maps, self.task.truth,
                                                                      self.task.photos.views)}

    def _of_photos(self, maps: SVBRDF) -> dict[str, float]:
        parts = {"seen": self.task.photos, "left_out": getattr(self.task, "unseen", None)}
        return {part: evaluate_capture(maps, shots, self.renderer)["rerender_rmse"]
                for part, shots in parts.items() if shots is not None}


def peers(task: KnownMaterial) -> dict[str, SVBRDF]:
    """Whose -> the maps that published methods recovered of a known material, no larger than its photos here.

    They lie in folders in ``peers/`` beside the known maps. Errors are counted at the size of the smaller
    maps: larger ones than those of the fits would be held against more detail.
    """
    inside = task.folder / "peers" if task.folder else None
    found = {METHOD_NAMES.get(p.name, p.name): load_maps(p) for p in sorted(inside.iterdir())
             if p.is_dir()} if inside and inside.is_dir() else {}
    return {who: maps.resized(min(maps.resolution, task.photos.resolution)) for who, maps in found.items()}
