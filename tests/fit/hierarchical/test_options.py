"""All kinds of photos and options."""

import math
from dataclasses import replace

import pytest
import torch
from helpers import MITSUBA, photos_of
from helpers.hierarchical_fits import SIDE
from helpers.variants import mostly_slow

from mitsvbrdf.capture import Capture
from mitsvbrdf.errors import MitsvbrdfError
from mitsvbrdf.fit import HierarchicalConfig, fit_svbrdf
from mitsvbrdf.fit.hierarchical import scales, stages
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.metrics import map_rmse
from mitsvbrdf.render import make_renderer
from mitsvbrdf.views import Views


def sane(result, resolution, bsdf="roughconductor"):
    result.svbrdf.check()
    assert result.svbrdf.resolution == resolution and result.svbrdf.bsdf == bsdf and not result.undone
    assert all(torch.isfinite(t).all() for t in (*result.svbrdf.maps.values(), *result.deviations.values(),
                                                 result.rerendered))
    assert all(math.isfinite(v) for entry in result.trace for v in entry.values())
    result.views.check()


@pytest.mark.parametrize("kind", ["exact", "phone"])
@pytest.mark.parametrize("side", mostly_slow([2, 5, 50, 100], 2))
def test_any_size(side, kind, monkeypatch):
    if kind == "phone":
        monkeypatch.setattr(stages, "EXACT", 0.0)
    truth = make_material("leather", side)
    result = fit_svbrdf(photos_of(truth), MITSUBA, HierarchicalConfig(iterations=7))
    sane(result, side)
    # Measured 0.005 to 0.011 (exact), and 0.011 to 0.034 after so few rounds (phone).
    assert map_rmse(result.svbrdf, truth)["mean"] < (0.02 if kind == "exact" else 0.05)


PHOTOS = {"one": lambda shots: shots.pick([0]), "two": lambda shots: shots.pick([0, 3]),
    "nine identical": lambda shots: Capture(shots.photos[:1].expand(9, -1, -1, -1).contiguous(), shots.views),
    "one photo nine times": lambda shots: Capture(shots.photos[[0] * 9], shots.views.pick([0] * 9)),
    "uncalibrated": lambda shots: Capture(shots.photos, Views.of([[0.0, 0.0, 2.0]] * 9,
                                                                 intensity=4 * math.pi), calibration="none"),
    "black": lambda shots: replace(shots, photos=torch.zeros_like(shots.photos)),
    "one black": lambda shots: replace(
        shots, photos=torch.cat((torch.zeros_like(shots.photos[:1]), shots.photos[1:]))),
    "white": lambda shots: replace(shots, photos=torch.ones_like(shots.photos)),
    "grey": lambda shots: replace(shots, photos=torch.full_like(shots.photos, 0.5)),
    "noise": lambda shots: replace(
        shots, photos=torch.rand(shots.photos.shape, generator=torch.Generator().manual_seed(0))),
    "paper's light": lambda shots: replace(shots, views=replace(shots.views, falloff="none")),
    "srgb, centimetres": lambda shots: replace(shots, transfer="srgb", views=Views.of(
        shots.views.camera * 20, intensity=shots.views.intensity * 400, size=20.0)),}


@pytest.mark.parametrize("change", mostly_slow(PHOTOS))
def test_any_photos(change, capture):
    shots = PHOTOS[change](capture.averaged(16))
    result = fit_svbrdf(shots, MITSUBA, HierarchicalConfig(stationary=False))
    sane(result, 16)
    assert result.stopped == "settled" and result.rerender_rmse <= result.trace[0]["rerender_rmse"] + 1e-4
    assert result.flash_offset is not None and result.calibration["estimated"] == (change == "uncalibrated")


OPTIONS = {"grey": {"grey_specular": True}, "principled": {"bsdf": "principled"}, "min": {"guess": "min"},
    "no neighbours": {"neighbours": False}, "one material": {"materials": 1},
    "more than texels": {"materials": 1000},
    "own 0": {"detail_spread": 0.0}, "own tiny": {"detail_spread": 1e-20},
    "tails 0": {"highlight_reach": 0.0}, "trend": {"remove_burn_in": False}, "views": {"calibrate": False},
    "no offset": {"flash_offset": False}, "sharp": {"similarity": 1e-6}, "alike": {"similarity": 100.0},
    **{f"fix {name}": {"fix": (f"{name}={value}",)} for name, value in
       (("diffuse", "0.1,0.2,0.2"), ("specular", 0.05), ("roughness", 0.3), ("normal", "flat"))},
    **{f"fix {name}": {"bsdf": "principled", "fix": (f"{name}={value}",)} for name, value in
       (("base_color", 0.1), ("metallic", 0))},
    "diffuse only": {"fix": ("normal=flat", "specular=0.04", "roughness=0.5")},
    "normal only": {"fix": ("diffuse=0.1", "specular=0.04", "roughness=0.5")},
    "roughness only": {"fix": ("diffuse=0.1", "specular=0.04", "normal=flat")},
    "matt": {"fix": ("specular=0", "roughness=1")},}
