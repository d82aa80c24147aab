"""What is fitted: photos of known materials, judged by their maps, and real photos, judged by some that were left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch

from ..capture import Capture, read_capture
from ..color import to_display
from ..errors import ConfigError
from ..evaluate import evaluate_maps
from ..material.made import make_material
from ..material.map_files import load_maps
from ..material.maps import SVBRDF
from ..measure.metrics import map_rmse, photo_rmse
from ..render import Renderer, make_renderer
from ..synth import photograph
from ..views import Views
from .methods import Fitted

LEFT_OUT = (4, 7)  # numbers of the photos that fits of real captures do not see, where nothing else is said


@dataclass(frozen=True)
class KnownMaterial:
    """Made photos of known maps.

    Args:
        name: of the material.
        truth: its maps.
        folder: where they were read; None for a made material.
        photos: what is fitted.
    """

    kind: ClassVar = "material"
    name: str
    truth: SVBRDF
    folder: Path | None
    photos: Capture

    def errors(self, found: Fitted) -> dict[str, float]:
        """RMSE of each map and their ``mean``, of pictures under ``novel_light``, and of the ``photos`` themselves."""
        maps = map_rmse(found.svbrdf, self.truth) if self.folder is None else evaluate_maps(found.svbrdf, self.folder)
        novel = novel_light_rmse(found.svbrdf, self.truth, self.photos.views)
        return maps | {"novel_light": novel, "photos": found.rmse}


@dataclass(frozen=True)
class RealCapture:
    """Real photos, some of them left out.

    Args:
        name: of the capture.
        photos: what is fitted.
        left_out: what is predicted; None where the capture has none of these photos, or states no views to predict from.
    """

    kind: ClassVar = "capture"
    name: str
    photos: Capture
    left_out: Capture | None

    def errors(self, found: Fitted) -> dict[str, float]:
        """RMSE in display values of the photos ``seen`` and, where there are any, ``left_out``."""
        predicted = {} if self.left_out is None else {"left_out": found.predict(self.left_out)}
        return {"seen": found.rmse} | predicted


def known_material(name: str, resolution: int, views: Views, renderer: Renderer) -> KnownMaterial:
    """A task from ``builtin:NAME`` or a folder of maps: 8-bit photos without noise, for these views.

    Raises:
        MapsError, ConfigError: no such material.
    """
    if name.startswith("builtin:"):
        truth, folder = make_material(name.removeprefix("builtin:"), resolution), None
    else:
        truth, folder = load_maps(name), Path(name)
    shown = truth.resized(min(resolution, truth.resolution))
    return KnownMaterial(name.removeprefix("builtin:") if folder is None else folder.name, truth, folder,
                         photograph(shown, views, renderer))


def real_capture(folder: Path, resolution: int, left_out: Sequence[int] = LEFT_OUT) -> RealCapture:
    """A task from a folder of photos.

    Args:
        folder: of the capture.
        resolution: of the fit.
        left_out: numbers of the photos that it does not see.

    Raises:
        CaptureError, ConfigError: photos that cannot be used, or none that is not left out.
    """
    shots = read_capture(folder, resolution=resolution)
    seen = [i for i in shots.index if i not in left_out]
    if not seen:
        raise ConfigError(f"photos besides {tuple(left_out)}", f"{list(shots.index)} in {folder}",
                          "give a capture with more photos")
    held = [i for i in shots.index if i in left_out and shots.calibrated]
    return RealCapture(folder.name, shots.pick(seen), shots.pick(held) if held else None)


def novel_light_rmse(svbrdf: SVBRDF, truth: SVBRDF, views: Views) -> float:
    """How different two materials look under lights that no photo had: RMSE in display values, over :func:`novel_views`.

    Args:
        svbrdf: the estimate.
        truth: the known material; the larger of both is area-averaged to the smaller.
        views: those of the photos.
    """
    size, renderer, lit = min(svbrdf.resolution, truth.resolution), make_renderer("analytic"), novel_views(views)
    with torch.no_grad():
        found, exact = (renderer.render(m.as_roughconductor().resized(size), lit) for m in (svbrdf, truth))
    return photo_rmse(found, to_display(exact))[0]


def novel_views(views: Views, tilts: Sequence[float] = (25.0, 50.0), around: int = 4) -> Views:
    """Seen from straight above and lit from the side: lights off the lens, as no photo with a flash has them.

    Args:
        views: those of the photos; their mean height is the distance of camera and lights.
        tilts: degrees between the lights and the upright; each further ring is turned by half a step.
        around: lights of each tilt.

    Returns:
        Views in patch sides; a white diffuse texel straight below such a light, were it upright, has radiance 1.
    """
    height = float(views.in_patch_sides().camera[:, 2].mean())
    lights = []
    for ring, tilt in enumerate(map(math.radians, tilts)):
        for k in range(around):
            turn = 2 * math.pi * (k + ring / 2) / around
            lights.append([height * math.sin(tilt) * math.cos(turn), height * math.sin(tilt) * math.sin(turn),
                           height * math.cos(tilt)])
    return Views.of([[0.0, 0.0, height]] * len(lights), lights, math.pi * height**2)


Task = KnownMaterial | RealCapture
