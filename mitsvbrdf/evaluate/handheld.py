"""A capture made of a simulated phone's photos, against what is true of them.

A rig that was found without a sheet lies somewhere on the material, in patch sides: it is compared after the similarity of
the plane (scale, turn, shift) that best takes what its photos show to where that truly is. One with a sheet is not moved.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from ..capture import Capture, read_capture
from ..capture.lens import on_plane, project, rays
from ..capture.rig import Rig, rig_from_json
from ..errors import CaptureError
from ..maps import SVBRDF, load_maps
from ..views import Views, texel_positions

Array = NDArray[np.float64]

POINTS = 17  # along a side of the patch, at which rectification is compared
PIXELS = 512  # of the rectified photo that its errors are counted in


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
            value = json.loads(path.read_text())
            return cls(value, rig_from_json(value["rig"]), path.parent)
        except (OSError, ValueError, KeyError, TypeError) as reason:
            raise CaptureError("the truth.json of simulated photos", f"{path}: {reason}",
                               "make photos with `mitsvbrdf synth --handheld`") from None

    @property
    def spoiled(self) -> dict[str, dict]:
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
        return rig_from_json(json.loads(path.read_text())["rig"])
    except (OSError, ValueError, KeyError, TypeError) as reason:
        raise CaptureError("a capture.json with a rig", f"{path}: {type(reason).__name__} {reason}",
                           "make it with `mitsvbrdf capture`") from None


def compare_with_truth(capture: str | Path | Rig, truth: str | Path | Truth) -> dict[str, Any]:
    """How far a rig, or a written capture, is from the truth. Lengths are in cm, ratios over 1, pixels of rectified 512.

    Args:
        capture: a folder with a capture.json, or a rig.
        truth: as :meth:`Truth.read` takes it, or the truth itself.

    Returns:
        ``similarity``: scale (cm a unit of the rig), degrees, shift; of a sheet's rig 1, 0, 0.
        ``cameras``, ``lights``: distance from the truth over that from the patch's middle: ``rms``, ``worst``, ``photos`` by
        name; without a sheet after the similarity that fits the cameras best. ``cameras_by_patch``: after ``similarity``.
        ``rectification``: where the photos' content lies, against where it should: ``rms``, ``worst`` (of a photo),
        ``photos``; its part ``common`` to all, which deforms the patch, and the ``mutual`` rest, which blurs it.
        ``lens``: ``focal`` (ratio), ``pixels`` (RMS over the photo at equal rays), ``distortion`` (k1, k2: found less true),
        ``vignetting`` (largest difference of the transmission), ``flash`` (cm, found less true, three axes).
        ``power``: of the lights (a folder's only): ``ratio`` (geometric mean of found over true), ``spread`` (RMS of each
        photo's logarithm around that).
        ``photos``: ``used``; ``wrongly_used`` with what is odd about them, ``wrongly_left_out`` and ``rightly_left_out``
        with the reasons given.

    Raises:
        CaptureError: no photo of the rig is among the true ones, or the photos have another size.
    """
    truth, rig = truth if isinstance(truth, Truth) else Truth.read(truth), rig_of(capture)
    names = _common(rig, truth)
    placed = similarity(rig, truth)
    found = np.stack([rig.poses[name].position for name in names])
    true = np.stack([truth.rig.poses[name].position for name in names])
    middle = placed(np.zeros(3))
    freed = placed if rig.unit == "cm" or len(names) < 2 else Similarity.best(found, true)
    lights = np.stack([rig.poses[name].flash(rig.lens) for name in names])
    true_lights = np.stack([truth.rig.poses[name].flash(truth.rig.lens) for name in names])
    return {
        "similarity": {"scale": placed.scale, "degrees": math.degrees(placed.angle), "shift": list(placed.shift)},
        "cameras": _distances(names, freed(found), true, middle),
        "cameras_by_patch": _distances(names, placed(found), true, middle),
        "lights": _distances(names, freed(lights), true_lights, middle),
        "rectification": _rectification(rig, truth, names, placed),
        "lens": _lens(rig, truth, placed.scale),
        "photos": _choice(rig, truth),
    } | ({} if isinstance(capture, Rig) else {"power": _power(Path(capture), rig, truth, names, placed)})


def similarity(rig: Rig, truth: Truth) -> Similarity:
    """Where the rig's world lies in the true one: by the patch's points, each where the median of the photos shows it."""
    if rig.unit == "cm":
        return Similarity()
    points = _grid(rig.size)
    shown = np.median([_shown(rig, truth, name, points) for name in _common(rig, truth)], axis=0)
    return Similarity.best(points, np.column_stack((shown, np.zeros(len(shown)))))


def _common(rig: Rig, truth: Truth) -> list[str]:
    if tuple(rig.lens.size) != tuple(truth.rig.lens.size):
        raise CaptureError(f"photos of {truth.rig.lens.size}", f"a rig of {rig.lens.size}", "give the truth of these photos")
    names = [name for name in rig.poses if name in truth.rig.poses
             and truth.spoiled.get(name, {}).get("kind") != "unrelated"]
    if not names:
        raise CaptureError("photos that the truth tells of", ", ".join(rig.poses) or "none", "give the truth of these photos")
    return names


def _grid(size: float) -> Array:
    return texel_positions(POINTS).numpy().reshape(-1, 3) * size


def _shown(rig: Rig, truth: Truth, name: str, points: Array) -> Array:
    """The true places (K x 2) of what a photo shows where the rig has these points of the patch."""
    return on_plane(truth.rig.lens, truth.rig.poses[name], project(rig.lens, rig.poses[name], points))


def _distances(names: list[str], found: Array, true: Array, middle: Array) -> dict[str, Any]:
    error = np.linalg.norm(found - true, axis=1) / np.linalg.norm(true - middle, axis=1)
    return {"rms": _rms(error), "worst": float(error.max()), "photos": dict(zip(names, error.tolist()))}


def _rectification(rig: Rig, truth: Truth, names: list[str], placed: Similarity) -> dict[str, Any]:
    points = _grid(rig.size)
    shown = np.stack([_shown(rig, truth, name, points) for name in names])
    there = placed.back(np.concatenate((shown, np.zeros_like(shown[..., :1])), axis=-1))
    error = (there - points)[..., :2] * PIXELS / rig.size
    common = np.median(error, axis=0)
    lengths = {name: _rms(np.linalg.norm(e, axis=-1)) for name, e in zip(names, error)}
    return {"rms": _rms(np.linalg.norm(error, axis=-1)), "worst": max(lengths.values()), "photos": lengths,
            "common": _rms(np.linalg.norm(common, axis=-1)), "mutual": _rms(np.linalg.norm(error - common, axis=-1))}


def _lens(rig: Rig, truth: Truth, scale: float) -> dict[str, Any]:
    lens, true = rig.lens, truth.rig.lens
    columns, rows = (np.linspace(0, side - 1, 33) for side in true.size)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    ray = rays(true, pixels)
    r2 = np.square(ray[:, :2]).sum(axis=1, keepdims=True)
    seen = lens.focal * ray[:, :2] * (1 + lens.distortion[0] * r2 + lens.distortion[1] * r2**2) + lens.middle
    return {"focal": lens.focal / true.focal, "pixels": _rms(np.linalg.norm(seen - pixels, axis=1)),
            "distortion": (np.array(lens.distortion) - true.distortion).tolist(),
            "vignetting": float(np.abs(lens.transmission(pixels) - true.transmission(pixels)).max()),
            "flash": (np.array(lens.flash) * scale - true.flash).tolist()}


def _power(folder: Path, rig: Rig, truth: Truth, names: list[str], placed: Similarity) -> dict[str, float]:
    shots = read_capture(folder)
    found = shots.views.in_patch_sides().intensity.mean(dim=1).numpy()
    rows = [row for row, name in enumerate(_photo_names(shots, rig)) if name in names]
    ratio = np.log(found[rows] * (placed.scale * rig.size) ** 2 / np.mean(truth.value["intensity"]))
    return {"ratio": float(np.exp(ratio.mean())), "spread": _rms(ratio - ratio.mean())}


def _photo_names(shots: Capture, rig: Rig) -> list[str]:
    """Of each photo of a written capture, the raw photo it was: they stand in the order of the rig's poses."""
    names = list(rig.poses)
    if max(shots.index) >= len(names):
        raise CaptureError("a pose for each photo of the capture", f"{len(names)} poses and photo {max(shots.index)}",
                           "make the capture again")
    return [names[i] for i in shots.index]


def _choice(rig: Rig, truth: Truth) -> dict[str, Any]:
    wrong = {name: odd for name, odd in truth.spoiled.items() if not odd["usable"]}
    # One of two alike is enough, whichever it is.
    for name, odd in list(wrong.items()):
        if "of" in odd and name in rig.poses and odd["of"] not in rig.poses:
            wrong[odd["of"]] = wrong.pop(name)
    reasons = {name: rig.left_out.get(name, "") for name in truth.rig.poses if name not in rig.poses}
    return {"used": [name for name in rig.poses if name in truth.rig.poses],
            "wrongly_used": {name: wrong[name]["kind"] for name in rig.poses if name in wrong},
            "wrongly_left_out": {name: why for name, why in reasons.items() if name not in wrong},
            "rightly_left_out": {name: {"kind": wrong[name]["kind"], "reason": why}
                                 for name, why in reasons.items() if name in wrong}}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean()))


