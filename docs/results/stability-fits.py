"""Fits that are asked too much: whether each is to be trusted, and where it is not, whether it says so.

``python docs/results/stability-fits.py`` makes stability-fits.md and stability-fits.svg from
stability-fits.json; with ``measure`` behind it every scene is fitted first (an hour and a half). What the
photos allow (``condition``, ``attainable``) stays as it was measured.
"""

import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import pandas as pd
import torch
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.run import version
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
MAPS = ("diffuse", "specular", "roughness", "normal")
SOUND, SIDE = 0.1, 64  # RMSE of a sound map; pixels
COVERED = 0.5  # share of an error that a stated deviation must reach
NOTHING = 0.28  # deviation of what photos do not tell: that of a uniform number

# What is wrong with the input -> words of a warning of it.
FAULTS = {
    "clipped photos": ("pixels are clipped",),
    "light power": ("stronger than stated", "weaker than stated", "light power or distances",
                    "check views, light"),
    "camera positions": ("view may be off", "check views", "distances may be off"),
    "one photo": ("one photo",), "identical photos": ("all alike", "the same picture"),
    "photos of one colour": ("of one colour",),
}
GOLD = (0.91, 0.70, 0.34)
# Material, what is changed in it or in its photos, and what is wrong with the input.
CASES: dict[str, tuple[str, dict, tuple[str, ...]]] = {
    "nothing wrong": ("tiles", {}, ()),
    "metal of roughness 0.05": ("tiles", {"metal": 0.05}, ()),
    "black albedo": ("leather", {"black": True}, ()),
    "relief 3 times as deep": ("leather", {"relief": 3.0}, ()),
    "30 % of the pixels clipped": ("inlay", {"clipped": 0.3}, ("clipped photos",)),
    "light stated 4x too weak": ("tiles", {"light": 0.25}, ("light power",)),
    "light stated 4x too strong": ("tiles", {"light": 4.0}, ("light power",)),
    "camera positions 5 % off": ("plates", {"off": 0.05}, ("camera positions",)),
    "a single photo": ("inlay", {"photos": 1}, ("one photo",)),
    "nine identical photos": ("inlay", {"same": True}, ("identical photos",)),
    "constant grey photos": ("inlay", {"grey": True}, ("photos of one colour",)),
    "metal of roughness 0.05, deep relief, 30 % clipped": (
        "tiles", {"metal": 0.05, "relief": 3.0, "clipped": 0.3}, ("clipped photos",)),
    "black albedo, light 4x too strong, cameras 5 % off": (
        "leather", {"black": True, "light": 4.0, "off": 0.05}, ("light power", "camera positions")),
    "deep relief, light 4x too weak, cameras 5 % off": (
        "leather", {"relief": 3.0, "light": 0.25, "off": 0.05}, ("light power", "camera positions")),
    "a single photo, 30 % clipped, noise 0.03": (
        "inlay", {"photos": 1, "clipped": 0.3, "noise": 0.03}, ("clipped photos", "one photo")),
}
# One thing at a time from harmless to extreme, on inlay: what changes -> an argument of `scene`, its values.
SERIES = {
    "number of photos": ("photos", (9, 5, 4, 3, 2, 1)),
    "spread of the cameras": ("spread", (1.5, 0.5, 0.2, 0.1, 0.03)),
    "roughness": ("roughness", (0.4, 0.3, 0.2, 0.1, 0.05)),
}
# Method -> its limit in seconds, and the seeds of the cases; series have the first seed.
METHODS = {"hierarchical": (120.0, (0, 1, 2)), "gan": (60.0, (0,)), "hybrid": (20.0, (0,)),
           "direct": (20.0, (0,))}


def verdict(record: dict) -> str:
    """One word for one fit."""
    errors, stated, warnings = record["errors"], record["stated"], " ".join(record["warnings"])
    single = any(warning.startswith("one photo") for warning in record["warnings"])  # met by its guess alone
    if record["why"] is not None or not errors["photos"] < (math.inf if single else errors["photos_start"]):
        return "failed"
    wrong = [name for name in MAPS if not errors.get(name, 1.0) <= SOUND]
    if not wrong:
        return "sound"
    faults = CASES[record["name"]][2] if record["kind"] == "case" else series_faults(record["name"])
    said = [fault for fault in faults if any(words in warnings for words in words_of(fault, record["name"]))]
    covered = all(stated.get(name, 0.0) >= min(COVERED * errors.get(name, 1.0), NOTHING) for name in wrong)
    if covered or faults and len(said) == len(faults):
        return "says so"
    return "says part" if said else "silent"


def words_of(fault: str, name: str) -> tuple[str, ...]:
    """Words of a warning; of a wrong power those of its direction."""
    if fault == "light power":
        return tuple(words for words in FAULTS[fault]
                     if words != f"{'weaker' if 'weak' in name else 'stronger'} than stated")
    return FAULTS[fault]


def series_faults(name: str) -> tuple[str, ...]:
    """What is wrong with a member of a series."""
    return ("one photo",) if name == "number of photos: 1" else ()


