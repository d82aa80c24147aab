"""Photos of the sheet of tags, drawn by the pinhole equation."""

import cv2
import numpy as np

from mitsvbrdf.capture.align.sheet import Sheet
from mitsvbrdf.capture.lens import Lens, Pose, on_plane
from mitsvbrdf.capture.photo import Photo

# Middles of the tags with a size of 18: along the top, down the right, back along the bottom, up the left.
MIDDLES = [(-8, 8), (-4, 8), (0, 8), (4, 8), (8, 8), (8, 4), (8, 0), (8, -4),
           (8, -8), (4, -8), (0, -8), (-4, -8), (-8, -8), (-8, -4), (-8, 0), (-8, 4)]
SHEET = Sheet(18.0)
LENS = Lens((1000, 750), 790.0, (502.0, 372.5), (0.08, -0.05))
POSES = [Pose.looking_at(*where) for where in (((0.5, -0.3, 33.0), (0.3, 0.2, 0)),
    ((8.0, 2.0, 31.0), (0.5, 0, 0), 0.1), ((-6.0, 5.0, 33.0), (0, 0.4, 0), 2.1),
    ((1.0, -8.5, 34.0), (0, -0.5, 0), np.pi), ((-4.0, -3.0, 32.0), (-0.4, 0, 0), -1.5))]


def on_grey(picture, hole):
    return np.where(hole, 90, picture).astype(np.uint8)


def photograph(path, pose, lens=LENS, depth=0.0, picture=None, glare=None, exif=None, noise=0.004, seed=0):
    """A noisy, slightly blurred flash photo of the sheet on a grey material, in sRGB; the sheet is at height
    ``depth``.
    """
    picture = on_grey(*SHEET.picture(80)) if picture is None else picture
    # 0.8 pixels of the photo, so that one sample a pixel is enough
    sharp = cv2.GaussianBlur(picture, (0, 0), 2.5)
    width, height = lens.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    at = on_plane(lens, pose, pixels, depth)
    where = (at * (1, -1) / SHEET.outer + 0.5) * len(picture) - 0.5
    seen = cv2.remap(sharp, where.reshape(height, width, 2).astype(np.float32), None, cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_CONSTANT, borderValue=(70,)) / 255.0
    linear = 0.04 + 0.6 * seen + np.random.default_rng(seed).normal(0, noise, seen.shape)
    if glare is not None:
        linear += 3 * np.exp(-np.square(at - glare).sum(axis=1) / 2).reshape(linear.shape)
    shown = np.where(linear < 0.0031308, 12.92 * linear,
                     1.055 * np.maximum(linear, 1e-6) ** (1 / 2.4) - 0.055).clip(0, 1)
    kind = np.uint16 if path.suffix == ".png" else np.uint8
    quality = [cv2.IMWRITE_JPEG_QUALITY, 92] if kind == np.uint8 else []
    cv2.imwrite(str(path), np.rint(shown * np.iinfo(kind).max).astype(kind), quality)
    return Photo(path, lens.size, 1, {"35 mm focal length": exif} if exif else {})
