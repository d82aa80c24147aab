"""Previews drawn by plain Mitsuba."""

import numpy as np
import torch


def drawn(mi, stage, frame=0, spp=16, seed=0):
    return torch.from_numpy(np.array(mi.render(stage.at(mi, frame), spp=spp, seed=seed)))


def unjittered(stage):
    """The stage with one ray through each pixel's middle."""
    stage.scene["sensor"]["sampler"] = {"type": "stratified", "sample_count": 1, "jitter": False}
    return stage
