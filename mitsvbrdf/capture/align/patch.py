"""The patch: an upright square of the plane that all photos show, as large as possible; and its frame."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog

from ..lens import Array, Lens, Pose, on_plane

PHOTO_MARGIN = 0.01  # least distance of the patch from a photo's border, as a share of the photo's sides
CENTRED = 0.95  # side of the patch over that of the largest square; smaller, to fit below the cameras
GAIN = 1.25  # a photo is rejected if the patch's side grows by at least this factor without it

# EXIF orientation: direction, in the stored pixels, to the top of the photo as shown.
TOP = {1: (0, -1), 2: (0, -1), 3: (0, 1), 4: (0, 1), 5: (-1, 0), 6: (-1, 0), 7: (1, 0), 8: (1, 0)}


def upright(pose: Pose, orientation: int) -> float:
    """Angle (rad) by which to turn the plane about z, so that its y axis points up in a photo as shown."""
    x, y, _ = pose.rotation.T @ np.array([*TOP[orientation], 0.0])
    return float(np.arctan2(x, y))


def turned(pose: Pose, angle: float) -> Pose:
    """The pose after the world and its cameras are turned by an angle (rad) about z."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return Pose(turn @ pose.position, pose.rotation @ turn.T)


def framed(poses: dict[str, Pose], centre: Array, side: float) -> dict[str, Pose]:
    """Poses in the world whose origin is ``centre`` (x, y) and whose unit is ``side``."""
    return {name: Pose((p.position - (*centre, 0.0)) / side, p.rotation) for name, p in poses.items()}


def outline(lens: Lens, pose: Pose) -> Array:
    """Half planes n . (x, y) <= b, a row (n, b) per side of a photo: 4 x 3. It shows their overlap."""
    size = np.array(lens.size)
    low, high = PHOTO_MARGIN * size - 0.5, (1 - PHOTO_MARGIN) * size - 0.5
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    middle = on_plane(lens, pose, (low + high)[None] / 2)[0]
    rows = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        # distortion bends the side
        points = on_plane(lens, pose, a + np.linspace(0, 1, 9)[:, None] * (b - a))
        edge = points[-1] - points[0]
        normal = np.array([edge[1], -edge[0]]) / np.linalg.norm(edge)
        normal *= np.sign(normal @ (points[0] - middle))
        rows.append((*normal, (points @ normal).min()))
    return np.array(rows)


def largest_square(outlines: Sequence[Array]) -> float:
    """Side of the largest upright square in all outlines; below 0: there is none.

    A linear programme: the largest h. A square is in n . x <= b if n . centre + h (|n_x| + |n_y|) <= b.
    """
    sides = np.concatenate(outlines)
    reach = np.abs(sides[:, :2]).sum(axis=1)
    found = linprog((0, 0, -1), np.column_stack((sides[:, :2], reach)), sides[:, 2], bounds=(None, None))
    return 2 * found.x[2] if found.success else -1.0


def centred_square(outlines: Sequence[Array], side: float, below: Array) -> Array:
    """Centre (x, y), nearest to ``below``, of an upright square of this side within all outlines."""
    # unknowns: the centre, and |centre - below| in x and in y
    sides = np.concatenate(outlines)
    left = sides[:, 2] - side / 2 * np.abs(sides[:, :2]).sum(axis=1)
    away = np.array([[1, 0, -1, 0], [-1, 0, -1, 0], [0, 1, 0, -1], [0, -1, 0, -1.0]])
    found = linprog((0, 0, 1, 1), np.concatenate((np.pad(sides[:, :2], ((0, 0), (0, 2))), away)),
                    np.concatenate((left, away[:, :2] @ below)), bounds=(None, None))
    return found.x[:2]


def choose_patch(outlines: dict[str, Array], least: int = 3,
                 always: str | None = None) -> tuple[float, list[str]]:
    """Side of the largest square that all photos show, and names of photos rejected to make it larger.

    No photo is rejected if only ``least`` are left; the photo ``always`` is never rejected. A side of 0 or
    below: too few photos show the same part.
    """
    kept = dict(outlines)
    out: list[str] = []
    while True:
        side = largest_square(list(kept.values()))
        if len(kept) <= least:
            return side, out
        without = {name: largest_square([o for n, o in kept.items() if n != name]) for name in kept
                   if name != always}
        worst = max(without, key=without.__getitem__)
        if side > 0 and without[worst] < GAIN * side:
            return side, out
        out.append(worst)
        del kept[worst]
