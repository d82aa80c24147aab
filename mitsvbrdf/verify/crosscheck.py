"""Every renderer and BSDF against the float64 twin: images, gradients and run time in one run.

Figures are computed over the texels of roughness 0.1 and more (``rough``), where
:data:`~mitsvbrdf.measure.tolerances.TOLERANCES` hold, and over the texels below (``smooth``). The limit of
float32 is listed beside the errors of images and gradients (:mod:`mitsvbrdf.verify.float32_limits`).
"""

import math
import statistics
from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import torch
from torch import Tensor

from .. import color
from ..io import Report
from ..io.entry import entry
from ..io.provenance import machine, versions
from ..io.timing import spread
from ..material.conversion import as_principled
from ..material.corner_cases import CONVERSION
from ..material.maps import SVBRDF, Bsdf
from ..measure.gradients import Measured, render_and_gradients
from ..measure.metrics import error_statistics, gradient_error, relative_error
from ..measure.tolerances import ROUGH_FROM, TOLERANCES, UNIT_ROUNDOFF
from ..render import Renderer, make_renderer
from ..render.needs import scene_needs
from ..views import Views
from .float32_limits import float32_limit

SCHEMA_VERSION = 2


@entry(gradients=True)
def crosscheck(svbrdf_by_name: Mapping[str, SVBRDF], views: Views, bsdfs: Sequence[Bsdf],
               renderers: Sequence[Renderer], repeats: int = 5, *, names: Sequence[str] | None = None,
               transfer: color.Transfer = "gamma2.2",
               error_maps: MutableMapping[tuple[str, str, str], Tensor] | None = None,
               command: dict | None = None, report: Report = lambda text, share: None) -> dict:
    """Compare renderers with the float64 twin on every material and BSDF.

    Args:
        svbrdf_by_name: materials, float32. A material of another BSDF is converted
            (:data:`mitsvbrdf.material.corner_cases.CONVERSION`).
        repeats: timed passes of each configuration. The configurations take turns.
        names: of the views; default: 00, 01, ...
        transfer: how display values encode light.
        error_maps: a dict to fill: (material, BSDF, renderer) to the relative error of the worst view, R x R,
            largest channel.
        command: kept in the record as it is.

    Returns:
        A record for JSON, without NaN; docs/evaluation.md explains each field.
    """
    names = list(names or (f"{i:02d}" for i in range(len(views))))
    twin, found, jobs = make_renderer("analytic64"), [], []
    pairs = [(name, bsdf) for name in svbrdf_by_name for bsdf in bsdfs]
    for number, (name, bsdf) in enumerate(pairs):
        report(f"{name}, {bsdf}", 0.7 * number / len(pairs))
        given = svbrdf_by_name[name]
        svbrdf = as_principled(given) if bsdf == "principled" else given.as_roughconductor()
        case = _Case(twin, svbrdf, views, names, transfer)
        for renderer in renderers:
            figures, error_map = case.compare(renderer)
            found.append({"material": name, "bsdf": bsdf, "renderer": renderer.name} | figures)
            jobs.append(partial(render_and_gradients, renderer, svbrdf, views))
            if error_maps is not None:
                error_maps[name, bsdf, renderer.name] = error_map
    turns: list[list] = [[] for _ in jobs]
    for turn in range(repeats):  # in turns, so that drift of the machine affects all alike
        for number, job in enumerate(jobs):
            turns[number].append(attrgetter("forward", "backward")(job()))  # the pictures are not kept
            report("run times", 0.7 + 0.3 * (turn + (number + 1) / len(jobs)) / repeats)
    for number, passes in enumerate(turns):
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
        self.views, self.names = views, names
        self.exact = render_and_gradients(twin, svbrdf, views)
        self.change = float32_limit(twin, svbrdf, views, self.exact)
        image = self.exact.image
        self.limit = UNIT_ROUNDOFF + relative_error(image + self.change.image, image)  # N x R x R x 3
        rough = svbrdf["roughness"][..., 0] >= ROUGH_FROM
        self.classes = {"rough": rough, "smooth": ~rough}

    def compare(self, renderer: Renderer) -> tuple[dict, Tensor]:
        """A renderer's part of the record without the run times, and the error map of its worst view."""
        got = render_and_gradients(renderer, self.svbrdf, self.views)
        # as shown, without gradients: a metallic of 1 that requires a gradient adds a rounding to dark texels
        with torch.no_grad():
            image = renderer.render(self.svbrdf, self.views)
        off = relative_error(image, self.exact.image)
        shown, wanted = (color.to_display(x, self.transfer) for x in (image.double(), self.exact.image))
        shown = (shown - wanted).abs()
        error_map = torch.nan_to_num(off.abs(), nan=torch.inf).amax(dim=-1)
        worst = int(error_map.flatten(1).mean(dim=1).argmax())
        # as in render_and_gradients: every map requires a gradient
        needs = scene_needs(self.svbrdf.map(lambda t: t.detach().clone().requires_grad_()), self.views,
                            renderer.name)
        return {"omitted": [{"what": what, "why": reason} for what, reason in needs.omitted],
                **{name: self._figures(texels, off, got) for name, texels in self.classes.items()},
                "display": _finite({"mean": float(shown.mean()), "worst": float(shown.max())}),
                "worst_texels": [texel for texels in self.classes.values()
                                 for texel in self._worst_texels(image, off, texels)],
                "worst_view": self.names[worst]}, error_map[worst]

    def _figures(self, texels: Tensor, off: Tensor, got: Measured) -> dict | None:
        """Errors and limits over these texels (R x R, bool); None if there are none."""
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

    def _worst_texels(self, image: Tensor, off: Tensor, among: Tensor) -> list[dict]:
        """The three worst texels of ``among`` (R x R, bool), each in its worst view and channel."""
        error = torch.nan_to_num(off.abs(), nan=torch.inf)
        size, channel = torch.where(among[..., None], error, -1.0).max(dim=-1)
        size, view = size.max(dim=0)
        found = []
        for place in size.flatten().topk(min(3, int(among.sum()))).indices.tolist():
            row, column = divmod(place, size.shape[1])
            k = int(view[row, column])
            at = k, row, column, int(channel[k, row, column])
            found.append({"view": self.names[k], "row": row, "column": column, "channel": "rgb"[at[3]],
                          "reference": float(self.exact.image[at]), "limit": float(self.limit[at]),
                          "roughness": float(self.svbrdf["roughness"][row, column])}
                         | _finite({"value": float(image[at]), "relative_error": float(error[at])}))
        return found


