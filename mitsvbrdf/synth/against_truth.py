"""A capture against the truth of its simulation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ..capture import read_capture
from ..capture.lens import rays
from ..capture.rig import Rig
from .truth import (
    Array,
    Similarity,
    Truth,
    grid_of,
    photo_names,
    photos_of_both,
    rig_of,
    rms_of,
    shown_points,
    similarity,
)

PIXELS = 512  # of the rectified photo that its errors are counted in


def compare_with_truth(capture: str | Path | Rig, truth: str | Path | Truth) -> dict[str, Any]:
    """How far a rig, or a written capture, is from the truth. Lengths are in cm, ratios over 1, pixels of
    rectified 512.

    Args:
        capture: a folder with a capture.json, or a rig.
        truth: as :meth:`Truth.read` takes it, or the truth itself.

    Returns:
        ``similarity``: scale (cm a unit of the rig), degrees, shift; of a sheet's rig 1, 0, 0.
        ``cameras``, ``lights``: distance from the truth over that from the patch's middle: ``rms``,
        ``worst``, ``photos`` by name; without a sheet after the similarity that fits the cameras best.
        ``cameras_by_patch``: after ``similarity``. ``rectification``: where the photos' content lies, against
        where it should: ``rms``, ``worst`` (of a photo), ``photos``; its part ``common`` to all, which
        deforms the patch, and the ``mutual`` rest, which blurs it. ``lens``: ``focal`` (ratio), ``pixels``
        (RMS over the photo at equal rays), ``distortion`` (k1, k2: found less true), ``vignetting`` (largest
        difference of the transmission), ``flash`` (cm, found less true, three axes). ``power``: of the lights
        (a folder's only): ``ratio`` (geometric mean of found over true), ``spread`` (RMS of each photo's
        logarithm around that). ``photos``: ``used``; ``wrongly_used`` with what is odd about them,
        ``wrongly_rejected`` and ``rightly_rejected`` with the reasons given.

    Raises:
        CaptureError: no photo of the rig is among the true ones, or the photos have another size.
    """
    truth, rig = truth if isinstance(truth, Truth) else Truth.read(truth), rig_of(capture)
    names = photos_of_both(rig, truth)
    placed = similarity(rig, truth)
    found = np.stack([rig.poses[name].position for name in names])
    true = np.stack([truth.rig.poses[name].position for name in names])
    middle = placed(np.zeros(3))
    freed = placed if rig.unit == "cm" or len(names) < 2 else Similarity.best(found, true)
    lights = np.stack([rig.poses[name].flash(rig.lens) for name in names])
    true_lights = np.stack([truth.rig.poses[name].flash(truth.rig.lens) for name in names])
    return {
        "similarity": {"scale": placed.scale, "degrees": math.degrees(placed.angle),
                       "shift": list(placed.shift)},
        "cameras": _distances(names, freed(found), true, middle),
        "cameras_by_patch": _distances(names, placed(found), true, middle),
        "lights": _distances(names, freed(lights), true_lights, middle),
        "rectification": _rectification(rig, truth, names, placed),
        "lens": _lens(rig, truth, placed.scale),
        "photos": _choice(rig, truth),
    } | ({} if isinstance(capture, Rig) else {"power": _power(Path(capture), rig, truth, names, placed)})


def _distances(names: list[str], found: Array, true: Array, middle: Array) -> dict[str, Any]:
    error = np.linalg.norm(found - true, axis=1) / np.linalg.norm(true - middle, axis=1)
    return {"rms": rms_of(error), "worst": float(error.max()), "photos": dict(zip(names, error.tolist()))}


def _rectification(rig: Rig, truth: Truth, names: list[str], placed: Similarity) -> dict[str, Any]:
    points = grid_of(rig.size)
    shown = np.stack([shown_points(rig, truth, name, points) for name in names])
    there = placed.back(np.concatenate((shown, np.zeros_like(shown[..., :1])), axis=-1))
    error = (there - points)[..., :2] * PIXELS / rig.size
    common = np.median(error, axis=0)
    lengths = {name: rms_of(np.linalg.norm(e, axis=-1)) for name, e in zip(names, error)}
    return {"rms": rms_of(np.linalg.norm(error, axis=-1)), "worst": max(lengths.values()), "photos": lengths,
            "common": rms_of(np.linalg.norm(common, axis=-1)),
            "mutual": rms_of(np.linalg.norm(error - common, axis=-1))}


def _lens(rig: Rig, truth: Truth, scale: float) -> dict[str, Any]:
    lens, true = rig.lens, truth.rig.lens
    columns, rows = (np.linspace(0, side - 1, 33) for side in true.size)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    ray = rays(true, pixels)
    r2 = np.square(ray[:, :2]).sum(axis=1, keepdims=True)
    seen = lens.focal * ray[:, :2] * (1 + lens.distortion[0] * r2 + lens.distortion[1] * r2**2) + lens.middle
    return {"focal": lens.focal / true.focal, "pixels": rms_of(np.linalg.norm(seen - pixels, axis=1)),
            "distortion": (np.array(lens.distortion) - true.distortion).tolist(),
            "vignetting": float(np.abs(lens.transmission(pixels) - true.transmission(pixels)).max()),
            "flash": (np.array(lens.flash) * scale - true.flash).tolist()}


def _power(folder: Path, rig: Rig, truth: Truth, names: list[str], placed: Similarity) -> dict[str, float]:
    shots = read_capture(folder)
    found = shots.views.in_patch_sides().intensity.mean(dim=1).numpy()
    rows = [row for row, name in enumerate(photo_names(shots, rig)) if name in names]
    ratio = np.log(found[rows] * (placed.scale * rig.size) ** 2 / np.mean(truth.value["intensity"]))
    return {"ratio": float(np.exp(ratio.mean())), "spread": rms_of(ratio - ratio.mean())}


def _choice(rig: Rig, truth: Truth) -> dict[str, Any]:
    wrong = {name: odd for name, odd in truth.spoiled.items() if not odd["usable"]}
    # One of two alike is enough, whichever it is.
    for name, odd in list(wrong.items()):
        if "of" in odd and name in rig.poses and odd["of"] not in rig.poses:
            wrong[odd["of"]] = wrong.pop(name)
    reasons = {name: rig.rejected.get(name, "") for name in truth.rig.poses if name not in rig.poses}
    return {"used": [name for name in rig.poses if name in truth.rig.poses],
            "wrongly_used": {name: wrong[name]["kind"] for name in rig.poses if name in wrong},
            "wrongly_rejected": {name: why for name, why in reasons.items() if name not in wrong},
            "rightly_rejected": {name: {"kind": wrong[name]["kind"], "reason": why}
                                 for name, why in reasons.items() if name in wrong}}
