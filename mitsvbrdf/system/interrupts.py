"""Ctrl-C and SIGTERM: long work is asked to stop and keeps what it has; short work that must be whole is not disturbed."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """A list that gets an entry when Ctrl-C or SIGTERM asks to stop; the third time raises KeyboardInterrupt."""
    stop: list[int] = []

    def asked_to_stop(*_: object) -> None:
        if len(stop) > 1:
            raise KeyboardInterrupt
        stop.append(1)

    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler):
        yield stop  # somebody else listens
        return
    signal.signal(signal.SIGINT, asked_to_stop)
    terminate = signal.signal(signal.SIGTERM, asked_to_stop)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, terminate)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Ctrl-C and SIGTERM do nothing until the block is done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
