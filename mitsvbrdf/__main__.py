"""Entry point: prepares the process, then hands over to the command line; ``doctor`` works even where
packages miss.
"""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130


def main() -> int:
    """Run ``mitsvbrdf`` with the arguments of the process; returns the exit code."""
    # Raised in the middle of an import, Ctrl-C may come out as another error, or not at all: there it ends
    # the process.
    heard = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    if heard:
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    # Idle threads sleep instead of spinning: torch and Dr.Jit have a pool each and take turns. Read when
    # torch loads.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from .io.streams import guard_streams, told
    guard_streams()
    try:
        code = _run(heard)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemExit as stop:  # help was shown, or options are wrong
        code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 2
    from .cli import only_prints
    code = told(code, only_prints(sys.argv[1:]))
    # Python forgets a Ctrl-C that came out of a library's exec; else it ends by the signal, without our exit
    # code
    exec("")
    if heard:
        # libraries that are being taken down would show a traceback
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return code


def _run(heard: bool) -> int:
    try:
        from .cli import load
        from .cli import main as run
        load(sys.argv[1:])
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return run()
    except ImportError as missing:
        if (missing.name or "").partition(".")[0] == __package__:
            raise  # a fault of our own, which no installation mends
        if sys.argv[1:2] == ["doctor"]:
            from .doctor import doctor
            return doctor(json="--json" in sys.argv)
        print(f"error: expected all packages installed, got: {missing}; type ./run setup, or mitsvbrdf doctor", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