def cases(record: dict) -> pd.DataFrame:
    """Error of the maps (median over seeds) and verdicts of each case and method."""
    cells: dict[str, dict[str, str]] = {}
    for name in CASES:
        groups: dict[str, list] = {}
        for r in record["records"]:
            if r["kind"] == "case" and r["name"] == name:
                groups.setdefault(f"`{r['method']}`", []).append(r)
        for method, group in groups.items():
            counts = Counter(map(verdict, group))
            words = ", ".join(word if len(counts) == 1 else f"{word} ({n} of {len(group)})" for word,
                              n in counts.items())
            errors = [r["errors"]["mean"] for r in group if "mean" in r["errors"]]
            error = f"{median(errors):.3f}" if errors else "–"
            cells.setdefault(method, {})[name] = f"{error} {words}"
    given = {r["name"]: f"{r['attainable']['mean']:.3f}" for r in record["records"] if r["attainable"]}
    return pd.DataFrame({"attainable": {name: given.get(name, "–") for name in CASES},
                         **cells}).loc[list(CASES)].fillna("–")


def series(record: dict) -> pd.DataFrame:
    """The same along each series."""
    rows = [r for r in record["records"] if r["kind"] == "series"]
    cells: dict[str, dict[str, str]] = {"condition": {}, "attainable": {}}
    for r in rows:
        middle, rank = r["condition"]["median"], f"rank {r['condition']['rank']} of 9"
        cells["condition"][r["name"]] = (rank if middle is None
                                         else f"{middle:.{'2e' if middle >= 1000 else '3g'}}")
        cells["attainable"][r["name"]] = f"{r['attainable']['mean']:.3f}"
        cells.setdefault(f"`{r['method']}`", {})[r["name"]] = f"{r['errors']['mean']:.3f} {verdict(r)}"
    return pd.DataFrame(cells).fillna("–")


def page(record: dict) -> str:
    """The text of stability-fits.md."""
    counts = Counter(map(verdict, record["records"]))
    words = ", ".join(f"{counts[word]} {word}"
                      for word in ("sound", "says so", "says part", "silent", "failed"))
    versions = " and ".join(dict.fromkeys(r["version"] for r in record["records"]))
    budgets = {r["method"]: r["budget"] for r in record["records"]}
    limits = ", ".join(f"`{method}` {budget:g} s" for method, budget in budgets.items())
    return f"""# Numerical stability of the fits

{as_markdown(cases(record))}

Mean RMSE of the maps, and a verdict on the fit; nine photos of a made material unless said otherwise, \
{SIDE} px, version {versions}. Errors of `hierarchical` are the median of three seeds. Limits: {limits}. Of \
{len(record["records"])} fits: {words}. *Attainable*: standard deviation of an estimate of each texel by \
itself, with the right views and light. A method that ties texels to each other can be better.

| verdict | when |
| --- | --- |
| sound | every map is off by at most {SOUND} RMSE |
| says so | a map is off by more; the fit warns of all that is wrong with its input, or the deviations that \
it states reach half of the error, or say that photos tell nothing |
| says part | it warns of one thing that is wrong, and not of another |
| silent | the stated deviations are too small, and it warns of nothing that is wrong with its input |
| failed | an error, a figure that is not finite, or photos (two or more) met no better than by the start |

No method warns of cameras that are off by 5 %, nor, under deep relief, of light that is stated too weak.

## From harmless to extreme

{as_markdown(series(record))}

![Error of the maps against condition](stability-fits.svg)

The same for photos of inlaid wood, one thing changed at a time, one seed. *Condition*: largest by smallest \
singular value of a texel's Jacobian, median; a rank below 9 is an infinite condition.
"""


def figure(record: dict) -> Figure:
    """Error of the maps against the condition of the scenes of the series."""
    drawing = Figure(figsize=(6, 3.6), layout="constrained")
    axes = drawing.subplots()
    rows = [r for r in record["records"] if r["kind"] == "series" and r["condition"]["median"]]
    for method in dict.fromkeys(r["method"] for r in rows):
        found = sorted((r["condition"]["median"], r["errors"]["mean"]) for r in rows if r["method"] == method)
        style = "x:" if method == "gan" else "o-"  # it lies on the default's
        axes.plot(*zip(*found), style, markersize=6 if method == "gan" else 4, linewidth=0.8, label=method)
    axes.set(xscale="log", yscale="log", xlabel="condition, median texel", ylabel="RMSE of the maps")
    axes.legend(fontsize=8)
    return drawing


