"""What the parts of a fit are measured on: made photos of every kind, each of another material, and real
ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from ...material.made import make_material
from ...material.maps import SVBRDF
from ...render import Renderer
from ...synth import photograph
from ...views import nine_view_grid
from ..tasks import KnownMaterial, Task, known_material, real_capture
from .parts import EXACT, MATTE, NOISY, OFF, REAL


class Scene(NamedTuple):
    """What is fitted, and of which kind it is."""

    kind: str
    task: Task

    @property
    def key(self) -> dict:
        """What identifies it in a record."""
        return self.task.key | {"kind": self.kind}


def scenes(resolution: int, renderer: Renderer, captures: Sequence[Path] = ()) -> list[Scene]:
    """One made scene of every kind, and the real ones.

    Args:
        resolution: of the fits.
        renderer: of the made photos.
        captures: folders of real photos; 4 and 7 are left out and predicted.
    """
    views = nine_view_grid()
    leather, plates, tiles = (make_material(name, resolution) for name in ("leather", "plates", "tiles"))
    matte = SVBRDF(leather.bsdf, dict(leather.maps) | {"specular": torch.zeros_like(leather["specular"])})
    turns = torch.tensor([1.0, -1.0, 0.0] * 3, dtype=views.camera.dtype)[:, None]
    moved = replace(views, camera=views.camera * (1 + 0.03 * turns), light=views.light * (1 + 0.03 * turns),
                    intensity=views.intensity * (1 - 0.1 * turns))
    shots = replace(photograph(tiles, moved, renderer), views=views)
    return [Scene(EXACT, known_material("builtin:inlay", resolution, views, renderer)),
            Scene(MATTE, KnownMaterial("matte leather", matte, None, photograph(matte, views, renderer))),
            Scene(NOISY, KnownMaterial("noisy plates", plates, None, photograph(plates, views, renderer,
                                                                                noise=0.003))),
            Scene(OFF, KnownMaterial("tiles, cameras off", tiles, None, shots)),
            *(Scene(REAL, real_capture(folder, resolution)) for folder in captures)]
