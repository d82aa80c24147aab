"""A patch with relief as a triangle mesh, and meshes as Mitsuba's shapes."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: positions, normals V x 3; uv V x 2; faces F x 3, counter-clockwise outside."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray


def relief(height: Tensor) -> Mesh:
    """The patch of side 1 with a height at each texel's centre; the normals stay the plane's.

    A normal map then still leans from the plane, as it was fitted, while silhouettes, shadows and parallax
    follow the height.

    Args:
        height: R x R in patch sides, row 0 at the top.
    """
    padded = torch.nn.functional.pad(height[None, None].double(), (1, 1, 1, 1), mode="replicate")
    lifted = padded[0, 0].flip(0).numpy()
    at = np.concatenate(([0.0], (np.arange(len(height)) + 0.5) / len(height), [1.0]))
    u, v = np.meshgrid(at, at)
    positions = np.stack((u - 0.5, v - 0.5, lifted), axis=-1)
    return sheet(positions, np.broadcast_to([0.0, 0.0, 1.0], positions.shape), np.stack((u, v), axis=-1))


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
