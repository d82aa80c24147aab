"""Gradients of a generator's weights through the whole method, of every renderer and of spoilt ones."""

from dataclasses import replace
from unittest.mock import patch

import torch

from mitsvbrdf.fit import GanConfig, HybridConfig, make_method
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.metrics import gradient_error
from mitsvbrdf.render import make_renderer

# steps; at the start the last layers are zero, and no weight below them has a gradient
AFTER = (3, 4, 5, 6, 7)
# The traced scene has no gradient to the light, and a fitted flash offset changes the loss: none fits it.
METHODS = {"gan": lambda **given: GanConfig(grow=False, flash_offset=False, **given),
    "hybrid": lambda **given: HybridConfig(flash_offset=False, **given)}
FAULTS = {
    "roughness squared twice": lambda svbrdf, views: (
        SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {"roughness": svbrdf["roughness"]**2}), views),
    "cameras 1 % too far": lambda svbrdf, views: (svbrdf, replace(views, camera=1.01 * views.camera))}


class Faulty:
    """The float64 twin with one thing of :data:`FAULTS` wrong: what a comparison has to notice."""

    name, variant = "analytic64", None

    def __init__(self, fault):
        self.twin, self.fault = make_renderer("analytic64"), FAULTS[fault]

    def render(self, svbrdf, views):
        return self.twin.render(*self.fault(svbrdf, views))


def trained_states(task, after=AFTER):
    """The running state after each of these numbers of steps, with the share of the run that is done."""
    method, limit = make_method(task), 10 * max(after)
    for step in range(max(after) + 1):
        if step in after:
            yield step / limit, {name: value.clone() for name, value in method.state().items()}
        method.step(step / limit)


def weight_gradient(method, state, progress):
    """Gradient of all losses with respect to the generator's weights in a state, one float64 vector.

    The step draws the same random numbers with every renderer; the discriminator stands still.
    """
    method.load_state(state)
    with patch.object(method.discriminator, "learn", lambda *given: 0.0):
        method.step(progress)
    return torch.cat([weight.grad.double().flatten() for weight in method.generator.parameters()])


def differences(task, others, after=AFTER):
    """How far each renderer's gradient is from the float64 twin's, |g - r| / |r|, in each trained state."""
    twin = make_method(replace(task, renderer=make_renderer("analytic64")))
    methods = {name: make_method(replace(task, renderer=other)) for name, other in others.items()}
    found = {name: [] for name in others}
    for progress, state in trained_states(task, after):
        exact = weight_gradient(twin, state, progress)
        for name, method in methods.items():
            found[name].append(gradient_error(weight_gradient(method, state, progress), exact)["relative_l2"])
    return found
