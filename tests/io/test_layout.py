"""Named parts of a vector."""

import numpy as np
import torch

from mitsvbrdf.io.layout import Layout

LENS = Layout(log_focal=(), centre=(2,), distortion=(2,))


def test_parts_lie_one_after_the_other():
    assert LENS.size == 5 and [LENS[name] for name in LENS.shapes] == [slice(0, 1), slice(1, 3), slice(3, 5)]


def test_what_is_packed_is_unpacked():
    parts = {"log_focal": 1.0, "centre": (2.0, 3.0), "distortion": (4.0, 5.0)}
    x = LENS.pack(**parts)
    assert x.dtype == np.float64 and x.tolist() == [1, 2, 3, 4, 5]
    found = LENS.unpack(x)
    assert found.log_focal == 1.0 and found.centre.tolist() == [2, 3] and found.distortion.tolist() == [4, 5]


def test_numbers_are_repeated_and_parts_left_out_are_zero():
    assert LENS.pack(centre=0.5).tolist() == [0, 0.5, 0.5, 0, 0]


def test_rows_of_a_tensor_are_unpacked_as_views():
    rows = torch.arange(10.0).reshape(2, 5)
    found = LENS.unpack(rows)
    assert found.log_focal.tolist() == [0, 5] and found.distortion.shape == (2, 2)
    found.centre[:] = -1
    assert rows[:, LENS["centre"]].eq(-1).all()


def test_numbers_tell_where_each_one_lies():
    layout = Layout(photos=(3, 2), common=())
    assert layout.numbers.photos.tolist() == [[0, 1], [2, 3], [4, 5]] and layout.numbers.common == 6
