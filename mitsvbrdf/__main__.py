"""Entry point: prepares the process, then hands over to the command line; ``doctor`` works even where packages miss."""

from __future__ import annotations

import io
import os
import sys


def main() -> int:
    """Run ``mitsvbrdf`` with the arguments of the process; returns the exit code."""
    # Idle threads sleep instead of spinning: torch and Dr.Jit have a pool each and take turns. Read when torch loads.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal that lacks a letter gets a question mark
    try:
        from .cli import main as run
        return run()
    except KeyboardInterrupt:
        return 130
    except ImportError as missing:
        if (missing.name or "").partition(".")[0] == __package__:
            raise  # a fault of our own, which no installation mends
        if sys.argv[1:2] == ["doctor"]:
            from .doctor import doctor
            return doctor(json="--json" in sys.argv)
        print(f"error: expected all packages installed, got: {missing}; type ./run setup, or mitsvbrdf doctor", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
