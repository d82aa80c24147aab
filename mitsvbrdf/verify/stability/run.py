"""The run: every configuration through every renderer, as one record."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from ... import color
from ...errors import MitsvbrdfError
from ...fit.losses import photometric
from ...io.entry import entry
from ...io.provenance import machine, versions
from ...measure.gradients import Measured, fixed_cotangent, render_and_gradients
from ...measure.tolerances import SWEEP_TOLERANCES, UNIT_ROUNDOFF
from ...render import Renderer, make_renderer
from ..float32_limits import float32_limit
from .conditioning import condition, disturbed, jacobian
from .sweeps import SWEEPS, Case
from .verdict import CLAMPS, verdict

SCHEMA_VERSION = 2
# a gradient entry of this share of its texel's is above float32's rounding: 0 in its place was put there
ABOVE_ROUNDING = 1e-5

Report = Callable[[str, float], object]


@entry(gradients=True)
def stability(renderers: Sequence[Renderer], sweeps: Sequence[str] = tuple(SWEEPS),
              report: Report = lambda text, share: None) -> dict:
    """Run sweeps and give a verdict on each configuration and renderer.

    Args:
        renderers: from :func:`mitsvbrdf.render.make_renderer`; float64 is there without being asked for.
        sweeps: keys of :data:`SWEEPS`.
        report: told what is going on and the share done.

    Returns:
        A record for JSON, without NaN; docs/results/stability.md shows it. ``violations`` lists what came out
        worse than expected.
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
    """What came out worse than expected: ``sweep``, ``label``, ``renderer``, ``what``."""
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
    twin = make_renderer("analytic64")
    photos = _photos(twin, case)
    cotangent = _cotangent(twin, case, photos)
    exact = render_and_gradients(twin, case.svbrdf, case.views, cotangent)
    row["clamps"] = [name for name, acts in CLAMPS.items() if acts(case, exact.image)]
    if case.small:
        row["limit"] = _limit(twin, case, exact, cotangent)
        row["condition"] = condition(jacobian(twin, case.svbrdf, case.views, _display(case)))
    found = {}
    for renderer in renderers:
        figures = _figures(renderer, case, exact, photos)
        kind, why = verdict(figures, row["limit"], row["clamps"], case.known.get(renderer.name))
        found[renderer.name] = {"verdict": kind, "why": why} | figures
    return row | {"renderers": found}


def _display(case: Case) -> Callable[[Tensor], Tensor]:
    """What a fit sees: display values, burnt out in photos whose exposure is swept."""
    return color.encode if case.transfer is None else lambda radiance: color.to_display(
        radiance, case.encoding)


def _photos(twin: Renderer, case: Case) -> Tensor | None:
    """Photos of a material a little different, for the configurations that ask for the photometric loss."""
    if case.transfer is None:
        return None
    with torch.no_grad():
        return color.to_display(twin.render(disturbed(case.svbrdf), case.views), case.encoding)


def _cotangent(twin: Renderer, case: Case, photos: Tensor | None) -> Tensor:
    if photos is None:
        return fixed_cotangent(
            torch.Size((len(case.views), case.svbrdf.resolution, case.svbrdf.resolution, 3)))
    with torch.no_grad():
        image = twin.render(case.svbrdf, case.views)
    image.requires_grad_()
    return torch.autograd.grad(photometric(image, photos, case.encoding), image)[0]


def _figures(renderer: Renderer, case: Case, exact: Measured, photos: Tensor | None) -> dict:
    """Errors, and values that are not finite or were made 0; or how the renderer refused."""
    try:
        found = _loss_gradients(renderer, case, photos) if photos is not None else render_and_gradients(
            renderer, case.svbrdf, case.views)
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
        "silenced": {name: _silenced(*pair) for name, pair in gradients.items()},
    }


def _loss_gradients(renderer: Renderer, case: Case, photos: Tensor) -> Measured:
    """As :func:`render_and_gradients`, of the photometric loss in the renderer's own precision."""
    leaves = case.svbrdf.map(lambda t: t.detach().clone().requires_grad_())
    image = renderer.render(leaves, case.views)
    gradients = torch.autograd.grad(photometric(image, photos.to(image), case.encoding),
                                    list(leaves.maps.values()))
    return Measured(image.detach(), dict(zip(leaves.maps, gradients)), 0.0, 0.0)


def _relative(found: Tensor, reference: Tensor) -> float | None:
    """|found - reference| / |reference|, 0 where both are 0; None for infinite."""
    off, size = ((x.flatten() if x.numel() else x.new_zeros(1)).norm()
                 for x in (found.double() - reference, reference))
    return 0.0 if off == 0 else float(off / size) if math.isfinite(float(off / size)) else None


def _not_finite(tensor: Tensor) -> int:
    return int((~torch.isfinite(tensor)).sum())


def _silenced(found: Tensor, reference: Tensor) -> int:
    """Entries that came back as 0 though they are not small beside the others of their texel."""
    return int(
        ((found == 0) & (reference.abs() > ABOVE_ROUNDING * reference.norm(dim=-1, keepdim=True))).sum())


def _limit(twin: Renderer, case: Case, exact: Measured, cotangent: Tensor) -> dict[str, float]:
    """Relative L2 change by one rounding of every normal, over the compared texels."""
    limit = float32_limit(twin, case.svbrdf, case.views, exact, cotangent)
    pick = slice(None) if case.texels is None else case.texels
    pairs = {"image": (limit.image[:, pick], exact.image[:, pick])} | {
        name: (change[pick], exact.gradients[name][pick]) for name, change in limit.gradients.items()}
    return {name: UNIT_ROUNDOFF + (float(change.norm() / value.norm()) if value.norm() > 0 else 0.0)
            for name, (change, value) in pairs.items()}
