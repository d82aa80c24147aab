"""A result put in place all or none: what is to move is written down first, so that the next command can go
on.

A move is a rename. Which of its two names is there tells whether it is done: going on after a kill, however
often, does what is left and nothing twice.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import OutputError
from .files import atomic_write, inside, stays_inside, to_disk
from .json_files import load

# in a folder of results: what is being made, this journal, and what waits for the end of the moves
PARTIAL = ".partial"
JOURNAL, EARLIER, ADDED = ".journal", ".earlier", ".added"  # in there


@dataclass(frozen=True)
class Journal:
    """The moves that put a result in place.

    Args:
        out: the folder of results.
        staged: where the new files lie: in the partial folder, or in the folder of this name inside it.
        earlier: names of files that an earlier command put into ``out``; they go.
        new: names of files that come. Somebody else's file, or a link, that is in the way of one gets
            ``.old`` behind its name.
    """

    out: Path
    staged: str
    earlier: list[str]
    new: list[str]
    set_aside: list[tuple[Path, Path]] = field(default_factory=list, repr=False)

    @classmethod
    def left(cls, out: Path) -> Journal | None:
        """What a command that was killed left to do; None: nothing.

        Raises:
            OutputError: a journal that this package did not write.
        """
        path = out / PARTIAL / JOURNAL
        try:
            found = load(path, links=False)
            journal = cls(out, found["staged"], found["earlier"], found["new"])
            if journal.staged not in ("", ADDED) or not all(is_own(name) for name in (*journal.earlier,
                                                                                      *journal.new)):
                raise ValueError("names that lead elsewhere")
            return journal
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as reason:
            raise OutputError("the list of files that a command of this package was moving",
                              f"{path}: {reason!r}",
                              f"look at the files in {path.parent}, then move it away") from None

    def run(self) -> None:
        """Make all moves, all or none: on an error they are undone, and after a kill :meth:`left` tells what
        is left to do.

        Raises:
            OSError: they could not be made.
        """
        for name in self.new:
            to_disk(self._new(name))
        for folder in (*map(self._new, _folders(self.new)), self._partial(self.staged), self.out,
                       self.out.parent):
            _folder_to_disk(folder)
        path = self.out / PARTIAL / JOURNAL
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps({"staged": self.staged, "earlier": self.earlier,
                                             "new": self.new}))
            to_disk(temporary)
        _folder_to_disk(path.parent)
        self.go_on()

    def go_on(self) -> None:
        """Make the moves that are left; undo all where one fails.

        Raises:
            OSError: they could not be made.
        """
        try:
            self._forward()
        except BaseException:
            self._back()
            self._close()
            raise
        self._close()

    def _forward(self) -> None:
        for name in self.earlier:
            here, there = inside(self.out, name), self._earlier(name)
            # else done: what has its name now is new
            if here and os.path.lexists(here) and not os.path.lexists(there):
                _move(here, there)
        for name in self.new:
            if os.path.lexists(self._new(name)):
                self._clear(name)
                _move(self._new(name), self.out / name)

    def _back(self) -> None:
        for name in reversed(self.new):
            here, there = inside(self.out, name), self._new(name)
            if here and os.path.lexists(here) and not os.path.lexists(there):
                _move(here, there)
        for name in self.earlier:
            here, there = inside(self.out, name), self._earlier(name)
            if here and os.path.lexists(there) and not os.path.lexists(here):
                _move(there, here)
        for path, spare in reversed(self.set_aside):
            if not os.path.lexists(path):
                os.replace(spare, path)

    def _close(self) -> None:
        """Have the moves on the disk, then forget them; folders that they emptied go."""
        for emptied in sorted(_folders(self.earlier), reverse=True):
            if folder := inside(self.out, emptied):
                with contextlib.suppress(OSError):
                    folder.rmdir()  # only where nothing is left in it
        for filled in ("", *_folders(self.new)):
            _folder_to_disk(self.out / filled)
        (self.out / PARTIAL / JOURNAL).unlink()
        _folder_to_disk(self.out / PARTIAL)

    def _clear(self, name: str) -> None:
        """Let nothing be in the way of a new file."""
        path = self.out
        for part in Path(name).parts:
            path /= part
            folder = path != self.out / name and path.is_dir() and not path.is_symlink()
            if os.path.lexists(path) and not folder:
                self.set_aside.append((path, _spare(path)))
                os.replace(*self.set_aside[-1])

    def _new(self, name: str) -> Path:
        return self._partial(self.staged, name)

    def _earlier(self, name: str) -> Path:
        return self._partial(EARLIER, name)

    def _partial(self, *names: str) -> Path:
        path = inside(self.out, os.path.join(PARTIAL, *names))
        if path is None:
            raise OutputError("files and folders alone", f"a link in {self.out / PARTIAL}", "move it away")
        return path


def is_own(name: object) -> bool:
    """Whether it can be the name of a file of a result: inside its folder and outside of the partial
    folder.
    """
    return stays_inside(name) and Path(str(name)).parts[0] != PARTIAL


def _folders(names: Iterable[str]) -> set[str]:
    """All folders that files lie in, relative as their names."""
    return {str(folder) for name in names for folder in list(Path(name).parents)[:-1]}


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(source, target)


def _spare(path: Path) -> Path:
    names = (path.with_name(f"{path.name}.old{count or ''}") for count in itertools.count())
    return next(name for name in names if not os.path.lexists(name))


def _folder_to_disk(path: Path) -> None:
    with contextlib.suppress(OSError):  # some systems cannot, and some of them are gone
        to_disk(path)
