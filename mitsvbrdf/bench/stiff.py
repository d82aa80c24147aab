"""Fits that are asked too much: extreme materials, wrong calibration, photos that say little. Do they end finite?

``python -m mitsvbrdf.bench.stiff`` photographs made materials, spoils what the case says, fits each with every method,
prints how far it came, what had to be taken back, how sure it is and what it warns of, and keeps the record as JSON.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import torch
import torch.nn.functional as F
import tyro
from torch import Tensor

from ..capture import Capture
from ..errors import MitsvbrdfError
from ..fit import DirectConfig, FitConfig, GanConfig, HierarchicalConfig, HybridConfig, fit_svbrdf
from ..fit.confidence import confidence
from ..material.made import GOLD, make_material
from ..material.maps import SVBRDF
from ..measure.metrics import map_rmse
from ..render import Renderer, RendererName, make_renderer
from ..synth import photograph
from ..system import files
from ..system.progress import Progress, say
from ..system.provenance import machine, versions
from ..system.timing import timed
from ..system.tool import run_tool
from ..views import Views, nine_view_grid

PHOTO_NOISE = 0.003  # of the made photos, linear

# The methods as they come: `hierarchical` may end before its budget.
CONFIGS: dict[str, Callable[[float, int], FitConfig]] = {
    "hierarchical": lambda budget, seed: HierarchicalConfig(budget=budget, seed=seed),
    "hybrid": lambda budget, seed: HybridConfig(budget=budget, seed=seed),
    "direct": lambda budget, seed: DirectConfig(budget=budget, seed=seed),
    "gan": lambda budget, seed: GanConfig(budget=budget, seed=seed),
}
Method = Literal["hierarchical", "hybrid", "direct", "gan"]


@dataclass(frozen=True)
class Case:
    """What a stiff fit is given.

    Args:
        capture: the photos, with the views that the fit is told.
        truth: the material photographed, where there was one.
    """

    capture: Capture
    truth: SVBRDF | None = None


def made(name: str, resolution: int, **maps: Tensor) -> SVBRDF:
    """A made material with some maps replaced; one value, or one colour, stands for a constant map."""
    material = make_material(name, resolution)
    return SVBRDF(material.bsdf, {k: maps[k].expand_as(v).contiguous() if k in maps else v for k, v in material.maps.items()})


def steeper(normal: Tensor, factor: float) -> Tensor:
    """The normals of a relief this many times as deep."""
    return F.normalize(normal * torch.tensor([factor, factor, 1.0]), dim=-1)


def shot(truth: SVBRDF, told: Views | None = None, views: Views | None = None) -> Case:
    """Photos of a material from nine views (or ``views``), and the views the fit is told (left out: the right ones)."""
    capture = photograph(truth, views or nine_view_grid(), make_renderer("analytic"), PHOTO_NOISE)
    return Case(replace(capture, views=told or capture.views), truth)


def smooth_metal(resolution: int) -> Case:
    """A metal whose highlight is narrow."""
    return shot(made("tiles", resolution, diffuse=torch.zeros(3), specular=torch.tensor(GOLD), roughness=torch.tensor([0.05])))


def black_albedo(resolution: int) -> Case:
    """A dielectric that reflects nothing diffusely."""
    return shot(made("leather", resolution, diffuse=torch.zeros(3)))


def deep_relief(resolution: int) -> Case:
    """Normals three times as steep."""
    leather = make_material("leather", resolution)
    return shot(made("leather", resolution, normal=steeper(leather["normal"], 3.0)))


def clipped(resolution: int) -> Case:
    """Photos burnt out in three texels of ten."""
    truth, views = make_material("inlay", resolution), nine_view_grid()
    radiance = make_renderer("analytic").render(truth, views).amax(dim=-1)
    return shot(truth, views=replace(views, intensity=views.intensity / float(radiance.quantile(0.7))))


def light_stated(factor: float) -> Callable[[int], Case]:
    """The light stated this many times as strong as it was."""
    def case(resolution: int) -> Case:
        views = nine_view_grid()
        return shot(make_material("tiles", resolution), told=replace(views, intensity=views.intensity * factor))
    return case


def cameras_off(resolution: int) -> Case:
    """Cameras told to stand off by 5 percent of their distance."""
    views = nine_view_grid()
    rng = torch.Generator().manual_seed(0)
    off = F.normalize(torch.randn(views.camera.shape, generator=rng, dtype=torch.float64), dim=1)
    wrong = views.camera + 0.05 * views.camera.norm(dim=1, keepdim=True) * off
    return shot(make_material("plates", resolution), told=replace(views, camera=wrong, light=wrong.clone()))


def one_photo(resolution: int) -> Case:
    """A single photo."""
    return shot(make_material("inlay", resolution), views=nine_view_grid().pick([0]))


def same_photos(resolution: int) -> Case:
    """Nine views with one and the same photo."""
    case = shot(make_material("inlay", resolution))
    return replace(case, capture=replace(case.capture, photos=case.capture.photos[:1].repeat(9, 1, 1, 1)))


def constant_grey(resolution: int) -> Case:
    """Photos of one grey, which no material explains."""
    return Case(Capture(torch.full((9, resolution, resolution, 3), 0.5), nine_view_grid()))


CASES: dict[str, Callable[[int], Case]] = {
    "metal of roughness 0.05": smooth_metal,
    "black albedo": black_albedo,
    "relief up to 60 degrees": deep_relief,
    "30 % of the pixels clipped": clipped,
    "light stated 4x too weak": light_stated(1 / 4),
    "light stated 4x too strong": light_stated(4.0),
    "camera positions 5 % off": cameras_off,
    "a single photo": one_photo,
    "nine identical photos": same_photos,
    "constant grey photos": constant_grey,
}


def run(case: Case, config: FitConfig, renderer: Renderer, title: str = "") -> dict:
    """Fit a case and say how it ended, as numbers and texts for JSON; Ctrl-C raises KeyboardInterrupt as elsewhere."""
    with Progress(title) as progress:
        result, seconds = timed(fit_svbrdf, case.capture, renderer, config, report=progress)
    if result.stopped == "interrupted":  # a fit keeps what it has; a table of fits cut short says nothing
        raise KeyboardInterrupt
    result.svbrdf.check()  # finite and in range, or a MapsError
    return {"rerender_rmse": result.rerender_rmse, "start_rmse": result.trace[0]["rerender_rmse"],
            "map_rmse": map_rmse(result.svbrdf, case.truth) if case.truth else None,
            "iterations": result.trace[-1]["iteration"], "stopped": result.stopped, "undone": list(result.undone),
            "restarts": list(result.restarts), "seconds": round(seconds, 2),
            "confidence": confidence(result.deviations), "warnings": list(result.warnings)}


def line(case: str, method: str, row: dict) -> str:
    """One row of the printed table; ``sure`` is the share of texels determined, of each map in turn."""
    error = "" if row["map_rmse"] is None else f"{row['map_rmse']['mean']:.3f}"
    sure = " ".join(f"{c['determined_share']:4.0%}" for c in row["confidence"].values())
    return (f"{case:27} {method:12}  {row['rerender_rmse']:.4f}  {error:>5}  {len(row['undone']):6}  {len(row['restarts']):8}"
            f"  {row['seconds']:7.1f}  {sure}  {len(row['warnings'])}")


def main(json: Annotated[Path, tyro.conf.arg(metavar="FILE", help="Where the record goes.")] = Path("out/stiff.json"),
         budget: Annotated[float, tyro.conf.arg(help="Seconds for each fit at most; `hierarchical` ends by "
                                                       "itself.")] = 20.0,
         resolution: Annotated[int, tyro.conf.arg(help="Side of the maps in texels.")] = 64,
         methods: Annotated[tuple[Method, ...], tyro.conf.arg(help="Which methods.")] = get_args(Method),
         renderer: RendererName = "mitsuba", seed: int = 0) -> int:
    """Fit what is hard to fit, and see how it ends; 1 if a fit fails."""
    files.check_output(json)
    engine, rows, failed = make_renderer(renderer), [], 0
    for name, make in CASES.items():
        case = make(resolution)
        for method in methods:
            row = {"case": name, "method": method}
            try:
                row |= run(case, CONFIGS[method](budget, seed), engine, f"{name} · {method}")
            except MitsvbrdfError as error:
                row |= {"error": str(error)}
                failed += 1
            rows.append(row)
            files.write_json(json, {"schema_version": 1, "budget": budget, "resolution": resolution, "renderer": renderer,
                                    "seed": seed, "rows": rows, "machine": machine(), "versions": versions()})
    say(f"{'case':27} {'method':12}  {'error':6}  {'maps':>5}  undone  restarts  seconds  sure: d s r n         warnings")
    for row in rows:
        say(f"{row['case']:27} {row['method']:12}  {row['error']}" if "error" in row else line(row["case"], row["method"], row))
    for row in rows:
        for warning in row.get("warnings", ()):
            say(f"{row['case']}, {row['method']}: {warning}")
    say(f"wrote {json}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.bench.stiff",
                      "interrupted; the JSON file has each fit that was finished"))
