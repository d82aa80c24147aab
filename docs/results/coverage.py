"""How often the truth lies within the uncertainty that a fit states.

``python docs/results/coverage.py`` makes coverage.md and coverage.svg from coverage.json; with ``measure``
behind it the fits are measured first (an hour). Known materials come from ``one-photo/known`` of the data
folder; without it they are omitted.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd
import torch
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
DETERMINED, METAL = 0.1, 0.2  # deviation of a determined texel, at most; F0 of a metal, at least
NARROW = 0.6
MADE, NOISES, SIDE = ("inlay", "tiles", "leather", "plates"), (0.003, 0, 0.01), 64
LEVELS = ".3", ".02", ".04"  # F0 beside the materials' own
GROUPS = ("all", "dielectric, highlight seen", "dielectric, not seen", "metal, highlight seen",
          "metal, not seen")
MAPS = ("diffuse", "specular", "roughness", "normal")
KINDS = {"own": "own photos", "alike": "with look-alikes"}
STEPS = torch.logspace(-3, -0.5, 13)  # of stated deviations
ERRORS = torch.logspace(-4, 0, 61)  # of true errors


def totals(record: dict) -> pd.DataFrame:
    """Sums over all cases, a row for each group and map."""
    rows = [{"group": group, "map": name, **counts} for case in record["cases"]
            for group, maps in case["groups"].items() for name, counts in maps.items()]
    return pd.DataFrame(rows).groupby(["group", "map"], sort=False).sum()


def share(within_alike: int, values: int, **_: int) -> str:
    """How many true values lie within one deviation; bold where they are few."""
    text = f"{within_alike / values:.0%}"
    return f"**{text}**" if within_alike < NARROW * values else text


def page(record: dict) -> str:
    """The text of coverage.md."""
    found = totals(record)
    for kind in KINDS:
        found[kind] = (found[f"within_{kind}"] / found["values"]).map("{:.0%}".format)
    found["sure"] = [f"{n / all_of:.0%}, {off / max(n, 1):.1%}" for n, all_of, off
                     in zip(found["determined"], found["texels"], found["off"])]
    table = as_markdown(pd.DataFrame({
        f"{group}; {title}": {name: found.loc[(group, name), kind] for name in MAPS}
        for group in GROUPS for kind, title in KINDS.items()}).T)
    sure = as_markdown(pd.DataFrame({group: {name: found.loc[(group, name), "sure"] for name in MAPS}
                                     for group in GROUPS}).T)
    each = pd.DataFrame({f"{case['material']}, F0 {case['f0']}, noise {case['noise']:g}, {case['side']} px": {
        name: share(**case["groups"]["all"][name]) for name in MAPS} for case in record["cases"]}).T
    return f"""# Stated uncertainty

![Stated deviation against true error](coverage.svg)

Horizontal: stated deviation. Vertical: the error that 68 % of the values with this deviation do not exceed. \
On the grey line both are equal. Below it a fit is better than it says; above it, worse.

## True values within one deviation

{table}

The table gives the share of true values within one stated deviation of the fit; 68 % would be right. All \
{len(record["cases"])} fits are of the default method (version {record["versions"]["mitsvbrdf"]}), to nine \
simulated 8-bit photos of made and known materials, with sensor noise of 0, 0.003 and 0.01 (linear). *Own \
photos*: the deviation that a texel's own photos leave. It is too wide where look-alikes gave the answer. \
*With look-alikes*: the deviation that counts them, and so the error to expect. A *metal* has F0 above \
{METAL:g}. A highlight is *seen* where a photo shows a quarter of its peak or more.

## Determined, and of these off by more than three deviations

{sure}

First the share of texels with a deviation below {DETERMINED:g} by their own photos (*determined*, as `fit` \
counts), then the share of these that are off by more than three deviations. On the whole, deviations of \
specular and roughness are too wide, most where no photo shows the highlight: there other texels tell the \
lobe.

## Within one deviation, with look-alikes, by case

