"""A guard as an actor of Ray; a module of its own, so that a node loads it from its own mitsvbrdf."""

from __future__ import annotations

from pathlib import Path

from .guard import Guard, die_with_parent


class WorkerActor(Guard):
    """A guard that dies with its node, even while it waits for a task, and can be asked what it sees; see
    Guard for Args.
    """

    def __init__(self, *settings: object) -> None:
        die_with_parent()
        super().__init__(*settings)  # type: ignore[arg-type]

    def sees(self, file: str, content: str) -> bool:
        """Whether this machine has that file with that content."""
        try:
            return Path(file).read_text(encoding="utf-8") == content
        except (OSError, UnicodeDecodeError):
            return False
