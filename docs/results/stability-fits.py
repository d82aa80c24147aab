"""Fits that are asked too much: whether each is to be trusted, and where it is not, whether it says so.

``python docs/results/stability-fits.py`` makes stability-fits.md and stability-fits.svg from
stability-fits.json; with ``measure`` behind it the cases are fitted first (an hour and a half). What the
photos allow (``condition``, ``attainable``, ``start``) stays as it was measured.
"""

import json
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from statistics import median

import pandas as pd
import torch
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
MAPS = ("diffuse", "specular", "roughness", "normal")
SOUND, SIDE = 0.1, 64  # RMSE of a sound map; pixels
COVERED = 0.5  # share of an error that a stated deviation must reach

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


def verdict(record: dict) -> str:
    """One word for one fit."""
    errors, stated, warnings = record["errors"], record["stated"], " ".join(record["warnings"])
    if record["why"] is not None or not errors["photos"] < errors["photos_start"]:
        return "failed"
    wrong = [name for name in MAPS if not errors.get(name, 1.0) <= SOUND]
    if not wrong:
        return "sound"
    faults = CASES[record["name"]][2] if record["kind"] == "case" else series_faults(record["name"])
    said = [fault for fault in faults if any(words in warnings for words in words_of(fault, record["name"]))]
    covered = all(stated.get(name, 0.0) >= COVERED * errors.get(name, 1.0) for name in wrong)
    if covered or len(said) == len(faults) and warnings:
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


def label(record: dict) -> str:
    """Method, and its budget where it is not the usual one."""
    return f"`{record['method']}`" + (", 300 s" if record["budget"] == 300 else "")


def cases(record: dict) -> pd.DataFrame:
    """Error of the maps (median over seeds) and verdicts of each case and method."""
    cells: dict[str, dict[str, str]] = {}
    for name in CASES:
        groups: dict[str, list] = {}
        for r in record["records"]:
            if r["kind"] == "case" and r["name"] == name:
                groups.setdefault(label(r), []).append(r)
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
        cells.setdefault(label(r), {})[r["name"]] = f"{r['errors']['mean']:.3f} {verdict(r)}"
    return pd.DataFrame(cells).fillna("–")


def page(record: dict) -> str:
    """The text of stability-fits.md."""
    counts = Counter(map(verdict, record["records"]))
    words = ", ".join(f"{counts[word]} {word}"
                      for word in ("sound", "says so", "says part", "silent", "failed"))
    undone = sum(r["undone"] for r in record["records"])
    return f"""# Numerical stability of the fits

{as_markdown(cases(record))}

RMSE of the maps and verdict, {SIDE} px, 20 s, median of three seeds (`direct` has none), version \
{record["versions"]["mitsvbrdf"]}. Of {len(record["records"])} fits: {words}; {undone} steps taken back. \
*Attainable*: standard deviation of an estimate of each texel by itself, with the right views and light.

| verdict | when |
| --- | --- |
| sound | every map is off by at most {SOUND} RMSE |
| says so | a map is off by more; the fit warns of all that is wrong with its input, or the deviations it \
states reach half of the error |
| says part | it warns of one thing that is wrong, and not of another |
| silent | it warns of nothing that is wrong, and the stated deviations are too small |
| failed | an error, a figure that is not finite, or photos met no better than by the start |

No method warns of cameras that are off by 5 %, nor, under deep relief, of light that is stated too weak.

## From harmless to extreme

{as_markdown(series(record))}

![Error of the maps against condition](stability-fits.svg)

Photos of inlaid wood, one thing changed at a time. *Condition*: largest by smallest singular value of a \
texel's Jacobian, median; a rank below 9 is an infinite condition.
"""


def figure(record: dict) -> Figure:
    """Error of the maps against the condition of the scenes of the series."""
    drawing = Figure(figsize=(6, 3.6), layout="constrained")
    axes = drawing.subplots()
    rows = [r for r in record["records"] if r["kind"] == "series" and r["condition"]["median"]]
    for method in dict.fromkeys(r["method"] for r in rows):
        found = sorted((r["condition"]["median"], r["errors"]["mean"]) for r in rows if r["method"] == method)
        axes.plot(*zip(*found), "o-", markersize=4, linewidth=0.8, label=method)
    axes.set(xscale="log", yscale="log", xlabel="condition, median texel", ylabel="RMSE of the maps")
    axes.legend(fontsize=8)
    return drawing


def scene(material: str, metal: float = 0.0, black: bool = False, relief: float = 1.0, clipped: float = 0.0,
          light: float = 1.0, off: float = 0.0, photos: int = 9, same: bool = False, grey: bool = False,
          noise: float = 0.003) -> tuple:
    """The maps of a case, and its photos with the views that a fit is told."""
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
        maps["roughness"] = torch.full_like(maps["roughness"], metal)
    truth, views = SVBRDF(made.bsdf, maps), shots.views
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


def measure(record: dict) -> dict:
    """Fit every case that the records have again."""
    from mitsvbrdf import MitsvbrdfError, fit_svbrdf, make_renderer
    from mitsvbrdf.bench.run import method_table

    renderer, found = make_renderer("mitsuba"), []
    for old in record["records"]:
        if old["kind"] == "case":
            truth, shots = scene(CASES[old["name"]][0], **CASES[old["name"]][1])
            config = replace(method_table()[old["method"]], budget=old["budget"], seed=old["seed"])
            began = time.perf_counter()
            try:
                result = fit_svbrdf(shots, renderer, config)
            except MitsvbrdfError as reason:
                found.append({**old, "why": str(reason), "errors": {}, "stated": {}, "warnings": []})
                continue
            last, start = result.trace[-1], result.trace[0]
            stated = {name: float(value.square().mean().sqrt()) for name, value in result.deviations.items()}
            errors = {} if "grey" in CASES[old["name"]][1] else rmse(result.svbrdf, truth)
            found.append({**old, "seconds": last["seconds"], "wall": time.perf_counter() - began, "why": None,
                          "iterations": last["iteration"], "stopped": result.stopped, "stated": stated,
                          "warnings": list(result.warnings), "undone": len(result.undone),
                          "errors": {**errors, "photos": result.rerender_rmse,
                                     "photos_start": start["rerender_rmse"]}})
            print(old["method"], old["name"], old["seed"], flush=True)
    return {**record, "records": [*found, *(r for r in record["records"] if r["kind"] == "series")]}


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
        content = measure(content)
        (HERE / "stability-fits.json").write_text(json.dumps(content))
    (HERE / "stability-fits.md").write_text(page(content))
    (HERE / "stability-fits.svg").write_bytes(svg(figure(content)))
