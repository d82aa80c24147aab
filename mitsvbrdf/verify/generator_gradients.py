"""Gradients of a generator's weights through the whole method, of every renderer against the float64 twin.

``python -m mitsvbrdf.verify.generator_gradients`` trains ``gan`` and ``hybrid`` for a few steps, asks every
renderer for the gradient of the same state, prints a table and keeps the record as JSON. The networks compute
in float32 with all of them.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import torch
import tyro
from torch import Tensor

from ..capture import Capture
from ..fit import FitConfig, FitTask, GanConfig, HybridConfig, make_method
from ..io import files
from ..io.progress import say
from ..io.provenance import machine, versions
from ..io.tool import run_tool
from ..material.made import make_material
from ..material.maps import CHANNELS, SVBRDF, Bsdf
from ..measure.metrics import gradient_error
from ..render import RENDERERS, Renderer, make_renderer
from ..synth import photograph
from ..views import Views, nine_view_grid

SCHEMA_VERSION = 1
# steps; at the start the last layers are zero, and no weight below them has a gradient
AFTER = (3, 4, 5, 6, 7)
# The traced scene has no gradient to the light, and a fitted flash offset changes the loss: it is left out
# for all.
METHODS: dict[str, Callable[..., FitConfig]] = {
    "gan": lambda **given: GanConfig(precision="float32", grow=False, flash_offset=False, **given),
    "hybrid": lambda **given: HybridConfig(flash_offset=False, **given)}


class Faulty:
    """The float64 twin with one thing wrong: what a comparison has to notice.

    Args:
        fault: a key of :data:`FAULTS`.
    """

    name, variant = "analytic64", None

    def __init__(self, fault: str) -> None:
        self.twin, self.fault = make_renderer("analytic64"), FAULTS[fault]

    def render(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        """What the twin draws of the wrong material in the wrong views."""
        return self.twin.render(*self.fault(svbrdf, views))


def _squared(svbrdf: SVBRDF, views: Views) -> tuple[SVBRDF, Views]:
    return SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {"roughness": svbrdf["roughness"]**2}), views


def _farther(svbrdf: SVBRDF, views: Views) -> tuple[SVBRDF, Views]:
    return svbrdf, replace(views, camera=1.01 * views.camera)


FAULTS = {"roughness squared twice": _squared, "cameras 1 % too far": _farther}


def trained_states(task: FitTask, after: Sequence[int] = AFTER) -> Iterator[tuple[float, dict[str, Tensor]]]:
    """The running state after each of these numbers of steps, with the share of the run that is done."""
    method, limit = make_method(task), 10 * max(after)
    for step in range(max(after) + 1):
        if step in after:
            yield step / limit, {name: value.clone() for name, value in method.state().items()}
        method.step(step / limit)


def weight_gradient(method: Any, state: dict[str, Tensor], progress: float) -> Tensor:
    """Gradient of all losses together with respect to the generator's weights, as one vector in float64.

    The step draws the same random numbers with every renderer; the discriminator stands still, so that it is
    the same too.

    Args:
        method: ``gan`` or ``hybrid``, of any renderer; its state is lost.
        state: to take the gradient in.
        progress: share of the run that is done.
    """
    method.load_state(state)
    with patch.object(method.discriminator, "learn", lambda *given: 0.0):
        method.step(progress)
    return torch.cat([weight.grad.double().flatten() for weight in method.generator.parameters()])


def differences(task: FitTask, others: Mapping[str, Renderer], after: Sequence[int] = AFTER) -> dict[str,
                                                                                                     list[float]]:
    """How far each renderer's gradient is from the float64 twin's, |g - r| / |r|, in each trained state.

    Args:
        task: trained through its own renderer.
        others: renderers by name.
        after: numbers of steps, one state each.
    """
    twin = make_method(replace(task, renderer=make_renderer("analytic64")))
    methods = {name: make_method(replace(task, renderer=other)) for name, other in others.items()}
    found = {name: list[float]() for name in others}
    for progress, state in trained_states(task, after):
        exact = weight_gradient(twin, state, progress)
        for name, method in methods.items():
            found[name].append(gradient_error(weight_gradient(method, state, progress), exact)["relative_l2"])
    return found


def measured(capture: Capture, methods: Sequence[str] = tuple(METHODS),
             bsdfs: Sequence[Bsdf] = tuple(CHANNELS), **settings: Any) -> list[dict]:
    """One row for each method, BSDF, and renderer or fault: median and largest difference over the states."""
    others = {name: make_renderer(name) for name in RENDERERS} | {fault: Faulty(fault) for fault in FAULTS}
    rows = []
    for method in methods:
        for bsdf in bsdfs:
            task = FitTask(capture, others["mitsuba"], METHODS[method](bsdf=bsdf, **settings))
            for name, values in differences(task, others).items():
                rows.append({"method": method, "bsdf": bsdf, "through": name, "fault": name in FAULTS,
                             "median": statistics.median(values), "largest": max(values)})
    return rows


def page(record: dict) -> str:
    """The record as a Markdown page."""
    rows = [f"| `{row['method']}` | {row['bsdf']} | "
            f"{row['through'] if row['fault'] else '`' + row['through'] + '`'} "
            f"| {row['median']:.1e} | {row['largest']:.1e} |" for row in record["rows"]]
    on, with_ = record["machine"], record["versions"]
    return "\n".join([
        "# Gradients of the generator's weights", "",
        "Written by `python -m mitsvbrdf.verify.generator_gradients`, nothing by hand. Machine: "
        f"{on['cpu']}. Versions: mitsuba {with_['mitsuba']}, drjit {with_['drjit']}, torch {with_['torch']}.",
        "",
        f"Photos of `{record['material']}` at {record['resolution']} px; networks of the default width, in "
        "float32. "
        "Compared with the float64 twin: the gradient of the whole loss with respect to all weights of the "
        "generator, relative "
        f"L2, after {', '.join(map(str, AFTER[:-1]))} and {AFTER[-1]} steps. Where a rounding carries an "
        "activation, an error "
        "or a clipped pixel across a kink of its function, a single state differs more: hence the median. "
        "The last two rows of "
        "each group are the float64 twin with one thing wrong.", "",
        "| method | BSDF | through | median | largest |", "|---|---|---|---:|---:|", *rows, ""])


def main(json: Annotated[Path, tyro.conf.arg(metavar="FILE",
                                             help="Where the record goes.")] = Path("out/gradients.json"),
         markdown: Annotated[Path | None, tyro.conf.arg(metavar="FILE",
                                                        help="Where the page goes; left out: nowhere.")] = None,
         material: Annotated[str, tyro.conf.arg(help="The made material that is photographed.")] = "inlay",
         resolution: Annotated[int, tyro.conf.arg(help="Side of the maps in texels.")] = 64) -> int:
    """Compare the gradients of a generator's weights through every renderer with those through the float64
    twin.
    """
    files.check_output(json, markdown)
    capture = photograph(make_material(material, resolution), nine_view_grid(), make_renderer("analytic"))
    record: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "material": material,
                              "resolution": resolution,
                              "rows": measured(capture), "machine": machine(), "versions": versions()}
    files.write_json(json, record)
    for row in record["rows"]:
        say(f"{row['method']:7} {row['bsdf']:15} {row['through']:24} {row['median']:.1e}  "
            f"{row['largest']:.1e}")
    if markdown:
        files.write_bytes(markdown, page(record).encode())
    say(f"wrote {json}")
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.verify.generator_gradients"))