Each row is one fit. *F0 own* is the material's; a number replaces it everywhere. Bold: below {NARROW:.0%}. \
There the stated deviation is too narrow, for leather at noise 0.01 with three of four F0. Texels of one \
material share much of their error, so the share of one fit also varies by chance.

{as_markdown(each)}
"""


def figure(record: dict) -> Figure:
    """Stated deviations against the error that 68 % of their texels keep to."""
    drawing = Figure(figsize=(9, 2.7), layout="constrained")
    middle = (STEPS[1:] * STEPS[:-1]).sqrt()
    for axes, name in zip(drawing.subplots(1, len(MAPS), sharex=True, sharey=True), MAPS):
        axes.plot([1e-3, 0.3], [1e-3, 0.3], color="0.6", linewidth=1)
        for kind, title in KINDS.items():
            counts = torch.tensor(record["curves"][name][kind]).double()
            share = counts.cumsum(dim=1) / counts.sum(dim=1, keepdim=True).clamp_min(1)
            at = (share < 0.6827).sum(dim=1)
            many = (counts.sum(dim=1) >= 300).tolist()
            axes.plot([float(x) for x, ok in zip(middle, many) if ok],
                      [float(ERRORS[min(k + 1, len(ERRORS) - 1)]) for k, ok in zip(at.tolist(), many) if ok],
                      "o-", markersize=3, label=title)
        axes.set(xscale="log", yscale="log", title=name)
        axes.title.set_fontsize(9)
    axes.legend(fontsize=7)
    drawing.supxlabel("stated deviation", fontsize=9)
    drawing.supylabel("error of 68 %", fontsize=9)
    return drawing


def in_numbers(name: str, value: torch.Tensor) -> torch.Tensor:
    """A map in the numbers in which its error is counted; of a normal, x and y."""
    if name in ("diffuse", "specular"):
        return value.clamp_min(0) ** (1 / 2.2)
    return (value[..., :2] + 1) / 2 if name == "normal" else value


def shown_lobe(truth, views) -> torch.Tensor:  # noqa: ANN001
    """Whether a photo shows a texel's lobe at a quarter of its peak or more, R x R."""
    side = truth.resolution
    x = (torch.arange(side) + 0.5) / side - 0.5
    place = torch.stack((*torch.meshgrid(x, -x, indexing="xy"), torch.zeros(side, side)), dim=-1)
    half = sum(torch.nn.functional.normalize(to[:, None, None].float() - place, dim=-1)
               for to in (views.camera, views.light))
    cosine = (torch.nn.functional.normalize(half, dim=-1) * truth["normal"]).sum(dim=-1)
    return ((1 - cosine**2) / cosine**2 < truth["roughness"][..., 0] ** 4).any(dim=0)


def counted(truth, found, views, own: dict, alike: dict, curves: dict) -> dict:  # noqa: ANN001
    """Counts of all texels, by group and map; histograms of errors are added to ``curves``."""
    seen, metal = shown_lobe(truth, views), truth["specular"].mean(-1) > METAL
    masks = dict(zip(GROUPS, (torch.ones_like(metal), ~metal & seen, ~metal & ~seen, metal & seen,
                              metal & ~seen)))
    counts: dict = {group: {} for group in GROUPS}
    for name in MAPS:
        error = (in_numbers(name, found[name]) - in_numbers(name, truth[name])).abs()
        spread = own[name].square().mean(-1).sqrt()
        off = error.square().mean(-1).sqrt() > 3 * spread
        for group, mask in masks.items():
            counts[group][name] = {
                "texels": int(mask.sum()), "values": int(mask.sum()) * error.shape[-1],
                "within_own": int((error <= own[name])[mask].sum()),
                "within_alike": int((error <= alike[name])[mask].sum()),
                "determined": int((spread[mask] < DETERMINED).sum()),
                "off": int(((spread < DETERMINED) & off)[mask].sum())}
        for kind, value in (("own", own[name]), ("alike", alike[name])):
            row = torch.bucketize(value, STEPS[1:-1]).flatten() * (len(ERRORS) - 1)
            cell = row + torch.bucketize(error, ERRORS[1:-1]).flatten()
            size = (len(STEPS) - 1) * (len(ERRORS) - 1)
            added = torch.bincount(cell, minlength=size).reshape(len(STEPS) - 1, -1)
            curves[name][kind] = (torch.tensor(curves[name][kind]) + added).tolist()
    return counts


