"""Signals: who listens to which, and that handlers are put back."""

import signal

import pytest

from mitsvbrdf.system.interrupts import stop_signals


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


def test_somebody_else_listens():
    heard = []
    signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    with stop_signals() as stop:
        signal.raise_signal(signal.SIGINT)
        assert heard and not stop
