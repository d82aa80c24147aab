"""Lens and poses of photos of the printed sheet, from the tags in each photo.

Bundle adjustment (Triggs et al. 2000) finds one lens (focal length, principal point, k1, k2) and a pose of
each photo: the least-squares fit to all points measured on edges of tags, with weak priors on the lens. The
sheet is a planar target as in Zhang (2000).
"""

import contextlib
import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from ...errors import CaptureError
from ...io import Report
from ...io.layout import Layout
from ..lens import Array, Lens, Pose, expected_lens, project, unsure_note
from ..photo import Photo, Unreadable
from ..rig import LEAST_PHOTOS, Rig, check_enough
from ..turned import one_place
from .planar import POSE
from .sheet import Sheet
from .tag_edges import POINTS, Edges, find_edges
from .tag_search import LEAST_TAGS

# Standard deviations of the priors. EXIF's focal length is rounded to a millimetre, and refers to the
# diagonal or to the long side. Without EXIF, the lens may be wide or tele. CENTRE_SD is for the
# principal point, as a share of the long side.
FOCAL_SHARE, FOCAL_SHARE_UNKNOWN, CENTRE_SD, DISTORTION_SD = 0.05, 0.4, 0.005, 0.1
FOCAL_SHARE_STILL = 1e-4  # for photos from one place: focal length and distance cannot be separated
NOISE = 2e-5  # error of points on edges in good photos, as a share of the long side: 0.08 pixels of 4000
# a photo is rejected if its error exceeds both: a share of the long side, a multiple of the median error
LARGE, TIMES_MEDIAN = 5e-4, 6.0
STILL, SLANTED = 0.1, 0.05  # of rectified photos, at most: shift of tags (share of their side), sine of tilt
UNSURE = 0.01  # standard deviation of the focal length, as a share, that is worth a note

LENS = Layout(log_focal=(), centre=(2,), distortion=(2,))  # unknowns of the lens: differences from the start


def rig_from_sheet(photos: Sequence[Photo], size_cm: float, depth_cm: float = 0.0,
                   report: Report = lambda text, share: None) -> Rig:
    """Lens and poses in cm from photos of the sheet. The patch is the middle 0.64 of its frame, at z = 0.

    ``size_cm``: printed size of the frame of tags, outer edge to outer edge. The sheet is ``depth_cm`` above
    the material. One photo at a time is in memory. For photos rectified to the sheet, the source is ``none``.

    Raises:
        CaptureError: fewer than three photos show the sheet.
        OnePlace: all photos show the sheet in the same place, and slanted.
    """
    sheet, seen, rejected, tags = Sheet(size_cm), dict[str, Edges](), dict[str, str](), dict[str, int]()
    for i, photo in enumerate(photos):
        report(f"tags of {photo.name}", 0.8 * i / len(photos))
        edges = find_edges(photo, sheet)
        tags[photo.name] = len(edges.corners)
        if reason := _too_few(edges, sheet):
            rejected[photo.name] = reason
        else:
            seen[photo.name] = edges
    stated = [photo.exif["35 mm focal length"] for photo in photos
              if photo.name in seen and "35 mm focal length" in photo.exif]
    still = _still(seen)
    depth_cm *= not still  # rectified photos show everything in the plane of the sheet
    size = photos[0].size
    share = FOCAL_SHARE_STILL if still else FOCAL_SHARE if stated else FOCAL_SHARE_UNKNOWN
    start = expected_lens(size, stated), share
    while True:
        check_enough(seen, rejected, "that show the sheet",
                     "take photos with all tags in view, sharp; where no sheet lies there, omit --sheet")
        report("poses", 0.8)
        lens, poses, errors, deviations, focal = _bundle(*start, sheet, depth_cm, seen)
        limit = max(LARGE * max(size), TIMES_MEDIAN * float(np.median(list(errors.values()))))
        worst = max(errors, key=lambda name: errors[name])
        if errors[worst] <= limit:
            break
        rejected[worst] = (f"its tags are {errors[worst]:.1f} pixels beside where a flat sheet would have "
                           "them: bent, moved, or seen by another lens")
        del seen[worst]
    if still and max(np.linalg.norm(pose.rotation[2, :2]) for pose in poses.values()) > SLANTED:
        raise one_place(len(seen))
    usual = float(np.median(list(errors.values())))
    notes = [unsure_note(focal)] if focal > UNSURE and not still else []
    if usual > LARGE * max(size):
        so = (": the photos were rectified no better than that" if still else
              ", and all views as uncertain as that: flatten the sheet, and take all photos with one lens")
        notes.append(f"the tags of all photos are some {usual:.1f} pixels beside where those of a flat "
                     f"sheet would be{so}")
    if trimmed := [name for name, edges in seen.items() if edges.trimmed]:
        notes.append(f"no white around the tags in {', '.join(trimmed)}: they were measured inside; keep the "
                     "white rim of the sheet")
    return Rig(lens, poses, sheet.patch, "cm", "none" if still else "sheet", errors, rejected, deviations,
               tuple(notes), tags)


