"""Ctrl-C and SIGTERM: long work stops and keeps its result, short work and imports are not interrupted.

The module also has the lock for everything that a process has only once.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

# Held while Mitsuba or Dr.Jit computes, while libraries load, and while torch's random state is changed.
PROCESS = threading.RLock()
AGAIN = 0.02  # seconds after which a Ctrl-C during an import is tried again
_waiting: list[threading.Timer] = []  # the next try of such a Ctrl-C


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C: raise KeyboardInterrupt as soon as no import is running.

    During the import of an extension module, the error could end the process, become another, or be lost.
    """
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            main = threading.main_thread().ident
            _waiting[:] = [threading.Timer(AGAIN, signal.pthread_kill, (main, number))]
            _waiting[0].daemon = True
            _waiting[0].start()
            return
        frame = frame.f_back
    _waiting.clear()
    raise KeyboardInterrupt


def still_waiting() -> bool:
    """Whether a Ctrl-C came during an import and was not raised yet; if so, it is dropped."""
    waited, _waiting[:] = _waiting[:], []
    for again in waited:
        again.cancel()
    return bool(waited)


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """A list that gets an entry for each Ctrl-C or SIGTERM; the third raises KeyboardInterrupt."""
    stop: list[int] = []

    def asked_to_stop(*_: object) -> None:
        if len(stop) > 1:
            raise KeyboardInterrupt
        stop.append(1)

    pressed, ours = signal.getsignal(signal.SIGINT), (signal.default_int_handler, interrupt, signal.SIG_IGN)
    if threading.current_thread() is not threading.main_thread() or pressed not in ours:
        yield stop  # another thread, or a program's own handler
        return
    # A background job of a script must ignore Ctrl-C; SIGTERM still ends it. A program's own handler of
    # SIGTERM is kept.
    heard = [number for number, plain in ((signal.SIGINT, ours[:2]), (signal.SIGTERM, (signal.SIG_DFL,)))
             if signal.getsignal(number) in plain]
    before = {number: signal.signal(number, asked_to_stop) for number in heard}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the block; in nested blocks, to the end of the outermost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: dict[int, None] = {}
    # None: a handler set in C, which Python could not restore
    before = {number: signal.signal(number, lambda number, _: heard.setdefault(number))
              for number in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(number) is not None}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for each in sorted(heard, reverse=True):  # SIGTERM first; after a failure, only its error is raised
        signal.raise_signal(each)
