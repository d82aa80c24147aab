"""Photos of a material on a sheet of tags or on the ground, of which everything is known."""

import math
from functools import cache

import cv2
import numpy as np
from PIL import Image

from mitsvbrdf.capture.align.sheet import Sheet
from mitsvbrdf.capture.lens import Lens, Pose, rays

SHEET = Sheet(18.0)
LENS = Lens((1200, 900), 900.0, distortion=(0.03, -0.02), vignetting=(-0.2, 0.0), flash=(1.4, 0.3, 0.0))
PLACES = [(0.5, -1), (4.5, -3.5), (-4, 4), (-4.5, -4), (4, 4.5), (0.5, -5), (-1, 5)]
POWER = 1500.0  # of the flash: white paper below it has a radiance of 0.7 or so


def material(seed=0, side=1200):
    """Coloured noise of several scales, albedo."""
    rng = np.random.default_rng(seed)
    out = np.zeros((side, side, 3), np.float32)
    for blur, weight in ((1.5, 0.3), (4, 0.35), (10, 0.4), (40, 0.4)):
        layer = cv2.GaussianBlur(rng.standard_normal((side, side)).astype(np.float32), (0, 0), blur)
        out += weight * (layer / layer.std())[..., None]
    return np.clip(0.25 * np.array((1.3, 1.0, 0.7)) * np.exp(0.45 * out), 0.02, 0.9).astype(np.float32)


@cache
def ground(with_sheet=True, seed=0):
    """Albedo of what lies on the table, and whether it is material: rows from the top, and its side in cm."""
    side = SHEET.outer if with_sheet else 24.0
    inside = material(seed)
    if not with_sheet:
        return np.dstack((inside, np.ones(inside.shape[:2], np.float32))), side
    printed, hole = SHEET.picture(1200 / side)
    printed, hole = printed[:1200, :1200], hole[:1200, :1200]
    paper = np.repeat(0.8 * np.maximum(printed[..., None] / 255, 0.03), 3, axis=2).astype(np.float32)
    inside, paper = (cv2.resize(image, hole.shape[::-1]) for image in (inside, paper))
    return np.dstack((np.where(hole[..., None], inside, paper), hole)).astype(np.float32), side


@cache
def optics(lens):
    """The ray of each pixel in camera axes, K x 3, and the share of its light that arrives, K."""
    pixels = np.stack(np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1])), axis=-1).reshape(-1, 2)
    return rays(lens, pixels), lens.transmission(pixels)


def taken(what, lens, pose, flash=True, seed=0):
    """What the phone stores, H x W x 3 linear radiance: flash or even light, vignetting, a highlight."""
    albedo, side = what
    (ray, arrives), shape = optics(lens), lens.size[::-1]
    ray = pose.rotation.T @ ray.T  # 3 x K: whole rows are many times quicker than columns
    gaze = ray * (-pose.position[2] / ray[2])  # to the point of the plane that the pixel sees
    at = pose.position[:, None] + gaze
    column, row = (((sign * x / side + 0.5) * len(albedo) - 0.5).astype(np.float32).reshape(shape)
                   for sign, x in zip((1, -1), at))
    seen = cv2.remap(albedo, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                     borderValue=(0.1, 0.1, 0.1, 0)).reshape(-1, 4)
    light, gloss = np.full(len(seen), 1.2), np.zeros(len(seen))
    if flash:
        to_flash = pose.flash(lens)[:, None] - at
        square = (to_flash**2).sum(axis=0)
        light = POWER * to_flash[2] / (square * np.sqrt(square))
        half = to_flash / np.sqrt(square) - gaze / np.sqrt((gaze**2).sum(axis=0))
        gloss = 0.3 * np.exp(-(half[0] ** 2 + half[1] ** 2) / half[2] ** 2 / 0.006) * seen[:, 3]
    out = (seen[:, :3] / math.pi + gloss[:, None]) * (light * arrives)[:, None]
    out = out.reshape(lens.size[1], lens.size[0], 3)
    return out + 0.002 * np.random.default_rng(seed).standard_normal(out.shape)


def stored(path, linear, flash=1, iso=100, **how):
    """A JPEG with sRGB values and EXIF."""
    linear = np.clip(linear, 0, 1)
    display = np.where(linear <= 0.0031308, 12.92 * linear,
                       1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    exif = Image.Exif()
    focal = LENS.focal / math.hypot(*LENS.size) * math.hypot(36, 24)
    exif.get_ifd(0x8769).update({34855: iso, 41989: round(focal)} | ({} if flash is None else {37385: flash}))
    shown = Image.fromarray((display * 255).round().astype(np.uint8))
    shown.save(path, quality=95, subsampling=0, exif=exif, **how)


def poses(scale=1.0, height=24.0):
    turns = np.radians([0, 4, -6, 90, 3, -3, 180])  # a phone held upright, and one upside down, are as good
    return {f"IMG_{i}.jpg": Pose.looking_at((x * scale, y * scale, height), (0.3 * x, 0.3 * y, 0), turn)
            for i, ((x, y), turn) in enumerate(zip(PLACES, turns))}
