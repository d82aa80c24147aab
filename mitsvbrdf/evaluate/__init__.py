"""How good a material is: against known maps, or against photos."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import torch

from ..capture import Capture
from ..errors import MapsError
from ..fit.loop import rerender
from ..fit.result import FitResult
from ..maps import SVBRDF, load_maps, read_material_json
from ..metrics import map_rmse
from ..render import Renderer, make_renderer
from ..views import Views


def evaluate_maps(svbrdf: SVBRDF, material: str | Path) -> dict[str, float]:
    """RMSE of each map against a folder of known maps, counted as :func:`mitsvbrdf.metrics.map_rmse` says.

    Returns:
        ``diffuse``, ``specular``, ``roughness``, ``normal`` and their ``mean``.
    """
    encoding = read_material_json(Path(material)).get("encoding", {}).get("roughness", "linear")
    return map_rmse(svbrdf, load_maps(material), "gamma 2.2" if encoding == "gamma 2.2" else "linear")


def evaluate_capture(svbrdf: SVBRDF, capture: Capture, renderer: Renderer,
                     flash_offset: tuple[float, float] | None = None) -> dict:
    """Error of the re-rendered photos in display values.

    Args:
        svbrdf: the material, brought to the photos' resolution if it differs.
        capture: the photos; they need not be those of the fit.
        renderer: draws them.
        flash_offset: (x, y) of the flash beside the lens in patch sides, as a fit found it; None leaves the views alone.

    Returns:
        ``rerender_rmse`` over all photos and ``per_photo`` by name.
    """
    views = shift_lights(capture.views, flash_offset)
    _, total, each = rerender(renderer, svbrdf.resized(capture.resolution), views, capture)
    return {"rerender_rmse": total, "per_photo": dict(zip(capture.names, each))}


def evaluate_fit(result: FitResult, capture: Capture) -> dict:
    """Error of a fit on the photos of a capture, with the flash offset it found; see :func:`evaluate_capture`."""
    offset = result.flash_offset and tuple(x / result.views.size for x in result.flash_offset)
    return evaluate_capture(result.svbrdf, capture, make_renderer(result.renderer, result.variant or "llvm_ad_rgb"), offset)


def shift_lights(views: Views, flash_offset: tuple[float, float] | None) -> Views:
    """The views with every light moved sideways by this much, in patch sides."""
    if flash_offset is None:
        return views
    return replace(views, light=views.light + torch.tensor([*flash_offset, 0.0], dtype=torch.float64) * views.size)


def fit_record_of(folder: str | Path) -> dict:
    """The ``fit.json`` of a fit's folder or of the ``maps`` folder inside it; empty where there is none.

    Raises:
        MapsError: it is there but cannot be read.
    """
    folder = Path(folder)
    for path in (folder / "fit.json", folder.parent / "fit.json"):
        if path.is_file() and (path.parent == folder or folder.name == "maps"):
            try:
                return json.loads(path.read_text())
            except ValueError as reason:
                raise MapsError("a valid fit.json", f"{path}: {reason}", "mend or remove it") from None
    return {}
