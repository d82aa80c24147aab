"""The one way in for tools that are no command, such as ``python -m mitsvbrdf.verify.soak``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from ..errors import exit_code, plain_warnings
from .streams import guard_streams, told


def run_tool(main: Callable[..., int], name: str, interrupted: str = "interrupted") -> int:
    """Run a tool with the arguments of the process, as ``mitsvbrdf`` runs its commands; returns the exit
    code.

    Args:
        main: its options are its parameters; returns its own exit code.
        name: what its help calls it.
        interrupted: what to say after Ctrl-C.
    """
    _let_idle_threads_sleep()
    import tyro

    guard_streams()
    try:
        with plain_warnings():
            code = exit_code(lambda: tyro.cli(main, prog=name), interrupted)
    except SystemExit as stop:  # help was shown, or options are wrong
        code = stop.code if isinstance(stop.code, int) else 2
    return told(code)


def _let_idle_threads_sleep() -> None:
    """As :mod:`mitsvbrdf.__main__` does. Torch reads it when it loads: a tool that has loaded torch begins
    anew.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        if "torch" in sys.modules and os.name == "posix":
            os.execv(sys.executable, sys.orig_argv)