def scene(material: str, metal: float = 0.0, black: bool = False, relief: float = 1.0, clipped: float = 0.0,
          light: float = 1.0, off: float = 0.0, photos: int = 9, same: bool = False, grey: bool = False,
          noise: float = 0.003, spread: float = 1.0, roughness: float | None = None) -> tuple:
    """The maps of a scene, and its photos with the views that a fit is told."""
    from mitsvbrdf import SVBRDF, make_material, make_renderer
    from mitsvbrdf.bench.tasks import find_tasks

    camera = make_renderer("analytic")
    shots = find_tasks(["inlay"], ["none"], None, SIDE, (), "builtin:grid",
                       camera)[0].photos.pick(range(photos))
    made = make_material(material, SIDE)
    maps = dict(made.maps)
    maps["normal"] = torch.nn.functional.normalize(made["normal"] * torch.tensor([relief, relief, 1.0]),
                                                   dim=-1)
    if metal or black:
        maps["diffuse"] = torch.zeros_like(maps["diffuse"])
    if metal:
        maps["specular"] = torch.tensor(GOLD).expand_as(maps["specular"]).contiguous()
    if metal or roughness:
        maps["roughness"] = torch.full_like(maps["roughness"], metal or roughness)
    aside = torch.tensor([spread, spread, 1.0], dtype=torch.float64)
    views = replace(shots.views, camera=shots.views.camera * aside, light=shots.views.light * aside)
    truth = SVBRDF(made.bsdf, maps)
    if clipped:
        bright = camera.render(truth, views).amax(-1).quantile(1 - clipped)
        views = replace(views, intensity=views.intensity / float(bright))
    draw = torch.Generator().manual_seed(0)
    seen = camera.render(truth, views)
    seen = (255 * (seen + noise * torch.randn(seen.shape,
                                              generator=draw)).clamp(0, 1) ** (1 / 2.2)).round() / 255
    seen = seen[:1].expand_as(seen).contiguous() if same else torch.full_like(seen, 0.5) if grey else seen
    away = torch.nn.functional.normalize(torch.randn(views.camera.shape, generator=draw, dtype=torch.float64),
                                         dim=1)
    where = views.camera + off * views.camera.norm(dim=1, keepdim=True) * away
    told = replace(views, camera=where, light=where.clone(), intensity=views.intensity * light)
    return truth, replace(shots, photos=seen, views=told)


def scenes() -> Iterator[tuple[str, str, str, dict]]:
    """Kind, name, material and arguments of :func:`scene`."""
    for name, (material, changes, _) in CASES.items():
        yield "case", name, material, changes
    for series, (argument, values) in SERIES.items():
        for value in values:
            yield "series", f"{series}: {value:g}", "inlay", {argument: value}


def fitted(kind: str, name: str, material: str, changes: dict, method: str, seed: int) -> dict:
    """Fit one scene once."""
    from mitsvbrdf import MitsvbrdfError, fit_svbrdf, make_renderer
    from mitsvbrdf.bench.run import method_table

    truth, shots = scene(material, **changes)
    limit = METHODS[method][0]
    key = {"method": method, "kind": kind, "name": name, "budget": limit, "seed": seed, "version": version()}
    began = time.perf_counter()
    try:
        result = fit_svbrdf(shots, make_renderer("mitsuba"),
                            replace(method_table()[method], budget=limit, seed=seed))
    except MitsvbrdfError as reason:
        return key | {"why": str(reason), "errors": {}, "stated": {}, "warnings": []}
    last, start = result.trace[-1], result.trace[0]
    errors = {} if changes.get("grey") else rmse(result.svbrdf, truth)
    return key | {"seconds": last["seconds"], "wall": time.perf_counter() - began, "why": None,
                  "iterations": last["iteration"], "stopped": result.stopped,
                  "stated": {name: float(value.square().mean().sqrt())
                             for name, value in result.deviations.items()},
                  "warnings": list(result.warnings),
                  "errors": {**errors, "photos": result.rerender_rmse,
                             "photos_start": start["rerender_rmse"]}}


def measure(record: dict, lines: Path) -> dict:
    """Fit every scene by every method; each is kept in a file of lines as soon as it is there."""
    there = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    done = {(r["method"], r["name"], r["seed"]) for r in there}
    known = {r["name"]: {key: r[key] for key in ("condition", "attainable")} for r in record["records"]}
    for method, (_, seeds) in METHODS.items():
        for kind, name, material, changes in scenes():
            for seed in seeds if kind == "case" else seeds[:1]:
                if (method, name, seed) not in done:
                    print(method, name, seed, flush=True)
                    there.append(fitted(kind, name, material, changes, method, seed) | known[name])
                    with lines.open("a") as file:
                        print(json.dumps(there[-1]), file=file)
    return {"records": there}


def rmse(svbrdf, truth) -> dict[str, float]:
    """RMSE of each map in display values, and their mean."""
    found = {}
    for name in MAPS:
        pair = [m[name].clamp_min(0) ** (1 / 2.2) if name in ("diffuse", "specular") else m[name]
                for m in (svbrdf, truth)]
        found[name] = float((pair[0] - pair[1]).square().mean().sqrt()) / (2 if name == "normal" else 1)
    return found | {"mean": sum(found.values()) / len(found)}


if __name__ == "__main__":
    content = json.loads((HERE / "stability-fits.json").read_text())
    if sys.argv[1:] == ["measure"]:
        content = measure(content, HERE / "stability-fits.jsonl")
        (HERE / "stability-fits.json").write_text(json.dumps(content))
    (HERE / "stability-fits.md").write_text(page(content))
    (HERE / "stability-fits.svg").write_bytes(svg(figure(content)))
