"""Renderers that must agree: images and gradients against a reference in float64."""

import math
from collections.abc import Sequence
from dataclasses import astuple

import torch
from torch import Tensor

from ..errors import ConfigError
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..measure.gradients import Measured, render_and_gradients
from ..measure.metrics import gradient_error, image_error
from ..measure.tolerances import LIMITS, Limits
from ..render import Renderer, RendererName, make_renderer
from ..views import Views
from .page import Figure, failure, gradient_row, view_rows


@entry(gradients=True)
def assert_renderers_agree(
        maps: SVBRDF, views: Views, renderers: Sequence[RendererName | Renderer] = ("mitsuba",), *,
        image_mean: float | None = None, image_p999: float | None = None, gradients: float | None = None,
        reference: RendererName | Renderer = "analytic64") -> None:
    """Fail unless the images and gradients of renderers agree with those of a reference.

    Gradients are those of :func:`mitsvbrdf.measure.gradients.render_and_gradients`.

    Args:
        maps: the material, float32; :func:`random_material` makes a hard one.
        renderers: names, or objects with ``name`` and ``render(svbrdf, views)`` like
            :class:`mitsvbrdf.render.Renderer`.
        image_mean: see :class:`Limits`. The default of all three limits is the entry of the renderer in
            :data:`LIMITS`.
        image_p999: see :class:`Limits`.
        gradients: see :class:`Limits`.
        reference: the renderer to compare with.

    Raises:
        AssertionError: they differ. The message names renderer, image or map, figure, limit, and a page that
            shows where.
        ConfigError: no renderer; limits that are missing for a renderer not in :data:`LIMITS`, negative, NaN,
            or all infinite; or missing gradients, though they have a finite limit.
    """
    __tracebackhide__ = True
    if not renderers:
        raise ConfigError("one renderer or more", "none", "name those to compare")
    engines = [make_renderer(r) if isinstance(r, str) else r for r in (reference, *renderers)]
    limits = [_limits(r.name, image_mean, image_p999, gradients) for r in engines[1:]]
    wanted = any(math.isfinite(limit.gradients) for limit in limits)
    truth = _measured(engines[0], maps, views, wanted)
    figures, rows, names = [], [], []
    for renderer, limit in zip(engines[1:], limits):
        found = _measured(renderer, maps, views, math.isfinite(limit.gradients))
        measured = _figures(renderer.name, found, truth, limit)
        figures += measured
        if any(f.missed for f in measured):
            names.append(renderer.name)
            rows += view_rows(found.image, truth.image, renderer.name) + [
                gradient_row(f"{renderer.name}, gradient of {name}", gradient, truth.gradients[name])
                for name, gradient in found.gradients.items()]
    if names:
        raise failure(f"{' and '.join(names)} differ{'s' * (len(names) == 1)} from {engines[0].name}",
                      figures, rows)


def _limits(name: str, *given: float | None) -> Limits:
    known = astuple(LIMITS[name]) if name in LIMITS else given
    limits = [usual if value is None else value for usual, value in zip(known, given)]
    if None in limits:
        raise ConfigError(f"limits for the renderer {name!r}, which is none of {list(LIMITS)}",
                          "some left out", "give image_mean, image_p999 and gradients")
    if not all(limit >= 0 for limit in limits) or min(limits) == math.inf:
        raise ConfigError("limits >= 0, not all infinite", f"{limits} for {name}", "others decide nothing")
    return Limits(*limits)


def _measured(renderer: Renderer, maps: SVBRDF, views: Views, gradients: bool) -> Measured:
    if gradients:
        return render_and_gradients(renderer, maps, views)
    with torch.no_grad():
        return Measured(renderer.render(maps, views), {}, 0.0, 0.0)


def _figures(name: str, found: Measured, truth: Measured, limit: Limits) -> list[Figure]:
    image = image_error(found.image, truth.image)
    return [Figure(f"{name}: image, mean relative error", image["mean"], limit.image_mean),
            Figure(f"{name}: image, 99.9 % of the values within", image["p99.9"], limit.image_p999),
            *(Figure(f"{name}: gradient of {each}, relative L2", _off(gradient, truth.gradients[each]),
                     limit.gradients) for each, gradient in found.gradients.items())]


def _off(gradient: Tensor, truth: Tensor) -> float:
    """Relative L2 error; 0 if both gradients are 0 everywhere."""
    return gradient_error(gradient, truth)["relative_l2"] if truth.any() or gradient.any() else 0.0
