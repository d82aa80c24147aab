"""How many pixels of photos carry detail, of photos whose detail is known: they were enlarged from it."""

import cv2
import numpy as np
import pytest
import torch
from helpers import GRID

from mitsvbrdf.capture import Capture, read_capture, write_capture
from mitsvbrdf.capture.sharpness import carried, middle

SIDE, LEAST = 128, 32


def texture(random):
    """Values of equal contrast in each octave."""
    line = np.fft.fftfreq(SIDE)
    radius = np.hypot(line[:, None], line)
    wave = np.fft.fft2(random.normal(size=(SIDE, SIDE))) / radius.clip(1 / SIDE)
    found = np.fft.ifft2(wave).real
    return 0.4 + 0.1 * found / found.std()


@pytest.fixture(scope="module")
def sharp():
    """Photos of one texture under lights of their own, 8 bits."""
    shown, slope = texture(np.random.default_rng(2)), np.linspace(-0.3, 0.3, SIDE)
    lights = [1 + slope, 1 - slope, 1 + slope[:, None], 1 - slope[:, None]]
    return [(shown * light * 255).clip(0, 255).round().astype(np.uint8)[..., None].repeat(3, axis=2)
            for light in lights]


@pytest.mark.parametrize("times", [1, 2, 4])
@pytest.mark.parametrize("noise", [0, 5])
def test_enlarged_photos_carry_no_more(times, noise, sharp):
    side, random = times * SIDE, np.random.default_rng(0)
    photos = [cv2.resize(photo, (side, side), interpolation=cv2.INTER_CUBIC) for photo in sharp]
    photos = [(photo + random.normal(0, noise, photo.shape)).clip(0, 255).astype(np.uint8)
              for photo in photos]
    assert carried([middle(photo) for photo in photos], side, LEAST) == SIDE


def test_noise_alone_and_single_photos_carry_nothing(sharp):
    random = np.random.default_rng(1)
    noise = [random.integers(0, 255, (SIDE, SIDE, 3), np.uint8) for _ in range(4)]
    assert carried([middle(photo) for photo in noise], SIDE, LEAST) == LEAST
    assert carried([middle(sharp[0])], SIDE, LEAST) == LEAST
    assert carried([middle(np.full_like(photo, 90)) for photo in sharp], SIDE, LEAST) == LEAST


def test_a_capture_tells_what_it_carried(tmp_path, sharp):
    write_capture(Capture(torch.from_numpy(np.stack(sharp)), GRID.pick(range(4))), tmp_path)
    assert read_capture(tmp_path).carries is None
    assert read_capture(tmp_path, 100).carries is None  # hardly smaller
    assert read_capture(tmp_path, 32).carries == SIDE
