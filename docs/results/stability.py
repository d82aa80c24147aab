"""Renderers at the ends of every range.

``python docs/results/stability.py`` makes stability.md and stability.svg from stability.json; with
``measure`` behind it `mitsvbrdf stability` is run first (two minutes).
"""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
VERDICTS = {
    "exact": "image within 1e-6 and every gradient within 1e-5",
    "clamped": "exact, and one of the clamps below acts",
    "degraded": "worse, but within what one float32 rounding of the normals makes",
    "limited": "beyond that, for a known cause and within a stated bound",
    "refused": "invalid: one error message that says what was expected",
}
CLAMPS = {
    "alpha >= 0.0001": "`roughconductor`: without an end float32 overflows at roughness 1e-10. Below "
                       "roughness 0.01 the image stays as it is there, and the gradient of roughness is 0.",
    "alpha >= 0.001": "`principled`: the plugin's own end. Below roughness 0.0316 only the diffuse lobe "
                      "answers to roughness.",
    "index for F0 in [1e-06, 0.999]": "Away from the camera F follows a refractive index, infinite at F0 = "
                                      "1. "
                                      "Beyond these ends F is proportional to F0, and keeps a slope.",
    "toe of gamma 2.2": "The power curve is vertical at 0. Below 2e-06 it is its chord.",
    "burnt-out photos": "A photo value from 0.995 on says at least this bright: gradient 0 where the "
                        "rendering is brighter.",
}


def number(value: float | None) -> str:
    """A figure in few characters; ∞ where there is none."""
    if value is None:
        return "∞"
    return f"{value:.1e}" if value and not 0.001 <= abs(value) < 100 else f"{value:.3g}"


def worst(errors: dict) -> tuple:
    """Error of the image, and of the worst map's gradient."""
    gradients = [value for name, value in errors.items() if name != "image"]
    return errors["image"], None if None in gradients else max(gradients)


def pair(errors: dict) -> str:
    """Both as text."""
    return " / ".join(map(number, worst(errors))) if errors else "–"


def condition(row: dict) -> str:
    """Median condition number, or the rank where unknowns cannot be told apart."""
    found = row["condition"]
    if found is None:
        return "–"
    if found["median"] is None:
        return f"rank {found['rank']} of {found['unknowns']}"
    return number(found["median"])


def overview(record: dict) -> pd.DataFrame:
    """Verdicts of each sweep, and its largest errors, for each renderer."""
    cells = {}
    for key, title in record["sweeps"].items():
        rows = [row for row in record["rows"] if row["sweep"] == key]
        cells[title] = [len(rows)]
        for name in record["renderers"]:
            found = [row["renderers"][name] for row in rows]
            counts = Counter(each["verdict"] for each in found)
            errors = [worst(each["errors"]) for each in found if "errors" in each]
            largest = " / ".join(number(max(e for e in each if e is not None)) for each in zip(*errors))
            cells[title].append(", ".join(f"{counts[v]} {v}" for v in VERDICTS if counts[v]) + f"; {largest}")
    return pd.DataFrame.from_dict(cells, orient="index", columns=["rows", *record["renderers"]])


def rows_of(record: dict, verdicts: tuple) -> pd.DataFrame:
    """The rows in which a renderer has one of these verdicts."""
    cells = {}
    for row in record["rows"]:
        if any(found["verdict"] in verdicts for found in row["renderers"].values()):
            cells[f"{row['sweep']}: {row['label']}"] = [
                condition(row), pair(row["limit"]),
                *(f"{found['verdict']}, {pair(found['errors'])}" for found in row["renderers"].values())]
    return pd.DataFrame.from_dict(cells, orient="index",
                                  columns=["condition", "one rounding", *record["renderers"]])


def refused(record: dict) -> pd.DataFrame:
    """What every renderer refuses, and the message."""
    cells = {f"{row['sweep']}: {row['label']}": [row["renderers"]["mitsuba"]["why"]]
             for row in record["rows"] if row["renderers"]["mitsuba"]["verdict"] == "refused"}
    return pd.DataFrame.from_dict(cells, orient="index", columns=["message"])


def listed(meanings: dict, head: str) -> str:
    """A table of words and meanings."""
    return as_markdown(pd.DataFrame.from_dict(meanings, orient="index", columns=[head])).replace("---:",
                                                                                                 "---")


def page(record: dict) -> str:
    """The text of stability.md."""
    return f"""# Numerical stability of the renderers

{as_markdown(overview(record))}

`mitsvbrdf stability` made these figures with version {record["versions"]["mitsvbrdf"]} (two minutes). A \
cell counts the verdicts on its rows, and gives the largest error of an image / of the worst map's gradient: \
relative L2 against the float64 twin. Tests compare the twin with the same model in fifty digits. No verdict \
is worse than expected.

{listed(VERDICTS, "when")}

![Errors along roughness](stability.svg)

## Where float32 shows

{as_markdown(rows_of(record, ("degraded", "limited")))}

*Apart*: camera and light are 31 to 39 degrees apart, seen from the middle of the patch. *One rounding*: the \
change of image / gradient in float64 when every normal turns by 2^-24 rad. *Condition*: largest by smallest \
singular value of a texel's Jacobian, median. *Limited* rows are Mitsuba's own: it forms G / (4 n.v) from \
its parts, adds both directions in float32, and measures the distance to the light from a rounded hit.

## Clamps

{listed(CLAMPS, "why, and what it does")}

## Refused

{as_markdown(refused(record)).replace("---:", "---")}
"""


def figure(record: dict) -> Figure:
    """Errors of image and worst gradient along roughness, with what one rounding makes."""
    drawing = Figure(figsize=(9, 3.4), layout="constrained")
    for panel, title, part in zip(drawing.subplots(1, 2, sharex=True), ("image", "gradient of the worst map"),
                                  (0, 1)):
        rows = [row for row in record["rows"] if row["sweep"] == "roughness" and row["limit"]
                and row["value"]]
        for name in record["renderers"]:
            panel.plot([row["value"] for row in rows],
                       [worst(row["renderers"][name]["errors"])[part] for row in rows],
                       "o", markersize=4, label=name)
        panel.plot([row["value"] for row in rows], [worst(row["limit"])[part] for row in rows], "_",
                   color="0.5",
                   markersize=10, label="one rounding of the normals")
        panel.axhline(record["tolerances"]["gradient" if part else "image"], color="0.6", linewidth=1)
        panel.set(xscale="log", yscale="log", xlabel="roughness", title=f"Relative L2 error of the {title}")
    panel.legend(fontsize=7)
    return drawing


if __name__ == "__main__":
    file = HERE / "stability.json"
    if sys.argv[1:] == ["measure"]:
        subprocess.run([sys.executable, "-m", "mitsvbrdf", "stability", "--json", str(file), "--overwrite"],
                       check=True)
    content = json.loads(file.read_text())
    file.write_text(json.dumps(content, separators=(",", ":")) + "\n")
    (HERE / "stability.md").write_text(page(content))
    (HERE / "stability.svg").write_bytes(svg(figure(content)))
