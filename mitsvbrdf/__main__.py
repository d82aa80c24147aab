"""Entry point: prepares the process, then runs the command line. ``doctor`` runs with packages missing."""

import os
import signal
import sys

INTERRUPTED = 130


def main() -> int:
    """Run ``mitsvbrdf`` with the arguments of the process; returns the exit code."""
    heard = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    if heard:  # until the command runs, Ctrl-C ends the process at once and without a message
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Idle threads sleep: torch and Dr.Jit have a pool each, and compute in turn. Torch reads this on loading.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        code = _run(heard)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemExit as stop:  # help was shown, or options are wrong
        code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 2
    if heard:  # else Ctrl-C during shutdown would show a traceback
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from .io.streams import told
    except ImportError:  # a package is missing, and was named
        return code
    return told(code)


def _run(heard: bool) -> int:
    try:
        from .io.signals import interrupt
        if heard:
            signal.signal(signal.SIGINT, interrupt)
        from .io.streams import guard_streams
        guard_streams()
        from .cli import main as run
        return run()
    except ImportError as missing:
        if (missing.name or "").partition(".")[0] == __package__:
            raise  # a fault of our own, which no installation mends
        if sys.argv[1:2] == ["doctor"]:
            from .doctor import doctor
            return doctor(json="--json" in sys.argv)
        print(f"error: expected all packages installed, got: {missing}; "
              "type ./run setup, or mitsvbrdf doctor", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
