"""What a library states of its materials: the JSON of its folders, as typed values."""

from __future__ import annotations

from typing import Any

import msgspec

SHORT = 8  # letters of an identity that the name of a folder has


class File(msgspec.Struct, frozen=True):
    """What a record states of a file."""

    bytes: int
    sha256: str


class Row(msgspec.Struct, frozen=True):
    """What the list of materials tells of a fit; None is not known."""

    error: float | None = None
    held_out_error: float | None = None
    burn_in: float | None = None
    warnings: list[str] = []
    method: str | None = None
    resolution: int | None = None
    photos: int | None = None
    preview: str | None = None
    report: str | None = None
    seconds: float | None = None
    peak_bytes: int | None = None


class Material(msgspec.Struct, frozen=True, kw_only=True):
    """A capture and what is asked for.

    Args:
        identity: SHA-256 of photos and options, in hex.
        name: of the capture.
        source: its path or URL.
        asked: method, settings and options.
        words: the options as they are typed.
        tags: words to find it by.
        date: when it was asked for, or its fit ended; UTC.
        attempts: how often a fit began.
    """

    identity: str
    name: str
    source: str = ""
    asked: dict[str, Any] = {}
    words: str = ""
    tags: list[str] = []
    date: str = ""
    attempts: int = 0

    @property
    def folder(self) -> str:
        """The name of its folder in a library."""
        return f"{self.name}-{self.identity[:SHORT]}"

    def stated(self) -> dict[str, Any]:
        """What all kinds of materials state."""
        return {name: getattr(self, name) for name in Material.__struct_fields__}


class Pending(Material, frozen=True, kw_only=True):
    """A material that is not fitted yet.

    Args:
        base: the folder where paths in its options start.
        cost: seconds that its fit takes, at a guess.
        limit: seconds after which its fit counts as hanging; None is no limit.
    """

    base: str
    cost: float
    limit: float | None


class Failure(Material, frozen=True, kw_only=True):
    """A material whose fit failed: how its last attempt ended, why, and whether a log lies beside that."""

    state: str
    reason: str
    log: bool = False


class Result(Material, frozen=True, kw_only=True):
    """A material that is done."""

    row: Row
    files: dict[str, File]
    host: str = ""
