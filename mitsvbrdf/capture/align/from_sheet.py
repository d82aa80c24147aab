"""Lens and poses from photos of the printed sheet: its tags are measured in each, and all photos explained at once.

One lens (focal length, principal point, k1, k2) and a pose of each photo are the least-squares answer to all points measured on
edges of tags (bundle adjustment, Triggs et al. 2000), with Zhang's planar target (2000) and weak priors on the lens.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import CaptureError
from ..lens import Lens, Pose, project
from ..photo import Photo, other_sizes
from ..rig import Rig
from .from_photos import expected_lens, unsure_note
from .sheet import Sheet
from .tag_edges import POINTS, Edges, find_edges

Array = NDArray[np.float64]

LEAST_TAGS = 4
LEAST_PHOTOS = 3
# Deviations of the priors: EXIF's focal length is rounded to a millimetre and means the diagonal or the long side; without
# it a phone is somewhere between its wide and its tele lens. The principal point as a share of the long side.
FOCAL, FOCAL_UNKNOWN, CENTRE, DISTORTION = 0.05, 0.4, 0.005, 0.1
NOISE = 2e-5  # of the long side: what points on edges are off by in good photos, 0.08 pixels of 4000
LARGE, TIMES_MEDIAN = 5e-4, 6.0  # errors of a photo that are too large: as a share of the long side, and beside the others
UNSURE = 0.01  # deviation of the focal length, as a share, that is worth a note


def rig_from_sheet(photos: Sequence[Photo], size_cm: float, depth_cm: float = 0.0,
                   report: Callable[[str, float], object] = lambda text, share: None) -> Rig:
    """Lens and poses from photos of the sheet, in cm; the patch is the middle 0.64 of it, in z = 0 below the hole.

    One photo at a time is in memory.

    Args:
        photos: of one camera, in any orientation.
        size_cm: of the frame of tags as printed, outer edge to outer edge.
        depth_cm: how far the sheet lies above the material.
        report: told what is going on and the share done.

    Returns:
        The rig, with the standard deviation of each camera position; photos that do not help are in ``left_out``.

    Raises:
        CaptureError: fewer than three photos show the sheet.
    """
    sheet, seen = Sheet(size_cm), {}
    size, left_out = other_sizes(photos)
    for i, photo in enumerate(photos):
        report(f"tags of {photo.name}", 0.8 * i / len(photos))
        if photo.name in left_out:
            continue
        edges = find_edges(photo, sheet)
        if reason := _too_few(edges, sheet):
            left_out[photo.name] = reason
        else:
            seen[photo.name] = edges
    lens, stated = expected_lens([photo for photo in photos if photo.name in seen], size)
    start = lens, FOCAL if stated else FOCAL_UNKNOWN
    while True:
        _check(seen, left_out, len(photos))
        report("poses", 0.8)
        lens, poses, errors, deviations, focal = _bundle(*start, sheet, depth_cm, seen)
        limit = max(LARGE * max(size), TIMES_MEDIAN * float(np.median(list(errors.values()))))
        worst = max(errors, key=lambda name: errors[name])
        if errors[worst] <= limit:
            break
        left_out[worst] = (f"its tags are {errors[worst]:.1f} pixels beside where a flat sheet would have them: bent, moved, "
                           "or seen by another lens")
        del seen[worst]
    usual = float(np.median(list(errors.values())))
    notes = [unsure_note(focal)] if focal > UNSURE else []
    if usual > LARGE * max(size):
        notes.append(f"the tags of all photos are some {usual:.1f} pixels beside where those of a flat sheet would be, and all "
                     "views as uncertain as that: flatten the sheet, and take all photos with one lens")
    return Rig(lens, poses, sheet.patch, "cm", "sheet", errors, left_out, deviations, tuple(notes))


def _too_few(edges: Edges, sheet: Sheet) -> str | None:
    """Why these tags do not tell a pose, or None."""
    count = len(edges.corners)
    if count < LEAST_TAGS:
        return f"{count or 'none'} of 16 tags seen, {LEAST_TAGS} needed"
    centres = np.array([sheet.corners[number][:, :2].mean(axis=0) for number in edges.corners])
    if np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1] < sheet.size / 10:
        return f"{count} of 16 tags seen, all in one line"
    return None


def _check(seen: dict[str, Edges], left_out: dict[str, str], count: int) -> None:
    if len(seen) < LEAST_PHOTOS:
        reasons = "".join(f"; {name}: {reason}" for name, reason in left_out.items())
        raise CaptureError(f"{LEAST_PHOTOS} photos or more that show the sheet", f"{len(seen)} of {count}{reasons}",
                           "take photos with all tags in view, sharp and of one size")


def _first_pose(lens: Lens, edges: Edges, sheet: Sheet, depth: float) -> Pose:
    """A pose from the corners of the tags."""
    import cv2

    points = np.concatenate([sheet.corners[number] for number in edges.corners])
    _, turns, shifts, errors = cv2.solvePnPGeneric(points, np.concatenate(list(edges.corners.values())), lens.matrix,
                                                   lens.coefficients, flags=cv2.SOLVEPNP_IPPE)
    best = int(np.argmin(np.ravel(errors)))
    rotation = cv2.Rodrigues(turns[best])[0]
    return Pose(-rotation.T @ np.ravel(shifts[best]) + (0.0, 0.0, depth), rotation)


def _bundle(lens: Lens, focal_share: float, sheet: Sheet, depth: float, seen: dict[str, Edges]
            ) -> tuple[Lens, dict[str, Pose], dict[str, float], dict[str, float], float]:
    """The lens, poses, RMS errors (pixels), deviations of positions (cm), and of the focal length as a share.

    Unknowns: logarithm of the focal length, principal point, k1, k2; then of each photo a rotation after that of the start,
    and a shift as a share of the distance; each divided by its prior's deviation, those of poses 1.
    """
    import cv2
    from scipy.optimize import least_squares

    width, noise = max(lens.size), NOISE * max(lens.size)
    firsts = {name: _first_pose(lens, edges, sheet, depth) for name, edges in seen.items()}
    points = {name: np.column_stack((edges.plane, np.full(len(edges.plane), depth))) for name, edges in seen.items()}
    scale = np.array([focal_share, *[CENTRE * width] * 2, DISTORTION, DISTORTION])

    def lens_of(x: Array) -> Lens:
        log_focal, u, v, k1, k2 = (x[:5] * scale).tolist()
        middle = lens.middle
        return replace(lens, focal=lens.focal * math.exp(log_focal), centre=(middle[0] + u, middle[1] + v), distortion=(k1, k2))

    def pose_of(name: str, x: Array) -> Pose:
        first = firsts[name]
        return Pose(first.position + x[3:] * np.linalg.norm(first.position), cv2.Rodrigues(x[:3])[0] @ first.rotation)

    def of_photo(name: str, shared: Array, own: Array) -> Array:
        off = project(lens_of(shared), pose_of(name, own), points[name]) - seen[name].pixels
        return np.nan_to_num((off * seen[name].across).sum(axis=1) / noise, nan=1e6)

    own = {name: slice(5 + 6 * i, 11 + 6 * i) for i, name in enumerate(seen)}
    ends = np.cumsum([5, *(len(edges.plane) for edges in seen.values())])
    rows = {name: slice(*ends[i : i + 2]) for i, name in enumerate(seen)}

    def residuals(x: Array) -> Array:
        return np.concatenate([x[:5], *(of_photo(name, x[:5], x[own[name]]) for name in seen)])

    def slopes(x: Array) -> Array:
        """Central differences; a photo depends on the lens and its own pose."""
        out = np.zeros((ends[-1], len(x)))
        out[:5, :5] = np.eye(5)
        for name in seen:
            mine = [*range(5), *range(own[name].start, own[name].stop)]
            for column, step in zip(mine, [1e-4] * 5 + [1e-6] * 6):
                high, low = x.copy(), x.copy()
                high[column] += step
                low[column] -= step
                out[rows[name], column] = (of_photo(name, high[:5], high[own[name]])
                                           - of_photo(name, low[:5], low[own[name]])) / (2 * step)
        return out

    found = least_squares(residuals, np.zeros(5 + 6 * len(seen)), slopes, loss="soft_l1", f_scale=3.0,
                          x_scale="jac")
    x, left = found.x, residuals(found.x)
    poses = {name: pose_of(name, x[own[name]]) for name in seen}
    errors = {name: float(np.sqrt(np.square(left[rows[name]]).mean()) * noise) for name in seen}
    jacobian = slopes(x)
    # Errors along an edge are much alike: two of its points count as known by themselves.
    spread = max(1.0, np.square(left[5:]).mean()) * POINTS / 2
    jacobian[5:] /= np.sqrt(spread)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    deviations = {name: float(np.sqrt(np.trace(covariance[own[name], own[name]][3:, 3:]))
                              * np.linalg.norm(firsts[name].position)) for name in seen}
    return lens_of(x), poses, errors, deviations, float(np.sqrt(covariance[0, 0]) * focal_share)
