"""Photos with known light: pictures without vignetting, and their views."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from ... import color
from ...color import NEARLY_CLIPPED
from ...errors import CaptureError
from ...views import Views, default_views, texel_positions
from ..lens import Array, project
from ..rectify import Rectified, filled
from ..rig import Rig
from .samples import transmission_of
from .shading import shading_of_material, shading_of_paper
from .solve import Shading

FARTHEST_FLASH = 5.0  # cm from the lens; phones have 1 to 3

Paper = Callable[[Array], np.ndarray]  # for points of the plane (K x 2, cm), whether bare paper is there


@dataclass(frozen=True)
class Lit:
    """The photos of a rig, and their light."""

    rig: Rig  # with the flash and vignetting of its lens; poses in the order in which the photos were given
    shading: Shading | None  # flash, vignetting and exposures; None: the photos do not show them
    # N x R x R x 3 display values without vignetting, filled where masked or beyond a photo's edges
    pictures: torch.Tensor
    measured: torch.Tensor | None  # N x R x R, False where a picture is filled; None: all True
    views: Views  # N
    notes: tuple[str, ...]  # what a user should know

    @classmethod
    def of(cls, rig: Rig, rectified: Rectified, transfer: color.Transfer, paper: Paper | None = None,
           depth: float = 0.0) -> Lit:
        """Find the light of photos with a pose in ``rig``; the paper of a sheet is at z = ``depth`` cm."""
        given = [name for name in rectified.pictures if name in rig.poses]
        rig = replace(rig, poses={name: rig.poses[name] for name in given})
        shading, notes = _shading(rig, rectified, transfer, paper, depth)
        if shading:
            rig = replace(rig, lens=shading.lens, poses=shading.poses)
        pictures = [without_vignetting(rectified.pictures[name], rig, name, transfer) for name in given]
        return cls(rig, shading, *filled(pictures), _views(rig, shading), notes)


def _shading(rig: Rig, rectified: Rectified, transfer: color.Transfer, paper: Paper | None,
             depth: float) -> tuple[Shading | None, tuple[str, ...]]:
    """The shading from the paper of the sheet, else from the material, else None; and notes."""
    if rig.source == "none":
        return None, ("photos rectified to their sheet already: views are unknown, and a fit estimates them",)
    notes = []
    if paper is not None:
        try:
            shading = shading_of_paper(rig, rectified.small, transfer, paper, depth)
            beside = float(np.linalg.norm(shading.lens.flash))
            far = (f"the flash seems to be {beside:.0f} cm beside the lens: is --sheet in cm, and as "
                   "measured?",)
            return shading, shading.notes + (far if beside > FARTHEST_FLASH else ())
        except CaptureError as reason:
            notes.append(f"the paper says nothing of the light ({reason.got}); the material is asked instead")
    try:
        shading = shading_of_material(rig, rectified.pictures, transfer)
        return shading, (*notes, *shading.notes)
    except CaptureError as reason:
        return None, (*notes, f"the shading says nothing of the light ({reason.got}): the flash is taken to "
                              "be at the lens, and so bright that a white texel has radiance 1")


def _views(rig: Rig, shading: Shading | None) -> Views:
    """The views: positions, and intensities times exposures; the default for what is unknown."""
    if rig.source == "none":
        views = default_views(len(rig.poses))
        return Views.of(views.camera * rig.size, None, views.intensity * rig.size**2, rig.size)
    camera, light = map(np.stack, zip(*((p.position, p.flash(rig.lens)) for p in rig.poses.values())))
    if shading is None:
        return Views.of(camera, light, math.pi * float(np.median(np.square(camera).sum(axis=1))), rig.size)
    power = [np.array(shading.intensity) * math.exp(shading.log_exposure.get(name, 0.0))
             * shading.tint.get(name, 1.0) for name in rig.poses]
    return Views.of(camera, light, np.stack(power), rig.size)


def without_vignetting(picture: np.ndarray, rig: Rig, name: str, transfer: color.Transfer) -> np.ndarray:
    """Remove vignetting from a rectified photo, R x R x 3 display values. Clipped values and NaN stay so."""
    if rig.lens.vignetting == (0.0, 0.0):
        return picture
    linear = color.decode(torch.from_numpy(picture), transfer).numpy()
    points = texel_positions(len(linear)).numpy().reshape(-1, 3) * rig.size
    radius2 = rig.lens.radius2(project(rig.lens, rig.poses[name], points))
    out = linear / transmission_of(radius2, np.array(rig.lens.vignetting)).reshape(*linear.shape[:2], 1)
    clipped = linear >= float(color.decode(torch.tensor(NEARLY_CLIPPED, dtype=torch.float64), transfer))
    out = np.where(clipped, np.maximum(out, linear), out).astype(linear.dtype)
    return color.to_display(torch.from_numpy(out), transfer).numpy()
