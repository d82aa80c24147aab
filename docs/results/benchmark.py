"""Error against run time, of methods and renderers.

``python docs/results/benchmark.py`` makes benchmark.md and benchmark.svg from benchmark.json; with
``measure`` behind it the fits are measured first (three hours; MITSVBRDF_DATA names the photos; a run that
stopped continues), with ``sizes`` seconds and memory from 64 to 4096 px (half an hour), with ``renderers``
those of the renderers (minutes).
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import torch
from matplotlib.figure import Figure

from mitsvbrdf import SVBRDF, Views, evaluate_capture, make_renderer, write_capture
from mitsvbrdf.bench.plot import plot, svg
from mitsvbrdf.bench.run import append, method_table, read_records, run
from mitsvbrdf.bench.table import as_markdown, judged, note, summary, table
from mitsvbrdf.bench.tasks import data_folder, find_tasks, known_material

HERE = Path(__file__).parent
BUDGETS, LONGEST, SEEDS = [3, 10, 30], 100, (0, 1, 2)
MAPS = ["diffuse", "specular", "roughness", "normal", "mean"]
PEERS = "peers-baseline"
STEPS = 1000  # of the peers' baseline
SIDES = [64, 128, 256, 512, 1024, 2048, 4096]
CASES = [(9, 64), (9, 128), (9, 256), (9, 512), (9, 1024), (1, 2048), (64, 256)]  # views, and their pixels


def of_one(records: list, kind: str, held_out: list) -> list:
    """The records of a kind of task, those of captures with these photos held out."""
    return [r for r in records if r["kind"] == kind and r.get("held_out", []) == held_out]


def published_means(group, published: list) -> dict[str, float]:
    """Whose -> mean of the published errors, of those that have one for each task of a group."""
    names, kind = {r["name"] for r in group.records}, group.records[0]["kind"]
    found: dict[str, dict[str, float]] = {}
    for row in of_one(published, kind, group.records[0].get("held_out", [])):
        if row["name"] in names and group.error in row["errors"]:
            found.setdefault(f"{row['method']}, published", {})[row["name"]] = row["errors"][group.error]
    return {who: statistics.fmean(each.values()) for who, each in found.items() if set(each) == names}


def markdown(group, published: list) -> str:
    """The table of a group with published errors below, and a note."""
    cells = table(group)
    for who, error in published_means(group, published).items():
        cells.loc[who] = f"{error:.4f}"
    return f"## {group.title}\n\n{as_markdown(cells)}\n\n{note(group)}\n"


def each_capture(records: list, published: list, error: str) -> pd.DataFrame:
    """The error of every capture by the default in 100 s from seed 0, beside what was published."""
    rows = {r["name"]: {"`hierarchical`": r["errors"][error]} for r in records
            if r["method"] == "hierarchical" and r["budget"] == LONGEST and r["seed"] == 0}
    for p in of_one(published, "capture", records[0]["held_out"]):
        if p["name"] in rows and error in p["errors"] and p["method"] in ("Gao 2019", "MaterialGAN"):
            rows[p["name"]][f"{p['method']}, published"] = p["errors"][error]
    cells = pd.DataFrame.from_dict(rows, orient="index")
    cells.loc["median"], cells.loc["mean"] = cells.median(), cells[:len(rows)].mean()
    return cells


def each_material(records: list) -> pd.DataFrame:
    """RMSE of each map of every known material by the default at the longest budget."""
    cells = pd.DataFrame.from_dict({r["name"]: {name: r["errors"][name] for name in MAPS}
                                    for r in records if r["method"] == "hierarchical"
                                    and r["budget"] == LONGEST}, orient="index")
    cells.loc["mean"] = cells.mean()
    return cells


def seconds(group) -> pd.DataFrame:
    """Seconds on the wall / of the loop."""
    found = summary(group.records, group.error)
    cells = found.apply(lambda row: f"{row['wall']:.3g} / {row['seconds']:.3g}", axis=1).unstack("budget")
    cells = cells.loc[list(dict.fromkeys(found.index.get_level_values("method")))]
    return cells.fillna("not run").rename(index="`{}`".format, columns="{:g} s".format)


def renderers(cases: list) -> pd.DataFrame:
    """Seconds forward and backward, and error of image / gradient, of every renderer."""
    rows: dict[str, dict[str, str]] = {}
    for r in cases:
        views = f"{r['views']} view{'s' if r['views'] > 1 else ''}"
        rows.setdefault(f"{r['bsdf']}, {views} of {r['side']} px", {})[f"`{r['renderer']}`"] = (
            f"{r['seconds']:.3g} s; {r['image']:.1e} / {r['gradient']:.1e}")
    return pd.DataFrame.from_dict(rows, orient="index")


def size_table(sizes: list) -> pd.DataFrame:
    """Seconds and memory of whole commands by texels a side."""
    rows = {f"{r['side']} px": [f"{r['loop']:.0f}", f"{r['fit']['seconds']:.0f}", f"{r['fit']['GiB']:.2f}",
                                f"{r['photos']:.4f}", r["stopped"]] for r in sizes}
    return pd.DataFrame.from_dict(rows, orient="index", columns=[
        "loop, s", "`fit`, s", "`fit`, GiB", "RMSE of the photos", "ended"])


def groups(records: list) -> list:
    """Eight captures by held-out and by seen photos, then all captures by theirs."""
    return [group for without in ([7, 8], [4, 7]) for group in judged(of_one(records, "capture", without))]


def beaten(cells: pd.DataFrame) -> str:
    """On how many captures the first column is the lowest; the last two rows are not of captures."""
    return f"{(cells[:-2].idxmin(axis=1) == cells.columns[0]).sum()} of {len(cells) - 2}"


def page(record: dict) -> str:
    """The text of benchmark.md."""
    records, published = record["records"], record["published"]
    held, seen, all_held, all_seen = groups(records)
    by_capture = each_capture(held.records, published, "held_out")
    materials = each_material(of_one(records, "material", []))
    whole = [r for r in records if r["method"] == "hierarchical" and r["budget"] == LONGEST]
    took = {kind: [r["seconds"] for r in whole if r["kind"] == kind and r["stopped"] != "budget"]
            for kind in ("capture", "material")}
    ratios = [r["errors"]["held_out"] / r["errors"]["seen"] for r in all_held.records
              if r["method"] == "hierarchical" and r["budget"] == LONGEST]
    settled = sum(r["stopped"] != "budget" for r in whole)
    versions = " and ".join(dict.fromkeys(r["version"] for r in records))
    figures = "{:.4f}".format
    drawn = record["renderers"][0]
    return f"""# Error against run time

