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
    photos: int | None = None
    seconds: float | None = None


class Material(msgspec.Struct, frozen=True, kw_only=True):
    """A capture, what is asked for, and what came of it.

    Args:
        identity: SHA-256 of photos and options, in hex.
        name: of the capture.
        state: pending, failed or done; the place of a record says it.
        source: its path or URL.
        asked: method, settings and options.
        words: the options that are not the defaults.
        tags: words to find it by.
        date: when it was asked for, or its fit ended; UTC.
        attempts: how often a fit began.
        base: the folder where paths in its options start.
        cost: seconds that its fit takes, at a guess.
        limit: seconds after which its fit counts as hanging; None is no limit.
        reason: why it failed.
        log: whether the output of a fit that failed is kept.
        host: where it was fitted.
        row: what the list tells.
        files: of a result.
    """

    identity: str
    name: str
    state: str = "pending"
    source: str = ""
    asked: dict[str, Any] = {}
    words: str = ""
    tags: list[str] = []
    date: str = ""
    attempts: int = 0
    base: str = ""
    cost: float = 0.0
    limit: float | None = None
    reason: str = ""
    log: bool = False
    host: str = ""
    row: Row = Row()
    files: dict[str, File] = {}

    @property
    def folder(self) -> str:
        """The name of its folder in a library."""
        return f"{self.name}-{self.identity[:SHORT]}"

    def but(self, **changes: Any) -> Material:
        """Itself with changes."""
        return msgspec.structs.replace(self, **changes)
