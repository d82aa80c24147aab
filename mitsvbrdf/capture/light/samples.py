"""Samples of the light in photos: means over small blocks of paper or material, with their positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from ... import color
from ...color import NEARLY_CLIPPED
from ...errors import CaptureError
from ...views import texel_positions
from ..lens import Array, Lens, Pose, on_plane, project
from ..rig import Rig

FAINTEST_CORNER = 0.2  # least transmission

BLOCKS_ALONG = 96  # blocks along a photo's long side; a block of paper is a sample
MATERIAL_SIDE = 32  # most texels a side to which a material is averaged
DARK_VALUE = 0.03  # display values below are noise
DIM = 0.1  # display value at which noise in the logarithm is as large as the model's error
CELLS = 8  # cells a side of a photo; residuals within a cell may be correlated


@dataclass(frozen=True)
class _Seen:
    """Points of one photo: position (K x 3), pixel (K x 2), linear radiance and display value (K x 3)."""

    points: Array
    pixels: Array
    linear: Array
    display: Array
    usable: np.ndarray
    texels: np.ndarray
    cells: np.ndarray


def paper_samples(pixels: np.ndarray, lens: Lens, pose: Pose, white: Callable[[Array], np.ndarray],
                  depth: float, transfer: color.Transfer) -> _Seen:
    """Blocks of a photo; ``usable``: those that show nothing but white paper."""
    height, width = pixels.shape[:2]
    step = max(1, max(height, width) // BLOCKS_ALONG)
    rows, columns = height // step, width // step
    whole = float(np.iinfo(pixels.dtype).max) if np.issubdtype(pixels.dtype, np.integer) else 1.0
    blocks = pixels[:rows * step, :columns * step].reshape(rows, step, columns, step, 3)
    display, darkest, brightest = (f(blocks, axis=(1, 3)).reshape(-1, 3).astype(np.float64) / whole
                                   for f in (np.mean, np.min, np.max))
    row, column = (index.ravel() for index in np.mgrid[:rows, :columns])
    scale = 1 / max(1, round(lens.size[0] / width))
    here, usable = [], np.ones(len(row), dtype=bool)
    for down, right in ((0.5, 0.5), (0, 0), (0, 1), (1, 0), (1, 1)):
        at = np.stack(((column + right) * step, (row + down) * step), axis=1) / scale - 0.5
        points = on_plane(lens, pose, at, depth)
        there = np.concatenate((points, np.full_like(points[:, :1], depth)), axis=1)
        usable &= np.isfinite(project(lens, pose, there)[:, 0]) & np.asarray(white(points), dtype=bool)
        here.append((there, at))
    usable &= (brightest < NEARLY_CLIPPED).all(axis=1) & ((brightest - darkest).max(axis=1) < 0.25)
    cells = row * CELLS // rows * CELLS + column * CELLS // columns
    linear = color.decode(torch.from_numpy(display), transfer).numpy()
    return _Seen(*here[0], linear, display, usable, np.zeros(len(row), dtype=int), cells)


def material_samples(photo: np.ndarray, lens: Lens, pose: Pose, size: float,
                     transfer: color.Transfer) -> _Seen:
    """Texels of a rectified photo, averaged to 32 x 32 at most."""
    side = min(MATERIAL_SIDE, photo.shape[0])
    step = photo.shape[0] // side
    blocks = np.asarray(photo, dtype=np.float64)[:side * step, :side * step]
    blocks = blocks.reshape(side, step, side, step, 3)
    display, brightest = blocks.mean(axis=(1, 3)).reshape(-1, 3), blocks.max(axis=(1, 3)).reshape(-1, 3)
    points = texel_positions(photo.shape[0]).numpy()[:side * step, :side * step]
    points = points.reshape(side, step, side, step, 3).mean(axis=(1, 3)).reshape(-1, 3) * size
    row, column = (index.ravel() for index in np.mgrid[:side, :side])
    usable = (brightest < NEARLY_CLIPPED).all(axis=1)  # False for NaN
    cells = row * CELLS // side * CELLS + column * CELLS // side
    linear = color.decode(torch.from_numpy(display), transfer).numpy()
    return _Seen(points, project(lens, pose, points), linear, display, usable, row * side + column, cells)


@dataclass(frozen=True)
class Samples:
    """Usable points of all photos, one after the other: K values each, or K x 3."""

    names: list[str]  # of the photos
    photo: np.ndarray  # number of each point's photo
    points: Array
    radius2: Array
    log: Array  # natural logarithm of linear radiance, the mean of the channels
    colour: Array  # natural logarithms of the channels over that mean
    weight: Array  # 1 / (1 + noise of the logarithm / error of the model)^2
    texel: np.ndarray  # points of one texel have one albedo
    cell: np.ndarray  # errors of points of one cell may be correlated
    glossy: bool  # whether there may be a lobe

    @classmethod
    def of(cls, rig: Rig, seen: Mapping[str, _Seen], what: str, glossy: bool) -> Samples:
        """Points of ``seen`` that are neither clipped nor dark. ``what``: what they show, for an error."""
        kept = {name: s.usable & (s.display.mean(axis=1) > DARK_VALUE) & np.isfinite(s.pixels).all(axis=1)
                for name, s in seen.items()}
        if not any(k.any() for k in kept.values()):
            clipped = sum(np.nanmax(s.display, initial=0.0) >= NEARLY_CLIPPED for s in seen.values())
            raise CaptureError(f"photos that show {what} neither clipped nor dark",
                               f"none of {len(seen)}" + (f" ({clipped} clipped)" if clipped else ""),
                               "take them again with another exposure, or check depth and size of the sheet")

        def joined(get: Callable[[_Seen], np.ndarray]) -> np.ndarray:
            return np.concatenate([get(s)[kept[name]] for name, s in seen.items()])

        linear, display = joined(lambda s: s.linear), joined(lambda s: s.display).mean(axis=1)
        log = np.log(linear.mean(axis=1))
        counts = [int(k.sum()) for k in kept.values()]
        photo = np.repeat(np.arange(len(seen)), counts)
        return cls(list(seen), photo, joined(lambda s: s.points),
                   rig.lens.radius2(joined(lambda s: s.pixels)), log,
                   np.log(linear.clip(1e-6)) - log[:, None], 1 / (1 + (DIM / display) ** 2),
                   joined(lambda s: s.texels), photo * CELLS**2 + joined(lambda s: s.cells), glossy)


def transmission_of(radius2: Array, vignetting: Array) -> Array:
    """Share of light that the lens transmits at K values of ``Lens.radius2``; ``vignetting``: v1, v2."""
    return (1 + vignetting[0] * radius2 + vignetting[1] * radius2**2).clip(FAINTEST_CORNER)


def falloff_of(flash: Array, points: Array) -> Array:
    """Logarithm of cos / d^2 at points (K x 3) with the flat normal."""
    to_flash = flash - points
    return np.log(to_flash[:, 2].clip(1e-9)) - 1.5 * np.log(np.square(to_flash).sum(axis=1))
