"""The tasks: photos of known materials, and real captures with some photos held out of the fit."""

import hashlib
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from ..capture import Capture, read_capture
from ..color import to_display
from ..errors import ConfigError
from ..evaluate import evaluate_maps
from ..evaluate.placement import named_views
from ..fit.checkpoint import digest
from ..material.made import MATERIALS, make_material
from ..material.map_files import load_maps
from ..material.maps import SVBRDF
from ..measure.metrics import map_rmse, photo_rmse
from ..render import Renderer, make_renderer
from ..synth import photograph
from ..views import Views

HELD_OUT = (4, 7)  # numbers of the photos of a real capture that no fit sees, by default
# Photos -> RMSE of the images that a fit predicts for them, in display values.
Predict = Callable[[Capture], float]


@dataclass(frozen=True)
class KnownMaterial:
    """Simulated photos of known maps."""

    kind: ClassVar = "material"
    name: str  # of the material
    truth: SVBRDF  # its maps
    folder: Path | None  # from which the maps were read; None for a made material
    photos: Capture  # what is fitted
    seen_from: str = "builtin:grid"  # name of the capture whose views the photos have

    @property
    def key(self) -> dict:
        """What identifies the task in a record."""
        return {"kind": self.kind, "name": self.name, "resolution": self.photos.resolution,
                "views": self.seen_from, "content": self._content}

    @cached_property
    def _content(self) -> str:
        return _digest(self.truth.maps.values(), [self.photos])

    def errors(self, svbrdf: SVBRDF, predict: Predict) -> dict[str, float]:
        """A dict of RMSE: each map, their ``mean``, images under ``novel_light``, and the ``photos``."""
        maps = map_rmse(svbrdf, self.truth) if self.folder is None else evaluate_maps(svbrdf, self.folder)
        size = min(svbrdf.resolution, self.truth.resolution)
        renderer, lit = make_renderer("analytic"), novel_views(self.photos.views)
        with torch.no_grad():
            found, exact = (renderer.render(each.as_roughconductor().resized(size), lit)
                            for each in (svbrdf, self.truth))
        novel = photo_rmse(found, to_display(exact))[0]
        return maps | {"novel_light": novel, "photos": predict(self.photos)}


@dataclass(frozen=True)
class RealCapture:
    """Real photos, some of them held out."""

    kind: ClassVar = "capture"
    name: str  # of the capture
    photos: Capture  # what is fitted
    unseen: Capture | None  # the photos held out; None if there are none, or their views are unknown
    held_out: tuple[int, ...] = HELD_OUT  # the numbers that were to be held out; the capture may lack some

    @property
    def key(self) -> dict:
        """What identifies the task in a record."""
        return {"kind": self.kind, "name": self.name, "resolution": self.photos.resolution,
                "held_out": list(self.held_out), "content": self._content}

    @cached_property
    def _content(self) -> str:
        shots = [each for each in (self.photos, self.unseen) if each]
        return _digest([shown for each in shots for shown in (each.stored, each.measured)], shots)

    def errors(self, svbrdf: SVBRDF, predict: Predict) -> dict[str, float]:
        """RMSE of the photos ``seen`` and ``held_out``."""
        held = {} if self.unseen is None else {"held_out": predict(self.unseen)}
        return {"seen": predict(self.photos)} | held


Task = KnownMaterial | RealCapture


def known_material(name: str, resolution: int, views: Views, renderer: Renderer,
                   seen_from: str = "builtin:grid") -> KnownMaterial:
    """Photograph ``builtin:NAME`` or a folder of maps: 8 bits, no noise. ``seen_from`` names the views."""
    if name.startswith("builtin:"):
        truth, folder = make_material(name.removeprefix("builtin:"), resolution), None
    else:
        truth, folder = load_maps(name), Path(name)
    shown = truth.resized(min(resolution, truth.resolution))
    return KnownMaterial(_label(name), truth, folder, photograph(shown, views, renderer), seen_from)


def real_capture(folder: Path, resolution: int, held_out: Sequence[int] = HELD_OUT) -> RealCapture:
    """A task from a folder of photos. No fit sees the photos with the numbers ``held_out``."""
    shots = read_capture(folder, resolution=resolution)
    seen = [i for i in shots.index if i not in held_out]
    if not seen:
        raise ConfigError(f"photos besides {tuple(held_out)}", f"{list(shots.index)} in {folder}",
                          "hold out fewer, or give a capture with more photos")
    rest = [i for i in shots.index if i in held_out and shots.calibrated]
    return RealCapture(_label(str(folder)), shots.pick(seen), shots.pick(rest) if rest else None,
                       tuple(held_out))


