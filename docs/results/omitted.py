"""What a render or a fit does not need, and what omitting it saves.

``python docs/results/omitted.py`` makes omitted.md and omitted.svg from omitted.json; with ``measure``
behind it the pairs of fits that settings make are timed first (half an hour; MITSVBRDF_DATA names
cards-blue). Parts that no setting takes away, and renders, stay as they were measured.
"""

import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
SHOWN = {"mean": "maps", "novel_light": "new light", "left_out": "held out", "photos": "seen", "seen": "seen"}
UNSEEN = ("maps", "new light", "held out")  # the errors that decide
FLOOR = 0.001  # errors below count as this
SAVES, COSTS = 1.05, 1.02  # ratios from which seconds count as saved, and errors as a cost
# names of parts in the record, as pages have them
NOW = {"rival starts": "many starts", "photos left out in turn": "cross-validation",
       "adversarial finish": "plausible detail"}

# A part of a fit -> method, settings that take it away, scenes.
SETTINGS = {
    "rival starts": ("hierarchical", {"multi_start": False}, ("inlay",)),
    "view refinement": ("hierarchical", {"calibrate": False}, ("cards-blue",)),
    "flash offset": ("hierarchical", {"flash_offset": False}, ("cards-blue",)),
    "other starts of texels": ("hierarchical", {"neighbours": False}, ("inlay", "cards-blue")),
    "look-alikes": ("hierarchical", {"materials": 1}, ("inlay", "cards-blue")),
    "discriminator": ("hybrid", {"adversarial": 0.0}, ("inlay", "cards-blue")),
    "photometric loss": ("hybrid", {"photometric": 0.0}, ("inlay", "cards-blue")),
    "feature matching": ("gan", {"features": 0.0}, ("inlay", "cards-blue")),
}


def renders(records: list) -> pd.DataFrame:
    """Seconds and difference of images with and without what is omitted."""
    rows = {}
    for r in records:
        full, lean = (r["seconds"][side]["median"] for side in ("full", "lean"))
        if full / lean >= SAVES:
            rows[f"{NOW.get(r['name'], r['name'])} ({r['where']})"] = [
                r["why"], f"{r['worst']:.2g}", f"{1e3 * full:.3g}", f"{1e3 * lean:.3g}", f"{full / lean:.2f}"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=[
        "when", "largest difference", "with, ms", "without, ms", "ratio"])


def fits(records: list) -> pd.DataFrame:
    """Seconds with over without, errors without over with, and verdict, of each part and kind of photos."""
    rows = {}
    first = {part: n for n, part in enumerate(dict.fromkeys((r["of"], r["part"]) for r in records))}
    for r in sorted(records, key=lambda r: (r["of"] != "hierarchical", first[r["of"], r["part"]])):
        pairs = sorted(a / b for a, b in zip(r["seconds"]["with"], r["seconds"]["without"]))
        low, ratio, high = statistics.quantiles(pairs, n=4, method="inclusive")
        errors = {shown: max(r["errors"]["without"][name], FLOOR) / max(r["errors"]["with"][name], FLOOR)
                  for name, shown in SHOWN.items() if name in r["errors"]["with"]
                  and (r["kind"], shown) != ("exact, matte",
                                             "maps")}  # roughness of a black lobe shows nowhere
        worst = max((errors[name] for name in UNSEEN if name in errors), default=1.0)
        verdict = "needed" if worst > COSTS else "not needed" if ratio >= SAVES else "no time saved"
        itself = " (by itself)" if r["put_in"] else ""
        rows[f"{NOW.get(r['part'], r['part'])}, `{r['of']}`: {r['kind']}{itself}"] = [
            f"{ratio:.2f} ({low:.2f} to {high:.2f})",
            *(f"{errors[name]:.3f}" if name in errors else "–" for name in (*UNSEEN, "seen")), verdict]
    return pd.DataFrame.from_dict(rows, orient="index",
                                  columns=["seconds, with / without", *UNSEEN, "seen", "verdict"])


def suite(record: dict, name: str) -> list:
    """The records of one kind."""
    return [r for r in record["records"] if r["suite"] == name]


