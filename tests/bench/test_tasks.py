"""What is fitted, and what nobody's fit may see."""

import pytest
import torch
from helpers import ANALYTIC, GRID, photos_of

from mitsvbrdf.bench.tasks import find_tasks, known_material, novel_views, real_capture
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    for name in ("cards-blue", "wood"):
        write_capture(photos_of(make_material("inlay", 16)), folder / "captures" / name)
    save_maps(make_material("leather", 16), folder / "materials/hide")
    return folder


def found(data, materials=None, captures=None, views=None):
    return find_tasks(materials, captures, data, 16, (4, 7), views, ANALYTIC)


def test_photos_held_out_are_in_no_fit(data):
    whole, task = (real_capture(data / "captures/wood", 16, held) for held in ((99,), (7, 8)))
    assert task.photos.index == (0, 1, 2, 3, 4, 5, 6) and task.unseen.index == (7, 8)
    for seen in task.photos.photos:
        assert not any(torch.equal(seen, whole.photos.photos[number]) for number in (7, 8))
    assert torch.equal(task.unseen.photos, whole.photos.photos[7:]) and whole.unseen is None
    with pytest.raises(ConfigError, match="photos besides"):
        real_capture(data / "captures/wood", 16, range(9))


def test_tasks_are_found_by_name(data):
    assert " ".join(t.name for t in found(data)) == "hide inlay tiles leather plates cards-blue wood"
    (hide, wood) = found(data, ["hide"], ["wood"])
    assert hide.folder == data / "materials/hide" and hide.key["views"] == "cards-blue"
    assert wood.key == {"kind": "capture", "name": "wood", "resolution": 16, "held_out": [4, 7],
                        "content": wood.key["content"]} and wood.key["content"] != hide.key["content"]
    assert found(data, ["inlay"], ["none"], "builtin:grid")[0].key["views"] == "builtin:grid"


def test_a_perfect_fit_has_no_error_and_a_wrong_one_has(data):
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    right, wrong = (task.errors(each, lambda _: 0.25) for each in (task.truth, make_material("plates", 16)))
    assert right["mean"] == 0 and right["novel_light"] < 1e-6 and right["photos"] == 0.25
    assert wrong["mean"] > 0.05 and wrong["novel_light"] > 0.05


def test_new_lights_are_far_from_the_lens():
    views = novel_views(GRID)
    ray = torch.nn.functional.normalize(views.light.double(), dim=-1)
    upright = torch.nn.functional.normalize(views.camera.double(), dim=-1)
    angles = torch.rad2deg(torch.arccos((ray * upright).sum(-1)))
    assert torch.allclose(angles, torch.tensor([25.0] * 4 + [50.0] * 4, dtype=torch.float64), atol=1e-3)
