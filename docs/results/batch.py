"""A batch against a loop of the shell, and a batch in which everything dies.

``python docs/results/batch.py`` makes batch.md and batch.svg from batch.json; with ``measure`` behind it
both ways to fit the captures of MITSVBRDF_DATA are timed first (20 minutes). ``chaos`` in batch.json is what
``python tests/batch/chaos.py`` prints.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

import mitsvbrdf
from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
LOOP = "a loop of the shell"
WAYS = {"a batch of two workers": ["--workers", "2", "--threads", "1"], LOOP: None}
TURNS = 3
COUNTED = ("folders", "identities", "torn", "attempts")


def ways(rows: list) -> pd.DataFrame:
    """Captures an hour of each way, over those of the loop in each turn, and error."""
    found = pd.DataFrame(rows)
    hours = found.pivot(index="way", columns="turn", values="seconds")
    ratios = hours.loc[LOOP] / hours
    totals = found.groupby("way", sort=False).agg(captures=("captures", "sum"), seconds=("seconds", "sum"),
                                                  error=("error", "mean"))
    cells = {way: [f"{3600 * row['captures'] / row['seconds']:.0f}",
                   f"{ratios.loc[way].median():.2f} ({', '.join(f'{x:.2f}' for x in ratios.loc[way])})",
                   f"{row['error']:.4f}"] for way, row in totals.iterrows()}
    return pd.DataFrame.from_dict(cells, orient="index", columns=[
        "captures an hour", "of the loop's (each turn)", "mean RMSE"])


def deaths(chaos: dict) -> pd.DataFrame:
    """What is counted of the library."""
    runs = {"disturbed": chaos["disturbed"], "undisturbed": chaos["undisturbed"]}
    rows = {name: [f"{run[name]:,}" for run in runs.values()] for name in COUNTED}
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(runs))


def page(record: dict) -> str:
    """The text of batch.md."""
    chaos = record["chaos"]
    killed = chaos["disturbed"]["killed"]
    return f"""# Batches

## Against a loop of the shell

{as_markdown(ways(record["ways"]["rows"]))}

Each way fits {record["ways"]["rows"][0]["captures"]} captures by the default method at \
{record["ways"]["resolution"]} px on two hardware threads (version {record["ways"]["version"]}), in turns. \
Pages and start-up count. The second column is the speed over that of the loop: the median, and each turn. \
RMSE is that of the re-rendered photos.

![Captures an hour](batch.svg)

## A batch in which everything dies

{as_markdown(deaths(chaos))}

{chaos["captures"]:,} made captures of {chaos["side"]} px, two workers. SIGKILL ended {killed["worker"]} \
workers and, {killed["command"]} times, the command; each time the same command was started again. *Folders* \
are results, *identities* different ones, *torn* those with a missing, damaged or foreign file, *attempts* \
the fits begun. {len(chaos["undisturbed"]["different maps"])} of {chaos["undisturbed"]["maps"]:,} maps \
differ from those of the undisturbed library.
"""


def figure(record: dict) -> Figure:
    """Captures an hour of each way and turn."""
    drawing = Figure(figsize=(6, 1.9), layout="constrained")
    axes = drawing.subplots()
    names = list(WAYS)
    for r in record["ways"]["rows"]:
        axes.plot(r["per_hour"], names.index(r["way"]), "o", color="C0")
    axes.set(yticks=range(len(names)), yticklabels=names, xlim=(0, None), ylim=(-0.5, len(names) - 0.5),
             xlabel="captures an hour, each turn")
    return drawing


def timed(way: str, captures: list, resolution: int) -> dict:
    """Fit captures in one way."""
    ours = [sys.executable, "-m", "mitsvbrdf"]
    with tempfile.TemporaryDirectory() as folder:
        commands = [[*ours, "fit", c, "-o", f"{folder}/{n}", "--resolution", str(resolution)] for n,
                    c in enumerate(captures)]
        if WAYS[way]:
            commands = [[*ours, "batch", *captures, "-o", f"{folder}/library", "--resolution",
                         str(resolution), *WAYS[way]]]
        began = time.monotonic()
        for command in commands:
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        seconds = time.monotonic() - began
        errors = [json.loads(path.read_text())["rerender_rmse"] for path in Path(folder).rglob("fit.json")]
    return {"way": way, "captures": len(captures), "seconds": round(seconds, 1),
            "per_hour": 3600 * len(captures) / seconds, "error": sum(errors) / len(errors)}


def measure(record: dict) -> dict:
    """Time both ways in turns."""
    captures = sorted(map(str, (Path(os.environ["MITSVBRDF_DATA"]) / "captures").iterdir()))
    rows, names = [], list(WAYS)
    for turn in range(TURNS):
        for way in names[::-1] if turn % 2 else names:
            rows.append(timed(way, captures, record["ways"]["resolution"]) | {"turn": turn})
            print(rows[-1], flush=True)
    return {**record, "ways": {**record["ways"], "version": mitsvbrdf.__version__, "rows": rows}}


if __name__ == "__main__":
    content = json.loads((HERE / "batch.json").read_text())
    if sys.argv[1:] == ["measure"]:
        content = measure(content)
        (HERE / "batch.json").write_text(json.dumps(content))
    (HERE / "batch.md").write_text(page(content))
    (HERE / "batch.svg").write_bytes(svg(figure(content)))
