"""Exported files, read by hand."""

import json

import cv2
import numpy as np
import torch

from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material

BSDFS = ["roughconductor", "principled"]


def srgb_to_linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1


def decoded(path, colour_space):
    """A PNG or EXR as linear float64 H x W x C, through OpenCV alone."""
    if path.suffix == ".exr":
        return images.read_image(path, ValueError).double().numpy()
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    values = np.atleast_3d(pixels)[..., ::-1] / np.iinfo(pixels.dtype).max
    return srgb_to_linear(values) if colour_space == "sRGB" else values


def gilt_plates(resolution):
    """The made material ``plates`` with bare gold in a corner."""
    made = make_material("plates", resolution)
    part = resolution // 4
    made["diffuse"][:part, :part], made["specular"][:part, :part] = 0.0, torch.tensor([1.0, 0.77, 0.34])
    return made


def stated(folder):
    return json.loads((folder / "export.json").read_text())
