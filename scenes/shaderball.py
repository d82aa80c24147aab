"""Writes ``shaderball.ply`` beside this file: ``python scenes/shaderball.py``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mitsvbrdf.render.exclusive import using_mitsuba

# The outline of the shader ball from the floor up, (radius, height): control points of a cubic B-spline. A
# foot, a groove, a belly, a rim, and a dish that falls from the rim to the axis.
OUTLINE = ((0.60, -0.05), (0.84, -0.01), (0.95, 0.08), (0.95, 0.22), (0.82, 0.31), (0.66, 0.35), (0.68, 0.44),
           (0.90, 0.54),
           (1.05, 0.82), (1.08, 1.12), (1.02, 1.42), (0.88, 1.68), (0.72, 1.84), (0.62, 1.86), (0.53, 1.76),
           (0.36, 1.63), (0.17, 1.58), (0.0, 1.57), (-0.17, 1.58))
QUADS_AROUND, QUADS_BETWEEN = 96, 5  # quads around the axis, and between two control points
TILES_AROUND = 2  # around the axis: one is in front, and they meet at the sides


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: positions, normals V x 3; uv V x 2; faces F x 3, counter-clockwise outside."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray


def shaderball() -> Mesh:
    """The shader ball: a surface of revolution about z, standing on z = 0, 1.9 high; front is -y.

    Texture coordinates keep angles. Around the side u is the turn, and v grows as the arc length over the
    radius, so the maps are smaller where the ball is thin; in the dish they are seen from above, as large as
    at its rim.
    """
    r, z, normal_r, normal_z = _outline()
    top = int(np.argmax(z))
    lengths = np.hypot(np.diff(r), np.diff(z))[:top]
    v = (np.concatenate(([0.0], np.cumsum(lengths * 2 / (r[:top] + r[1:top + 1])))) * TILES_AROUND
         / (2 * math.pi))
    v += 0.5 - v[np.argmax(r[:top + 1])]
    turn = np.linspace(-1.5 * math.pi, 0.5 * math.pi, QUADS_AROUND + 1)  # the seam is at the back
    cos, sin = np.cos(turn), np.sin(turn)
    u = (turn + 0.5 * math.pi) * TILES_AROUND / (2 * math.pi) + 0.5

    def part(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        around = [np.stack((radial[rows, None] * cos, radial[rows, None] * sin,
                            np.broadcast_to(up[rows, None], (len(up[rows]), len(turn)))), axis=-1)
                  for radial, up in ((r, z), (normal_r, normal_z))]
        return around[0], around[1]

    side, side_normals = part(slice(None, top + 1))
    dish, dish_normals = part(slice(top, None))
    side_uv = np.stack(np.broadcast_arrays(u[None], v[:, None]), axis=-1)
    dish_uv = dish[..., :2] * TILES_AROUND / (2 * math.pi * r[top]) + 0.5
    return _joined(sheet(side, side_normals, side_uv), sheet(dish, dish_normals, dish_uv))


def _outline() -> tuple[np.ndarray, ...]:
    """The outline's points, radius and height, and its outward normals, likewise."""
    points = np.array(OUTLINE)
    segments = len(points) - 3
    s = np.linspace(0, segments, segments * QUADS_BETWEEN + 1)
    first = np.minimum(s.astype(int), segments - 1)
    controls = points[first[:, None] + np.arange(4)]
    t = (s - first)[:, None]
    basis = np.concatenate(((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3),
                           axis=1) / 6
    slope = np.concatenate((-(1 - t) ** 2, 3 * t**2 - 4 * t, -3 * t**2 + 2 * t + 1, t**2), axis=1) / 2
    place, tangent = ((weights[..., None] * controls).sum(axis=1) for weights in (basis, slope))
    normal = (np.stack((tangent[:, 1], -tangent[:, 0]), axis=1)
              / np.linalg.norm(tangent, axis=1, keepdims=True))
    return place[:, 0], place[:, 1], normal[:, 0], normal[:, 1]


def _joined(first: Mesh, second: Mesh) -> Mesh:
    """Both as one mesh."""
    both = {name: np.concatenate((getattr(first, name), getattr(second, name))) for name in ("positions",
                                                                                             "normals", "uv")}
    return Mesh(**both, faces=np.concatenate((first.faces, second.faces + len(first.positions))))


def sheet(positions: np.ndarray, normals: np.ndarray, uv: np.ndarray) -> Mesh:
    """A grid of rows x columns vertices as a mesh; outside is where columns x rows points."""
    rows, columns = positions.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate((np.stack((a, b, c), axis=-1), np.stack((a, c, d), axis=-1)), axis=2)
    return Mesh(positions.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), faces.reshape(-1, 3))


def mitsuba_mesh(mi: ModuleType, mesh: Mesh, name: str, material: Any = None) -> Any:
    """The mesh as a Mitsuba shape, with this BSDF where one is given."""
    props = mi.Properties()
    if material is not None:
        props["bsdf"] = material
    shape = mi.Mesh(name, len(mesh.positions), len(mesh.faces), props=props, has_vertex_normals=True,
                    has_vertex_texcoords=True)
    held = mi.traverse(shape)
    for key, value in (("vertex_positions", mesh.positions), ("vertex_normals", mesh.normals),
                       ("vertex_texcoords", mesh.uv)):
        held[key] = mi.Float(np.ascontiguousarray(value, dtype=np.float32).ravel())
    held["faces"] = mi.UInt32(np.ascontiguousarray(mesh.faces, dtype=np.uint32).ravel())
    held.update()
    return shape


if __name__ == "__main__":
    with using_mitsuba() as mi:
        mitsuba_mesh(mi, shaderball(), "ball").write_ply(str(Path(__file__).with_suffix(".ply")))
