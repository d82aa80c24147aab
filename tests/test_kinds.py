"""Arguments of another kind than they should be are refused, wherever a program enters."""

import inspect

import pytest
import torch

import mitsvbrdf as mv
from mitsvbrdf.capture.align.sheet import write_sheet
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.stages import make_capture
from mitsvbrdf.errors import MitsvbrdfError
from mitsvbrdf.kinds import _about
from mitsvbrdf.material.maps import flat

MADE, VIEWS = flat(8), mv.Views.of([[0.0, 0.0, 2.0]])
CAPTURE = mv.Capture(torch.rand(1, 8, 8, 3), VIEWS)
FUNCTIONS = [getattr(mv, name) for name in mv.__all__ if inspect.isfunction(getattr(mv, name))]
WRONG = {
    "resolution as text": lambda: mv.make_material("inlay", "64"),
    "a fraction of a texel": lambda: mv.make_material("inlay", 64.5),
    "a name in a list": lambda: mv.make_material(["inlay"], 64),
    "no whole seed": lambda: mv.make_material("inlay", 16, "1"),
    "truth as a number": lambda: mv.make_material("inlay", True),
    "a variant by number": lambda: mv.make_renderer("mitsuba", 5),
    "needs by number": lambda: mv.make_renderer("analytic", needs=5),
    "maps and views swapped": lambda: mv.make_renderer("analytic").render(VIEWS, MADE),
    "no maps": lambda: mv.make_renderer("mitsuba").render(None, VIEWS),
    "maps as lists": lambda: mv.SVBRDF(MADE.bsdf, {name: m.tolist() for name, m in MADE.maps.items()}),
    "maps of numpy": lambda: mv.SVBRDF(MADE.bsdf, {name: m.numpy() for name, m in MADE.maps.items()}),
    "maps of whole numbers": lambda: mv.SVBRDF(MADE.bsdf, {name: m.long() for name, m in MADE.maps.items()}),
    "maps of one number": lambda: mv.SVBRDF(MADE.bsdf, {name: torch.tensor(1.0) for name in MADE.maps}),
    "maps without a texel": lambda: MADE.map(lambda m: m[:0, :0]),
    "no map at all": lambda: mv.SVBRDF(MADE.bsdf, None), "a flat map of text": lambda: flat("8"),
    "a flat map of nothing": lambda: flat(0), "a flat map of no name": lambda: flat(4, difuse=0.5),
    "resized to text": lambda: MADE.resized("4"), "resized to nothing": lambda: MADE.resized(0),
    "another dtype": lambda: MADE.to("float64"),
    "a patch size of text": lambda: mv.Views(VIEWS.camera, VIEWS.light, VIEWS.intensity, "1"),
    "photos without views": lambda: mv.Capture(CAPTURE.photos, 5),
    "photos without a pixel": lambda: mv.Capture(CAPTURE.photos[:, :0, :0], VIEWS),
    "photos by the name of their folder": lambda: make_capture("photos"),
    "photos by number": lambda: photos_in(5),
    "a photo by number": lambda: Photo.open(5), "photos averaged to text": lambda: CAPTURE.averaged("4"),
    "photos averaged to nothing": lambda: CAPTURE.averaged(-1),
    "photos sampled to text": lambda: CAPTURE.sampled("4"),
    "photos sampled to nothing": lambda: CAPTURE.sampled(0), "a sheet by number": lambda: write_sheet(5),
    "a sheet's size of text": lambda: write_sheet("sheet.pdf", "18"),
    "a sheet on unknown paper": lambda: write_sheet("sheet.pdf", 18.0, "a5"),
    "a capture by number": lambda: mv.fit_svbrdf(5, mv.make_renderer("analytic")),
    "a renderer by number": lambda: mv.fit_svbrdf(CAPTURE, 5),
    "settings by number": lambda: mv.fit_svbrdf(CAPTURE, mv.make_renderer("analytic"), 5),
    "seconds as text": lambda: mv.fit_svbrdf(CAPTURE, mv.make_renderer("analytic"),
                                             mv.HierarchicalConfig(budget="3")),
    "a side of text": lambda: mv.ExportSettings(side="1"),
    "a negative side": lambda: mv.export_material(MADE, "out", settings=mv.ExportSettings(side=-1.0)),
    "an export out of range": lambda: mv.export_material(MADE.map(lambda m: 3 * m), "out"),
    "maps out of range": lambda: mv.save_maps(MADE.map(lambda m: 3 * m), "out"),
    "formats by number": lambda: mv.export_material(MADE, "out", 5),
    "a folder by number": lambda: mv.load_maps(5),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_other_kinds_are_refused(wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MitsvbrdfError, match="expected .*got .*; "):
        WRONG[wrong]()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_every_public_function_refuses_other_kinds(function):
    """Its annotations can be resolved at run time, and one that may be anything is not its first argument."""
    first, *_ = inspect.signature(function).parameters
    assert first in _about(inspect.unwrap(function))[0]
    with pytest.raises(MitsvbrdfError, match=f"expected {first}: "):
        function(**{first: 5j} | {name: None for name, each in inspect.signature(function).parameters.items()
                                  if name != first and each.default is each.empty})

