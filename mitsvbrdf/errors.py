"""The package's errors: each says what was expected, what came, and the way out.

Everything raised on purpose derives from :class:`MitsvbrdfError`; the command line turns it into one
message and exit code 2.
"""

from __future__ import annotations


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


class CaptureError(MitsvbrdfError):
    """Photos or their calibration cannot be used."""


class MapsError(MitsvbrdfError):
    """Material maps cannot be used."""


class OutputError(MitsvbrdfError):
    """A result cannot be written where it was asked for."""


class ConfigError(MitsvbrdfError):
    """Options that do not fit together, or out of range."""


class BackendError(MitsvbrdfError):
    """Mitsuba, Dr.Jit or libLLVM is missing or does not work here."""
