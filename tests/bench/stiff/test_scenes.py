"""What stiff fits are given is as spoilt as it is said to be, and what the photos allow is counted as errors
are.
"""

import math

import pytest
import torch
from helpers import GRID

from mitsvbrdf.bench.stiff.scenes import CASES, SERIES, StiffTask, stated, stiff_tasks
from mitsvbrdf.color import CLIPPED
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.metrics import map_rmse

SIDE = 16


def task(name):
    return StiffTask("case", name, CASES[name], SIDE)


@pytest.mark.parametrize("name", [name for name, scene in CASES.items() if scene.clipped])
def test_three_pixels_of_ten_are_clipped(name):
    share = float((task(name).photos.photos >= CLIPPED).any(dim=-1).float().mean())
    assert share == pytest.approx(0.3, abs=0.03)  # noise, and values from 0.995 to 1


def test_a_fit_is_told_what_is_stated_and_the_photos_are_of_the_truth():
    weak, off = task("light stated 4x too weak"), task("camera positions 5 % off")
    torch.testing.assert_close(weak.photos.views.intensity, GRID.intensity / 4)
    torch.testing.assert_close(weak.photos.photos, task("nothing wrong").photos.photos)
    away = (off.photos.views.camera - GRID.camera).norm(dim=1) / GRID.camera.norm(dim=1)
    torch.testing.assert_close(away, torch.full((9,), 0.05, dtype=torch.float64))
    assert torch.equal(off.seen.views.camera, GRID.camera)
    same, single = task("nine identical photos"), task("a single photo")
    assert torch.equal(same.photos.photos, same.photos.photos[:1].expand(9, -1, -1,
                                                                         -1)) and len(same.photos.views) == 9
    assert len(same.seen) == len(single.photos) == 1 and len(
        torch.unique(task("constant grey photos").photos.photos)) == 1


def test_the_materials_are_as_extreme_as_they_are_called():
    both = task("metal of roughness 0.05, deep relief, 30 % clipped").truth
    assert float(both["diffuse"].max()) == 0 and float(both["roughness"].max()) == pytest.approx(0.05)
    plain = make_material("tiles", SIDE)["normal"]
    slopes, steeper = (n[..., :2] / n[..., 2:] for n in (plain, both["normal"]))
    torch.testing.assert_close(steeper, 3 * slopes, atol=1e-5, rtol=1e-4)
    both.check()


def test_deviations_are_counted_as_errors_of_maps_are():
    """Of maps that are off by known deviations: both ways to count agree."""
    truth, rng = make_material("leather", 64), torch.Generator().manual_seed(0)
    spread = {"roughness": torch.full((64, 64, 1), 0.01), "normal": torch.full((64, 64, 2), 0.02)}
    xy = truth["normal"][..., :2] + 2 * 0.02 * torch.randn(64, 64, 2, generator=rng)
    normal = torch.cat((xy, (1 - xy.square().sum(dim=-1, keepdim=True)).sqrt()), dim=-1)
    rough = truth["roughness"] + 0.01 * torch.randn(64, 64, 1, generator=rng)
    errors = map_rmse(SVBRDF(truth.bsdf, {**truth.maps, "normal": normal, "roughness": rough}), truth)
    found = stated(spread)
    assert errors["roughness"] == pytest.approx(found["roughness"], rel=0.05)
    assert errors["normal"] == pytest.approx(found["normal"], rel=0.05)
    assert found["mean"] == pytest.approx((found["roughness"] + found["normal"]) / 2)


@pytest.mark.slow
def test_every_series_goes_from_harmless_to_extreme():
    tasks = {t.name: t for t in stiff_tasks(8)[1]}
    assert len(tasks) == sum(map(len, SERIES.values()))
    for series, members in SERIES.items():
        first, *_, last = (tasks[f"{series}: {member}"] for member in members)
        assert (last.known["condition"]["median"]
                or math.inf) > 100 * first.known["condition"]["median"], series
        assert last.known["attainable"]["mean"] > 2 * first.known["attainable"]["mean"], series


def test_photos_of_no_material_have_no_truth_and_the_true_maps_meet_the_others():
    assert task("constant grey photos").known == {"condition": {}, "attainable": {}, "start": {}}
    known = task("nothing wrong").known
    assert 0 < known["attainable"]["photos"] < 0.02 < known["start"]["mean"]