Fits at 256 px through `mitsuba` on {record['machine']}, version {versions}. `hierarchical` is the default \
method; `{PEERS}` is the per-texel Adam of svbrdf-diff-renderer. Our fits do not see held-out photos. These \
photos are rendered with the stated views, and with the flash offset of fits that find one. Photos seen are \
rendered with the views that the fit ended with; `{PEERS}` keeps the stated ones. *Published* rows are \
errors of published predictions. Budgets and seconds count the loop alone.

![Error against seconds](benchmark.svg)

{markdown(held, published)}
In the row *which saw them*, MaterialGAN was fitted to all nine photos, so nothing is held out from it. \
`gan` begins at the maps of the default. It changes a map only if that predicts held-out patches of the \
photos seen better. `direct` and the baseline draw no random numbers; `hybrid` has one seed. *Not run*: for \
lack of machine time, as 300 s with every method.

## Each capture, held-out photos 7 and 8

{as_markdown(by_capture.map(figures))}

The default's errors are those of {LONGEST} s and seed 0. It has the lowest error on {beaten(by_capture)} \
captures. With this budget and all seeds, its fits of captures settled after {min(took["capture"]):.0f} to \
{max(took["capture"]):.0f} s, those of known materials after {min(took["material"]):.0f} to \
{max(took["material"]):.0f} s: {settled} of {len(whole)}. A last round may exceed the budget.