def truth_maps(truth: str | Path | Truth, rig: Rig, resolution: int) -> SVBRDF:
    """The known maps of just the patch that a rig has: averaged over each texel, normals turned with the patch.

    Args:
        truth: as :meth:`Truth.read` takes it, or the truth itself.
        rig: where the patch is.
        resolution: texels along its side.
    """
    truth = truth if isinstance(truth, Truth) else Truth.read(truth)
    placed, maps, side = similarity(rig, truth), load_maps(truth.folder / "maps"), truth.value["sample_cm"]
    texel = placed.scale * rig.size / resolution * maps.resolution / side  # in texels of the known maps
    times = max(1, math.ceil(2 * texel))
    where = placed(texel_positions(resolution * times).numpy() * rig.size)[..., :2] / side * (2, -2)
    grid = torch.from_numpy(where).float()[None]

    def cut(value: torch.Tensor) -> torch.Tensor:
        fine = F.grid_sample(value.permute(2, 0, 1)[None], grid, "bilinear", "border", align_corners=False)
        return F.avg_pool2d(fine, times)[0].permute(1, 2, 0)

    found = {name: cut(value) for name, value in maps.maps.items()}
    found["normal"] = F.normalize(found["normal"] @ torch.from_numpy(placed.turn).float(), dim=-1)
    return SVBRDF(maps.bsdf, found)


def true_capture(folder: str | Path, truth: str | Path | Truth, **options) -> Capture:
    """The rectified photos of a written capture with the true cameras, lights and powers, in the frame of its patch.

    Args:
        folder: with a capture.json.
        truth: as :meth:`Truth.read` takes it, or the truth itself.
        options: of :func:`mitsvbrdf.capture.read_capture`.
    """
    truth, rig = truth if isinstance(truth, Truth) else Truth.read(truth), rig_of(folder)
    shots, placed = read_capture(folder, **options), similarity(rig, truth)
    poses = [truth.rig.poses[name] for name in _photo_names(shots, rig)]
    side = placed.scale * rig.size
    camera, light = (placed.back(np.stack(p)) / rig.size for p in
                     ([pose.position for pose in poses], [pose.flash(truth.rig.lens) for pose in poses]))
    power = np.array(truth.value["intensity"]) / side**2
    views = Views.of(camera, light, power, falloff=shots.views.falloff)
    return replace(shots, views=views, calibration="given")
