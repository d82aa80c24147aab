"""The errors of the package. Each says what was expected, what came, and the way out.

Every deliberate error derives from :class:`MitsvbrdfError`. The command line prints it as one message and
exits with 2. A fault that was corrected is a Python warning, on the command line a line of its own.
"""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any


class MitsvbrdfError(Exception):
    """A mistake that the caller can correct.

    Args:
        expected: the right input, in a few words.
        got: the actual input, with its name or value.
        fix: the way out.
    """

    def __init__(self, expected: str, got: str, fix: str) -> None:
        super().__init__(f"expected {expected}, got {got}; {fix}")
        self.expected, self.got, self.fix = expected, got, fix


LARGEST = 1e10  # of any number in an option: float32 holds its square


class CaptureError(MitsvbrdfError):
    """Photos or their calibration cannot be used."""


class MapsError(MitsvbrdfError):
    """Material maps cannot be used."""


class InputWarning(UserWarning):
    """A damaged or corrected file is used; the message names the file and the fault."""


class NotFiniteError(MapsError, CaptureError):
    """A map or a view has values that are NaN or infinite."""


class MapsWarning(InputWarning):
    """Material maps were corrected; the message says what, where, and in how many texels."""


class OutputError(MitsvbrdfError):
    """A result cannot be written to its place."""


class ConfigError(MitsvbrdfError):
    """Options are out of range or contradict each other."""


class BackendError(MitsvbrdfError):
    """Mitsuba, Dr.Jit or libLLVM is missing or does not work here."""


@contextlib.contextmanager
def strict(wanted: bool = True) -> Iterator[None]:
    """Inside, an :class:`InputWarning` is an error, if wanted."""
    with warnings.catch_warnings():
        if wanted:
            warnings.simplefilter("error", InputWarning)
        try:
            yield
        except InputWarning as warning:
            raise MitsvbrdfError("files without a fault", str(warning), "or leave --strict out") from None


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Inside, a warning of this package is one line on standard error, printed once, without its place."""
    said = set()
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                if str(message) not in said:  # Python forgets printed warnings when a filter changes
                    print(f"warning: {message}", file=sys.stderr)
                said.add(str(message))
            else:
                others(message, category, *place, **more)

        warnings.showwarning = show
        yield


def exit_code(command: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command. A mistake becomes one line and exit code 2, Ctrl-C one line and 130.

    Args:
        command: returns its own exit code.
        interrupted: the line after Ctrl-C.
    """
    try:
        return _interruptible(command)
    except MitsvbrdfError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except UnicodeEncodeError as error:
        if error.reason != "surrogates not allowed":
            raise  # a fault of our own, not of a name
        near = error.object[max(0, error.start - 40):error.end + 20]
        near = near.encode("utf-8", "backslashreplace").decode()
        print(f"error: expected names of files in UTF-8, got {near}; rename the file or folder",
              file=sys.stderr)
        return 2
    except OSError as error:
        place, got = error.filename or "a file", error.strerror or error
        print(f"error: expected to read or write {place}, got {got}; check the name and your rights to it",
              file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "allocate memory" not in str(error):  # torch's words for it
            raise
        got = str(error).splitlines()[0] if str(error) else "too little"
        print(f"error: expected enough memory, got {got}; choose a lower --resolution, or fewer photos",
              file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)
        return 130


def _interruptible(command: Callable[[], int]) -> int:
    """Run a command. Ctrl-C in a render of Mitsuba is KeyboardInterrupt again, not Dr.Jit's RuntimeError."""
    try:
        return command()
    except RuntimeError as error:
        cause = error.__cause__
        while cause and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause:
            raise cause from None
        raise
