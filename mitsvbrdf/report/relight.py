"""Pictures of renders: the error over time, and a contact sheet. They show numbers and compute none.

``python -m mitsvbrdf.report.relight SHEET.jpg NAME=FOLDER ...`` makes a contact sheet of the results of ``mitsvbrdf relight``:
a row for each folder, a column for each preset; of movies the frame after a third.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from torch import Tensor

from .. import files
from ..errors import ConfigError, OutputError, exit_code
from ..relight.frames import RECORD, read_frame
from ..relight.passes import shown
from ..relight.stage import PRESETS
from .sheet import PlainNumbers

INK, QUIET, TARGET = "#c2571a", "#9aa0a8", "#2a6fb0"
SIDE, GAP, CAPTION = 320, 6, 30  # pixels of a contact sheet
BACK, TEXT = (19, 21, 25), (236, 238, 241)


def error_curve(path: str | Path, curves: Sequence[Sequence[Mapping]], target: float | None = None, title: str = "") -> None:
    """An SVG of the estimated error against seconds, one line a frame, both axes logarithmic.

    The target is a dashed line; a dotted one falls as the root of time through the end of the last frame's.

    Args:
        path: the SVG to write or replace.
        curves: of each frame, points with ``seconds`` > 0 and ``error``; points whose error is 0 are left out.
        target: the error asked for.
        title: the heading.

    Raises:
        OutputError: the file cannot be written.
    """
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.subplots()
    lines = [[(p["seconds"], p["error"]) for p in curve if p["seconds"] > 0 and p["error"] > 0] for curve in curves]
    lines = [line for line in lines if line]
    alone = len(lines) == 1
    for number, line in enumerate(lines):
        axes.plot(*zip(*line), color=INK, linewidth=1.8 if alone else 0.8, alpha=1 if alone else 0.5, marker="o", markersize=3,
                  label=None if number else "estimated error" if alone else f"estimated error, {len(lines)} frames")
    if lines:
        t, e = lines[-1][-1]  # the first frame also compiles
        ends = np.array([min(x for line in lines for x, _ in line), max(x for line in lines for x, _ in line)])
        axes.plot(ends, e * np.sqrt(t / ends), color=QUIET, linewidth=1, linestyle=":", label="1 / \N{SQUARE ROOT}seconds")
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(PlainNumbers())
            axis.set_minor_formatter(PlainNumbers())
    if target:
        axes.axhline(target, color=TARGET, linewidth=1, linestyle="--", label=f"target {target:g}")
    axes.set_title(title, loc="left", fontsize=9)
    axes.set_xlabel("seconds", fontsize=8)
    axes.set_ylabel("RMSE in display values", fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color="#e3e5e8", linewidth=0.6)
    axes.tick_params(labelsize=7, which="both", color="#9aa0a8")
    if lines or target:
        axes.legend(fontsize=7, frameon=False)
    data = io.BytesIO()
    # Text stays text, and the same curves give the same file.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mitsvbrdf"}):
        FigureCanvasSVG(figure).print_svg(data, metadata={"Date": None})
    files.write_bytes(Path(path), data.getvalue())


def contact_sheet(path: str | Path, folders: Mapping[str, Path], side: int = SIDE) -> None:
    """A JPEG of what ``mitsvbrdf relight`` left in some folders: a row each, with captions.

    Args:
        path: the JPEG to write or replace.
        folders: by caption.
        side: of each picture in pixels; others than squares are fitted in.

    Raises:
        ConfigError: a folder without results.
        OutputError: the file cannot be written.
    """
    from PIL import Image, ImageDraw, ImageFont, ImageOps

    rows = {name: _pictures(folder) for name, folder in folders.items()}
    presets = [name for name in PRESETS if any(name in pictures for pictures in rows.values())]
    sheet = Image.new("RGB", (GAP + len(presets) * (side + GAP), len(rows) * (side + CAPTION) + GAP), BACK)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for row, (name, pictures) in enumerate(rows.items()):
        y = row * (side + CAPTION)
        for preset, picture in pictures.items():
            x = GAP + presets.index(preset) * (side + GAP)
            draw.text((x + 2, y + 7), f"{name} · {preset}", TEXT, font)
            image = Image.fromarray(np.rint(picture.numpy() * 255).astype(np.uint8))
            image = ImageOps.contain(image, (side, side), Image.Resampling.LANCZOS)
            sheet.paste(image, (x + (side - image.width) // 2, y + CAPTION + (side - image.height) // 2))
    data = io.BytesIO()
    sheet.save(data, "JPEG", quality=88, optimize=True)
    files.write_bytes(Path(path), data.getvalue())


def _pictures(folder: Path) -> dict[str, Tensor]:
    try:
        record = json.loads((Path(folder) / RECORD).read_text())
        chosen = {name: preset["frames"][len(preset["frames"]) // 3]["file"] for name, preset in record["presets"].items()}
        exposure = float(record["settings"]["exposure"])
    except (OSError, ValueError, KeyError, IndexError) as reason:
        raise ConfigError("a folder of mitsvbrdf relight", f"{folder}: {reason!r}", "render it first") from None
    return {name: shown(read_frame(Path(folder) / file), exposure) for name, file in chosen.items()}


def main(arguments: Sequence[str]) -> int:
    """``SHEET.jpg NAME=FOLDER ...``; returns the exit code."""
    if len(arguments) < 2 or not all("=" in each for each in arguments[1:]):
        raise ConfigError("SHEET.jpg NAME=FOLDER ...", " ".join(arguments) or "nothing", "name each folder")
    if Path(arguments[0]).suffix.lower() not in (".jpg", ".jpeg"):
        raise OutputError("a .jpg file to write", arguments[0], "give another name")
    contact_sheet(arguments[0], {name: Path(folder) for name, _, folder in (each.partition("=") for each in arguments[1:])})
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(lambda: main(sys.argv[1:])))
