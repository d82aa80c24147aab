"""Ctrl-C and SIGTERM: long work is asked to stop and keeps what it has; short work that must be whole is not
disturbed.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """A list that gets an entry when Ctrl-C or SIGTERM asks to stop; the third time raises
    KeyboardInterrupt.
    """
    stop: list[int] = []

    def asked_to_stop(*_: object) -> None:
        if len(stop) > 1:
            raise KeyboardInterrupt
        stop.append(1)

    pressed = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or pressed not in (
        signal.default_int_handler, signal.SIG_IGN):
        yield stop  # somebody else listens
        return
    # A job that a script starts in the background is not to hear Ctrl-C, and still is ended by SIGTERM.
    heard = (signal.SIGTERM,) if pressed == signal.SIG_IGN else (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, asked_to_stop) for number in heard}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def deferred_signals() -> Iterator[None]:
    """Ctrl-C and SIGTERM are heard once the block is done; of blocks inside each other, the outermost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: dict[int, None] = {}
    before = {number: signal.signal(number, lambda number, _: heard.setdefault(number))
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for each in sorted(heard, reverse=True):  # SIGTERM first; not after a failure, which says more
        signal.raise_signal(each)
