"""What a scene may do without: each item measured against the scene that has it, one record of a benchmark's
file each.

Every case renders one material twice, forward and backward, nine co-located views: once with the item
computed although it changes nothing, once without. The two run in turn in one process, so their ratio is fair
where their seconds are not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...capture import Capture, guess_diffuse
from ...color import to_display
from ...fit import (
    FitConfig,
    FitTask,
    GanConfig,
    HierarchicalConfig,
    HybridConfig,
    fit_svbrdf,
    losses,
    make_method,
)
from ...fit.finish_config import FinishConfig
from ...fit.generator.finish import finished
from ...fit.methods import METHODS, method_name
from ...io.timing import side_by_side
from ...material.made import make_material
from ...material.maps import SVBRDF
from ...measure.gradients import fixed_cotangent
from ...measure.metrics import image_error
from ...render import RendererName, make_renderer
from ...render.needs import Needs
from ...views import Views, nine_view_grid
from ..code import method_module, own_code

SUITE = "leave-out-renders"
EVERYTHING = Needs()
CO_LOCATED = replace(EVERYTHING, fresnel_curve=False)
# Seconds of a turn: those that its size does not change, and those of each texel.
SECONDS = {"mitsuba": (0.02, 5e-6), "hybrid": (1.0, 5e-5), "gan": (1.0, 5e-5), "hierarchical": (4.0, 3e-4)}
OF_RAYS = (0.2, 1e-4)  # the same of all others


@dataclass(frozen=True)
class Case:
    """One item to leave out, as a job of a benchmark's file.

    Args:
        what: its name.
        where: what renders: a renderer's name, or ``hybrid`` for a step of the fit.
        why: when it is not needed.
        full: computes with the item; returns the image, or the maps, to compare.
        lean: computes without.
        truth: renders the same image by the float64 twin, or None.
        says: the names by which the program says that it is left out.
        resolution: side of the maps in texels.
        repeats: measured turns of the pair.
    """

    what: str
    where: str
    why: str
    full: Callable[[], Tensor]
    lean: Callable[[], Tensor]
    truth: Callable[[], Tensor] | None = None
    says: tuple[str, ...] = ()
    resolution: int = 256
    repeats: int = 9

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": SUITE, "where": self.where, "name": self.what}

    @property
    def settings(self) -> dict:
        """What else shapes the record: the code of a fit; of scenes nothing that all records do not share."""
        return ({"code": own_code(method_module(self.where), finished.__module__)} if self.where in METHODS
                else {})

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"{self.what}, {self.where}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return self.where

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        fixed, each = SECONDS.get(self.where, OF_RAYS)
        return 2 * (self.repeats + 2) * (fixed + each * self.resolution**2)

    def run(self, report: Callable[[float], None] = lambda share: None) -> dict:
        """The figures: :class:`mitsvbrdf.bench.records.LeaveOutRenderRecord`."""
        full, lean = self.full(), self.lean()
        difference = image_error(lean, full)
        truth = None if self.truth is None else self.truth()
        errors = [None if truth is None else image_error(found, truth)["worst"] for found in (full, lean)]
        return {"says": [self.what, *self.says], "why": self.why, "worst": difference["worst"],
                "mean": difference["mean"],
                "full_error": errors[0], "lean_error": errors[1],
                "seconds": side_by_side({"full": self.full, "lean": self.lean}, self.repeats)}


def render_cases(resolution: int = 256, repeats: int = 9) -> list[Case]:
    """Every item.

    Args:
        resolution: side of the maps in texels.
        repeats: measured turns of each pair.
    """
    return [replace(case, resolution=resolution, repeats=repeats) for case in _cases(resolution)]


def lean_material(resolution: int) -> SVBRDF:
    """Inlaid wood and metal whose specular map is grey and whose normals are flat."""
    svbrdf = make_material("inlay", resolution)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(resolution, resolution, 3).contiguous()
    grey = svbrdf["specular"].mean(dim=-1, keepdim=True).expand(resolution, resolution, 3).contiguous()
    return SVBRDF("roughconductor", dict(svbrdf.maps) | {"specular": grey, "normal": up})


def _cases(resolution: int) -> Iterator[Case]:
    """The items in the order of the table, from single ones to all at once."""
    views, coloured, lean = nine_view_grid(), make_material("inlay", resolution), lean_material(resolution)
    black = torch.zeros(resolution, resolution, 3)
    matte, mirror = _with(coloured, specular=black), _with(coloured, diffuse=black)
    metal = SVBRDF("principled", {"base_color": coloured["diffuse"], "metallic": black[..., :1],
                                  "roughness": coloured["roughness"], "normal": coloured["normal"]})

    def pair(what: str, why: str, svbrdf: SVBRDF, without: Sequence[str], fixed: Sequence[str] = (),
             needs: Needs = CO_LOCATED, renderer: RendererName = "mitsuba",
             says: tuple[str, ...] = ()) -> Case:
        wanted = tuple(name for name in svbrdf.maps if name not in fixed)
        less: dict[str, Any] = dict.fromkeys(without, False)
        return Case(what, renderer, why, _pass(renderer, svbrdf, views, wanted, needs),
                    _pass(renderer, svbrdf, views, wanted, replace(needs, **less)),
                    partial(twin.render, svbrdf, views), says)

    def across(what: str, why: str, svbrdf: SVBRDF, wanted: tuple[str, ...], needs: Needs, lean_needs: Needs
               | None, says: tuple[str, ...] = ()) -> Case:
        return Case(what, "mitsuba-scene, mitsuba", why, _pass("mitsuba-scene", svbrdf, views,
                                                               tuple(svbrdf.maps), needs),
                    _pass("mitsuba", svbrdf, views, wanted, lean_needs), partial(twin.render, svbrdf, views),
                    says)

    def gradient(svbrdf: SVBRDF, name: str) -> Case:
        everything, others = tuple(svbrdf.maps), tuple(other for other in svbrdf.maps if other != name)
        full, lean = (_pass("mitsuba", svbrdf, views, wanted, bare) for wanted in (everything, others))
        return Case(f"gradient of {name}", "mitsuba", "it is held fixed", full, lean,
                    partial(twin.render, svbrdf, views))

    every, twin = tuple(coloured.maps), make_renderer("analytic64")
    bare = replace(CO_LOCATED, shadow_rays=False, path_depth=False, environment=False)
    yield pair("specular lobe", "the specular map is 0", matte, ("specular_lobe",), ("specular", "roughness"))
    yield pair("diffuse lobe", "the diffuse map is 0", mirror, ("diffuse_lobe",), ("diffuse",))
    yield pair("colour of the specular map", "it is grey", lean, ("coloured_specular",), ("specular",))
    yield pair("normal map", "it is flat", lean, ("normal_map",), ("normal",))
    yield pair("metallic map", "it is 0", metal, ("metallic",), ("metallic",))
    yield pair("Fresnel curve", "the light is at the camera", coloured, ("fresnel_curve",), needs=EVERYTHING)
    yield from (gradient(coloured, name) for name in every)
    yield from (gradient(metal, name) for name in ("base_color", "metallic"))
    yield Case("gradients of three maps", "mitsuba", "they are held fixed", _pass("mitsuba", coloured, views,
                                                                                  every, bare),
               _pass("mitsuba", coloured, views, ("diffuse",), bare), partial(twin.render, coloured, views))
    falling, constant = (_pass("mitsuba", coloured, lit, every, bare) for lit in (views,
                                                                                  replace(views, falloff="none")))
    yield Case("light falloff", "mitsuba", "asked for: the paper's light, so other pictures", falling,
               constant)
    yield pair("environment", "the flash is the only light", coloured, ("environment",),
               renderer="mitsuba-scene")
    yield pair("path depth", "a plane does not see itself", coloured, ("path_depth",),
               renderer="mitsuba-scene", says=("interreflection and path depth",))
    yield pair("shadow rays", "nothing stands in the way", coloured, ("shadow_rays",),
               renderer="mitsuba-scene")
    yield across("ray tracing", "the texel behind each pixel is known", coloured, every, bare, bare,
                 ("texture look-ups",))
    yield from _of_fits(coloured, views)
    yield across("all of these", "a flat, grey material; normal and specular held fixed", lean,
                 ("diffuse", "roughness"), EVERYTHING, None)


def _with(svbrdf: SVBRDF, **maps: Tensor) -> SVBRDF:
    return SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | maps)


def _pass(renderer: RendererName, svbrdf: SVBRDF, views: Views, wanted: tuple[str, ...],
          needs: Needs | None) -> Callable[[], Tensor]:
    """A forward and a backward pass with gradients of the maps ``wanted``; it returns the image."""
    engine = make_renderer(renderer, needs=needs)

    def forward_and_backward() -> Tensor:
        leaves = SVBRDF(svbrdf.bsdf, {n: t.detach().clone().requires_grad_(n in wanted)
                                      for n, t in svbrdf.maps.items()})
        image = engine.render(leaves, views)
        image.backward(fixed_cotangent(image.shape))
        return image.detach()

    return forward_and_backward


def _of_fits(svbrdf: SVBRDF, views: Views) -> Iterator[Case]:
    """What a fit does not compute: losses whose weight is 0, a guess that nobody asks for, a finish."""
    engine, small = make_renderer("mitsuba"), svbrdf.resized(min(svbrdf.resolution, 128))
    capture = Capture(to_display(engine.render(small, views)), views, "gamma2.2")

    def without(what: str, config: FitConfig, name: str, *says: str) -> Case:
        full, lean = (_steps(FitTask(capture, engine, replace(config, **{name: weight}),  # type: ignore[arg-type]
                                     small["diffuse"]))
                      for weight in (1e-30, 0.0))
        return Case(what, method_name(config), "its weight is 0", full, lean, says=says)

    hybrid, gan = HybridConfig(iterations=3), GanConfig(iterations=3, grow=False)
    yield without("discriminator", hybrid, "adversarial", losses.NAMES["adversarial"])
    for name in ("diffuse", "smooth", "flat", "photometric"):
        yield without(losses.NAMES[name], hybrid, name)
    yield without(losses.NAMES["features"], gan, "features")
    steps = _steps(FitTask(capture, engine, hybrid, small["diffuse"]))

    def guessing() -> Tensor:
        guess_diffuse(capture, "robust")
        return steps()

    yield Case("guessed diffuse map", "hybrid", "the diffuse map is held fixed", guessing, steps)
    short = HierarchicalConfig(iterations=3)

    def fitted(finish: bool) -> Tensor:
        found = fit_svbrdf(capture, engine, short)
        found = finished(found, capture, engine, FinishConfig(steps=3)) if finish else found
        return flat(found.svbrdf)

    yield Case("adversarial finish", "hierarchical", "not asked for", partial(fitted, True),
               partial(fitted, False))


def flat(svbrdf: SVBRDF) -> Tensor:
    """All numbers of a material, one after the other."""
    return torch.cat([t.flatten() for t in svbrdf.maps.values()])


def _steps(task: FitTask) -> Callable[[], Tensor]:
    """Three steps of a fit from its start; the maps they end at, one after the other."""
    def three_steps() -> Tensor:
        method = make_method(task)
        for step in range(3):
            method.step(step / 3)
        return flat(method.estimate()[0])

    return three_steps
