"""How often the truth lies within the uncertainty that a fit states.

``python docs/results/coverage.py`` makes coverage.md and coverage.svg from coverage.json; with ``measure``
behind it the 24 fits are measured first (half an hour).
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import torch
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
DETERMINED = 0.1  # deviation below which a fit calls a texel determined
MATERIALS, NOISES, SEEDS, SIDE = ("inlay", "tiles", "leather", "plates"), (0.003, 0.01), (0, 1, 2), 64


def rows(record: dict) -> pd.DataFrame:
    """One row for each fit and map."""
    return pd.DataFrame([{"material": fit["material"], "noise": fit["noise"], "map": name, **figures}
                         for fit in record["fits"] for name, figures in fit["maps"].items()])


def page(record: dict) -> str:
    """The text of coverage.md."""
    found = rows(record)
    order = list(found["map"].unique())
    means = found.groupby("map")[["rmse", "median_sd", "within_68", "within_95", "determined",
                                  "right"]].mean().loc[order]
    cells = pd.DataFrame({name: means[name].map("{:.4f}".format if name in ("rmse", "median_sd")
                                                else "{:.0%}".format)
                          for name in means})
    cells["ranks"] = [" ".join(f"{100 * x:.0f}"
                               for x in torch.tensor(list(found[found["map"] == name]["ranks"])).mean(0))
                      for name in order]
    cells.columns = ["RMSE", "median deviation", "within 68 %", "within 95 %", "determined", "right", "ranks"]
    each = found.groupby(["material", "noise", "map"], sort=False)["within_68"].mean().unstack("map")[order]
    each = each.loc[list(dict.fromkeys(zip(found["material"], found["noise"])))].map("{:.0%}".format)
    each.index = [f"{material}, noise {noise:g}" for material, noise in each.index]
    return f"""# Stated uncertainty

{as_markdown(cells)}

{len(record["fits"])} fits of the default method to made materials, {record["resolution"]} px, nine 8-bit \
photos, sensor noise of 0.003 and 0.01 (linear); *within*: share of the truths at most 1 and 1.96 stated \
deviations from what was found. *Determined*: texels of a stated deviation below {DETERMINED}; *right*: \
those of them off by less than {1.96 * DETERMINED:.3g}. *Ranks*: where the truth lies in the stated normal \
distribution, in ten equal bins, per cent (10 each would be true); specular and roughness are stated too \
unsure.

## Within 68 %, by material and noise

{as_markdown(each)}

![Where the truth lies in what was stated](coverage.svg)
"""


def figure(record: dict) -> Figure:
    """Ranks of each map."""
    found = rows(record)
    drawing = Figure(figsize=(9, 2.4), layout="constrained")
    names = list(found["map"].unique())
    for axes, name in zip(drawing.subplots(1, len(names), sharey=True), names):
        axes.bar(range(10), 100 * torch.tensor(list(found[found["map"] == name]["ranks"])).mean(0))
        axes.axhline(10, color="0.4", linewidth=1)
        axes.set_title(name, fontsize=9)
    drawing.supylabel("per cent", fontsize=9)
    return drawing


def in_numbers(name: str, value: torch.Tensor) -> torch.Tensor:
    """A map in the numbers in which its error is counted."""
    if name in ("diffuse", "specular"):
        return value.clamp_min(0) ** (1 / 2.2)
    return (value + 1) / 2 if name == "normal" else value


def counted(error: torch.Tensor, deviation: torch.Tensor) -> dict:
    """The figures of one map from errors and stated deviations, S x S x C."""
    ratio = (error / deviation.clamp_min(1e-9)).flatten()
    ranks = torch.histc(0.5 * (1 + torch.erf(ratio / 2**0.5)), bins=10, min=0, max=1) / ratio.numel()
    sure = deviation.square().mean(-1).sqrt() < DETERMINED
    off = error.square().mean(-1).sqrt()[sure]
    return {"within_68": float((ratio.abs() <= 1).float().mean()),
            "within_95": float((ratio.abs() <= 1.96).float().mean()),
            "ranks": ranks.tolist(), "rmse": float(error.square().mean().sqrt()),
            "median_sd": float(deviation.median()), "determined": float(sure.float().mean()),
            "right": float((off < 1.96 * DETERMINED).float().mean()) if len(off) else None}


def measure(record: dict) -> dict:
    """Fit noisy 8-bit photos of made materials, and count."""
    from mitsvbrdf import HierarchicalConfig, fit_svbrdf, make_material, make_renderer
    from mitsvbrdf.bench.tasks import find_tasks

    fits, renderer, camera = [], make_renderer("mitsuba"), make_renderer("analytic")
    clean = find_tasks(["inlay"], ["none"], None, SIDE, (), "builtin:grid", camera)[0].photos
    for material, noise, seed in ((m, n, s) for m in MATERIALS for n in NOISES for s in SEEDS):
        truth, draw = make_material(material, SIDE, seed), torch.Generator().manual_seed(seed)
        light = camera.render(truth, clean.views)
        light = light + noise * torch.randn(light.shape, generator=draw)
        shots = replace(clean, photos=(255 * light.clamp(0, 1) ** (1 / 2.2)).round() / 255)
        result, maps = fit_svbrdf(shots, renderer, HierarchicalConfig()), {}
        for name, deviation in result.deviations.items():
            found, true = (in_numbers(name, m.resized(len(deviation))[name])[..., :deviation.shape[-1]]
                           for m in (result.svbrdf, truth))
            maps[name] = counted(found - true, deviation)
        fits.append({"material": material, "noise": noise, "seed": seed, "maps": maps})
        print(material, noise, seed, flush=True)
    return {**record, "fits": fits}


if __name__ == "__main__":
    content = json.loads((HERE / "coverage.json").read_text())
    if sys.argv[1:] == ["measure"]:
        content = measure(content)
        (HERE / "coverage.json").write_text(json.dumps(content))
    (HERE / "coverage.md").write_text(page(content))
    (HERE / "coverage.svg").write_bytes(svg(figure(content)))