def page(record: dict) -> str:
    """The text of omitted.md."""
    return f"""# What is omitted, and what that saves

## Of a fit

{as_markdown(fits(suite(record, "leave-out")))}

Fits at 64 px, version {record["versions"]["mitsvbrdf"]}, three turns of each pair. Seconds are those with \
the part over those without it, errors those \
without it over those with it. *By itself*: \
the program omits the part for such photos (`fit --explain`). *Needed*: an error of maps, under new \
light or of held-out photos grows by more than {COSTS - 1:.0%}; *not needed*: none does and at least \
{SAVES - 1:.0%} of the seconds are saved.

![Seconds against errors](omitted.svg)

## Of a render

{as_markdown(renders(suite(record, "leave-out-renders")))}

Nine co-located views of 256 px, forward and backward, median of nine turns. Differences are at most \
float32's rounding. The JSON has {len(suite(record, "leave-out-renders"))} items; those that save less than \
5 % are not shown.
"""


def figure(record: dict) -> Figure:
    """What each part saves against what omitting it costs."""
    drawing = Figure(figsize=(6, 3.6), layout="constrained")
    axes = drawing.subplots()
    found = fits(suite(record, "leave-out"))
    for verdict, rows in found.groupby("verdict", sort=False):
        cost = rows[list(UNSEEN)].apply(pd.to_numeric, errors="coerce").max(axis=1)
        axes.plot(rows["seconds, with / without"].str.split().str[0].astype(float), cost, "o", markersize=4,
                  label=verdict)
    axes.axhline(COSTS, color="0.6", linewidth=1)
    axes.axvline(SAVES, color="0.6", linewidth=1)
    axes.set(xscale="log", yscale="log", xlabel="seconds with / without",
             ylabel="largest error without / with")
    axes.legend(fontsize=8)
    return drawing


def measure(record: dict) -> dict:
    """Time the pairs of :data:`SETTINGS`, turn by turn."""
    from mitsvbrdf import make_renderer
    from mitsvbrdf.bench.run import fit, method_table
    from mitsvbrdf.bench.tasks import data_folder, find_tasks

    renderer, table = make_renderer("mitsuba"), method_table()
    tasks = {task.name: task for task in find_tasks(["inlay"], ["cards-blue"], data_folder(), 64, (4, 7),
                                                    "builtin:grid",
                                                    renderer)}
    found = []
    for part, (method, changes, scenes) in SETTINGS.items():
        limits = {"budget": 3600.0} if method == "hierarchical" else {"iterations": 150}
        configs = {"with": replace(table[method], **limits),
                   "without": replace(table[method], **limits, **changes)}
        for scene in scenes:
            task, seconds, errors = tasks[scene], {"with": [], "without": []}, {}
            for turn in range(4):  # the first compiles kernels
                for side, config in configs.items():
                    began = time.perf_counter()
                    result, predict = fit(task.photos, renderer, config, lambda share: None)
                    if turn:
                        seconds[side].append(time.perf_counter() - began)
                    errors[side] = {name.replace("held_out", "left_out"): value
                                    for name, value in task.errors(result.svbrdf, predict).items()}
            found.append({"suite": "leave-out", "part": part, "of": method, "put_in": False, "name": scene,
                          "kind": "real photos" if task.kind == "capture" else "exact", "seconds": seconds,
                          "errors": errors, "says": [part]})
            print(part, scene, flush=True)
    measured = {(r["part"], r["of"], r["name"]) for r in found}
    others = [r for r in record["records"] if (r.get("part"), r.get("of"), r["name"]) not in measured
              or r.get("put_in")]
    return {**record, "records": [*others, *found]}


if __name__ == "__main__":
    content = json.loads((HERE / "omitted.json").read_text())
    if sys.argv[1:] == ["measure"]:
        content = measure(content)
        (HERE / "omitted.json").write_text(json.dumps(content))
    (HERE / "omitted.md").write_text(page(content))
    (HERE / "omitted.svg").write_bytes(svg(figure(content)))
