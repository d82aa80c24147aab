"""Poses of cameras over an unknown plane: a start from homographies, then bundle adjustment.

A pixel of one photo is projected onto the plane, and from there into another photo. So points of the plane
are no unknowns. The unknowns are the lens (focal length, distortion) and a pose of each photo. One photo, the
hub, sets the frame: it is above the origin at height 1, and the world's x axis points along the hub's.

Source: Triggs 1998, Autocalibration from Planar Scenes; Zhang 2000; Triggs et al. 2000, bundle adjustment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...io.layout import Layout
from ..lens import Array, Lens, Pose, rays

# Standard deviations of the priors. They decide what photos do not: in nearly parallel photos, a tilt of all
# cameras looks like a shift, and a focal length like a height.
TILT_SD = 0.17  # of a camera's axis from straight down, rad
HEIGHT_SD = 0.15  # of a camera's height from the others', as a share
DISTORTION_SD = (0.03, 0.01)  # k1, k2: phones correct their lens
SOFT = 1.0  # larger errors, in standard deviations, count linearly
MOST_STARTS = 3  # tilts of the hub from which the bundle adjustment starts
# this many matches count as one for uncertainties: errors of relief, highlights and lens are correlated
ALIKE = 10

# unknowns of a photo: a rotation vector, applied after the start's rotation; x, y, z
POSE = Layout(rotation=(3,), position=(3,))


@dataclass(frozen=True)
class Match:
    """The same points of the plane in two photos."""

    a: str  # name of a photo
    b: str  # name of another
    at_a: Array  # K x 2, pixels of a
    at_b: Array  # K x 2, pixels of b
    sigma: float  # standard deviation of an error, in pixels

    def pick(self, index: Any) -> Match:
        """The matches with these indices."""
        return replace(self, at_a=self.at_a[index], at_b=self.at_b[index])

    def errors(self, lens: Lens, poses: dict[str, Pose]) -> Array:
        """K distances in pixels of ``b``, from points of ``a`` projected into ``b`` to points of ``b``."""
        seen = rays(lens, self.at_a)
        return np.linalg.norm(self.at_b - carried(lens, poses[self.a], poses[self.b], seen), axis=1)


def carried(lens: Lens, a: Pose, b: Pose, directions: Array) -> Array:
    """Pixels in b of the points where rays (K x 3) of a meet the plane; a and b are one pose or K poses."""
    down = np.einsum("...ji,...j->...i", a.rotation, directions)
    point = a.position - down * (a.position[..., 2:] / down[..., 2:])
    seen = np.einsum("...ij,...j->...i", b.rotation, point - b.position)
    at = seen[..., :2] / seen[..., 2:]
    r2 = np.square(at).sum(axis=-1, keepdims=True)
    return lens.focal * at * (1 + lens.distortion[0] * r2 + lens.distortion[1] * r2**2) + lens.middle


def starts(lens: Lens, homographies: dict[str, Array]) -> list[dict[str, Pose]]:
    """Poses that agree with homographies, for the likeliest tilts of the hub; the best first.

    A homography maps pixels of the hub to pixels of a photo; that of the hub is the identity. Given a tilt of
    the hub, it defines two axes of the plane in the photo's camera. With the right tilt, these have the same
    length and are at a right angle. Two tilts may satisfy this; with parallel photos, many do.
    """
    inverse = np.linalg.inv(lens.matrix)
    maps = np.stack([inverse @ h @ lens.matrix for h in homographies.values()])
    steps = np.deg2rad(np.arange(-48, 49, 4.0))
    tilts = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    above = np.diag((1.0, -1.0, -1.0))  # looks straight down, the world's y up in the photo
    hubs = Rotation.from_rotvec(np.pad(tilts, ((0, 0), (0, 1)))).as_matrix() @ above
    # from (x, y, 1) of the plane to camera axes of a hub at (0, 0, 1)
    frames = np.concatenate((hubs[:, :, :2], -hubs[:, :, 2:]), axis=2)
    axes = maps[:, None] @ frames
    x, y = axes[..., 0], axes[..., 1]
    xx, yy, xy = (x * x).sum(-1), (y * y).sum(-1), (x * y).sum(-1)
    skew = (xy**2 + (xx - yy) ** 2 / 4) / ((xx + yy) / 2) ** 2
    cost = np.minimum(skew, 0.05).sum(axis=0) + 0.003 * np.square(tilts).sum(axis=-1) / TILT_SD**2
    chosen: list[int] = []
    for k in np.argsort(cost):
        if len(chosen) < MOST_STARTS and all(np.linalg.norm(tilts[k] - tilts[c]) > 0.25 for c in chosen):
            chosen.append(k)
    return [{name: _pose(axes[n, k]) for n, name in enumerate(homographies)} for k in chosen]


def _pose(axes: Array) -> Pose:
    """The pose that best fits a plane's x axis, y axis and origin (columns, in camera axes), up to scale."""
    scale = np.linalg.norm(axes[:, :2], axis=0).mean() * np.sign(axes[2, 2])
    x, y, origin = (axes / scale).T
    u, _, v = np.linalg.svd(np.stack((x, y, np.cross(x, y)), axis=1))
    rotation = u @ np.diag((1, 1, np.linalg.det(u @ v))) @ v
    position = -rotation.T @ origin
    return Pose(np.array([*position[:2], max(position[2], 0.05)]), rotation)


