"""Where cameras stood over a plane of which nothing is known: a start from homographies, and bundle adjustment.

A pixel of one photo is carried to the plane and into another photo, so the plane's points are no unknowns. Unknown are the
lens (focal length, distortion) and a pose of each photo. The frame is that of one photo, the hub: above the origin at
height 1, the world's x along its own.

Source: Triggs 1998, Autocalibration from Planar Scenes; Zhang 2000; bundle adjustment as in Triggs et al. 2000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lens import Lens, Pose, rays

Array = NDArray[np.float64]

# Deviations of what is expected beforehand. They decide where photos do not: taken nearly parallel, a tilt of all cameras
# looks like a shift, and a focal length like a height.
TILT = 0.17  # of a camera's axis from straight down, rad
HEIGHT = 0.15  # of a camera's height from the others', as a share
DISTORTION = (0.03, 0.01)  # k1, k2: phones correct their lens
SOFT = 1.0  # deviations from which on an error counts in proportion only
ALIKE = 10  # matches count as one for what is left uncertain: relief, highlights and what the lens lacks err alike nearby
UNKNOWNS = 6  # of a pose


@dataclass(frozen=True)
class Match:
    """The same points of the plane in two photos.

    Args:
        a: name of a photo.
        b: name of another.
        at_a: K x 2, pixels of ``a``.
        at_b: K x 2, pixels of ``b``.
        sigma: deviation of an error, in pixels.
    """

    a: str
    b: str
    at_a: Array
    at_b: Array
    sigma: float

    def pick(self, index) -> Match:
        """Those with these indices."""
        return replace(self, at_a=self.at_a[index], at_b=self.at_b[index])

    def errors(self, lens: Lens, poses: dict[str, Pose]) -> Array:
        """Distance in pixels of ``b`` to where each pixel of ``a`` is carried, K."""
        return np.linalg.norm(self.at_b - carried(lens, poses[self.a], poses[self.b], self.at_a), axis=1)


def carried(lens: Lens, a: Pose, b: Pose, pixels: Array) -> Array:
    """Where in photo b the points of the plane are that pixels (K x 2) of photo a see."""
    return _carried(lens, a.rotation, a.position, b.rotation, b.position, rays(lens, pixels))


def _carried(lens: Lens, rotation_a, position_a, rotation_b, position_b, directions: Array) -> Array:
    """As :func:`carried`; each row may have poses of its own (K x 3 x 3, K x 3)."""
    down = np.einsum("...ji,...j->...i", rotation_a, directions)
    point = position_a - down * (position_a[..., 2:] / down[..., 2:])
    seen = np.einsum("...ij,...j->...i", rotation_b, point - position_b)
    at = seen[..., :2] / seen[..., 2:]
    r2 = np.square(at).sum(axis=-1, keepdims=True)
    return lens.focal * at * (1 + lens.distortion[0] * r2 + lens.distortion[1] * r2**2) + lens.middle


def _turned(vectors: Array) -> Array:
    """Rotations (... x 3 x 3) by rotation vectors (... x 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vectors).as_matrix()


def starts(lens: Lens, homographies: dict[str, Array], hub: str, most: int = 3) -> list[dict[str, Pose]]:
    """Poses that agree with homographies, for the likeliest tilts of the hub; the best first.

    For a tilt of the hub each homography gives the two axes of the plane in the other camera. They must be of one length and
    at a right angle, which tells tilts apart; there may be two answers, and with parallel photos there are many.

    Args:
        homographies: from pixels of the hub to pixels of each photo, 3 x 3; that of the hub is 1.
        most: number of starts.
    """
    inverse = np.linalg.inv(lens.matrix)
    maps = np.stack([inverse @ h @ lens.matrix for h in homographies.values()])
    steps = np.deg2rad(np.arange(-48, 49, 4.0))
    tilts = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    above = np.diag((1.0, -1.0, -1.0))  # looks straight down, the world's y up in the photo
    hubs = _turned(np.pad(tilts, ((0, 0), (0, 1)))) @ above
    frames = np.concatenate((hubs[:, :, :2], -hubs[:, :, 2:]), axis=2)  # of a plane's (x, y, 1), seen from (0, 0, 1)
    axes = maps[:, None] @ frames
    x, y = axes[..., 0], axes[..., 1]
    xx, yy, xy = (x * x).sum(-1), (y * y).sum(-1), (x * y).sum(-1)
    skew = (xy**2 + (xx - yy) ** 2 / 4) / ((xx + yy) / 2) ** 2
    cost = np.minimum(skew, 0.05).sum(axis=0) + 0.003 * np.square(tilts).sum(axis=-1) / TILT**2
    chosen: list[int] = []
    for k in np.argsort(cost):
        if len(chosen) < most and all(np.linalg.norm(tilts[k] - tilts[c]) > 0.25 for c in chosen):
            chosen.append(k)
    return [{name: _pose(axes[n, k]) for n, name in enumerate(homographies)} for k in chosen]


def _pose(axes: Array) -> Pose:
    """The pose nearest to a plane's x axis, y axis and origin in camera axes, up to scale (columns of 3 x 3)."""
    scale = np.linalg.norm(axes[:, :2], axis=0).mean() * np.sign(axes[2, 2])
    x, y, origin = (axes / scale).T
    u, _, v = np.linalg.svd(np.stack((x, y, np.cross(x, y)), axis=1))
    rotation = u @ np.diag((1, 1, np.linalg.det(u @ v))) @ v
    position = -rotation.T @ origin
    return Pose(np.array([*position[:2], max(position[2], 0.05)]), rotation)


