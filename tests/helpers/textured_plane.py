"""A simulated phone over a textured plane, of which everything is known."""

from functools import cache

import cv2
import numpy as np
from PIL import Image
from scipy.optimize import least_squares

from mitsvbrdf.capture.lens import Lens, Pose, on_plane, project
from mitsvbrdf.capture.photo import Photo

SIZE = (480, 360)
LENS = Lens(SIZE, 0.75 * SIZE[0], distortion=(0.02, -0.01), flash=(0.08, 0.0, 0.0))
SPAN = 2.4  # side of the material; cameras are some 1.5 above it


@cache
def texture(seed=0, side=1200):
    """Noise of several scales, in display values."""
    rng = np.random.default_rng(seed)
    out = np.zeros((side, side), dtype=np.float32)
    for blur, weight in ((1.2, 0.35), (3, 0.35), (8, 0.4), (30, 0.4)):
        layer = cv2.GaussianBlur(rng.standard_normal(out.shape).astype(np.float32), (0, 0), blur)
        out += weight * layer / layer.std()
    return np.clip(0.4 + 0.15 * out, 0.05, 0.9)


def photo_of(material, lens, pose, seed, shine=1.2):
    """What the phone stores: the material under its flash, with falloff, a moving highlight and noise."""
    columns, rows = np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1]))
    at = on_plane(lens, pose, np.stack((columns, rows), axis=-1).reshape(-1, 2))
    texels = ((np.stack((at[:, 0], -at[:, 1]), axis=1) / SPAN + 0.5) * len(material) - 0.5).astype(np.float32)
    seen = cv2.remap(material, texels.reshape(*columns.shape, 2), None, cv2.INTER_CUBIC,
                     borderMode=cv2.BORDER_REFLECT)
    x, y, z = pose.flash(lens)
    aside = np.square(at - (x, y)).sum(axis=1).reshape(columns.shape) / z**2
    light = seen**2.2 * 1.2 * (1 + aside) ** -1.5 + shine * np.exp(-aside / 0.006) * (0.3 + seen)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(light.shape)
    return (np.clip(np.clip(light, 0, 1) ** (1 / 2.2) + noise, 0, 1) * 255).round().astype(np.uint8)


def held(count, seed=0, spread=0.35, turn=8.0):
    """Poses of a hand."""
    rng = np.random.default_rng(seed)
    found = {}
    for i in range(count):
        position = np.array([*rng.uniform(-spread, spread, 2), 1.5 * np.exp(rng.normal(0, 0.06))])
        aim = np.append(position[:2] * 0.5 + rng.normal(0, 0.06, 2), 0.0)
        found[f"{i}.png"] = Pose.looking_at(position, aim, np.deg2rad(rng.normal(0, turn)))
    return found


def save(folder, name, pixels, orientation=1, stated=27):
    Image.fromarray(np.repeat(pixels[..., None], 3, axis=2)).save(folder / name)
    return Photo(folder / name, (pixels.shape[1], pixels.shape[0]), orientation,
                 {"35 mm focal length": stated} if stated else {})


# LENS is one of 0.75 * 43.27 / 1.25 = 26.0 mm: what is stated is 4 % too long, twice the deviation expected.
def take(folder, poses, material=None, stated=27, **how):
    material = texture() if material is None else material
    return [save(folder, name, photo_of(material, LENS, pose, i, **how), stated=stated)
            for i, (name, pose) in enumerate(poses.items())]


def position_errors(rig, poses):
    """Distances to the true positions, as shares of the distance, after the best common similarity: N."""
    ours = np.array([rig.poses[name].position for name in rig.poses])
    true = np.array([poses[name].position for name in rig.poses])
    a, b = ours[:, 0] + 1j * ours[:, 1], true[:, 0] + 1j * true[:, 1]

    def off(x):
        scale = x[0] + 1j * x[1]
        aside = scale * a + x[2] + 1j * x[3] - b
        return np.stack((aside.real, aside.imag, abs(scale) * ours[:, 2] - true[:, 2]))

    found = least_squares(lambda x: off(x).ravel(), (1.0, 0.0, 0.0, 0.0)).x
    return np.linalg.norm(off(found), axis=0) / np.linalg.norm(true, axis=1)


def misalignment(rig, poses):
    """RMS distance, in pixels at 512, between points of the material at one place of rectified photos."""
    steps = (np.arange(9) + 0.5) / 9 - 0.5
    grid = np.array([[x, y, 0.0] for y in steps for x in steps]) * rig.size
    seen = np.stack([on_plane(LENS, poses[name], project(rig.lens, pose, grid))
                     for name, pose in rig.poses.items()])
    side = np.linalg.norm(seen[:, 8] - seen[:, 0], axis=1).mean() * 9 / 8
    return np.sqrt(np.square(seen - seen.mean(axis=0)).sum(axis=-1).mean()) / side * 512
