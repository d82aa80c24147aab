"""The studio of the live viewer, made ready for one look-up a pixel.

Source: the split sum of Karis 2013, "Real Shading in Unreal Engine 4". It approximates what a lobe gathers
from all directions by two factors. :func:`lobes` is the light that a lobe of that roughness gathers around
the mirrored direction, as if seen from there. :func:`shares` is the share that it reflects. Measured against
the sum over all directions, the mean error is below 4 % facing the viewer. Real lobes are longer aslant:
metals are off by up to 30 % at 48 degrees and 45 % at 60 to 75, single texels by 75 %. :func:`diffuse` is
the irradiance of the normal, Lambert's in both BSDFs. ``relight/environment.py`` says how directions lie in
pictures.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from ..relight import environment

ROWS = 48  # of the pictures that lobes see
LEVELS = 9  # level k stands for roughness k / (LEVELS - 1)
DIFFUSE_ROWS = 16
SHARES = 32  # cosines and roughnesses
FINE = 2 * ROWS  # rows of what is summed over; a multiple of the others


@functools.cache
def lobes() -> np.ndarray:
    """Radiance that mirror lobes gather, a picture for each of 9 roughnesses: 9 H x 2 H x 3, H = 48."""
    sharp = (environment.studio(ROWS) * _scale()).numpy()
    rough = [_gathered(ROWS, functools.partial(_lobe, alpha=(k / (LEVELS - 1)) ** 2))
             for k in range(1, LEVELS)]
    return np.concatenate([sharp, *rough])


@functools.cache
def diffuse() -> np.ndarray:
    """Irradiance over pi by direction of the normal, 16 x 32 x 3, float64; it is 0.8 facing the camera."""
    return _gathered(DIFFUSE_ROWS, lambda cosine: cosine.clamp_min(0))


@functools.cache
def shares(min_alpha: float) -> np.ndarray:
    """Share that a lobe without Fresnel term reflects, and that share times (1 - v.h)^5: 32 x 32 x 2.

    Rows: roughness from 0 to 1, columns: n.v from 0 to 1, in the middles of the pixels. The share of a lobe
    with Schlick's reflectance of F0 is F0 times the first plus (1 - F0) times the second.
    """
    middles = (np.arange(SHARES) + 0.5) / SHARES
    u, w = (axis.ravel() for axis in np.meshgrid(middles, middles))
    alpha = np.maximum(middles**2, min_alpha)[:, None, None]
    n_v = middles[None, :, None]
    # Half vectors as the camera sees them (Dupuy and Benyoub 2023); the weight of each is the masking of its
    # light.
    v = _unit(np.stack(np.broadcast_arrays(alpha * np.sqrt(1 - n_v**2), 0 * n_v, n_v), axis=-1))
    z = (1 - u) * (1 + v[..., 2]) - v[..., 2]
    across = np.sqrt(np.clip(1 - z**2, 0, None))
    h = np.stack((across * np.cos(2 * np.pi * w), across * np.sin(2 * np.pi * w), z), axis=-1) + v
    h = _unit(np.concatenate((alpha[..., None] * h[..., :2], h[..., 2:]), axis=-1))
    v_h = np.clip(np.sqrt(1 - n_v**2) * h[..., 0] + n_v * h[..., 2], 0, 1)
    n_l = np.clip(2 * v_h * h[..., 2] - n_v, 0, 1)
    weight = 2 * n_l / (n_l + np.sqrt(alpha**2 + (1 - alpha**2) * n_l**2))
    return np.stack((weight.mean(-1), (weight * (1 - v_h) ** 5).mean(-1)), axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _lobe(cosine: Tensor, alpha: float) -> Tensor:
    """D(h) G1(l) of GGX where normal and camera are one direction and light stands at this cosine from it."""
    a2, n_l = alpha**2, cosine.clamp_min(0)
    return n_l / ((1 + cosine) / 2 * (a2 - 1) + 1) ** 2 / (n_l + torch.sqrt(a2 + (1 - a2) * n_l**2))


def _gathered(rows: int, kernel: Callable[[Tensor], Tensor]) -> np.ndarray:
    """The studio under a kernel of the cosine, rows x 2 rows x 3; the kernel's weights sum to 1.

    The kernel is the same at all longitudes: sums over them are products of Fourier series.
    """
    light, solid = _fine()
    columns, finer = 2 * FINE, FINE // rows
    out, theta = (torch.linspace(0, math.pi, count, dtype=torch.float64) for count in (rows, FINE))
    out = out[:, None, None]
    # From a pixel of the finer picture to the middle of a coarser one: whole pixels and half of what the
    # coarser has more.
    along = (torch.arange(columns, dtype=torch.float64) + (finer - 1) / 2) * (2 * math.pi / columns)
    # rows, along, FINE
    weights = kernel(out.cos() * theta.cos() + out.sin() * theta.sin() * along.cos()[:, None]) * solid
    series = torch.fft.rfft(torch.cat((light, torch.ones_like(light[..., :1])), dim=-1), dim=1)
    found = torch.fft.irfft(torch.einsum("rpf,fpc->rpc", torch.fft.rfft(weights, dim=1), series), columns,
                            dim=1)[:, ::finer]
    return (found[..., :3] / found[..., 3:] * _scale()).numpy()


@functools.cache
def _fine() -> tuple[Tensor, Tensor]:
    """The studio's radiance, FINE x 2 FINE x 3, and the solid angle of a pixel of each row, FINE, float64."""
    # At the poles the pixels of a row are one point, to which half a row's width belongs.
    theta = torch.linspace(0, math.pi, FINE, dtype=torch.float64)
    edges = torch.cat((theta[:1], (theta[1:] + theta[:-1]) / 2, theta[-1:])).cos()
    return environment.studio(FINE), (edges[:-1] - edges[1:]) * (math.pi / FINE)


@functools.cache
def _scale() -> float:
    """Factor that gives a white diffuse surface facing the studio's ahead direction luminance 0.8."""
    light, solid = _fine()
    facing = -environment.directions(FINE, 2 * FINE)[..., 1].clamp_max(0)
    return (environment.WHITE_LUMINANCE * math.pi
            / float((light @ environment.LUMINANCE * facing * solid[:, None]).sum()))
