"""The edge of the Python API: a program's own defaults come back, whatever happens behind it."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import pytest
import torch
from helpers import GRID
from torch import Tensor

from mitsvbrdf import color
from mitsvbrdf.capture import Capture
from mitsvbrdf.io import entry as edge
from mitsvbrdf.io.entry import entry


def test_each_thread_has_its_number_of_threads_again(monkeypatch):
    monkeypatch.setattr(edge, "SPINS", True)
    before, entered, leave = torch.get_num_threads(), threading.Event(), threading.Event()

    @entry()
    def long():
        entered.set()
        leave.wait(10)

    @entry()
    def seen():
        return torch.get_num_threads()

    try:
        torch.set_num_threads(3)
        with ThreadPoolExecutor(2) as pool:
            other = pool.submit(long)
            entered.wait(10)
            new = pool.submit(lambda: (seen(), torch.get_num_threads()))
            assert seen() == 1 and torch.get_num_threads() == 3 and new.result() == (1, 3)
            leave.set()
            other.result()
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


@pytest.fixture
def float64():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@entry()
def numbers():
    return torch.ones(2)


@entry(gradients=True)
def slope(x):
    assert not torch.is_inference_mode_enabled()
    x = x.detach().requires_grad_()
    return torch.autograd.grad((x * x).sum(), x)[0]


def test_numbers_are_float32_behind_the_edge_and_the_default_comes_back(float64):
    assert numbers().dtype == torch.float32 and torch.ones(1).dtype == torch.float64

    @entry()
    def failing():
        numbers()  # one edge inside another
        assert torch.ones(1).dtype == torch.float32
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        failing()
    assert torch.ones(1).dtype == torch.float64


def test_calls_that_overlap_in_threads_leave_the_default_as_the_first_found_it(float64):
    entered, leave = [threading.Event(), threading.Event()], [threading.Event(), threading.Event()]

    @entry()
    def call(k):
        entered[k].set()
        leave[k].wait(10)
        return torch.ones(1).dtype

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(call, 0)
        entered[0].wait(10)
        second = pool.submit(call, 1)
        entered[1].wait(10)
        leave[0].set()
        assert first.result() == torch.float32
        leave[1].set()
        assert second.result() == torch.float32  # though the first has left
    assert torch.get_default_dtype() == torch.float64


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_gradients_are_recorded_where_they_are_needed(mode):
    with mode():
        assert torch.equal(slope(torch.ones(2)), torch.full((2,), 2.0))
        assert not torch.is_grad_enabled() and numbers().requires_grad is False
        assert not numbers().is_inference()


def test_tensors_of_inference_mode_stay_outside():
    @dataclass(frozen=True)
    class Held:
        maps: dict[str, Tensor]
        pair: tuple[Tensor, int]
        name: str = "x"

    @entry()
    def given(held, tensors):
        return held, tensors

    ordinary = torch.zeros(3)
    with torch.inference_mode():
        made = torch.ones(3)
    held, (first, second) = given(Held({"a": made, "b": ordinary}, (made, 2)), [made, ordinary])
    assert not any(each.is_inference() for each in (held.maps["a"], held.pair[0], first))
    assert held.maps["b"] is ordinary and second is ordinary
    assert torch.equal(held.maps["a"], made) and held.name == "x"
    untouched = Held({"b": ordinary}, (ordinary, 1))
    assert given(untouched, [])[0] is untouched


def test_photos_kept_in_8_bits_pass_as_they_are(monkeypatch):
    capture = Capture(torch.full((9, 4, 4, 3), 51, dtype=torch.uint8), GRID)
    kept, told = entry()(lambda capture: (capture.stored, capture.photos))(capture)
    assert kept is capture.stored and torch.equal(told, torch.full((9, 4, 4, 3), 0.2))
    monkeypatch.setattr(color, "shown", lambda stored: pytest.fail("the photos were decoded"))
    assert entry()(lambda capture: capture)(capture) is capture
    with torch.inference_mode():
        capture = capture.but(photos=torch.full((9, 4, 4, 3), 51, dtype=torch.uint8))
    assert not entry()(lambda capture: capture)(capture).stored.is_inference()
