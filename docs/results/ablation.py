"""What each ingredient of the default method is worth, and what plausible detail adds.

``python docs/results/ablation.py`` makes ablation.md and ablation.svg from ablation.json; with ``measure``
behind it the fits without each ingredient are measured first (hours; MITSVBRDF_DATA names the photos; a run
that stopped continues).
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown, summary

HERE = Path(__file__).parent
ERRORS = {"mean": ("material", "maps"), "novel_light": ("material", "new light"),
          "held_out": ("capture", "held-out photos"), "seen": ("capture", "photos seen")}
PATCHES, RMSE = 0.8, 1.1  # of the maps' errors: the bar of detail

# An ingredient that is off -> the settings of HierarchicalConfig that take it away.
VARIANTS = {
    "one basis material": {"materials": 1},
    "no neighbours as starts": {"neighbours": False},
    "sharing not enforced": {"spread": 10.0},
    "relief 5 times as deep": {"relief": 0.1},
    "detail believed alike in all photos": {"noise": 0.03},
    "no freedom at full size": {"detail_spread": 0.0},
    "all pixels alike at 64 px": {"highlight_reach": 0.0},
    "burn-in not taken out": {"remove_burn_in": False},
    "no flash offset": {"flash_offset": False},
    "views as calibrated": {"calibrate": False},
}


def pairs(records: list, error: str) -> pd.DataFrame:
    """Error less that of the full method, of each material or capture: a column for each variant."""
    rows = pd.DataFrame([{"method": r["method"], "name": r["name"], "error": r["errors"].get(error)}
                         for r in records])
    found = rows.dropna().pivot(index="name", columns="method", values="error")
    found = found[list(dict.fromkeys(r["method"] for r in records))]
    return found.drop(columns="full").sub(found["full"], axis=0)


def table(records: list) -> pd.DataFrame:
    """Mean error, and the median difference to the full method with its quartiles."""
    columns = {}
    for error, (kind, title) in ERRORS.items():
        here = [r for r in records if r["kind"] == kind]
        means = summary(here, error)["median"].droplevel("budget")
        quarters = pairs(here, error).quantile([0.5, 0.25, 0.75])
        columns[title] = {m: f"{mean:.4f}" if m == "full" else f"{mean:.4f}, {quarters[m][0.5]:+.4f} "
                          f"({quarters[m][0.25]:+.4f} to {quarters[m][0.75]:+.4f})" for m,
                          mean in means.items()}
    return pd.DataFrame(columns)


def detail(rows: list) -> pd.DataFrame:
    """Figures of held-out photos: of the maps, and with detail."""
    found = {}
    for row in rows:
        maps, look = row["maps"], row["look"]
        ratios = {error: look[error] / maps[error] for error in ("patches", "rmse", "flip")}
        met = ratios["patches"] <= PATCHES and ratios["rmse"] <= RMSE
        at = "" if row["detail_at"] == 128 else f", {row['detail_at']} px"
        found[row["name"] + at] = [
            f"{row['highlights']:.0%}",
            f"{maps['patches']:.4f} → {look['patches']:.4f} ({ratios['patches']:.2f})",
            f"{maps['rmse']:.4f} → {look['rmse']:.4f} ({ratios['rmse']:.2f})",
            f"{maps['flip']:.3f} → {look['flip']:.3f}", "met" if met else "missed"]
    return pd.DataFrame.from_dict(found, orient="index",
                                  columns=["highlights", "patches", "RMSE", "FLIP", "bar"])


def page(record: dict) -> str:
    """The text of ablation.md."""
    added = detail(record["detail"])
    small = [name for name in added.index if "px" not in name]
    return f"""# Each ingredient of the default method

{as_markdown(table(record["records"]))}

RMSE at 128 px with a budget of 60 s, seed 0, version {record["versions"]["mitsvbrdf"]}: mean of 6 known \
materials and of 18 captures without photos 4 and 7. The second number is the median difference to `full`, \
with quartiles in brackets; above 0 the ingredient helps. On known materials only the \
neighbours' answers as starts help.

![Difference on held-out photos](ablation.svg)

## Plausible detail

{as_markdown(added)}

Held-out photos 4 and 7: error of the maps → with detail (ratio). *Patches* is the sliced Wasserstein \
distance of 7 x 7 patches inside highlights, *highlights* the share of these pixels. \
{(added["bar"][small] == "met").sum()} of {len(small)} captures at 128 px meet the bar (patches at most \
{PATCHES} and RMSE at most {RMSE} times those of the maps), so detail stays optional.
"""


def figure(record: dict) -> Figure:
    """A box for each variant: differences on held-out photos."""
    found = pairs([r for r in record["records"] if r["kind"] == "capture"], "held_out")
    drawing = Figure(figsize=(7, 3.6), layout="constrained")
    axes = drawing.subplots()
    axes.boxplot([found[name] for name in found], orientation="horizontal", tick_labels=list(found))
    axes.axvline(0, color="0.6", linewidth=1)
    axes.invert_yaxis()
    axes.set_xlabel("RMSE of held-out photos, less that of the full method")
    return drawing


def measure(file: Path) -> dict:
    """Fit with and without each ingredient; detail stays as it was measured."""
    from mitsvbrdf import HierarchicalConfig, make_renderer
    from mitsvbrdf.bench.run import run
    from mitsvbrdf.bench.tasks import data_folder, find_tasks

    renderer, full = make_renderer("mitsuba"), HierarchicalConfig()
    methods = {"full": full, **{name: replace(full, **changes) for name, changes in VARIANTS.items()}}
    tasks = find_tasks(None, None, data_folder(), 128, (4, 7), None, renderer)
    records = run(methods, tasks, [60], [0], renderer, file.with_suffix(".jsonl"),
                  lambda text, share: print(f"{share:4.0%} {text}", flush=True))
    return {**json.loads(file.read_text()), "records": records}


if __name__ == "__main__":
    file = HERE / "ablation.json"
    if sys.argv[1:] == ["measure"]:
        file.write_text(json.dumps(measure(file)))
    content = json.loads(file.read_text())
    (HERE / "ablation.md").write_text(page(content))
    (HERE / "ablation.svg").write_bytes(svg(figure(content)))
