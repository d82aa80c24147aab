"""The one way in for tools that are no command, such as ``python -m mitsvbrdf.verify.soak``."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import exit_code, plain_warnings
from .streams import guard_streams, told


def run_tool(main: Callable[..., int], name: str, interrupted: str = "interrupted") -> int:
    """Run a tool with the arguments of the process, as ``mitsvbrdf`` runs its commands; returns the exit code.

    Args:
        main: its options are its parameters; returns its own exit code.
        name: what its help calls it.
        interrupted: what to say after Ctrl-C.
    """
    import tyro

    guard_streams()
    try:
        with plain_warnings():
            code = exit_code(lambda: tyro.cli(main, prog=name), interrupted)
    except SystemExit as stop:  # help was shown, or options are wrong
        code = stop.code if isinstance(stop.code, int) else 2
    return told(code)
