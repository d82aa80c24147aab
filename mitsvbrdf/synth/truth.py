"""A capture made of a simulated phone's photos, against what is true of them.

A rig that was found without a sheet lies somewhere on the material, in patch sides: it is compared after the
similarity of the plane (scale, turn, shift) that best takes what its photos show to where that truly is. One
with a sheet is not moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from ..capture import Capture, read_capture
from ..capture.lens import on_plane, project
from ..capture.rig import Rig, rig_from_json
from ..errors import CaptureError
from ..io.json import NUMBER, load, shape_error
from ..material.map_files import load_maps
from ..material.maps import SVBRDF
from ..views import Views, texel_positions

Array = NDArray[np.float64]

_SHAPE = {"rig": dict, "sample_cm": NUMBER, "intensity": [NUMBER],
          "spoiled": {str: {"kind": str, "usable": bool}}}
# folders beside truth.json: the maps of the whole sample, and of the patch within a sheet
SAMPLE, PATCH = "sample", "maps"
POINTS = 17  # along a side of the patch, at which rectification is compared


@dataclass(frozen=True)
class Similarity:
    """From the rig's world to the true one: x -> scale turn x + shift, z -> scale z."""

    scale: float = 1.0
    angle: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)

    @property
    def turn(self) -> Array:
        """3 x 3."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])

    def __call__(self, points: Array) -> Array:
        """True places of points (... x 3) of the rig's world."""
        return self.scale * points @ self.turn.T + (*self.shift, 0.0)

    def back(self, points: Array) -> Array:
        """The inverse."""
        return (points - (*self.shift, 0.0)) @ self.turn / self.scale

    @classmethod
    def best(cls, points: Array, true: Array) -> Similarity:
        """Of least squares, for points K x 3; heights only count for the scale."""
        xy, uv = (p[:, :2] @ (1, 1j) for p in (points, true))  # a turn and a scale are one complex factor
        middle, aim = xy.mean(), uv.mean()
        z, w = xy - middle, uv - aim
        angle = np.angle(np.vdot(z, w))
        inner = abs(np.vdot(z, w)) + points[:, 2] @ true[:, 2]
        scale = inner / (np.vdot(z, z).real + points[:, 2] @ points[:, 2])
        shift = aim - scale * np.exp(1j * angle) * middle
        return cls(float(scale), float(angle), (float(shift.real), float(shift.imag)))


@dataclass(frozen=True)
class Truth:
    """What ``truth.json`` says: its content, the rig with all photos in it, and the folder it lies in."""

    value: dict[str, Any]
    rig: Rig
    folder: Path

    @classmethod
    def read(cls, path: str | Path) -> Truth:
        """From the file, or the folder of photos that ``synth --handheld`` wrote.

        Raises:
            CaptureError: there is none, or it is no such file.
        """
        path = Path(path)
        path = path if path.suffix == ".json" else path / "truth" / "truth.json"
        try:
            value = load(path)
            if wrong := shape_error(value, _SHAPE):
                raise ValueError(f"{wrong} is missing or of another kind")
            return cls(value, rig_from_json(value["rig"]), path.parent)
        except (OSError, ValueError, KeyError, TypeError) as reason:
            raise CaptureError("the truth.json of simulated photos", f"{path}: {reason}",
                               "make photos with `mitsvbrdf synth --handheld`") from None

    @property
    def spoiled(self) -> dict[str, dict]:
        """What is odd about a photo (``kind``, ``usable``), by name of each that something is odd about."""
        return self.value["spoiled"]


def rig_of(capture: str | Path | Rig) -> Rig:
    """The rig in the capture.json of a folder.

    Raises:
        CaptureError: it has none.
    """
    if isinstance(capture, Rig):
        return capture
    path = Path(capture) / "capture.json"
    try:
        return rig_from_json(load(path)["rig"])
    except (OSError, ValueError, KeyError, TypeError) as reason:
        raise CaptureError("a capture.json with a rig", f"{path}: {type(reason).__name__} {reason}",
                           "make it with `mitsvbrdf capture`") from None


def similarity(rig: Rig, truth: Truth) -> Similarity:
    """Where the rig's world lies in the true one: by the patch's points, each where the median of the photos
    shows it.
    """
    if rig.unit == "cm":
        return Similarity()
    points = grid_of(rig.size)
    shown = np.median([shown_points(rig, truth, name, points) for name in photos_of_both(rig, truth)], axis=0)
    return Similarity.best(points, np.column_stack((shown, np.zeros(len(shown)))))


