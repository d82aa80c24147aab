"""Previews drawn by plain Mitsuba, and what is read back of them."""

import numpy as np
import torch

from mitsvbrdf.errors import MitsvbrdfError
from mitsvbrdf.io import images


def drawn(mi, stage, frame=0, spp=16, seed=0):
    return torch.from_numpy(np.array(mi.render(stage.at(mi, frame), spp=spp, seed=seed)))


def unjittered(stage):
    """The stage with one ray through each pixel's middle."""
    stage.scene["sensor"]["sampler"] = {"type": "stratified", "sample_count": 1, "jitter": False}
    return stage


def srgb(x):
    x = np.asarray(x, dtype=np.float64)
    return np.clip(np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055), 0,
                   1)


def pictures(out, preset):
    return [images.read_image(path, MitsvbrdfError) for path in sorted((out / preset).glob("*.exr"))]