def refuse_tags(photos: Sequence[Photo],
                how: str = "give that, for example `mitsvbrdf capture PHOTOS -o CAPTURE --sheet 18`") -> None:
    """Raise CaptureError if a photo shows a sheet: its size is needed. ``how``: how to give the size."""
    for photo in photos:
        count = 0
        with contextlib.suppress(Unreadable):  # the photo may not be needed
            count = len(find_edges(photo, Sheet(), patient=False).corners)
        if count >= LEAST_TAGS:
            raise CaptureError("--sheet CM for photos of a sheet of tags",
                               f"{count} tags in {photo.name} and no size",
                               f"measure the frame of tags from outer edge to outer edge and {how}")


def _still(seen: dict[str, Edges]) -> bool:
    shared = set.intersection(*(set(edges.corners) for edges in seen.values())) if seen else set()
    if len(seen) < LEAST_PHOTOS or not shared:
        return False
    at = np.array([[edges.corners[number] for number in sorted(shared)] for edges in seen.values()])
    side = np.linalg.norm(at[..., 1, :] - at[..., 0, :], axis=-1).mean()
    return bool(np.sqrt(np.square(at - at.mean(axis=0)).sum(axis=-1).mean()) < STILL * side)


def _too_few(edges: Edges, sheet: Sheet) -> str | None:
    count = len(edges.corners)
    if count < LEAST_TAGS:
        return edges.fault or f"{count or 'none'} of 16 tags seen, {LEAST_TAGS} needed"
    centres = np.array([sheet.corners[number][:, :2].mean(axis=0) for number in edges.corners])
    if np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)[1] < sheet.size / 10:
        return f"{count} of 16 tags seen, all in one line"
    return None


def _first_pose(lens: Lens, edges: Edges, sheet: Sheet, depth: float) -> Pose:
    points = np.concatenate([sheet.corners[number] for number in edges.corners])
    bends = np.array([*lens.distortion, 0.0, 0.0, 0.0])  # k1, k2, p1, p2, k3
    _, turns, shifts, errors = cv2.solvePnPGeneric(points, np.concatenate(list(edges.corners.values())),
                                                   lens.matrix, bends, flags=cv2.SOLVEPNP_IPPE)
    best = int(np.argmin(np.ravel(errors)))
    rotation = cv2.Rodrigues(turns[best])[0]
    return Pose(-rotation.T @ np.ravel(shifts[best]) + (0.0, 0.0, depth), rotation)


def _bundle(lens: Lens, focal_share: float, sheet: Sheet, depth: float, seen: dict[str, Edges]
            ) -> tuple[Lens, dict[str, Pose], dict[str, float], dict[str, float], float]:
    """Lens, poses, RMS errors (pixels), standard deviations of positions (cm) and focal length (share)."""
    problem = _Bundle(lens, focal_share, sheet, depth, seen)
    found = least_squares(problem.residuals, np.zeros(problem.layout.size), problem.slopes, loss="soft_l1",
                          f_scale=3.0, x_scale="jac")
    x, left = found.x, problem.residuals(found.x)
    poses = {name: problem.pose(name, x[own]) for name, own in problem.own.items()}
    errors = {name: float(np.sqrt(np.square(left[rows]).mean()) * problem.noise)
              for name, rows in problem.rows.items()}
    jacobian = problem.slopes(x)
    # Errors along an edge are correlated: all its points count as two independent ones.
    spread = max(1.0, np.square(left[problem.equations["points"]]).mean()) * POINTS / 2
    jacobian[problem.equations["points"]] /= np.sqrt(spread)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    position = POSE["position"]
    deviations = {name: float(np.sqrt(np.trace(covariance[own, own][position, position]))
                              * np.linalg.norm(problem.firsts[name].position))
                  for name, own in problem.own.items()}
    focal = LENS.unpack(problem.layout.numbers.lens).log_focal
    focal_sd = float(np.sqrt(covariance[focal, focal]) * focal_share)
    return problem.lens_of(x), poses, errors, deviations, focal_sd