def _finite(figures: dict) -> dict:
    """The figures, with None for values that are not finite, because JSON does not allow these."""
    return {name: value if math.isfinite(value) else None for name, value in figures.items()}


def _gradient_figures(gradient: Tensor, reference: Tensor) -> dict:
    """:func:`gradient_error` (None if the reference is 0), and the lengths of reference and difference."""
    difference = (gradient.double() - reference).norm()
    figures = (gradient_error(gradient, reference)
               | {"reference": float(reference.norm()), "difference": float(difference)})
    return _finite(figures) | {"not_finite": int((~torch.isfinite(gradient)).sum())}


def _relative(change: Tensor, gradient: Tensor) -> float | None:
    """The float32 limit of a gradient's relative L2 error; None if the gradient is 0."""
    length = float(gradient.norm())
    return UNIT_ROUNDOFF + float(change.norm()) / length if length else None


def summary(configurations: Sequence[dict]) -> list[dict]:
    """Worst figures and median run times of each BSDF and renderer, ``rough`` and ``smooth`` apart."""
    rows = []
    for texels in ("rough", "smooth"):
        groups: dict[tuple[str, str], list[dict]] = {}
        for configuration in configurations:
            if configuration[texels]:
                key = configuration["bsdf"], configuration["renderer"]
                groups.setdefault(key, []).append(configuration)
        rows += [{"texels": texels, "bsdf": bsdf, "renderer": renderer, "materials": len(group)}
                 | _summary_row(group, texels) for (bsdf, renderer), group in groups.items()]
    return rows