def find_tasks(materials: Sequence[str] | None, captures: Sequence[str] | None, data: Path | None,
               resolution: int, held_out: Sequence[int], views: str | None, renderer: Renderer) -> list[Task]:
    """The tasks named: known materials (``builtin:NAME``, folders, made ones or those in ``data``), captures.

    None takes all there are; the name "none" is skipped. No fit sees the photos of captures with the numbers
    ``held_out``. The renderer makes the photos of known materials, in the views of the capture ``views`` or
    of builtin:grid; None: the views of the capture cards-blue in ``data``, else of builtin:grid.

    ConfigError, CaptureError, MapsError: a task is missing, two tasks have one name, or there is no task.
    """
    there = {what: {p.name: str(p) for p in _folders(data, what)} for what in ("materials", "captures")}
    made = {name: f"builtin:{name}" for name in MATERIALS}
    names = _chosen(materials, there["materials"] | made)
    shots = _chosen(captures, there["captures"])
    if not names and not shots:
        raise ConfigError("a material or capture to fit", "none", "give --materials or --captures")
    source = there["captures"].get(views or "cards-blue", views or "builtin:grid")
    tasks: list[Task] = []
    if names:
        lit = named_views(source, "inverse-square")[1]
        seen_from = source if source.startswith("builtin:") else _label(source)
        tasks += [known_material(name, resolution, lit, renderer, seen_from) for name in names]
    return tasks + [real_capture(Path(name), resolution, held_out) for name in shots]


def _chosen(asked: Sequence[str] | None, known: Mapping[str, str]) -> list[str]:
    """The names as ``builtin:NAME`` or folders; ConfigError: one is missing, or named twice."""
    names = list(known.values()) if asked is None else [
        name if Path(name).is_dir() else known.get(name, name) for name in asked if name != "none"]
    missing = [name for name in names if not name.startswith("builtin:") and not Path(name).is_dir()]
    if missing:
        raise ConfigError("materials and captures that are there", f"none called {missing[0]}",
                          "name folders, or those in --data; without the option all are taken")
    labels = list(map(_label, names))
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise ConfigError("each material and capture once, by a name of its own", f"{twice[0]} twice",
                          "rename a folder")
    return names


def data_folder(folder: Path | None = None) -> Path | None:
    """The folder of captures and known materials: ``folder``, else MITSVBRDF_DATA, else None."""
    named = folder or (Path(os.environ["MITSVBRDF_DATA"]) if os.environ.get("MITSVBRDF_DATA") else None)
    if named is not None and not ((named / "captures").is_dir() or (named / "materials").is_dir()):
        raise ConfigError("a folder with captures/ or materials/", str(named), "check --data, MITSVBRDF_DATA")
    return named


def _digest(pictures: Iterable[Tensor | None], shots: Sequence[Capture]) -> str:
    """16 hex digits that tell tasks of one name apart: a hash of pictures, views, transfer, calibration."""
    views = [each.views for each in shots]
    lit = [numbers for each in views for numbers in (each.camera, each.light, each.intensity)]
    told = digest(*(shown for shown in pictures if shown is not None), *lit)
    told += repr([(each.transfer, each.calibration, each.views.size, each.views.falloff) for each in shots])
    return hashlib.sha256(told.encode()).hexdigest()[:16]


def novel_views(views: Views) -> Views:
    """Views from straight above, with lights far from the lens. No flash photo has such light.

    Four lights are 25 degrees from the vertical, and four 50 degrees, turned by half a step. Their distance
    is the mean height of the photos' cameras. A central white diffuse texel facing a light has radiance 1.
    """
    height = float(views.in_patch_sides().camera[:, 2].mean())
    lights = []
    for ring, tilt in enumerate((math.radians(25.0), math.radians(50.0))):
        for k in range(4):
            turn = 2 * math.pi * (k + ring / 2) / 4
            lights.append([height * math.sin(tilt) * math.cos(turn), height * math.sin(tilt) * math.sin(turn),
                           height * math.cos(tilt)])
    return Views.of([[0.0, 0.0, height]] * len(lights), lights, math.pi * height**2)


def _folders(data: Path | None, what: str) -> list[Path]:
    folder = data / what if data else None
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder and folder.is_dir() else []


def _label(source: str) -> str:
    return Path(os.path.abspath(source.removeprefix("builtin:"))).name
