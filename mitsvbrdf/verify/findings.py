"""What the record of a cross-check shows: its summary, what was omitted, and which tolerances do not hold."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from typing import Any

from ..measure.tolerances import TOLERANCES


def summary(configurations: Sequence[dict]) -> list[dict]:
    """The worst figures of each BSDF and renderer, ``rough`` and ``smooth`` apart; median run times."""
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
            "flip": largest(c["flip"]["worst"] for c in group),
            "seconds": {way: statistics.median(c["seconds"][way]["median"] for c in group)
                        for way in ("forward", "backward")}}


def omitted(record: dict) -> list[dict]:
    """What was omitted and why, once each, ``by`` which renderers (and BSDF, where only one)."""
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
    """What exceeds the stated tolerances.

    Returns:
        One dict each with ``material``, ``bsdf``, ``renderer``, ``what``, ``value``, ``tolerance``, and
        ``limit``: what float32 allows there, None where that is not known.
    """
    return [{name: configuration[name] for name in ("material", "bsdf", "renderer")} | each
            for configuration in record["configurations"] for each in _exceeded(configuration)]


def _exceeded(configuration: dict) -> list[dict]:
    found: list[dict[str, Any]] = [
        {"what": f"values that are not finite in {place}", "value": count, "tolerance": 0, "limit": None}
        for place, count in _not_finite(configuration) if count]
    rough = configuration["rough"]
    if rough is None:
        return found
    for name, tolerance in TOLERANCES["image"].items():
        found += _over(f"{name} relative image error", rough["image"][name], tolerance,
                       rough["limit"]["image"][name])
    stated = TOLERANCES["gradients"]
    for name, gradient in rough["gradients"].items():
        what, limit = f"gradient of {name}", rough["limit"]["gradients"][name]
        if gradient["reference"] == 0:
            found += _over(f"{what}: length, 0 in the reference", gradient["difference"], 0, None)
            continue
        turned = None if gradient["cosine"] is None else 1 - gradient["cosine"]
        found += _over(f"{what}: relative L2", gradient["relative_l2"], stated["relative_l2"], limit)
        found += _over(f"{what}: 1 - cosine", turned, stated["1 - cosine"], None)
    return found


def _over(what: str, value: float | None, tolerance: float, limit: float | None) -> list[dict[str, Any]]:
    """One violation or none; a missing figure is not finite, which is counted apart."""
    exceeded = value is not None and value > tolerance
    return [{"what": what, "value": value, "tolerance": tolerance, "limit": limit}] if exceeded else []


def _not_finite(configuration: dict) -> list[tuple[str, int]]:
    """How many values of image and gradients are not finite, by place, all views together."""
    classes = [configuration[name] for name in ("rough", "smooth") if configuration[name]]
    return [("the image", sum(c["image"]["not_finite"] for c in classes)),
            *((f"the gradient of {name}", sum(c["gradients"][name]["not_finite"] for c in classes))
              for name in classes[0]["gradients"])]
