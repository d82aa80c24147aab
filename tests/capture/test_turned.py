"""Photos turned or mirrored beside the others are found by their pattern; without one nothing is claimed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.stated_captures import json_capture

from mitsvbrdf.capture import Capture, read_capture
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.turned import WAYS, in_place, laid, laid_alike, ways
from mitsvbrdf.views import default_views

SIDE = 128


def capture(pattern: np.ndarray, count: int = 7) -> Capture:
    """Photos of a pattern, each brightest elsewhere, with noise."""
    rng, line = np.random.default_rng(3), np.linspace(-1, 1, SIDE)
    x, y = np.meshgrid(line, -line)
    lights = rng.uniform(-1, 1, (count, 2))
    photos = [pattern * np.exp(-((x - a) ** 2 + (y - b) ** 2)) + rng.normal(0, 0.02, (SIDE, SIDE))
              for a, b in lights]
    shown = torch.tensor(np.stack(photos), dtype=torch.float32).clamp(0, 1)
    return Capture(shown[..., None].repeat(1, 1, 1, 3), default_views(count), calibration="none")


def grains() -> np.ndarray:
    return np.random.default_rng(1).uniform(0.2, 0.9, (SIDE, SIDE))


def put(found: Capture, **photos: int) -> Capture:
    """With some photos in other ways, by number."""
    shown = found.photos.clone()
    for name, way in photos.items():
        shown[int(name[1:])] = laid(shown[int(name[1:]), None], way)[0]
    return replace(found, photos=shown)


@pytest.mark.parametrize("way", range(1, len(WAYS)))
def test_a_photo_in_any_way_is_laid_as_the_others(way):
    right = capture(grains())
    found = laid_alike(put(right, _4=way))
    assert torch.equal(found.photos, right.photos)
    assert [note.split(": ")[1] for note in found.notes] == ["04; laid as the others lie"]
    assert ("mirrored" in found.notes[0], "180" in found.notes[0]) == (WAYS[way][0], WAYS[way][1] == 2)


def test_several_photos_in_several_ways():
    right = capture(grains())
    assert ways(put(right, _0=2, _5=2, _6=5)) == [2, 0, 0, 0, 0, 2, 5]
    assert ways(put(right, _0=2, _1=2, _5=2, _6=5)) == [0] * 7  # only three of seven lie alike
    assert laid_alike(right) is right


def test_nothing_is_claimed_of_symmetric_or_missing_patterns():
    grain = grains()
    alike = (grain + np.rot90(grain, 2)) / 2
    assert ways(put(capture(alike), _2=2)) == [0] * 7
    assert ways(put(capture(np.full((SIDE, SIDE), 0.5)), _2=2)) == [0] * 7
    assert ways(put(capture(grain, 2), _1=2)) == [0] * 2


def test_relief_under_opposite_light_is_no_photo_turned():
    """Its shading is negative: the correlation is, and its square tells how it lies."""
    found = capture(grains())
    shown = found.photos.clone()
    shown[3] = 1 - shown[3]
    found = replace(found, photos=shown)
    assert ways(found) == [0] * 7
    assert ways(put(found, _3=2)) == [0, 0, 0, 2, 0, 0, 0]


def test_masks_and_single_pixels_turn_along_and_do_not_tell():
    right = capture(grains())
    measured = torch.ones(right.photos.shape[:3], dtype=torch.bool)
    measured[2, :40] = False
    right = replace(right, measured=measured, single=right.photos[:, ::4, ::4])
    turned = {name: torch.stack([laid(kept[None], 2)[0] if n == 2 else kept for n, kept in enumerate(
        getattr(right, name))]) for name in ("photos", "measured", "single")}
    found = laid_alike(replace(right, **turned))
    assert all(torch.equal(getattr(found, name), getattr(right, name)) for name in turned)


@pytest.mark.parametrize("resolution", [SIDE, SIDE // 4])
@pytest.mark.parametrize("stated", [True, False])
def test_reading_turns_them_before_photos_are_picked_or_shrunk(stated, resolution, tmp_path):
    coarse = grains()[::3, ::3].repeat(3, 0).repeat(3, 1)[:SIDE, :SIDE]  # features of plain photos need it
    right = (capture(coarse, 5).photos * 255).round().byte().numpy()
    wrong = right.copy()
    wrong[1] = wrong[1, ::-1, ::-1]
    folder = json_capture(tmp_path, wrong)
    found = read_capture(folder if stated else folder / "target", resolution, index=[0, 1])
    means = right[:2].reshape(2, resolution, SIDE // resolution, resolution, -1, 3).mean(axis=(2, 4))
    assert np.allclose(found.photos.numpy() * 255, means, atol=1e-3)
    assert "turned by 180 degrees beside the others, as the pattern shows: 01" in found.notes[-1]


@pytest.mark.parametrize("name", ["cards-blue", "leather-blue"])
def test_real_photos(data_folder, name):
    folder = data_folder / "captures" / name
    assert in_place([Photo.open(path) for path in photos_in(folder / "target")])  # few features agree
    found = read_capture(folder, resolution=SIDE)
    assert ways(found) == [0] * 9
    assert ways(put(found, _1=2, _6=4, _8=3)) == [0, 2, 0, 0, 0, 0, 4, 0, 1]
