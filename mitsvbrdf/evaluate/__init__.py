"""How good a material is: against known maps, or against photos."""

from pathlib import Path

from ..calibrate.refine import UNKNOWNS, Priors, refine_views
from ..capture import Capture
from ..io.entry import entry
from ..material.encoding import NormalConvention
from ..material.map_files import encodings, load_maps
from ..material.maps import SVBRDF
from ..measure.metrics import map_rmse
from ..measure.rerender import rerender_errors
from ..render import Renderer
from ..views import Views, shift_lights


@entry()
def evaluate_maps(svbrdf: SVBRDF, material: str | Path, encoding: str | None = None,
                  normal: NormalConvention | None = None) -> dict[str, float]:
    """RMSE of each map against a folder of known maps (:func:`mitsvbrdf.measure.metrics.map_rmse`).

    Args:
        svbrdf: the estimate.
        encoding: of the files of known maps, as in ``load_maps``.
        normal: the convention of the known normals, as in ``load_maps``.

    Returns:
        ``diffuse``, ``specular``, ``roughness``, ``normal`` and their ``mean``.
    """
    encoded = encodings(material, encoding)["roughness"] == "gamma 2.2"
    return map_rmse(svbrdf, load_maps(material, None, encoding, normal), "gamma 2.2" if encoded else "linear")


@entry()
def evaluate_capture(svbrdf: SVBRDF, capture: Capture, renderer: Renderer,
                     flash_offset: tuple[float, float] | None = None, priors: Priors | None = None) -> dict:
    """Error of the re-rendered photos in display values.

    Args:
        svbrdf: the material, brought to the photos' resolution if it differs.
        capture: the photos; they need not be those of the fit.
        flash_offset: (x, y) of the flash beside the lens in patch sides, as a fit found it; None: the
            views stay.
        priors: standard deviations of the views; if given, refined views are measured, too
            (:mod:`mitsvbrdf.calibrate.refine`).

    Returns:
        ``rerender_rmse`` over all photos, and ``per_photo``: photo name to RMSE. With priors, ``refined`` has
        the same for refined views, and ``views``: name to ``change`` and ``deviation`` of each unknown.
    """
    material = svbrdf.resized(capture.resolution)

    def errors(views: Views) -> dict:
        total, each = rerender_errors(renderer, material, views, capture)
        return {"rerender_rmse": total, "per_photo": dict(zip(capture.names, each))}

    views = shift_lights(capture.views, flash_offset)
    found = errors(views)
    if priors:
        refined = refine_views(svbrdf, views, capture, priors)
        moved = {name: {"change": dict(zip(UNKNOWNS, change)), "deviation": dict(zip(UNKNOWNS, deviation))}
                 for name, change, deviation in zip(capture.names, refined.change.tolist(),
                                                    refined.deviation.tolist())}
        found["refined"] = errors(refined.views) | {"views": moved}
    return found
