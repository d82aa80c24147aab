"""Photos saved upside down are found by the flash."""

import numpy as np
import pytest
from helpers.made_photos import LENS, ground, poses, stored, taken

from mitsvbrdf.capture.light.upside_down import Flashes
from mitsvbrdf.capture.photo import Photo, photos_in
from mitsvbrdf.capture.stages import make_capture


def asked(flashes, sd):
    """What independent photos ask that measured their flashes (M x 2) with this deviation."""
    return Flashes(flashes, np.tile(np.eye(2) / sd**2, (len(flashes), 1, 1)), np.eye(2) / 4)


@pytest.mark.parametrize("turned", [[3], [0], [1, 3, 5, 7], [0, 1, 2, 4, 5, 6, 7, 8]])
def test_those_on_the_other_side_are_the_fewer(turned):
    signs = np.ones(9)
    signs[turned] = -1
    noise = 0.05 * np.random.default_rng(0).standard_normal((9, 2))
    signs *= np.sign(signs.sum())
    assert asked(signs[:, None] * (1.5, 0.4) + noise, 0.05).likeliest().tolist() == signs.tolist()
    assert asked((1.5, 0.4) + noise, 0.05).turned(signs)


@pytest.mark.parametrize("seed", range(10))
def test_a_flash_at_the_lens_or_more_noise_than_stated_turns_nothing(seed):
    noise = np.random.default_rng(seed).standard_normal((9, 2))
    for flashes in (asked(0.05 * noise, 0.05), asked(noise, 0.05)):
        signs = flashes.likeliest()  # turned as suits the noise best, it is no more than noise
        assert not asked(signs[:, None] * noise * 0.05, 0.05).turned(signs)
        assert not asked(signs[:, None] * noise, 0.05).turned(signs)


@pytest.mark.slow
def test_photos_saved_upside_down_are_turned_and_named_and_a_phone_held_so_is_not(tmp_path):
    what, true = ground(), dict(list(poses().items())[:6])
    true["IMG_0.jpg"] = true["IMG_0.jpg"].upside_down()  # held so: its flash turns with it
    for i, (name, pose) in enumerate(true.items()):
        photo = taken(what, LENS, pose, seed=i)
        stored(tmp_path / name, np.rot90(photo, 2) if i in (2, 3) else photo)
    made = make_capture([Photo.open(path) for path in photos_in(tmp_path)], 18.0, resolution=64)
    assert made.used == list(true)
    assert [note for note in made.warnings if "saved upside down" in note and "IMG_2.jpg, IMG_3.jpg;" in note]
    light = np.stack([pose.flash(LENS) for pose in true.values()])
    # 1.4 cm beside the lens
    assert np.linalg.norm(made.capture.views.light.numpy() - light, axis=1).max() < 0.1
