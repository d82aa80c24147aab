"""Every renderer and BSDF against the float64 twin: images, gradients and run time in one run.

Figures are counted over the texels of roughness 0.1 and more (``rough``), where
:data:`~mitsvbrdf.measure.tolerances.TOLERANCES` hold, and over those below (``smooth``), each beside what
float32 allows there (:mod:`mitsvbrdf.verify.float32_limits`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from functools import partial

import torch
from torch import Tensor

from .. import color
from ..errors import BackendError
from ..io.entry import entry
from ..io.provenance import machine, versions
from ..io.timing import in_turns, spread
from ..material.corner_cases import CONVERSION, as_bsdf
from ..material.maps import SVBRDF, Bsdf
from ..measure.gradients import Measured, fixed_cotangent, render_and_gradients
from ..measure.metrics import error_statistics, flip, gradient_error, relative_error
from ..measure.tolerances import ROUGH_FROM, TOLERANCES, UNIT_ROUNDOFF
from ..render import Renderer, make_renderer
from ..render.needs import scene_needs
from ..views import Views
from .findings import summary, violations
from .float32_limits import float32_limit

SCHEMA_VERSION = 2

Report = Callable[[str, float], object]


@entry(gradients=True)
def crosscheck(svbrdf_by_name: Mapping[str, SVBRDF], views: Views, bsdfs: Sequence[Bsdf],
               renderers: Sequence[Renderer], repeats: int = 5, *, names: Sequence[str] | None = None,
               transfer: color.Transfer = "gamma2.2",
               error_maps: MutableMapping[tuple[str, str, str], Tensor] | None = None,
               command: dict | None = None, report: Report = lambda text, share: None) -> dict:
    """Compare renderers with the float64 twin on every material and BSDF.

    Args:
        svbrdf_by_name: materials, float32; one of the other BSDF is converted by
            :func:`mitsvbrdf.material.corner_cases.as_bsdf`.
        views: camera and light positions.
        bsdfs: the BSDFs to render each material with.
        renderers: from :func:`mitsvbrdf.render.make_renderer`.
        repeats: timed passes of each configuration, in turn with all others.
        names: of the views; left out: 00, 01, ...
        transfer: how display values and FLIP encode light.
        error_maps: filled with the relative error of each configuration's worst view, R x R, largest channel,
            by (material, BSDF, renderer).
        command: options of the command line, kept in the record.
        report: told what is going on and the share done.

    Returns:
        A record for JSON, without NaN; docs/evaluation.md explains each field.
    """
    names = list(names or (f"{i:02d}" for i in range(len(views))))
    twin, found, jobs = make_renderer("analytic64"), [], {}
    pairs = [(name, bsdf) for name in svbrdf_by_name for bsdf in bsdfs]
    for number, (name, bsdf) in enumerate(pairs):
        report(f"{name}, {bsdf}", 0.7 * number / len(pairs))
        svbrdf = as_bsdf(svbrdf_by_name[name], bsdf)
        case = _Case(twin, svbrdf, views, names, transfer)
        for renderer in renderers:
            figures, error_map = case.compare(renderer)
            found.append({"material": name, "bsdf": bsdf, "renderer": renderer.name} | figures)
            jobs[len(found) - 1] = partial(_seconds, renderer, svbrdf, views)
            if error_maps is not None:
                error_maps[name, bsdf, renderer.name] = error_map
    turns = in_turns(jobs, repeats, 0, lambda share: report("run times", 0.7 + 0.3 * share))
    for number, passes in turns.items():
        forward, backward = zip(*passes)
        found[number]["seconds"] = {"forward": spread(forward), "backward": spread(backward)}
    record = {"schema_version": SCHEMA_VERSION, "reference": twin.name, "tolerances": TOLERANCES,
              "rough_from": ROUGH_FROM, "transfer": transfer, "command": command or {},
              "views": {"names": names, "size": views.size, "falloff": views.falloff,
                        "camera": views.camera.tolist(), "light": views.light.tolist(),
                        "intensity": views.intensity.tolist()},
              "materials": {name: {"resolution": m.resolution, "bsdf": m.bsdf,
                                   "converted": {bsdf: CONVERSION[bsdf] for bsdf in bsdfs if bsdf != m.bsdf}}
                            for name, m in svbrdf_by_name.items()},
              "configurations": found, "machine": machine(), "versions": versions()}
    return record | {"summary": summary(found), "violations": violations(record)}


class _Case:
    """One material as one BSDF: the twin's image and gradients, float32's limit, a renderer's errors."""

    def __init__(self, twin: Renderer, svbrdf: SVBRDF, views: Views, names: list[str],
                 transfer: color.Transfer) -> None:
        self.svbrdf, self.transfer = svbrdf, transfer
        cotangent = fixed_cotangent(torch.Size((len(views), svbrdf.resolution, svbrdf.resolution, 3)))
        self.views, self.names = views, names
        self.exact = render_and_gradients(twin, svbrdf, views, cotangent)
        self.change = float32_limit(twin, svbrdf, views, self.exact, cotangent)
        image = self.exact.image
        # of the relative error of each value, N x R x R x 3
        self.limit = UNIT_ROUNDOFF + relative_error(image + self.change.image, image)
        rough = svbrdf["roughness"][..., 0] >= ROUGH_FROM
        self.classes = {"rough": rough, "smooth": ~rough}

    def compare(self, renderer: Renderer) -> tuple[dict, Tensor]:
        """A renderer's part of the record but for run times, and the error map of its worst view."""
        got = render_and_gradients(renderer, self.svbrdf, self.views)
        # as it is shown: a metallic map that wants its slope at 1 adds a rounding to dark texels
        with torch.no_grad():
            image = renderer.render(self.svbrdf, self.views)
        off = relative_error(image, self.exact.image)
        look: dict[str, float | None] = {"mean": None, "worst": None}
        with contextlib.suppress(BackendError):  # without the extra; it decides nothing here
            looks = torch.stack([flip(torch.nan_to_num(a), b, self.transfer)
                                 for a, b in zip(image, self.exact.image)])
            look = {"mean": float(looks.mean()), "worst": float(looks.max())}
        shown, wanted = (color.to_display(x, self.transfer) for x in (image.double(), self.exact.image))
        shown = (shown - wanted).abs()
        error_map = torch.nan_to_num(off.abs(), nan=torch.inf).amax(dim=-1)
        worst = int(error_map.flatten(1).mean(dim=1).argmax())
        return {"omitted": self._omitted(renderer.name),
                **{name: self._figures(texels, off, got) for name, texels in self.classes.items()},
                "display": _finite({"mean": float(shown.mean()), "worst": float(shown.max())}), "flip": look,
                "worst_texels": [texel for texels in self.classes.values()
                                 for texel in self._worst_texels(image, off, texels)],
                "worst_view": self.names[worst]}, error_map[worst]

    def _figures(self, texels: Tensor, off: Tensor, got: Measured) -> dict | None:
        """Errors and limits over these texels (R x R, bool), None without any."""
        if not texels.any():
            return None
        off = off[:, texels]
        limit = error_statistics(self.limit[:, texels])
        return {"texels": int(texels.sum()),
                "image": _finite(error_statistics(off)) | {"not_finite": int((~torch.isfinite(off)).sum())},
                "gradients": {name: _gradient_figures(got.gradients[name][texels], gradient[texels])
                              for name, gradient in self.exact.gradients.items()},
                "limit": {"image": {name: limit[name] for name in ("mean", "p99.9", "worst")},
                          "gradients": {name: _relative(self.change.gradients[name][texels], gradient[texels])
                                        for name, gradient in self.exact.gradients.items()}}}

    def _worst_texels(self, image: Tensor, off: Tensor, among: Tensor, count: int = 3) -> list[dict]:
        """The texels of ``among`` (R x R, bool) furthest off, each in its worst view and channel."""
        error = torch.nan_to_num(off.abs(), nan=torch.inf)
        size, channel = torch.where(among[..., None], error, -1.0).max(dim=-1)
        size, view = size.max(dim=0)
        found = []
        for place in size.flatten().topk(min(count, int(among.sum()))).indices.tolist():
            row, column = divmod(place, size.shape[1])
            k = int(view[row, column])
            at = k, row, column, int(channel[k, row, column])
            found.append({"view": self.names[k], "row": row, "column": column, "channel": "rgb"[at[3]],
                          "reference": float(self.exact.image[at]), "limit": float(self.limit[at]),
                          "roughness": float(self.svbrdf["roughness"][row, column])}
                         | _finite({"value": float(image[at]), "relative_error": float(error[at])}))
        return found

    def _omitted(self, renderer: str) -> list[dict[str, str]]:
        """As :func:`render_and_gradients` asks for it: every map wants a gradient."""
        needs = scene_needs(self.svbrdf.map(lambda t: t.detach().clone().requires_grad_()), self.views,
                            renderer)
        return [{"what": what, "why": reason} for what, reason in needs.omitted]


def _seconds(renderer: Renderer, svbrdf: SVBRDF, views: Views) -> tuple[float, float]:
    """Seconds of a forward and of a backward pass."""
    passes = render_and_gradients(renderer, svbrdf, views)
    return passes.forward, passes.backward


def _finite(figures: dict) -> dict:
    """The figures with None for those that are not finite, which JSON does not have."""
    return {name: value if math.isfinite(value) else None for name, value in figures.items()}


def _gradient_figures(gradient: Tensor, reference: Tensor) -> dict:
    """:func:`gradient_error`, None where the reference is 0, with the lengths of reference and difference."""
    difference = (gradient.double() - reference).norm()
    figures = (gradient_error(gradient, reference)
               | {"reference": float(reference.norm()), "difference": float(difference)})
    return _finite(figures) | {"not_finite": int((~torch.isfinite(gradient)).sum())}


def _relative(change: Tensor, gradient: Tensor) -> float | None:
    """The float32 limit of a gradient's relative L2 error; None where the gradient is 0."""
    length = float(gradient.norm())
    return UNIT_ROUNDOFF + float(change.norm()) / length if length else None