def adjust(lens: Lens, poses: dict[str, Pose], hub: str, matches: Sequence[Match], focal: float,
           focal_share: float, steps: int = 50) -> tuple[Lens, dict[str, Pose], float, float]:
    """Lens and poses that agree best with the matches and the priors.

    The hub stays above the origin, but may tilt. The focal length of ``lens`` is only a start. Its prior is
    ``focal`` (pixels) with a standard deviation of ``focal_share`` times that. The third value is the cost,
    by which starts are compared. The fourth is the focal length's standard deviation, as a share.
    """
    problem = _Bundle(lens, poses, hub, matches, focal, focal_share)
    result = least_squares(problem.residuals, problem.start[problem.free], problem.slopes, x_scale="jac",
                           loss=problem.loss, max_nfev=steps, ftol=1e-6, xtol=1e-7)
    found, all_poses = problem.rig(problem.full(result.x))
    counted = np.where(np.arange(len(result.jac)) < 2 * problem.count, math.sqrt(ALIKE), 1)
    jacobian = result.jac / counted[:, None]
    focal_at = problem.layout.numbers.log_focal
    unsure = math.sqrt(np.linalg.inv(jacobian.T @ jacobian)[focal_at, focal_at])
    return found, {name: all_poses.pick(i) for i, name in enumerate(poses)}, float(result.cost), unsure


