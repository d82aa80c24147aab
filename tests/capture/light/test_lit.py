"""What a photo does not reach, and vignetting."""

from dataclasses import replace

import numpy as np
import pytest

from mitsvbrdf.capture.lens import Lens, Pose, project
from mitsvbrdf.capture.light.lit import filled, without_vignetting
from mitsvbrdf.capture.rig import Rig
from mitsvbrdf.errors import InputWarning


def test_vignetting_is_undone_in_linear_light():
    """A lens as dark as 0.75 in the corners before a grey wall; what is clipped stays clipped."""
    lens, pose = Lens((1200, 900), 900.0, vignetting=(-0.3, 0.05)), Pose.looking_at((3, 1, 12), (1, 0, 0))
    rig = Rig(lens, {"a": pose}, 10.0, "cm", "sheet")
    at = (np.stack(np.meshgrid((np.arange(32) + 0.5) / 32 - 0.5, 0.5 - (np.arange(32) + 0.5) / 32), axis=-1)
          * 10)
    points = np.dstack((at, np.zeros((32, 32)))).reshape(-1, 3)
    passed = lens.transmission(project(lens, pose, points)).reshape(32, 32, 1)
    assert passed.min() < 0.9
    display = ((0.4 * passed) ** (1 / 2.2)).astype(np.float32).repeat(3, axis=2)
    display[0, 0], display[5, 5] = 1.0, np.nan
    out = without_vignetting(display, rig, "a", "gamma2.2")
    assert (out[0, 0] == 1).all() and np.isnan(out[5, 5]).all()
    out[0, 0] = out[5, 5] = 0.4 ** (1 / 2.2)
    assert np.abs(out - 0.4 ** (1 / 2.2)).max() < 2e-6  # float32 there and back
    brighter = replace(rig, lens=replace(lens, vignetting=(0.3, 0.0)))  # what is clipped stays bright
    assert (without_vignetting(np.ones_like(display), brighter, "a", "gamma2.2") >= 1).all()


def test_what_a_photo_does_not_reach_is_taken_from_the_others():
    photos = np.stack([np.full((2, 2, 3), value, np.float32) for value in (0.2, 0.4, 0.9)])
    photos[0, 0, 0], photos[:, 1, 1] = np.nan, np.nan
    with pytest.warns(InputWarning, match="25.0% of the patch"):
        found, measured = filled(list(photos))
    assert np.array_equal(measured.numpy(), np.isfinite(photos).all(axis=-1))
    found = found.numpy()
    assert found[0, 0, 0] == pytest.approx(0.65)
    assert np.array_equal(found[:, 1, 1], photos[:, 0, 1])  # seen in none: the nearest texel of each
    untouched = np.isfinite(photos)
    assert np.array_equal(found[untouched], photos[untouched])
