"""Signals: who listens to which, and that handlers are put back."""

import signal

import pytest

from mitsvbrdf.errors import exit_code
from mitsvbrdf.io.signals import deferred_signals, stop_signals
from mitsvbrdf.render.llvm import mitsuba_module


@pytest.fixture(autouse=True)
def handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_third_signal_does_not_wait(number):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), stop_signals() as stop:
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert len(stop) == 2
        signal.raise_signal(number)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_a_job_in_the_background_hears_sigterm_only():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell without job control starts it
    with stop_signals() as stop:
        signal.raise_signal(signal.SIGINT)
        assert not stop
        signal.raise_signal(signal.SIGTERM)
        assert stop
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


@pytest.mark.parametrize("theirs, ours", [(signal.SIGINT, None), (signal.SIGTERM, signal.SIGINT)])
def test_a_programs_own_handler_stays(theirs, ours):
    heard = []
    signal.signal(theirs, lambda *_: heard.append(1))
    with stop_signals() as stop:
        signal.raise_signal(theirs)
        assert heard and not stop
        if ours:
            signal.raise_signal(ours)
            assert stop


def test_a_handler_that_was_set_in_c_stays(monkeypatch):
    def refused(*_):
        raise TypeError("None is no handler")  # which Python would be asked to put back

    monkeypatch.setattr(signal, "getsignal", lambda number: None)  # as Python then says
    monkeypatch.setattr(signal, "signal", refused)
    with deferred_signals():
        pass


def test_what_comes_while_nobody_may_disturb_is_heard_afterwards(capsys):
    done = []

    def command():
        with deferred_signals():
            with deferred_signals():
                signal.raise_signal(signal.SIGINT)
                done.append("inner")
            done.append("outer")
        done.append("never")

    assert exit_code(command) == 130 and done == ["inner", "outer"]
    assert capsys.readouterr().err == "interrupted\n"
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell without job control starts a job
    with deferred_signals():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_ctrl_c_in_a_render_of_mitsuba_ends_with_130(capsys):
    # Dr.Jit makes a RuntimeError of whatever is raised while mi.render runs.
    mi = mitsuba_module("llvm_ad_rgb")

    class Interrupted(mi.SamplingIntegrator):
        def sample(self, *_: object, **__: object) -> None:
            signal.raise_signal(signal.SIGINT)

    mi.register_integrator("interrupted", Interrupted)
    sensor = {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}}
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "interrupted"}, "sensor": sensor})
    assert exit_code(lambda: mi.render(scene, spp=1) and 0) == 130
    assert capsys.readouterr().err.count("interrupted") == 1

    def fault() -> int:
        raise RuntimeError("a fault") from ValueError("x")

    with pytest.raises(RuntimeError, match="a fault"):
        exit_code(fault)


def test_ctrl_c_while_mitsuba_makes_a_plugin_ends_with_130(capsys):
    # Mitsuba's parser makes a RuntimeError of it that has only its text.
    mi = mitsuba_module("llvm_ad_rgb")

    class Interrupted(mi.Texture):
        def __init__(self, props: object) -> None:
            super().__init__(props)
            signal.raise_signal(signal.SIGINT)

    mi.register_texture("interrupted", Interrupted)
    assert exit_code(lambda: mi.load_dict({"type": "interrupted"}) and 0) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_the_signal_that_ends_more_comes_first():
    came = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: came.append(number))
    with deferred_signals():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert not came
    assert came == [signal.SIGTERM, signal.SIGINT]
    with pytest.raises(OSError, match="full"), deferred_signals():
        signal.raise_signal(signal.SIGINT)
        raise OSError("full")
    assert len(came) == 2  # the failure says more