def _summary_row(group: list[dict], texels: str) -> dict:
    images = [c[texels]["image"] for c in group]
    gradients = [g for c in group for g in c[texels]["gradients"].values()]
    limits = [c[texels]["limit"] for c in group]

    def largest(values: Iterable[float | None]) -> float | None:
        return max((value for value in values if value is not None), key=abs, default=None)

    return {"image": {name: largest(i[name] for i in images) for name in ("mean", "p99.9", "worst", "bias")},
            "gradients": {"relative_l2": largest(g["relative_l2"] for g in gradients),
                          "cosine": min((g["cosine"] for g in gradients if g["cosine"] is not None),
                                        default=None)},
            "limit": {"mean": largest(limit["image"]["mean"] for limit in limits),
                      "p99.9": largest(limit["image"]["p99.9"] for limit in limits),
                      "relative_l2": largest(value for limit in limits
                                             for value in limit["gradients"].values())},
            "display": largest(c["display"]["worst"] for c in group),
            "seconds": {way: statistics.median(c["seconds"][way]["median"] for c in group)
                        for way in ("forward", "backward")}}


def omitted(record: dict) -> list[dict]:
    """What was omitted and why, each once. ``by``: the renderers, and the BSDFs unless all omit it."""
    found: dict[tuple[str, str], list[dict]] = {}
    for configuration in record["configurations"]:
        for each in configuration["omitted"]:
            found.setdefault((each["what"], each["why"]), []).append(configuration)
    bsdfs = len({c["bsdf"] for c in record["configurations"]})

    def by(configurations: list[dict]) -> str:
        names, kinds = (list(dict.fromkeys(c[key] for c in configurations)) for key in ("renderer", "bsdf"))
        return ", ".join(names) + ("" if len(kinds) == bsdfs else f" ({', '.join(kinds)})")

    return [{"what": what, "why": why, "by": by(configurations)}
            for (what, why), configurations in found.items()]


def violations(record: dict) -> list[dict]:
    """Figures above the stated tolerances. ``limit``: float32's own error there; None if unknown."""
    return [{name: configuration[name] for name in ("material", "bsdf", "renderer")} | each
            for configuration in record["configurations"] for each in _exceeded(configuration)]


def _exceeded(configuration: dict) -> list[dict]:
    rough, stated = configuration["rough"], TOLERANCES["gradients"]
    classes = [configuration[name] for name in ("rough", "smooth") if configuration[name]]
    places = {"the image": [each["image"] for each in classes]} | {
        f"the gradient of {name}": [each["gradients"][name] for each in classes]
        for name in classes[0]["gradients"]}
    found: list[tuple[str, Any, float, float | None]] = [
        (f"values that are not finite in {place}", sum(each["not_finite"] for each in parts), 0, None)
        for place, parts in places.items()]
    for name, tolerance in TOLERANCES["image"].items() if rough else ():
        found.append((f"{name} relative image error", rough["image"][name], tolerance,
                      rough["limit"]["image"][name]))
    for name, gradient in rough["gradients"].items() if rough else ():
        what = f"gradient of {name}"
        if gradient["reference"] == 0:
            found.append((f"{what}: length, 0 in the reference", gradient["difference"], 0, None))
            continue
        turned = None if gradient["cosine"] is None else 1 - gradient["cosine"]
        found += [(f"{what}: relative L2", gradient["relative_l2"], stated["relative_l2"],
                   rough["limit"]["gradients"][name]),
                  (f"{what}: 1 - cosine", turned, stated["1 - cosine"], None)]
    # a figure of None was not finite; such values are counted apart
    return [dict(zip(("what", "value", "tolerance", "limit"), row)) for row in found
            if row[1] is not None and row[1] > row[2]]