{markdown(seen, published)}
{markdown(all_held, published)}
The default's error of held-out photos over that of photos seen is {min(ratios):.1f} to {max(ratios):.1f} by \
capture, median {statistics.median(ratios):.1f} ({LONGEST} s).

{markdown(all_seen, published)}
## Each known material

{as_markdown(materials.map(figures))}

RMSE of the default's maps encoded to 0 to 1 ({LONGEST} s), from nine exact 8-bit photos in the views of \
cards-blue. `brick-uneven-stones` and `10_brick_uneven_stones` are the same maps.

## Seconds on the wall / of the loop, captures without photos 7 and 8

{as_markdown(seconds(held))}

Columns are budgets. The wall time adds the guessed diffuse map before the loop and the uncertainty of the \
maps after it. The process is warm.

## Seconds and memory by size

{as_markdown(size_table(record["sizes"]))}

![Seconds and memory against texels](benchmark-size.svg)

Whole commands, one after the other, on nine exact 8-bit photos of made inlaid wood (two cores; \
version {record["sizes"][0]["version"]}). The loop ends by itself (*settled*), or with the step that runs \
when the *budget* is over: 120 s (2048 px: 240 s, 4096 px: 480 s).

## Renderers

Seconds forward and backward; mean relative error of the image / relative L2 of the worst gradient, against \
float64.

{as_markdown(renderers(record["renderers"]))}