class _Bundle:
    """The least-squares problem of :func:`adjust`: K matches in two coordinates each, then the priors.

    ``layout`` is that of unknowns: ``log_focal``, log of the focal length over the start's; ``distortion``,
    k1 and k2; ``poses``, each as :data:`POSE`. The hub's position and turn about its axis are not ``free``.
    """

    def __init__(self, lens: Lens, poses: dict[str, Pose], hub: str, matches: Sequence[Match], focal: float,
                 focal_share: float) -> None:
        names = list(poses)
        self.lens, self.focal_share, self.moved_before = lens, focal_share, math.log(lens.focal / focal)
        self.rotations = np.stack([poses[name].rotation for name in names])
        positions = np.stack([poses[name].position for name in names])
        self.first = np.concatenate([np.full(len(m.at_a), names.index(m.a)) for m in matches])
        self.second = np.concatenate([np.full(len(m.at_b), names.index(m.b)) for m in matches])
        self.at_a = np.concatenate([m.at_a for m in matches])
        self.at_b = np.concatenate([m.at_b for m in matches])
        self.sigma = np.concatenate([np.full(len(m.at_a), m.sigma) for m in matches])[:, None]
        self.count = len(self.at_a)
        self.layout = Layout(log_focal=(), distortion=(2,), poses=(len(names), POSE.size))
        self.start = self.layout.pack(distortion=lens.distortion,
                                      poses=[POSE.pack(position=p) for p in positions])
        self.free = np.ones(self.layout.size, dtype=bool)
        self.free[self.layout.numbers.poses[names.index(hub)]] = POSE.pack(rotation=(True, True, False)) == 1

    def full(self, chosen: Array) -> Array:
        """All unknowns, from the free ones; the others keep the values of the start."""
        values = self.start.copy()
        values[self.free] = chosen
        return values

    def rig(self, values: Array) -> tuple[Lens, Pose]:
        """The lens, and the N poses in one :class:`Pose`."""
        u = self.layout.unpack(values)
        own = POSE.unpack(u.poses)
        lens = replace(self.lens, focal=self.lens.focal * math.exp(u.log_focal),
                       distortion=tuple(u.distortion.tolist()))
        return lens, Pose(own.position, Rotation.from_rotvec(own.rotation).as_matrix() @ self.rotations)

    def _reprojection(self, seen: Array, lens: Lens, a: Pose, b: Pose) -> Array:
        """Errors (K x 2, standard deviations) of rays (K x 3) of first photos in second ones, for N poses."""
        return (carried(lens, a.pick(self.first), b.pick(self.second), seen) - self.at_b) / self.sigma

    def _beforehand(self, values: Array) -> Array:
        """Residuals of the priors of lens, heights and tilts, in standard deviations: 3 + 3 N."""
        _, poses = self.rig(values)
        height = np.log(np.maximum(poses.position[:, 2], 1e-3))
        u = self.layout.unpack(values)
        shared = (np.array((u.log_focal + self.moved_before, *u.distortion))
                  / (self.focal_share, *DISTORTION_SD))
        return np.concatenate((shared, (height - height.mean()) / HEIGHT_SD,
                               poses.rotation[:, 2, :2].ravel() / math.sin(TILT_SD)))

    def residuals(self, chosen: Array) -> Array:
        """2 K residuals of matches, then those of the priors, in standard deviations."""
        values = self.full(chosen)
        lens, poses = self.rig(values)
        error = self._reprojection(rays(lens, self.at_a), lens, poses, poses)
        return np.concatenate((np.nan_to_num(error, nan=1e3, posinf=1e3, neginf=-1e3).ravel(),
                               self._beforehand(values)))

    def slopes(self, chosen: Array) -> Array:
        """Jacobian by central differences, one unknown of all photos at once: a match involves two photos."""
        values, step, at = self.full(chosen), 1e-6, self.layout.numbers
        expected = 3 + 3 * len(self.rotations)
        out = np.zeros((2 * self.count + expected, len(values)))
        matched, match = out[: 2 * self.count].reshape(self.count, 2, -1), np.arange(self.count)

        def ends(moving: Any) -> list[tuple[Lens, Pose]]:
            moved = [values.copy(), values.copy()]
            for each, sign in zip(moved, (1, -1)):
                each[moving] += sign * step
            return [self.rig(each) for each in moved]

        for k in (at.log_focal, *at.distortion):
            more, less = (self._reprojection(rays(f, self.at_a), f, p, p) for f, p in ends(k))
            matched[:, :, k] = (more - less) / (2 * step)
        lens, poses = self.rig(values)
        seen = rays(lens, self.at_a)
        for unknown in at.poses.T:
            both = ends(unknown)
            more, less = (self._reprojection(seen, lens, moved, poses) for _, moved in both)
            matched[match, :, unknown[self.first]] += (more - less) / (2 * step)
            more, less = (self._reprojection(seen, lens, poses, moved) for _, moved in both)
            matched[match, :, unknown[self.second]] += (more - less) / (2 * step)
        for k in np.flatnonzero(self.free):
            moved = np.zeros_like(values)
            moved[k] = step
            out[2 * self.count :, k] = ((self._beforehand(values + moved) - self._beforehand(values - moved))
                                        / (2 * step))
        return out[:, self.free]

    def loss(self, z: Array) -> Array:
        """Pseudo-Huber for matches, squares for the priors."""
        matches = 2 * self.count
        rho = np.stack((z, np.ones_like(z), np.zeros_like(z)))
        t = 1 + z[:matches] / SOFT**2
        rho[:, :matches] = 2 * SOFT**2 * (np.sqrt(t) - 1), t**-0.5, -0.5 * t**-1.5 / SOFT**2
        return rho
