"""Photos are rendered one by one where they are large; those that a fit saw are rendered with its views."""

import json
import math
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID, MITSUBA, photos_of

from mitsvbrdf import cli
from mitsvbrdf.bench.run import fit as bench_fit
from mitsvbrdf.bench.tasks import RealCapture
from mitsvbrdf.evaluate.photos import Entry, compare, evaluate_fit
from mitsvbrdf.fit import Fit, HierarchicalConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.measure import rerender
from mitsvbrdf.synth import photograph
from mitsvbrdf.views import nine_view_grid

SIDE = 32


def test_pictures_that_are_rendered_one_by_one(monkeypatch):
    capture = photos_of(make_material("inlay", SIDE), GRID.pick([0, 1, 3]))
    entries, found = [Entry("flat", "x", flat(SIDE))], []
    for pixels in (rerender.PIXELS, SIDE**2):
        monkeypatch.setattr(rerender, "PIXELS", pixels)
        found.append(compare(entries, capture, ANALYTIC))
    (record, (pictures,)), (again, (others,)) = found
    assert record == again and torch.equal(pictures, others) and len(pictures) == 3


def test_seen_photos_are_measured_with_the_views_of_the_fit():
    material, shots = make_material("inlay", 16), photos_of(make_material("inlay", 16), GRID, 0.01)
    told = GRID.intensity * torch.linspace(0.8, 1.2, 9)[:, None]
    shots = replace(shots, views=replace(GRID, intensity=told))
    task = RealCapture("x", shots.pick(range(7)), shots.pick((7, 8)), (7, 8))
    fit, predict = bench_fit(task.photos, MITSUBA, HierarchicalConfig(iterations=30, exact=False, budget=600),
                             lambda share: None)
    assert fit.calibrated_rmse > 1.5 * fit.rerender_rmse  # measured 0.028 and 0.015
    found, errors = evaluate_fit(fit, shots), task.errors(fit.svbrdf, predict)
    assert found["rmse_seen"] == pytest.approx(fit.rerender_rmse, rel=1e-5) == errors["seen"]
    assert found["calibrated"]["rmse_seen"] == pytest.approx(fit.calibrated_rmse, rel=1e-5)
    assert errors["held_out"] == pytest.approx(found["rmse_held_out"], rel=1e-5)
    # photos of the same numbers from other places are others, though no folder has a name
    others = evaluate_fit(fit, photos_of(material, replace(GRID, light=GRID.light + 0.1)))
    assert others["rmse_seen"] is None and not others["fitted_views"]


def test_photos_are_seen_as_each_fit_saw_them():
    # Photos under light without falloff, in sRGB, which their folder does not say; the bound is of 8 bits.
    maps, views = make_material("inlay", SIDE), nine_view_grid(distance=1.0).pick([1, 3])
    photos = photograph(maps, replace(views, falloff="none"), ANALYTIC, transfer="srgb")
    fits = [Fit().but(falloff=falloff, transfer=transfer, shots=photos, seen=(0, 1))
            for falloff, transfer in (("none", "srgb"), ("inverse-square", "srgb"), ("none", "gamma2.2"))]
    others = Fit().but(falloff="none", transfer="srgb")  # of other photos, whose code is not that of these
    photos = replace(photos, views=views, transfer="gamma2.2")
    record, _ = compare([Entry(name, name, maps, fit) for name, fit in zip("abcd", (*fits, others))], photos,
                        ANALYTIC)
    theirs, light, code, stated = (method["rerender_rmse"] for method in record["methods"])
    assert theirs < 0.0013 and light > 0.004 and code == stated > 0.004
    whole = fits[0].but(renderer="analytic", svbrdf=maps, capture=None)
    assert evaluate_fit(whole, photos)["rerender_rmse"] == theirs
    measured = (torch.arange(SIDE) < torch.tensor([[4], [SIDE]]))[..., None].expand(2, SIDE, SIDE)
    found = evaluate_fit(whole, photos.but(measured=measured))  # of one photo, 4 of 32 rows count
    pooled = math.sqrt(sum(n * e**2 for n, e in zip((4, 32), found["per_photo"].values())) / 36)
    assert found["rmse_seen"] == pytest.approx(pooled, rel=1e-9) == found["rerender_rmse"]


def test_a_made_reference_has_the_size_of_the_maps(tmp_path):
    # More texels than the default of 256: another grain would count as an error.
    save_maps(make_material("tiles", 300), tmp_path / "maps")
    found = tmp_path / "found.json"
    assert cli.main(["evaluate", str(tmp_path / "maps"), "--reference", "builtin:tiles", "--json",
                     str(found)]) == 0
    assert max(json.loads(found.read_text()).values()) < 1e-6  # EXR keeps float32