OF_TWO_SIZES = "matt", "diffuse only", "normal only", "own 0", "own tiny"
# Options that have nothing to do with each other, in one fit.
TOGETHER = {
    "grey, min, no offset, more than texels, own tiny": "exact", "no neighbours, one material, tails 0, "
                                                                 "views, sharp": "phone",
    "principled, fix base_color, trend, alike": "phone",
    "fix diffuse, fix specular, own 0": "phone, two sizes",
    "fix roughness, fix normal, grey": "exact", "principled, fix metallic": "phone",
    "diffuse only": "exact, two sizes",
    "normal only": "phone, two sizes", "roughness only": "phone", "matt": "phone, two sizes"}
QUICK = ("no neighbours, one material, tails 0, views, sharp", "principled, fix metallic",
         "fix roughness, fix normal, grey", "diffuse only")


def settings_of(options):
    several = [OPTIONS[name] for name in options.split(", ")]
    return {name: value for one in several for name, value in one.items()} | {
        "fix": tuple(item for one in several for item in one.get("fix", ()))}


@pytest.mark.parametrize("options, kind", [*mostly_slow(TOGETHER.items(), *QUICK), *mostly_slow((
        *((name, "phone") for name in OPTIONS),
        *((name, "exact") for name in ("grey", "principled", "fix normal", "fix metallic")),
        *((name, kind) for name in OF_TWO_SIZES for kind in ("phone, two sizes", "exact, two sizes"))))])
def test_any_options(options, kind, tiles, monkeypatch):
    if "phone" in kind:
        monkeypatch.setattr(stages, "EXACT", 0.0)
    if "two sizes" in kind:
        monkeypatch.setattr(scales, "COARSE", 4)
    # of which the phone's third to sixth tie the texels
    config = HierarchicalConfig(iterations=12, **settings_of(options))
    result = fit_svbrdf(tiles, MITSUBA, config)
    sane(result, 8, config.bsdf)
    assert result.rerender_rmse < result.trace[0]["rerender_rmse"]
    for item in config.fix:
        name, value = item.split("=")
        wanted = [0.0, 0.0, 1.0] if value == "flat" else [float(x) for x in value.split(",")]
        assert torch.equal(result.svbrdf[name], torch.tensor(wanted).expand_as(result.svbrdf[name]))
        assert name not in result.deviations and f"gradient of {name}" in dict(result.omitted)
    if config.grey_specular:
        assert (result.svbrdf["specular"] == result.svbrdf["specular"][..., :1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("renderer", ["analytic", "mitsuba-scene"])
def test_the_renderer_only_draws_the_comparison(renderer, capture):
    shots, config = capture.averaged(8), HierarchicalConfig(iterations=3)
    plain, other = (fit_svbrdf(shots, make_renderer(name), config) for name in ("mitsuba", renderer))
    assert all(torch.equal(plain.svbrdf[name], other.svbrdf[name]) for name in plain.svbrdf.maps)
    assert other.renderer == renderer and other.rerender_rmse == pytest.approx(plain.rerender_rmse, rel=1e-3)


def test_one_iteration(capture):
    result = fit_svbrdf(capture, MITSUBA, HierarchicalConfig(iterations=1))
    sane(result, SIDE)
    assert result.stopped == "iterations" and len(result.trace) == 2


@pytest.mark.parametrize("wrong", [{"materials": 0}, {"similarity": 0.0}, {"spread": -1.0}, {"relief": 0.0},
                                   {"detail_spread": -0.1},
                                   {"highlight_reach": math.nan}, {"fix": ("gloss=1",)},
                                   {"grey_specular": True, "bsdf": "principled"}])
def test_what_cannot_be_asked_for(wrong, capture):
    with pytest.raises(MitsvbrdfError):
        fit_svbrdf(capture, MITSUBA, HierarchicalConfig(**wrong))
