"""What the geometry of a set of raw photos is, however it was found, and photos rectified by it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np

from ..errors import CaptureError
from .lens import Lens, Pose, project


@dataclass(frozen=True)
class Rig:
    """A lens and where it stood in each photo. The patch is the square of side ``size`` around the world's origin.

    Args:
        lens: what all photos share.
        poses: by name of the photo, of the photos that are used.
        size: side of the patch, in ``unit``.
        unit: of all lengths: ``cm`` where a sheet of known size was seen, else ``patch sides`` (``size`` is 1).
        source: what the poses come from.
        errors: RMS reprojection error in pixels of the photo, by name.
        left_out: reason, by name of each photo that is not used.
        deviations: standard deviation of a camera's position in ``unit``, by name, where it is known.
        notes: what the user should know about it.
    """

    lens: Lens
    poses: dict[str, Pose]
    size: float
    unit: Literal["cm", "patch sides"]
    source: Literal["sheet", "photos"]
    errors: dict[str, float] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    deviations: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def rectified(pixels: np.ndarray, lens: Lens, pose: Pose, size: float, resolution: int) -> np.ndarray:
    """A photo as seen straight from above: the patch in R x R pixels, row 0 at the top, lens distortion undone.

    Each pixel is the average over its area, from as many samples as the photo has pixels there, or more.

    Args:
        pixels: H x W x 3 as stored, 8 or 16 bits, or float32; its size may be that of ``lens`` divided by a whole number.
        size: side of the patch.
        resolution: R.

    Returns:
        R x R x 3 float32 in [0, 1] (integers are divided by their largest), NaN where the photo does not reach.
    """
    import cv2

    height, width = pixels.shape[:2]
    scale = 1 / max(1, round(lens.size[0] / width))
    corners = np.array([[x, y, 0.0] for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]) * size
    at = project(lens, pose, corners) * scale
    longest = np.linalg.norm(np.roll(at, -1, axis=0) - at, axis=1).max()
    times = max(1, int(np.ceil(np.nan_to_num(longest, nan=0.0) / resolution))) if np.isfinite(longest) else 1
    whole = float(np.iinfo(pixels.dtype).max) if np.issubdtype(pixels.dtype, np.integer) else 1.0
    # Positions of texels as in views.texel_positions, but a band of rows at a time.
    steps = ((np.arange(resolution * times) + 0.5) / (resolution * times) - 0.5) * size
    out = np.empty((resolution, resolution, 3), dtype=np.float32)
    rows = max(1, 2**21 // (resolution * times * times))  # of the result at once: memory stays small
    for first in range(0, resolution, rows):
        y = -steps[first * times : (first + rows) * times, None]
        part = np.stack(np.broadcast_arrays(steps, y, 0.0), axis=-1)
        where = (project(lens, pose, part.reshape(-1, 3)).reshape(*part.shape[:2], 2) + 0.5) * scale - 0.5
        where = np.nan_to_num(where, nan=-1e6).astype(np.float32)
        low = np.clip(np.floor(where.min(axis=(0, 1))).astype(int) - 2, 0, (width - 1, height - 1))
        high = np.clip(np.ceil(where.max(axis=(0, 1))).astype(int) + 3, low + 1, (width, height))
        window = pixels[low[1] : high[1], low[0] : high[0]].astype(np.float32) / whole
        sampled = cv2.remap(window, where - low.astype(np.float32), None, cv2.INTER_LINEAR,
                            borderMode=cv2.BORDER_REPLICATE)
        outside = ((where < -0.5) | (where > np.array((width, height)) - 0.5)).any(axis=-1)
        sampled[outside] = np.nan
        count = part.shape[0] // times
        out[first : first + count] = sampled.reshape(count, times, resolution, times, 3).mean(axis=(1, 3))
    return out


def rig_to_json(rig: Rig) -> dict:
    """What :func:`rig_from_json` makes a rig of again, for ``capture.json["rig"]``: plain numbers, lists and texts."""
    lens = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(rig.lens).items()}
    poses = {name: {"position": np.asarray(pose.position).tolist(), "rotation": np.asarray(pose.rotation).tolist()}
             for name, pose in rig.poses.items()}
    return {"lens": lens, "poses": poses, "size": rig.size, "unit": rig.unit, "source": rig.source,
            "errors": dict(rig.errors), "left_out": dict(rig.left_out),
            "deviations": dict(rig.deviations), "notes": list(rig.notes)}


def rig_from_json(value: dict) -> Rig:
    """The rig that :func:`rig_to_json` wrote.

    Raises:
        CaptureError: something is missing or no number.
    """
    try:
        lens = {name: tuple(x) if isinstance(x, list) else x for name, x in value["lens"].items()}
        poses = {name: Pose(np.array(pose["position"], dtype=np.float64).reshape(3),
                            np.array(pose["rotation"], dtype=np.float64).reshape(3, 3))
                 for name, pose in value["poses"].items()}
        return Rig(Lens(**lens), poses, float(value["size"]), value["unit"], value["source"],
                   dict(value.get("errors", {})), dict(value.get("left_out", {})),
                   dict(value.get("deviations", {})), tuple(value.get("notes", ())))
    except (KeyError, TypeError, ValueError, AttributeError) as reason:
        raise CaptureError("a rig of lens and poses", f"{type(reason).__name__}: {reason}",
                           "make the capture again with `mitsvbrdf capture`") from None
