"""The records in the folders of a library: their JSON as typed values."""

from __future__ import annotations

from typing import Any

import msgspec

SHORT = 8  # hex digits of an identity in the name of a folder


class File(msgspec.Struct, frozen=True):
    """Size and hash of a file."""

    bytes: int
    sha256: str


class Row(msgspec.Struct, frozen=True):
    """The figures of a fit in the list of materials; None: unknown."""

    error: float | None = None
    held_out_error: float | None = None
    burn_in: float | None = None
    warnings: list[str] = []
    photos: int | None = None
    seconds: float | None = None


class Material(msgspec.Struct, frozen=True, kw_only=True):
    """A capture, the options of its fit, and the outcome."""

    identity: str  # SHA-256 of photos and options, in hex
    name: str  # of the capture
    state: str = "pending"  # pending, failed or done; set by the folder in which the record is
    source: str = ""  # its path or URL
    asked: dict[str, Any] = {}  # method, settings and options
    words: str = ""  # the options that are not the defaults
    tags: list[str] = []  # words for a search
    date: str = ""  # when it was asked for, or its fit ended; UTC
    attempts: int = 0  # how many times its fit was begun
    base: str = ""  # paths in its options are relative to this folder
    cost: float = 0.0  # guessed seconds of its fit
    limit: float | None = None  # seconds after which its fit counts as hanging; None is no limit
    reason: str = ""  # why it failed
    log: bool = False  # whether the output of a fit that failed is kept
    host: str = ""  # where it was fitted
    row: Row = Row()  # its figures in the list
    files: dict[str, File] = {}  # of a result: relative path to size and hash

    @property
    def folder(self) -> str:
        """The name of its folder in a library."""
        return f"{self.name}-{self.identity[:SHORT]}"

    def but(self, **changes: Any) -> Material:
        """A copy with changes."""
        return msgspec.structs.replace(self, **changes)
