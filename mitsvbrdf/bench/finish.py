"""``python -m mitsvbrdf.bench.finish CAPTURES -o docs/results``: what the adversarial finish does to photos
left out of a fit.

Of each capture the default fit sees all photos but two, and its finish too; both predict the two.
``finish.json`` has the figures, ``finish.md`` is written from it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import torch
import tyro

from .. import color
from ..capture import Capture, read_capture
from ..evaluate.placement import predict
from ..fit import HierarchicalConfig, fit_svbrdf
from ..fit.finish_config import FinishConfig
from ..fit.generator.finish import finished, matte, why_not
from ..fit.result import FitResult
from ..io import files
from ..io.progress import say
from ..io.provenance import machine, versions
from ..io.tool import run_tool
from ..material.maps import SVBRDF
from ..measure.metrics import flip
from ..measure.patch_statistics import PROJECTIONS, SEED, SIDE, highlights, patches_of, sliced_wasserstein
from ..measure.rerender import rerender
from ..render import Renderer, make_renderer

USUAL_LEFT_OUT = (4, 7)
# what the patches' distance and the RMSE may be, over those of the maps, for the bar
NEARER, FARTHER = 0.8, 1.1


def reduced(result: FitResult, capture: Capture, renderer: Renderer, side: int) -> tuple[FitResult, Capture]:
    """A fit and its photos with fewer texels, by area averages; as they are where they have no more."""
    if capture.resolution <= side:
        return result, capture
    smaller, svbrdf = capture.averaged(side), result.svbrdf.resized(side)
    images, rmse, each = rerender(renderer, svbrdf, result.views, smaller)
    return replace(result, svbrdf=svbrdf, rerendered=images, rerender_rmse=rmse, per_photo=each), smaller


def figures(result: FitResult, left: Capture, renderer: Renderer) -> dict:
    """How well maps and look predict photos that the fit did not see.

    Args:
        result: a fit with a look.
        left: those photos, with their stated views.
        renderer: draws them.

    Returns:
        ``highlights``: share of pixels counted as highlights by photos and maps; of ``maps`` and ``look``
        each ``patches`` (sliced Wasserstein-1 distance of the patches there, display values), ``rmse`` over
        all pixels, ``flip``, and ``seen``, the RMSE of the photos seen; ``seconds`` of fit and finish.
    """
    assert result.look is not None and result.finish is not None
    offset = result.flash_offset
    beside = None if offset is None else (offset[0] / result.views.size, offset[1] / result.views.size)

    def drawn(svbrdf: SVBRDF) -> tuple[torch.Tensor, float]:
        return predict(svbrdf, left, renderer, beside)[:2]

    (solved, rmse), (look, look_rmse), (dull, _) = map(drawn,
                                                       (result.svbrdf, result.look, matte(result.svbrdf)))
    where = highlights(left.linear, solved, dull)
    real = patches_of(left.photos, where)

    def row(images: torch.Tensor, error: float, seen: float) -> dict[str, float]:
        shown = color.to_display(images, left.transfer)
        looks = [float(flip(image, photo, left.transfer).mean()) for image, photo in zip(images, left.linear)]
        return {"patches": sliced_wasserstein(patches_of(shown, where), real), "rmse": error,
                "flip": sum(looks) / len(looks), "seen": seen}

    return {"highlights": float(where.float().mean()), "maps": row(solved, rmse, result.rerender_rmse),
            "look": row(look, look_rmse, result.finish["rerender_rmse"]),
            "seconds": {"fit": result.trace[-1]["seconds"], "finish": result.finish["seconds"]}}


def passes(row: dict) -> bool:
    """Whether a capture meets the bar: patches a fifth nearer, RMSE at most a tenth larger."""
    maps, look = row["maps"], row["look"]
    return bool(look["patches"] <= NEARER * maps["patches"] and look["rmse"] <= FARTHER * maps["rmse"])


def page(record: dict) -> str:
    """The figures as Markdown."""
    rows = record["captures"]
    smaller = record["finish_at"] < record["resolution"]
    averaged = f", maps and photos averaged to {record['finish_at']} px" if smaller else ""
    good = sum(map(passes, rows.values()))
    ratios = {name: sorted(row["look"][name] / row["maps"][name] for row in rows.values())
              for name in ("patches", "rmse", "flip")}
    middle = {name: _median(values) for name, values in ratios.items()}
    nearer = sum(ratio <= NEARER for ratio in ratios["patches"])
    close = sum(ratio <= FARTHER for ratio in ratios["rmse"])
    lines = [
        "# The adversarial finish, measured", "",
        "Written by `python -m mitsvbrdf.bench.finish` from `finish.json`.", "",
        f"The default fit to all photos but {' and '.join(map(str, record['left_out']))}, "
        f"{record['resolution']} px"
        f"{averaged}; then {record['config']['steps']} steps of `--finish gan`, seed "
        f"{record['config']['seed']}. Figures are "
        "of the two photos left out, as calibrated.", "",
        f"- *Patches*: sliced Wasserstein-1 distance between {SIDE} x {SIDE} x 3 patches of rendering and "
        "photo, "
        f"{PROJECTIONS} projections, seed {SEED}, display values; inside highlights: where the brighter of "
        "photo and maps' "
        "rendering, averaged over the patch in linear light, is over twice the rendering of the diffuse "
        "map. The look takes no "
        "part in that choice.",
        "- *RMSE*: display values, all pixels. *FLIP*: 67 pixels a degree, mean.",
        f"- *Bar*: patches at most {NEARER} and RMSE at most {FARTHER} times those of the maps.",
        *(["- Averaged maps meet the photos seen less well than the maps did (RMSE seen): averaging takes "
           "relief away. Part "
           "of what the look mends there is that."] if smaller else []), "",
        f"**{good} of {len(rows)} captures meet the bar**; {nearer} that of patches, {close} that of RMSE. "
        "Medians of look "
        f"over maps: patches {middle['patches']:.2f}, RMSE {middle['rmse']:.2f}, FLIP {middle['flip']:.2f}.",
        "",
        "| capture | highlights | patches: maps | look | ratio | RMSE: maps | look | ratio | FLIP: maps | "
        "look | "
        "RMSE seen: maps | look | finish, s | bar |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"]
    for name, row in rows.items():
        maps, look = row["maps"], row["look"]
        lines.append(f"| {name} | {row['highlights']:.0%} | {maps['patches']:.4f} | {look['patches']:.4f} | "
                     f"{look['patches'] / maps['patches']:.2f} | {maps['rmse']:.4f} | {look['rmse']:.4f} | "
                     f"{look['rmse'] / maps['rmse']:.2f} | {maps['flip']:.3f} | {look['flip']:.3f} | "
                     f"{maps['seen']:.4f} | "
                     f"{look['seen']:.4f} | {row['seconds']['finish']:.0f} | "
                     f"{'met' if passes(row) else 'missed'} |")
    return "\n".join(lines) + "\n"


def _median(ordered: Sequence[float]) -> float:
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2 if ordered else math.nan


def write(rows: dict[str, dict], config: FinishConfig, sides: tuple[int, int], out: Path) -> None:
    """``finish.json`` and ``finish.md`` of what :func:`figures` gave for each capture; texels a side of fit
    and finish.
    """
    record = {"schema_version": 1, "left_out": list(USUAL_LEFT_OUT), "resolution": sides[0],
              "finish_at": sides[1],
              "config": asdict(config), "captures": rows, "machine": machine(), "versions": versions()}
    files.write_json(out / "finish.json", record)
    files.write_bytes(out / "finish.md", page(record).encode())


def main(captures: Annotated[Path, tyro.conf.arg(metavar="FOLDER", help="Of calibrated captures of nine "
                                                                        "photos each.")],
         out: Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder to write.")],
         resolution: Annotated[int, tyro.conf.arg(help="Side of the maps in texels.")] = 256,
         finish_at: Annotated[int, tyro.conf.arg(help="Side at which solved maps and photos, averaged, are "
                                                      "finished and "
                                                      "compared.")] = 256) -> int:
    """Fit, finish and measure each capture; both files are written after each."""
    files.check_output(out / "finish.json", out / "finish.md")
    renderer, config = make_renderer("mitsuba"), FinishConfig()
    rows: dict[str, dict] = {}
    for folder in sorted(path for path in captures.iterdir() if path.is_dir()):
        shots = read_capture(folder, resolution=resolution)
        kept = shots.pick([number for number in shots.index if number not in USUAL_LEFT_OUT])
        solved, kept = reduced(fit_svbrdf(kept, renderer, HierarchicalConfig()), kept, renderer, finish_at)
        result = finished(solved, kept, renderer, config)
        if result.look is None:
            why = why_not(result)
            if why is None or solved.stopped == "interrupted":
                raise KeyboardInterrupt
            say(f"{folder.name}: left out, {why}")
            continue
        rows[folder.name] = figures(result, shots.pick(USUAL_LEFT_OUT).averaged(finish_at), renderer)
        write(rows, config, (resolution, finish_at), out)
        say(f"{folder.name}: bar {'met' if passes(rows[folder.name]) else 'missed'}")
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.bench.finish",
                      "interrupted; the files have each capture that was measured"))
