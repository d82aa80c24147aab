"""The errors of the package. Each says what was expected, what came, and the way out.

Every deliberate error derives from :class:`MitsvbrdfError`. The command line prints it as one message and
exits with 2. A fault that was corrected is a Python warning, which the command line prints as one line.
"""

import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any


class MitsvbrdfError(Exception):
    """A mistake that the caller can correct: the expected input, the input given, and the way out."""

    def __init__(self, expected: str, got: str, fix: str) -> None:
        super().__init__(f"expected {expected}, got {got}; {fix}")
        self.expected, self.got, self.fix = expected, got, fix

    def __reduce__(self) -> tuple:
        return type(self), (self.expected, self.got, self.fix)  # else other processes could not receive it


LARGEST = 1e10  # largest number in an option: float32 holds its square


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


class AssumedWarning(UserWarning):
    """A file does not state what it contains; the message says what is assumed, and how to overrule that."""


class OutputError(MitsvbrdfError):
    """A result cannot be written to its place."""


class ConfigError(MitsvbrdfError):
    """Options are out of range or contradict each other."""


class BackendError(MitsvbrdfError):
    """Mitsuba, Dr.Jit or libLLVM is missing or does not work here."""


@contextlib.contextmanager
def strict(wanted: bool = True) -> Iterator[None]:
    """Inside, an :class:`InputWarning` becomes a :class:`MitsvbrdfError`, if ``wanted``."""
    with warnings.catch_warnings():
        if wanted:
            warnings.simplefilter("error", InputWarning)
        try:
            yield
        except InputWarning as warning:
            raise MitsvbrdfError("files without a fault", str(warning), "or leave --strict out") from None


_notes: ContextVar[tuple[list[str], ...]] = ContextVar("_notes", default=())  # one for each :func:`noted`


def warn_of(fault: str, path: Path | None = None, stacklevel: int = 2) -> None:
    """Warn of a fault: the :class:`InputWarning` begins with the path, the note with the file's name."""
    for notes in _notes.get():
        notes.append(f"{Path(os.path.abspath(path)).name if path else ''}{fault}")
    warnings.warn(f"{path or ''}{fault}", InputWarning, stacklevel=stacklevel + 1)


@contextlib.contextmanager
def noted() -> Iterator[list[str]]:
    """A list. Inside, each :func:`warn_of` of this thread adds a note: the file's name and the fault."""
    notes: list[str] = []
    token = _notes.set((*_notes.get(), notes))
    try:
        yield notes
    finally:
        _notes.reset(token)


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Inside, each warning of this package is printed once: one line on standard error, no file or line."""
    said = set()
    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, (InputWarning, AssumedWarning)):
                kind = "note" if issubclass(category, AssumedWarning) else "warning"
                if str(message) not in said:  # Python forgets printed warnings when a filter changes
                    print(f"{kind}: {message}", file=sys.stderr)
                said.add(str(message))
            else:
                others(message, category, *place, **more)

        warnings.showwarning = show
        yield


def exit_code(command: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Run a command. A mistake prints one line and returns exit code 2; Ctrl-C prints one and returns 130."""
    try:
        return command()
    except (Exception, KeyboardInterrupt) as error:
        if _is_of_ctrl_c(error):
            print(interrupted, file=sys.stderr)
            return 130
        if (said := _said(error)) is None:
            raise
        print(f"error: {said}", file=sys.stderr)
        return 2


def _said(error: BaseException) -> str | None:
    """The message of a mistake that the user can correct; None for a fault of the package."""
    if isinstance(error, MitsvbrdfError):
        return str(error)
    if isinstance(error, UnicodeEncodeError) and error.reason == "surrogates not allowed":
        name = error.object[max(0, error.start - 40):error.end + 20].encode("utf-8", "backslashreplace")
        return f"expected names of files in UTF-8, got {name.decode()}; rename the file or folder"
    if isinstance(error, OSError):
        return (f"expected to read or write {error.filename or 'a file'}, got {error.strerror or error}; "
                "check the name and your rights to it")
    of_torch = isinstance(error, RuntimeError) and "allocate memory" in str(error)
    if isinstance(error, MemoryError) or of_torch:
        return (f"expected enough memory, got {str(error).splitlines()[0] if str(error) else 'too little'}; "
                "choose a lower --resolution, or fewer photos")
    return None


def _is_of_ctrl_c(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: Dr.Jit makes KeyboardInterrupt a RuntimeError, CPython a SystemError.

    Of an error in a plugin's ``__init__``, Mitsuba keeps only the text.
    """
    while not (error is None or isinstance(error, KeyboardInterrupt) or "KeyboardInterrupt" in str(error)):
        error = error.__cause__ or error.__context__
    return error is not None