Made inlaid wood, flash 0.1 patch sides beside the lens; two cores of an {drawn["machine"]["cpu"]}, \
version {drawn["version"]}. Errors are of texels of roughness 0.1 and more. The renderers took turns. \
`mitsuba` draws texel centres and is the fastest at every size.
"""


def figure(record: dict):
    """Curves of the eight captures, held-out photos and photos seen; a line for every published error."""
    drawn = plot(found := groups(record["records"])[:2])
    for axes, group in zip(drawn.axes, found, strict=True):
        for look, (who, error) in zip(("--", ":", "-."), published_means(group, record["published"]).items()):
            axes.axhline(error, color="0.4", linewidth=1, linestyle=look, label=who)
        axes.legend(fontsize=7)
    return drawn


def size_figure(sizes: list) -> Figure:
    """Seconds, both axes in powers, and peak memory of ``fit`` against texels a side."""
    drawing = Figure(figsize=(7, 2.8), layout="constrained")
    time_axes, memory_axes = drawing.subplots(1, 2)
    sides = [r["side"] for r in sizes]
    time_axes.loglog(sides, [r["fit"]["seconds"] for r in sizes], "o-", label="command")
    time_axes.loglog(sides, [r["loop"] for r in sizes], "x-", label="loop")
    time_axes.set_yticks(ticks := [10, 30, 100, 300, 1000], ticks)
    time_axes.legend(fontsize=8)
    memory_axes.semilogx(sides, [r["fit"]["GiB"] for r in sizes], "o-")
    memory_axes.set_ylim(0)
    for axes, label in ((time_axes, "seconds"), (memory_axes, "peak memory, GiB")):
        axes.set_xticks(sides, sides, rotation=45)
        axes.minorticks_off()
        axes.set(xlabel="texels a side", ylabel=label)
    return drawing


def peers_baseline(photos, renderer, budgets: list) -> list[tuple[float, int, SVBRDF]]:
    """Every texel by Adam alone from a constant material: seconds, steps and maps after each budget.

    As svbrdf-diff-renderer does (Guo 2023, ``optim_perpixel`` from "const"): gamma-encoded maps between -1
    and 1, normals by x and y, renderings cut to [0, 1] before they are encoded, neither prior nor falling
    step size. Ours are the renderer, and values outside their range are put back (theirs become NaN).
    """
    side, begun, found = photos.resolution, time.perf_counter(), []
    start = {"diffuse": (3, 0.0), "specular": (3, -0.92), "roughness": (1, -0.6), "across": (2, 0.0)}
    maps = {name: torch.full((side, side, channels), value, requires_grad=True)
            for name, (channels, value) in start.items()}
    optimizer = torch.optim.Adam(list(maps.values()), lr=0.01)

    def material() -> SVBRDF:
        linear = {name: ((maps[name] + 1) / 2).clamp_min(0.17 if name == "roughness" else 0) ** 2.2
                  for name in ("diffuse", "specular", "roughness")}
        up = (1 - maps["across"].square().sum(-1, keepdim=True)).clamp_min(1e-6).sqrt()
        normal = torch.nn.functional.normalize(torch.cat((maps["across"], up), dim=-1), dim=-1)
        return SVBRDF("roughconductor", linear | {"normal": normal})

    for step in range(1, STEPS + 1):
        images = renderer.render(material(), photos.views).clamp(1e-6, 1)
        shown = (torch.where(images > 0.0031308, 1.055 * images ** (1 / 2.4) - 0.055, 12.92 * images)
                 if photos.transfer == "srgb" else images ** (1 / 2.2))
        optimizer.zero_grad()
        (shown - photos.photos).square().mean().backward()
        optimizer.step()
        took = time.perf_counter() - begun
        with torch.no_grad():
            for values in maps.values():
                values.clamp_(-1, 1)
            while len(found) < len(budgets) and (took >= budgets[len(found)] or step == STEPS):
                found.append((took, step, material().map(torch.clone)))
        if len(found) == len(budgets):
            break
    return found


def measured_peers(tasks: list, records: list, renderer, lines: Path) -> list:
    """Records of the peers' baseline, one run a task; those that the file of lines has are not run again."""
    budgets = [*BUDGETS, LONGEST]
    for task in tasks:
        like = next(r for r in records if all(r.get(key) == value for key, value in task.key.items()))
        there = [r for r in read_records(lines) if r["method"] == PEERS]
        if any(r["name"] == task.name for r in there):
            continue
        print(PEERS, task.name, flush=True)
        for budget, (took, steps, maps) in zip(budgets, peers_baseline(task.photos, renderer, budgets)):
            errors = task.errors(maps, lambda photos, maps=maps: evaluate_capture(
                maps, photos, renderer)["rerender_rmse"])
            append(lines, {**like, "method": PEERS, "config": {"class": PEERS}, "budget": float(budget),
                           "seconds": took, "wall": took, "iterations": steps, "errors": errors,
                           "stopped": "iterations" if steps == STEPS else "budget"})
    return [r for r in read_records(lines) if r["method"] == PEERS]


def measure(lines: Path) -> list:
    """Records of all fits, the default first; each is kept in a file of lines as soon as it is there."""
    data, renderer, table = data_folder(), make_renderer("mitsuba"), method_table()
    published = json.loads(lines.with_suffix(".json").read_text())["published"]
    names = sorted({p["name"] for p in published if p["method"] == "Gao 2019" and p["kind"] == "capture"})
    eight = find_tasks(["none"], names, data, 256, (7, 8), None, renderer)
    all_captures = find_tasks(["none"], None, data, 256, (4, 7), None, renderer)
    known = find_tasks(None, ["none"], data, 256, (), None, renderer)
    known += [replace(known_material(str(folder / "strip.png"), 256, known[0].photos.views, renderer,
                                     "cards-blue"), name=folder.name)
              for folder in sorted((data / "one-photo/known").iterdir())]

    def fitted(methods: list, tasks: list, budgets: list, seeds: Sequence[int] = (0,)) -> list:
        return run({name: table[name] for name in methods}, tasks, budgets, seeds, renderer, lines,
                   lambda text, share: print(f"{share:4.0%} {text}", flush=True))

    captures, longer = [*eight, *all_captures], [*BUDGETS, LONGEST]
    records = fitted(["hierarchical"], captures, longer) + fitted(["hierarchical"], known, [LONGEST])
    records += fitted(["direct", "hybrid", "gan"], eight, longer)
    records += fitted(["direct", "hybrid", "gan"], all_captures, BUDGETS[1:])
    records += fitted(["hierarchical"], eight, longer[1:], SEEDS[1:])
    records += fitted(["gan"], eight, BUDGETS[1:], SEEDS[1:])
    return records + measured_peers(eight, records, renderer, lines)


