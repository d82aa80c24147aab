"""Exports in other people's programs.

``python docs/results/clients.py`` makes clients.md and clients.svg from clients.json. The exports are drawn
and compared by ``python -m clients.table`` in ``tests``, which needs Blender, Chromium and three.js.
"""

import json
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
LIGHTS = ("at the camera", "beside it", "oblique")
LIMITS = {"three.js, USD": "doubles normals (takes the texture's scale for normalScale) and reads no texture "
                           "of the index",
          "Blender, USD": "reads no coloured F0",
          "Blender, maps": "has no F0 above 0.08 and no coloured one (Specular IOR Level ends at 1)"}


def table(record: dict, cell) -> pd.DataFrame:
    """A row for each client, a column for each material."""
    return pd.DataFrame({name: {client: cell(found) for client, found in clients.items()}
                         for name, clients in record["materials"].items()})


def rmse(found: dict) -> str:
    """RMSE by light."""
    return " / ".join(f"{x:.3f}" for x in found["rmse"])


def means(found: dict) -> str:
    """The mean of the channel that is farthest off, over what it should be, by light."""
    return " / ".join(f"{max(light, key=lambda x: abs(x - 1)):.2f}" for light in found["means"])


def page(record: dict) -> str:
    """The text of clients.md."""
    limits = "\n".join(f"- {client} {what}." for client, what in LIMITS.items())
    pictures = "\n\n".join(f"![{name} in all clients](clients-{name}.jpg)" for name in record["pictured"])
    return f"""# Exports in other people's programs

## RMSE in display values, by light: {" / ".join(LIGHTS)}

{as_markdown(table(record, rmse))}

Blender 4.5 (Cycles), Mitsuba 3.9, and three.js r187 and model-viewer 4.4 in headless Chromium load the \
export by their own importers, and draw it at 256 px under one point light. The reference is our analytic \
renderer. `gilt plates` and `inlay` are made (metals, coloured dielectrics, F0 below 0.04); the others are \
fits of captures. The exports are those of version {record["version"]}. Three clients cannot show all of a \
material:

{limits}

![RMSE with the light at the camera](clients.svg)

## Mean of a colour channel over the right one: the channel that is farthest off

{as_markdown(table(record, means))}

The picture's mean over that of the reference, by light as above. 1.00 is right.

## Pictures

From top to bottom: our renderer, then the clients in the order of the table. From left to right, the light: \
{", ".join(LIGHTS)}.

{pictures}
"""


def figure(record: dict) -> Figure:
    """RMSE of each client and material, light at the camera."""
    drawing = Figure(figsize=(7, 3), layout="constrained")
    axes = drawing.subplots()
    for name, clients in record["materials"].items():
        axes.plot([found["rmse"][0] for found in clients.values()], list(clients), "o", markersize=4,
                  label=name)
    axes.set(xlabel="RMSE, light at the camera")
    axes.invert_yaxis()
    axes.legend(fontsize=7)
    return drawing


if __name__ == "__main__":
    content = json.loads((HERE / "clients.json").read_text())
    (HERE / "clients.md").write_text(page(content))
    (HERE / "clients.svg").write_bytes(svg(figure(content)))
