"""What tests of all folders share: renderers, views, photos of made materials, the repository's folder."""

from pathlib import Path

from mitsvbrdf.capture import Capture
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import Views, nine_view_grid

ROOT = Path(__file__).resolve().parents[2]
ANALYTIC, MITSUBA, TWIN = make_renderer("analytic"), make_renderer("mitsuba"), make_renderer("analytic64")
GRID = nine_view_grid()


def photos_of(material: SVBRDF, views: Views = GRID, noise: float = 0.0) -> Capture:
    """8-bit photos of a material by the analytic renderer, with sensor noise of this deviation."""
    return photograph(material, views, ANALYTIC, noise)
