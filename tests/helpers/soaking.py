"""Thousands of steps in one process: does memory grow, is anything compiled again, do steps get slower?"""

import gc
import os
import re
import statistics
import sys
from dataclasses import replace
from pathlib import Path

import torch

from mitsvbrdf.io.timing import timed
from mitsvbrdf.material.corner_cases import random_material
from mitsvbrdf.views import Views

SLOPE_LIMIT = 0.5  # MiB of resident memory per 100 steps; below some 500 steps warm-up counts as growth
WARM_UP = 0.2  # share of the steps during which pools and caches may still fill


def with_gradients(renderer, material, views, between=lambda: None):
    """A step of a fit: forward, backward."""
    leaves = material.map(lambda t: t.clone().requires_grad_())
    image = renderer.render(leaves, views)
    between()
    torch.autograd.grad(image.square().mean(), list(leaves.maps.values()))


def without_gradients(renderer, material, views):
    with torch.no_grad():
        renderer.render(material, views)


def with_preview(renderer, material, views):
    """A step of a fit with a preview drawn between forward and backward."""
    with_gradients(renderer, material, views, lambda: without_gradients(renderer, material, views.pick([0])))


WORK = {"gradients": with_gradients, "images": without_gradients, "preview": with_preview}


def soak(renderers, bsdf, work, steps, resolution=64):
    """Run steps of renderers in turn, each with three moving views, co-located and apart: two kernels each.
    Returns ``slope`` (MiB of memory per 100 steps), ``late`` (steps that made a kernel after each was
    asked for twice), ``variables`` (Dr.Jit's, more than after warm-up), ``milliseconds`` (of a step,
    medians of the first and the last tenth after warm-up).
    """
    gc.collect()  # kernels call every BSDF that lives: scenes freed on the way would have them made again
    turn = 2 * len(renderers)
    assert steps >= max(20, 4 * turn)
    material, rng = random_material(bsdf, resolution), torch.Generator().manual_seed(0)
    warm = max(2 * turn, int(WARM_UP * steps))
    memory, seconds, kernels = [], [], [kernels_made()]
    for step in range(steps):
        if step == warm:
            before = variables()
        views = moving_views(rng, apart=step % 2 == 1)
        seconds.append(timed(work, renderers[step // 2 % len(renderers)], material, views)[1])
        memory.append(resident())
        kernels.append(kernels_made())
    tenth = max(1, (steps - warm) // 10)
    return {"slope": 100 * statistics.linear_regression(range(steps - warm), memory[warm:]).slope,
            "late": [step for step in range(2 * turn, steps) if kernels[step + 1] > kernels[step]],
            "variables": variables() - before, "milliseconds": [1e3 * statistics.median(part)
            for part in (seconds[warm:warm + tenth], seconds[-tenth:])]}


def moving_views(rng, apart):
    """Three views at random places two patch sides above the patch; the light at the camera or apart."""
    camera = torch.rand(3, 3, generator=rng, dtype=torch.float64) - 0.5 + torch.tensor([0.0, 0.0, 2.0])
    views = Views.of(camera, intensity=10.0)
    return replace(views, light=camera + torch.tensor([0.5, -0.3, 0.1])) if apart else views


def resident():
    """Resident memory of this process in MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def kernels_made():
    """Kernels that this process compiled or took from Dr.Jit's cache on disk; a kernel met again is none."""
    drjit = sys.modules.get("drjit")
    return sum(drjit.detail.launch_stats()[1:]) if drjit else 0


def variables():
    drjit = sys.modules.get("drjit")
    return len(re.findall(r"^ +\d+ +(?:LLVM|CUDA) ", drjit.whos(True), re.MULTILINE)) if drjit else 0
