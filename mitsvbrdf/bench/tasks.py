"""What is fitted: photos of known materials, judged by their maps, and real photos, judged by some that were
left out.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from ..capture import Capture, read_capture
from ..color import Transfer, to_display
from ..errors import ConfigError
from ..evaluate import evaluate_maps
from ..material.made import make_material
from ..material.map_files import load_maps
from ..material.maps import SVBRDF
from ..measure.metrics import flip, map_rmse, photo_rmse
from ..render import Renderer, make_renderer
from ..synth import photograph
from ..views import Views
from .methods import Fitted
from .schema import USUAL_LEFT_OUT


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

    @property
    def key(self) -> dict:
        """What identifies it in a record."""
        return {"kind": self.kind, "name": self.name}

    def errors(self, found: Fitted) -> dict[str, float]:
        """RMSE of each map and their ``mean``, of pictures under ``novel_light``, and of the ``photos``
        themselves.
        """
        maps = (map_rmse(found.svbrdf, self.truth) if self.folder is None
                else evaluate_maps(found.svbrdf, self.folder))
        novel = novel_light_rmse(found.svbrdf, self.truth, self.photos.views)
        return maps | {"novel_light": novel, "photos": found.rmse}

    def looks(self, found: Fitted) -> dict[str, float]:
        """Mean FLIP of pictures under ``flip_novel_light``, and of the ``flip_photos`` themselves."""
        return {"flip_novel_light": mean_flip(*novel_pictures(found.svbrdf, self.truth, self.photos.views)),
                "flip_photos": mean_flip(found.predict(self.photos)[0], self.photos.linear,
                                         self.photos.transfer)}


@dataclass(frozen=True)
class RealCapture:
    """Real photos, some of them left out.

    Args:
        name: of the capture.
        photos: what is fitted.
        unseen: what is predicted; None where the capture has none of these photos, or states no views to
            predict from.
        left_out: the numbers of the photos that were to be left out.
    """

    kind: ClassVar = "capture"
    name: str
    photos: Capture
    unseen: Capture | None
    left_out: tuple[int, ...] = USUAL_LEFT_OUT

    @property
    def key(self) -> dict:
        """What identifies it in a record."""
        return {"kind": self.kind, "name": self.name, "left_out": list(self.left_out)}

    def errors(self, found: Fitted) -> dict[str, float]:
        """RMSE in display values of the photos ``seen`` and, where there are any, ``left_out``."""
        predicted = {} if self.unseen is None else {"left_out": found.predict(self.unseen)[1]}
        return {"seen": found.rmse} | predicted

    def looks(self, found: Fitted) -> dict[str, float]:
        """Mean FLIP of the photos ``flip_seen`` and, where there are any, ``flip_left_out``."""
        parts = {"flip_seen": self.photos, "flip_left_out": self.unseen}
        return {name: mean_flip(found.predict(shots)[0], shots.linear, shots.transfer)
                for name, shots in parts.items() if shots is not None}


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


def real_capture(folder: Path, resolution: int, left_out: Sequence[int] = USUAL_LEFT_OUT) -> RealCapture:
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
    return RealCapture(folder.name, shots.pick(seen), shots.pick(held) if held else None, tuple(left_out))


def novel_light_rmse(svbrdf: SVBRDF, truth: SVBRDF, views: Views) -> float:
    """How different two materials look under lights that no photo had: RMSE in display values, over
    :func:`novel_views`.

    Args:
        svbrdf: the estimate.
        truth: the known material; the larger of both is area-averaged to the smaller.
        views: those of the photos.
    """
    found, exact = novel_pictures(svbrdf, truth, views)
    return photo_rmse(found, to_display(exact))[0]


def novel_pictures(svbrdf: SVBRDF, truth: SVBRDF, views: Views) -> tuple[Tensor, Tensor]:
    """The pictures that :func:`novel_light_rmse` compares, of both materials, N x R x R x 3 linear; R of the
    smaller one.
    """
    size, renderer, lit = min(svbrdf.resolution,
                              truth.resolution), make_renderer("analytic"), novel_views(views)
    with torch.no_grad():
        found, exact = (renderer.render(m.as_roughconductor().resized(size), lit) for m in (svbrdf, truth))
    return found, exact


def mean_flip(images: Tensor, exact: Tensor, transfer: Transfer = "gamma2.2") -> float:
    """Mean FLIP over all pixels of N pictures, linear, as screens with this transfer curve show them."""
    return statistics.fmean(float(flip(image, other, transfer).mean()) for image, other in zip(images, exact))


def novel_views(views: Views, tilts: Sequence[float] = (25.0, 50.0), around: int = 4) -> Views:
    """Seen from straight above and lit from the side: lights off the lens, as no photo with a flash has them.

    Args:
        views: those of the photos; their mean height is the distance of camera and lights.
        tilts: degrees between the lights and the upright; each further ring is turned by half a step.
        around: lights of each tilt.

    Returns:
        Views in patch sides; a white diffuse texel straight below such a light, were it upright, has radiance
        1.
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
