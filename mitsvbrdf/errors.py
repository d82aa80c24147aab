"""The package's errors: each says what was expected, what came, and the way out.

Everything raised on purpose derives from :class:`MitsvbrdfError`; the command line turns it into one
message and exit code 2. What was mended instead is a Python warning, on the command line a line of its own.
"""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any


class MitsvbrdfError(Exception):
    """A mistake the caller can mend.

    Args:
        expected: what would have been right, in a few words.
        got: what came instead, with its name or value.
        fix: what to do now.
    """

    def __init__(self, expected: str, got: str, fix: str) -> None:
        super().__init__(f"expected {expected}, got {got}; {fix}")
        self.expected, self.got, self.fix = expected, got, fix


LARGEST = 1e10  # of any number that is asked for: its square, and that one's, still are float32


class CaptureError(MitsvbrdfError):
    """Photos or their calibration cannot be used."""


class MapsError(MitsvbrdfError):
    """Material maps cannot be used."""


class InputWarning(UserWarning):
    """A file is damaged or was mended, and is used all the same; says which, and what is wrong."""


class NotFiniteError(MapsError, CaptureError):
    """A map or a view has values that are NaN or infinite."""


class MapsWarning(InputWarning):
    """Something in material maps was mended; says what, where, and how many texels."""


class OutputError(MitsvbrdfError):
    """A result cannot be written where it was asked for."""


class ConfigError(MitsvbrdfError):
    """Options that do not fit together, or out of range."""


class BackendError(MitsvbrdfError):
    """Mitsuba, Dr.Jit or libLLVM is missing or does not work here."""


@contextlib.contextmanager
def strict(wanted: bool = True) -> Iterator[None]:
    """Inside, what would be an :class:`InputWarning` is an error, where wanted."""
    with warnings.catch_warnings():
        if wanted:
            warnings.simplefilter("error", InputWarning)
        try:
            yield
        except InputWarning as warning:
            raise MitsvbrdfError("files without a fault", str(warning), "or leave --strict out") from None


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Inside, warnings of this package are single lines on standard error, each once, without the place in
    the code.
    """
    said = set()
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                if str(message) not in said:  # Python forgets what it said whenever a filter changes
                    print(f"warning: {message}", file=sys.stderr)
                said.add(str(message))
            else:
                others(message, category, *place, **more)

        warnings.showwarning = show
        yield


def exit_code(command: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command; mistakes and Ctrl-C become one line and an exit code, 2 and 130.

    Args:
        command: returns its own exit code.
        interrupted: what to say after Ctrl-C.
    """
    try:
        return _interruptible(command)
    except MitsvbrdfError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except UnicodeEncodeError as error:
        if error.reason != "surrogates not allowed":
            raise  # a fault of our own, not of a name
        near = error.object[max(0, error.start - 40):error.end + 20].encode("utf-8",
                                                                            "backslashreplace").decode()
        print(f"error: expected names of files in UTF-8, got {near}; rename the file or folder",
              file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: expected to read or write {error.filename or 'a file'}, got "
              f"{error.strerror or error}; check the name "
              "and your rights to it", file=sys.stderr)
        return 2
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "allocate memory" not in str(error):  # torch's words for it
            raise
        print("error: expected enough memory, got "
              f"{str(error).splitlines()[0] if str(error) else 'too little'}; "
              "choose a lower --resolution, or fewer photos", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)
        return 130


def _interruptible(command: Callable[[], int]) -> int:
    """Run a command; Ctrl-C is KeyboardInterrupt again where Dr.Jit made a RuntimeError of it, in a render of
    Mitsuba.
    """
    try:
        return command()
    except RuntimeError as error:
        cause = error.__cause__
        while cause and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause:
            raise cause from None
        raise
