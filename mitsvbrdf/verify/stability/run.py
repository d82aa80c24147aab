"""A stability run: all renderers render all configurations, and each result gets a verdict, in one record.

The verdict ``clamped`` names the active clamps of the model.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from ... import color
from ...color import TOE
from ...errors import MitsvbrdfError
from ...fit.losses import photometric
from ...io import Report
from ...io.entry import entry
from ...io.provenance import machine, versions
from ...measure.gradients import Measured, render_and_gradients
from ...measure.tolerances import SWEEP_TOLERANCES, UNIT_ROUNDOFF
from ...render import Renderer, make_renderer
from ...render.analytic import MIN_ALPHA
from ...render.bsdf import F0_RANGE
from ...render.needs import CONSTANT_FRESNEL_DEGREES, half_angle_bound
from ..float32_limits import float32_limit
from .conditioning import condition, disturbed, jacobian
from .sweeps import SWEEPS, Case

SCHEMA_VERSION = 2
# an entry above this share of its texel's gradient is more than float32's rounding: 0 instead is a fault
ABOVE_ROUNDING = 1e-5


@entry(gradients=True)
def stability(renderers: Sequence[Renderer], sweeps: Sequence[str] = tuple(SWEEPS),
              report: Report = lambda text, share: None) -> dict:
    """Run sweeps, keys of :data:`SWEEPS`, and give a verdict on each configuration and renderer. float64 is
    the reference; it need not be among the renderers.

    Returns a record for JSON, without NaN; docs/results/stability.md shows it. ``violations`` lists
    results that are worse than expected.
    """
    cases = [case for key in sweeps for case in SWEEPS[key][1]()]
    rows = []
    for number, case in enumerate(cases):
        report(f"{case.sweep}: {case.label}", number / len(cases))
        rows.append(measured(case, renderers))
    record = {"schema_version": SCHEMA_VERSION, "reference": "analytic64",
              "renderers": [r.name for r in renderers], "tolerances": SWEEP_TOLERANCES,
              "sweeps": {key: SWEEPS[key][0] for key in sweeps}, "rows": rows, "machine": machine(),
              "versions": versions()}
    return record | {"violations": violations(rows)}


def violations(rows: Sequence[dict]) -> list[dict]:
    """Results that are worse than expected: ``sweep``, ``label``, ``renderer``, ``what``."""
    found = []
    for each in rows:
        where = {"sweep": each["sweep"], "label": each["label"]}
        for name, figures in each["renderers"].items():
            kind = figures["verdict"]
            if kind in ("wrong", "not finite") or (kind == "refused") != each["refused"]:
                found.append(where | {"renderer": name, "what": f"{kind}: {figures['why'] or 'not refused'}"})
    return found


def measured(case: Case, renderers: Sequence[Renderer]) -> dict:
    """The record of one configuration."""
    row: dict[str, Any] = {"sweep": case.sweep, "label": case.label, "value": case.value,
                           "bsdf": case.svbrdf.bsdf, "resolution": case.svbrdf.resolution,
                           "views": len(case.views), "refused": case.refused,
                           "condition": None, "limit": {}, "clamps": []}
    try:
        case.svbrdf.check()
        case.views.check()
    except MitsvbrdfError as error:
        kind, why = verdict({"refused": str(error)}, {})
        return row | {"renderers": {r.name: {"verdict": kind, "why": why} for r in renderers}}
    twin, photos, cotangent = make_renderer("analytic64"), None, None
    if case.transfer is not None:  # the photometric loss, on photos of a slightly different material
        with torch.no_grad():
            photos = color.to_display(twin.render(disturbed(case.svbrdf), case.views), case.transfer)
            image = twin.render(case.svbrdf, case.views)
        image.requires_grad_()
        cotangent = torch.autograd.grad(photometric(image, photos, case.transfer), image)[0]
    exact = render_and_gradients(twin, case.svbrdf, case.views, cotangent)
    row["clamps"] = [name for name, acts in CLAMPS.items() if acts(case, exact.image)]
    if case.small:
        row["limit"] = _limit(twin, case, exact, cotangent)
        row["condition"] = condition(jacobian(twin, case.svbrdf, case.views, case.display))
    found = {}
    for renderer in renderers:
        figures = _figures(renderer, case, exact, photos)
        kind, why = verdict(figures, row["limit"], row["clamps"], case.known.get(renderer.name))
        found[renderer.name] = {"verdict": kind, "why": why} | figures
    return row | {"renderers": found}


def _figures(renderer: Renderer, case: Case, exact: Measured, photos: Tensor | None) -> dict:
    """Errors, and counts of values that are not finite or were set to 0; or ``refused``: the message."""
    try:
        if photos is None or case.transfer is None:
            found = render_and_gradients(renderer, case.svbrdf, case.views)
        else:  # gradients of the photometric loss, in the renderer's own precision
            leaves = case.svbrdf.map(lambda t: t.detach().clone().requires_grad_())
            drawn = renderer.render(leaves, case.views)
            slopes = torch.autograd.grad(photometric(drawn, photos.to(drawn), case.transfer),
                                         list(leaves.maps.values()))
            found = Measured(drawn.detach(), dict(zip(leaves.maps, slopes)), 0.0, 0.0)
    except MitsvbrdfError as error:
        return {"refused": str(error)}
    pick = slice(None) if case.texels is None else case.texels
    image, true = found.image[:, pick], exact.image[:, pick]
    gradients = {name: (g[pick], exact.gradients[name][pick]) for name, g in found.gradients.items()}
    return {
        "errors": {"image": _relative(image, true)}
        | {name: _relative(*pair) for name, pair in gradients.items()},
        "not_finite": {"image": _not_finite(image)}
        | {name: _not_finite(g) for name, (g, _) in gradients.items()},
        # entries that are 0, although in the reference they are not small beside the others of their texel
        "silenced": {name: int(((got == 0) & (wanted.abs() > ABOVE_ROUNDING * wanted.norm(
            dim=-1, keepdim=True))).sum()) for name, (got, wanted) in gradients.items()},
    }


def _relative(found: Tensor, reference: Tensor) -> float | None:
    """|found - reference| / |reference|; 0 if both are 0, None if infinite."""
    off, size = ((x.flatten() if x.numel() else x.new_zeros(1)).norm()
                 for x in (found.double() - reference, reference))
    return 0.0 if off == 0 else float(off / size) if math.isfinite(float(off / size)) else None


def _not_finite(tensor: Tensor) -> int:
    return int((~torch.isfinite(tensor)).sum())


def _limit(twin: Renderer, case: Case, exact: Measured, cotangent: Tensor | None) -> dict[str, float]:
    """Relative L2 change over the compared texels if every normal is rounded once."""
    limit = float32_limit(twin, case.svbrdf, case.views, exact, cotangent)
    pick = slice(None) if case.texels is None else case.texels
    pairs = {"image": (limit.image[:, pick], exact.image[:, pick])} | {
        name: (change[pick], exact.gradients[name][pick]) for name, change in limit.gradients.items()}
    return {name: UNIT_ROUNDOFF + (float(change.norm() / value.norm()) if value.norm() > 0 else 0.0)
            for name, (change, value) in pairs.items()}


# From best to worst. ``degraded``: conditioning explains the error. ``limited``: the error is larger, but
# within a stated bound of a known cause. The last two are never accepted, ``refused`` only for invalid input.
VERDICTS = ("exact", "clamped", "degraded", "limited", "refused", "wrong", "not finite")


def verdict(figures: Mapping, limit: Mapping[str, float], clamps: Sequence[str] = (),
            known: tuple[float, str] | None = None) -> tuple[str, str]:
    """One of :data:`VERDICTS`, and the reason.

    ``figures`` has ``errors``: relative L2 error of ``image`` and of each map's gradient, None for infinite.
    It also has ``not_finite``, with the same keys, and ``silenced``, by map: counts of such values. On error
    it has only ``refused``, the message. ``limit``: the relative change if every normal is rounded once
    (:func:`mitsvbrdf.verify.float32_limits.float32_limit`), with the keys of ``errors``; empty if it was not
    computed. Measured errors reach a third of it if nothing else is wrong. ``clamps``: names of the active
    clamps. ``known``: the largest error that a known cause explains, and this cause.
    """
    if "refused" in figures:
        return "refused", figures["refused"]
    for kind, what, how in (("not finite", "not_finite", ""), ("wrong", "silenced", " come back as 0")):
        found = [f"{count} of {name}" for name, count in figures[what].items() if count]
        if found and not (known and kind == "wrong"):
            return kind, ", ".join(found) + how
    errors = {name: float("inf") if error is None else error for name, error in figures["errors"].items()}
    excess = {name: error / max(_tolerance(name), limit.get(name, 0.0)) for name, error in errors.items()}
    name = max(excess, key=excess.__getitem__)
    if excess[name] > 1:
        if known and errors[name] <= known[0]:
            return "limited", f"{known[1]}: {name} {errors[name]:.1g}"
        return "wrong", f"{name} {errors[name]:.1g}, {_beside(name, limit)}"
    off = {name: error / _tolerance(name) for name, error in errors.items()}
    name = max(off, key=off.__getitem__)
    if off[name] > 1:
        return "degraded", f"{name} {errors[name]:.1g}, {_beside(name, limit)}"
    return ("clamped", ", ".join(clamps)) if clamps else ("exact", "")


def _tolerance(name: str) -> float:
    return SWEEP_TOLERANCES["image" if name == "image" else "gradient"]


def _beside(name: str, limit: Mapping[str, float]) -> str:
    return f"one rounding makes {limit[name]:.1g}" if name in limit else f"tolerance {_tolerance(name):.1g}"


Acts = Callable[[Case, Tensor], bool]


def _smoother_than(bsdf: str) -> Acts:
    return lambda case, radiance: case.svbrdf.bsdf == bsdf and bool(
        (case.svbrdf["roughness"].double() ** 2 <= MIN_ALPHA[bsdf]).any())


def _index_cut(case: Case, radiance: Tensor) -> bool:
    if case.svbrdf.bsdf != "roughconductor" or half_angle_bound(case.views) <= CONSTANT_FRESNEL_DEGREES:
        return False
    f0 = case.svbrdf["specular"]
    return bool(((f0 < F0_RANGE[0]) | (f0 > F0_RANGE[1])).any())


# Name in a verdict -> function: does the clamp change a value or gradient of a case with this radiance? No
# other clamp acts in the sweeps.
CLAMPS: dict[str, Acts] = {
    # D is 1 / (pi alpha^2) at its peak. Without a bound it overflows float32 at r = 1e-10, and one rounding
    # of the normal changes D by 6e-8 D / alpha. Below the bound, roughness has no effect and gradient 0.
    f"alpha >= {MIN_ALPHA['roughconductor']:g}": _smoother_than("roughconductor"),
    # The bound of the plugin itself. Below it, only the diffuse lobe depends on roughness.
    f"alpha >= {MIN_ALPHA['principled']:g}": _smoother_than("principled"),
    # The refractive index is infinite at F0 = 1, and its slope at F0 = 0. Outside, F is proportional to F0.
    f"index for F0 in [{F0_RANGE[0]:g}, {F0_RANGE[1]:g}]": _index_cut,
    # The power curve is vertical at 0. Below the toe, its chord of slope 1282 replaces it.
    "toe of gamma 2.2": lambda case, radiance: case.transfer == "gamma2.2" and bool((radiance < TOE).any()),
    # A burnt-out photo value is only a lower bound: the gradient is 0 where the rendering is brighter.
    "burnt-out photos": lambda case, radiance: case.transfer is not None and bool((radiance >= 1).any()),
}