def adjust(lens: Lens, poses: dict[str, Pose], hub: str, matches: Sequence[Match], focal: float, focal_share: float,
           steps: int = 50) -> tuple[Lens, dict[str, Pose], float, float]:
    """Lens and poses at which matches and what is expected beforehand agree best.

    Args:
        poses: a start; that of the hub is above the origin and stays there, but may tilt.
        matches: between photos of ``poses``.
        focal: focal length that is expected beforehand, in pixels; that of ``lens`` is but a start.
        focal_share: deviation of the expected focal length from the true one, as a share.
        steps: most steps.

    Returns:
        Lens, poses, the cost, which tells starts apart, and the standard deviation of the focal length, as a share.
    """
    from scipy.optimize import least_squares

    names = list(poses)
    rotations = np.stack([poses[name].rotation for name in names])
    positions = np.stack([poses[name].position for name in names])
    row = names.index(hub)
    first = np.concatenate([np.full(len(m.at_a), names.index(m.a)) for m in matches])
    second = np.concatenate([np.full(len(m.at_b), names.index(m.b)) for m in matches])
    at_a, at_b = np.concatenate([m.at_a for m in matches]), np.concatenate([m.at_b for m in matches])
    sigma = np.concatenate([np.full(len(m.at_a), m.sigma) for m in matches])[:, None]
    moved_before = math.log(lens.focal / focal)
    count, expected = len(at_a), 3 + 3 * len(names)
    free = np.ones(3 + UNKNOWNS * len(names), dtype=bool)
    free[3 + UNKNOWNS * row : 3 + UNKNOWNS * (row + 1)] = (True, True, False, False, False, False)
    start = np.concatenate(((0.0, *lens.distortion), np.concatenate((np.zeros_like(positions), positions), axis=1).ravel()))

    def unpacked(values: Array) -> tuple[Lens, Array, Array]:
        own = values[3:].reshape(-1, UNKNOWNS)
        found = replace(lens, focal=lens.focal * math.exp(values[0]), distortion=(float(values[1]), float(values[2])))
        return found, _turned(own[:, :3]) @ rotations, own[:, 3:]

    def reprojection(seen: Array, found: Lens, turned: tuple[Array, Array], at: tuple[Array, Array]) -> Array:
        return (_carried(found, turned[0], at[0], turned[1], at[1], seen) - at_b) / sigma

    def beforehand(values: Array) -> Array:
        _, turned, at = unpacked(values)
        height = np.log(np.maximum(at[:, 2], 1e-3))
        shared = (values[:3] + (moved_before, 0.0, 0.0)) / (focal_share, *DISTORTION)
        return np.concatenate((shared, (height - height.mean()) / HEIGHT,
                               turned[:, 2, :2].ravel() / math.sin(TILT)))

    def full(chosen: Array) -> Array:
        values = start.copy()
        values[free] = chosen
        return values

    def residuals(chosen: Array) -> Array:
        values = full(chosen)
        found, turned, at = unpacked(values)
        error = reprojection(rays(found, at_a), found, (turned[first], turned[second]), (at[first], at[second]))
        return np.concatenate((np.nan_to_num(error, nan=1e3, posinf=1e3, neginf=-1e3).ravel(), beforehand(values)))

    def slopes(chosen: Array) -> Array:
        """Central differences: the same unknown of all photos at once, as a match knows but two of them."""
        values, step = full(chosen), 1e-6
        out = np.zeros((2 * count + expected, len(values)))
        matched = out[: 2 * count].reshape(count, 2, -1)
        for k in range(3 + UNKNOWNS):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[k if k < 3 else slice(k, None, UNKNOWNS)] += sign * step
                ends.append(unpacked(moved))
            if k < 3:
                found = [reprojection(rays(f, at_a), f, (r[first], r[second]), (p[first], p[second])) for f, r, p in ends]
                matched[:, :, k] = (found[0] - found[1]) / (2 * step)
                continue
            own, turned, at = unpacked(values)
            seen = rays(own, at_a)
            found = [reprojection(seen, own, (r[first], turned[second]), (p[first], at[second])) for _, r, p in ends]
            columns = 3 + UNKNOWNS * np.stack((first, second)) + k - 3
            matched[np.arange(count), :, columns[0]] += (found[0] - found[1]) / (2 * step)
            found = [reprojection(seen, own, (turned[first], r[second]), (at[first], p[second])) for _, r, p in ends]
            matched[np.arange(count), :, columns[1]] += (found[0] - found[1]) / (2 * step)
        for k in np.flatnonzero(free):
            moved = np.zeros_like(values)
            moved[k] = step
            out[2 * count :, k] = (beforehand(values + moved) - beforehand(values - moved)) / (2 * step)
        return out[:, free]

    def loss(z: Array) -> Array:
        """Pseudo-Huber for matches, squares for what is expected."""
        rho = np.stack((z, np.ones_like(z), np.zeros_like(z)))
        t = 1 + z[: 2 * count] / SOFT**2
        rho[:, : 2 * count] = 2 * SOFT**2 * (np.sqrt(t) - 1), t**-0.5, -0.5 * t**-1.5 / SOFT**2
        return rho

    result = least_squares(residuals, start[free], slopes, x_scale="jac", loss=loss, max_nfev=steps, ftol=1e-6, xtol=1e-7)
    found, turned, at = unpacked(full(result.x))
    jacobian = result.jac / np.where(np.arange(len(result.jac)) < 2 * count, math.sqrt(ALIKE), 1)[:, None]
    unsure = math.sqrt(np.linalg.inv(jacobian.T @ jacobian)[0, 0])
    return found, {name: Pose(at[i], turned[i]) for i, name in enumerate(names)}, float(result.cost), unsure