def known(folder: Path, side: int):  # noqa: ANN201
    """A known material from a strip of normal, diffuse, roughness and specular."""
    from matplotlib.image import imread

    from mitsvbrdf import SVBRDF

    strip = torch.tensor(imread(folder / "strip.png"))[..., :3]
    normal, diffuse, roughness, specular = (part.contiguous() for part in strip.split(strip.shape[0], dim=1))
    normal = torch.nn.functional.normalize(normal * 2 - 1, dim=-1)
    normal[..., 2].clamp_(min=0.05)
    return SVBRDF("roughconductor", {
        "diffuse": diffuse, "specular": specular, "roughness": roughness[..., :1].clamp_min(0.06),
        "normal": torch.nn.functional.normalize(normal, dim=-1)}).resized(side)


def cases(data: Path | None) -> Iterator[tuple[str, str, float, int]]:
    """Material, F0, noise and texels a side of each fit."""
    yield "inlay", "own", 0.003, 256
    for noise in NOISES:
        yield from ((name, "own", noise, SIDE) for name in MADE)
    if data:
        strips = sorted((data / "one-photo" / "known").glob("*/strip.png"))
        yield from ((strip.parent.name, "own", 0.003, SIDE) for strip in strips)
    for level in LEVELS:
        yield from ((name, level, noise, SIDE) for noise in NOISES for name in MADE)


def empty() -> dict:
    """Curves with nothing counted."""
    none = torch.zeros(len(STEPS) - 1, len(ERRORS) - 1, dtype=torch.long).tolist()
    return {name: {kind: none for kind in KINDS} for name in MAPS}


def measure(record: dict) -> dict:
    """Fit noisy 8-bit photos of known materials, and count."""
    from mitsvbrdf import SVBRDF, HierarchicalConfig, fit_svbrdf, make_material, make_renderer
    from mitsvbrdf.bench.run import version
    from mitsvbrdf.bench.tasks import data_folder, find_tasks

    data, renderer, curves, found = data_folder(), make_renderer("mitsuba"), empty(), []
    clean = find_tasks(["inlay"], ["none"], None, 8, (), "builtin:grid", renderer)[0].photos
    for number, (material, level, noise, side) in enumerate(cases(data)):
        truth = (known(data / "one-photo" / "known" / material, side) if data and material not in MADE
                 else make_material(material, side))
        if level != "own":
            level_map = torch.full_like(truth["specular"], float(level))
            truth = SVBRDF(truth.bsdf, {**truth.maps, "specular": level_map})
        light = renderer.render(truth, clean.views)
        light = light + noise * torch.randn(light.shape, generator=torch.Generator().manual_seed(number))
        shots = replace(clean, photos=(255 * light.clamp(0, 1) ** (1 / 2.2)).round() / 255)
        fit = fit_svbrdf(shots, renderer, HierarchicalConfig(budget=300))
        groups = counted(truth, fit.svbrdf, fit.views, fit.deviations, fit.deviations_with_look_alikes,
                         curves)
        found.append({"material": material, "f0": level, "noise": noise, "side": side, "groups": groups})
        print(material, level, noise, flush=True)
    return {"schema_version": 2, "cases": found, "curves": curves, "versions": {"mitsvbrdf": version()}}


if __name__ == "__main__":
    content = json.loads((HERE / "coverage.json").read_text())
    if sys.argv[1:] == ["measure"]:
        content = measure(content)
        (HERE / "coverage.json").write_text(json.dumps(content))
    (HERE / "coverage.md").write_text(page(content))
    (HERE / "coverage.svg").write_bytes(svg(figure(content)))