def photos_of_both(rig: Rig, truth: Truth) -> list[str]:
    """Names of the rig's photos that the truth knows, those of another material left out."""
    if tuple(rig.lens.size) != tuple(truth.rig.lens.size):
        raise CaptureError(f"photos of {truth.rig.lens.size}", f"a rig of {rig.lens.size}",
                           "give the truth of these photos")
    names = [name for name in rig.poses if name in truth.rig.poses
             and truth.spoiled.get(name, {}).get("kind") != "unrelated"]
    if not names:
        raise CaptureError("photos that the truth tells of", ", ".join(rig.poses) or "none",
                           "give the truth of these photos")
    return names


def grid_of(size: float) -> Array:
    """Points of a patch of this side, 17 x 17 of them as rows (x, y, z)."""
    return texel_positions(POINTS).numpy().reshape(-1, 3) * size


def shown_points(rig: Rig, truth: Truth, name: str, points: Array) -> Array:
    """The true places (K x 2) of what a photo shows where the rig has these points of the patch."""
    return on_plane(truth.rig.lens, truth.rig.poses[name], project(rig.lens, rig.poses[name], points))


def photo_names(shots: Capture, rig: Rig) -> list[str]:
    """Of each photo of a written capture, the raw photo it was: they stand in the order of the rig's
    poses.
    """
    names = list(rig.poses)
    if max(shots.index) >= len(names):
        raise CaptureError("a pose for each photo of the capture",
                           f"{len(names)} poses and photo {max(shots.index)}",
                           "make the capture again")
    return [names[i] for i in shots.index]


def rms_of(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.square(values).mean()))


def truth_maps(truth: str | Path | Truth, rig: Rig, resolution: int) -> SVBRDF:
    """The known maps of just the patch that a rig has.

    Args:
        truth: as :meth:`Truth.read` takes it, or the truth itself.
        rig: where the patch is.
        resolution: texels along its side.
    """
    truth = truth if isinstance(truth, Truth) else Truth.read(truth)
    sample, placed = load_maps(truth.folder / SAMPLE), similarity(rig, truth)
    return patch_of(sample, truth.value["sample_cm"], rig.size, resolution, placed)


def patch_of(sample: SVBRDF, side: float, size: float, resolution: int,
             placed: Similarity = Similarity()) -> SVBRDF:
    """The maps of a square patch of a sample: averaged over each texel, normals turned with the patch.

    Args:
        sample: the maps of all of it.
        side: of the sample, cm.
        size: side of the patch, in units of its own world, around whose origin it lies.
        resolution: texels along the patch's side.
        placed: from the patch's world to the sample's; left out: in its middle, in cm.
    """
    texel = placed.scale * size / resolution * sample.resolution / side  # in texels of the sample
    times = max(1, math.ceil(2 * texel))
    where = placed(texel_positions(resolution * times).numpy() * size)[..., :2] / side * (2, -2)
    grid = torch.from_numpy(where).float()[None]

    def cut(value: torch.Tensor) -> torch.Tensor:
        fine = F.grid_sample(value.permute(2, 0, 1)[None], grid, "bilinear", "border", align_corners=False)
        return F.avg_pool2d(fine, times)[0].permute(1, 2, 0)

    found = {name: cut(value) for name, value in sample.maps.items()}
    found["normal"] = F.normalize(found["normal"] @ torch.from_numpy(placed.turn).float(), dim=-1)
    return SVBRDF(sample.bsdf, found)


def true_capture(folder: str | Path, truth: str | Path | Truth, **options: Any) -> Capture:
    """The rectified photos of a written capture with the true cameras, lights and powers, in the frame of its
    patch.

    Args:
        folder: with a capture.json.
        truth: as :meth:`Truth.read` takes it, or the truth itself.
        options: of :func:`mitsvbrdf.capture.read_capture`.
    """
    truth, rig = truth if isinstance(truth, Truth) else Truth.read(truth), rig_of(folder)
    shots, placed = read_capture(folder, **options), similarity(rig, truth)
    poses = [truth.rig.poses[name] for name in photo_names(shots, rig)]
    side = placed.scale * rig.size
    camera, light = (placed.back(np.stack(p)) / rig.size for p in
                     ([pose.position for pose in poses], [pose.flash(truth.rig.lens) for pose in poses]))
    power = np.array(truth.value["intensity"]) / side**2
    views = Views.of(camera, light, power, falloff=shots.views.falloff)
    return replace(shots, views=views, calibration="given")