def command(*words: object) -> dict[str, float]:
    """Seconds and peak memory of one run of the program."""
    begun = time.perf_counter()
    child = subprocess.Popen(["mitsvbrdf", *map(str, words)], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"mitsvbrdf {words[0]} failed")
    return {"seconds": time.perf_counter() - begun, "GiB": used.ru_maxrss / 2**20}


def sizes() -> Iterator[dict]:
    """Seconds and memory of whole commands by size."""
    for side in SIDES:
        print(side, flush=True)
        with TemporaryDirectory() as place:
            photos, out = Path(place, "photos"), Path(place, "out")
            synth = command("synth", "builtin:inlay", "--resolution", side, "-o", photos)
            fit = command("fit", photos, "-o", out, "--resolution", side)
            found = json.loads((out / "fit.json").read_text())
        yield {"side": side, "synth": synth, "fit": fit, "loop": found["trace"][-1]["seconds"],
               "photos": found["rerender_rmse"], "stopped": found["stopped"],
               "version": found["versions"]["mitsvbrdf"]}


def renderer_cases() -> Iterator[dict]:
    """Errors and seconds of the renderers, by ``crosscheck``, through views on a square grid."""
    renderer = make_renderer("mitsuba")
    for count, side in CASES:
        print(count, "views,", side, "px", flush=True)
        rows = [0.6 * (2 * k + 1 - count**0.5) / count**0.5 for k in range(round(count**0.5))]
        cameras = [[x, y, 2.0] for y in rows for x in rows]
        views = Views.of(cameras, [[x + 0.1, y, z] for x, y, z in cameras], 12.0)
        with TemporaryDirectory() as place:
            task = known_material("builtin:inlay", 16, views, renderer, "grid")
            write_capture(task.photos, Path(place, "views"))
            file = Path(place, "found.json")
            command("crosscheck", "builtin:inlay", "--views", Path(place, "views"), "--resolution", side,
                    "--repeats", 3, "--json", file)
            found = json.loads(file.read_text())
        for case in found["configurations"]:
            texels = case["rough"]
            yield {"views": count, "side": side, "bsdf": case["bsdf"], "renderer": case["renderer"],
                   "seconds": sum(case["seconds"][way]["median"] for way in ("forward", "backward")),
                   "image": texels["image"]["mean"],
                   "gradient": max(each["relative_l2"] for each in texels["gradients"].values()),
                   "machine": found["machine"], "version": found["versions"]["mitsvbrdf"]}


if __name__ == "__main__":
    file = HERE / "benchmark.json"
    content = json.loads(file.read_text())
    if sys.argv[1:] == ["measure"]:
        content["records"] = measure(file.with_suffix(".jsonl"))
        file.write_text(json.dumps(content))
    elif sys.argv[1:] == ["sizes"]:
        content["sizes"] = []
        for found in sizes():
            content["sizes"].append(found)
            file.write_text(json.dumps(content))
    elif sys.argv[1:] == ["renderers"]:
        content["renderers"] = list(renderer_cases())
        file.write_text(json.dumps(content))
    (HERE / "benchmark.md").write_text(page(content))
    (HERE / "benchmark.svg").write_bytes(svg(figure(content)))
    (HERE / "benchmark-size.svg").write_bytes(svg(size_figure(content["sizes"])))