class _Bundle:
    """The least-squares problem of all photos: the prior of the lens, then each photo's points.

    ``equations`` is the layout of residuals: ``prior``, five for the lens; ``points``, one for each point.
    ``rows`` has the slice of each photo. ``layout`` is that of unknowns: ``lens``, as :data:`LENS` but in
    standard deviations of the prior; ``poses``, each as :data:`~.planar.POSE`: a rotation (rad) applied after
    that of the start, and a shift as a share of the distance.
    """

    def __init__(self, lens: Lens, focal_share: float, sheet: Sheet, depth: float,
                 seen: dict[str, Edges]) -> None:
        width = max(lens.size)
        self.lens, self.seen, self.noise = lens, seen, NOISE * width
        self.firsts = {name: _first_pose(lens, edges, sheet, depth) for name, edges in seen.items()}
        self.points = {name: np.column_stack((edges.plane, np.full(len(edges.plane), depth)))
                       for name, edges in seen.items()}
        self.spread = LENS.pack(log_focal=focal_share, centre=CENTRE_SD * width, distortion=DISTORTION_SD)
        self.layout = Layout(lens=(LENS.size,), poses=(len(seen), POSE.size))
        self.own = {name: slice(at[0], at[-1] + 1) for name, at in zip(seen, self.layout.numbers.poses)}
        counts = [len(edges.plane) for edges in seen.values()]
        self.equations = Layout(prior=(LENS.size,), points=(sum(counts),))
        ends = np.cumsum([self.equations["points"].start, *counts])
        self.rows = {name: slice(*ends[i : i + 2]) for i, name in enumerate(seen)}

    def lens_of(self, x: Array) -> Lens:
        """The lens for all unknowns ``x``."""
        moved, middle = LENS.unpack(x[self.layout["lens"]] * self.spread), self.lens.middle
        (u, v), distortion = moved.centre.tolist(), tuple(moved.distortion.tolist())
        return replace(self.lens, focal=self.lens.focal * math.exp(moved.log_focal),
                       centre=(middle[0] + u, middle[1] + v), distortion=distortion)

    def pose(self, name: str, own: Array) -> Pose:
        """The pose of a photo for its six unknowns."""
        first, moved = self.firsts[name], POSE.unpack(own)
        return Pose(first.position + moved.position * np.linalg.norm(first.position),
                    cv2.Rodrigues(moved.rotation)[0] @ first.rotation)

    def _of_photo(self, name: str, x: Array) -> Array:
        off = (project(self.lens_of(x), self.pose(name, x[self.own[name]]), self.points[name])
               - self.seen[name].pixels)
        return np.nan_to_num((off * self.seen[name].across).sum(axis=1) / self.noise, nan=1e6)

    def residuals(self, x: Array) -> Array:
        """All residuals, in standard deviations, in the layout ``equations``."""
        return np.concatenate([x[self.layout["lens"]], *(self._of_photo(name, x) for name in self.seen)])

    def slopes(self, x: Array) -> Array:
        """The Jacobian by central differences; a photo's residuals depend on the lens and its own pose."""
        out, numbers = np.zeros((self.equations.size, len(x))), self.layout.numbers
        out[self.equations["prior"], self.layout["lens"]] = np.eye(LENS.size)
        for name, own in zip(self.seen, numbers.poses):
            for columns, step in ((numbers.lens, 1e-4), (own, 1e-6)):
                for column in columns:
                    high, low = x.copy(), x.copy()
                    high[column] += step
                    low[column] -= step
                    out[self.rows[name], column] = ((self._of_photo(name, high) - self._of_photo(name, low))
                                                    / (2 * step))
        return out
