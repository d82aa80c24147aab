"""Result folders that appear whole or not at all, and in which nobody else's file is lost.

A result is made in a hidden folder inside its place and then moved; a manifest lists the files that are ours,
so that ``--overwrite`` takes away those alone, with what commands made of them in there; a lock keeps two
runs apart. An unfinished run leaves what it can be resumed from, and moves that a kill ended are made by the
next command that opens the folder (:mod:`.journal`).

The folder that a user names may be a link. Inside, a link, a pipe or a device is never gone through.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ..errors import OutputError
from .files import check_output, inside, is_regular, open_regular, remove
from .interrupts import deferred_signals
from .journal import ADDED, JOURNAL, PARTIAL, Journal, is_own
from .json_files import load
from .progress import say

MANIFEST = ".mitsvbrdf"  # in each folder we make: the files we put there
CHECKPOINT = "checkpoint.safetensors"
LIVE = "live.safetensors"  # what a running fit is watched through; no part of the result
LOCK = ".lock"
# Folders that commands make of maps, inside their folder where no other is named, and a file by which each is
# known.
DERIVED = {"export": "export.json", "relight": "relight.json"}
PATIENCE = 5.0  # seconds that another command may take to put its result in place
GLANCE = 0.05  # seconds that somebody who asks :func:`in_use` may take


def partial_folder(out: Path) -> Path:
    """Where a result lies while it is being made: inside ``out``, so that putting it in place is a rename."""
    return Path(out) / PARTIAL


@contextlib.contextmanager
def output_folder(out: Path, overwrite: bool, resume: bool = False, keep: tuple[str, ...] = (CHECKPOINT,),
                  add: bool = False) -> Iterator[Path]:
    """Make the files of a result folder all or not at all.

    Yields the folder to write into, inside :func:`partial_folder`. When the block ends well its files move to
    ``out``, those that an earlier run put there (the manifest lists them) go, with what commands made of them
    in :data:`DERIVED` folders, and files of anybody else stay: one that is in the way gets ``.old`` behind
    its name. What goes so or stays beside is said. When the block fails only what a later run resumes from is
    kept.

    Args:
        out: the folder the caller asked for.
        overwrite: whether earlier results, or an unfinished run, may be replaced.
        resume: go on in the partial folder that an interrupted run left.
        keep: files and folders to resume from.
        add: the files join earlier ones and replace those of the same name alone; an unfinished run stays as
            it is.

    Raises:
        OutputError: ``out`` has results, is no folder, is in use by another run, or cannot be written; or a
            link, or a file of another user, is where an unfinished run's files are.
    """
    out = Path(os.path.realpath(out))
    partial = partial_folder(out)
    staged = partial / ADDED if add else partial
    keep = (CHECKPOINT, LIVE) if add else keep
    try:
        settle(out)
        if not add:
            _check_free(out, overwrite, resume, keep)
        made = not out.exists()
        partial.mkdir(parents=True, exist_ok=True)
        lock = _locked(out)
        _empty(partial, (LOCK, *keep) if resume or add else (LOCK,))
        staged.mkdir(exist_ok=True)
    except OSError as reason:
        raise OutputError(f"a place to write at {out}", reason.strerror or str(reason),
                          "free space, or choose a folder you may write to") from None
    done = False
    try:
        yield staged
        with deferred_signals():
            earlier, made_of_it = ([], {}) if add else (own_files(out), derived(out))
            _put_in_place(out, staged, add)
            done = True
            if earlier:
                _say_beside(out, made_of_it)
    except OSError as reason:
        raise OutputError(f"to write {out}", reason.strerror or str(reason),
                          "free space or choose another place") from None
    finally:
        if os.name == "nt":
            lock.close()  # Windows removes no open file
        if not os.path.lexists(partial / JOURNAL):  # else the next command needs all
            _clean(partial, () if done and not add else keep)
            if made and not done:
                with contextlib.suppress(OSError):
                    out.rmdir()
        lock.close()  # now that nothing of a next run can be taken away


def settle(out: Path) -> None:
    """Finish what a command that was killed had begun to put in place, and say so; mostly there is nothing to
    do.

    Whoever reads a result calls it first, and so meets the old one whole or the new one whole.

    Raises:
        OutputError: it cannot be finished: ``out`` holds files of two results.
    """
    if not os.path.lexists(partial_folder(out) / JOURNAL):
        return
    out = Path(os.path.realpath(out))
    partial = partial_folder(out)
    try:
        with _locked(out, PATIENCE), deferred_signals():
            if journal := Journal.left(out):
                journal.go_on()
                _clean(partial, (CHECKPOINT, LIVE) if journal.staged else ())
                say(f"{out}: a command was killed while it put its result in place; that is done now, and "
                    "the result whole")
    except (OutputError, OSError) as reason:
        # done by another command just now, or undone: the earlier result is whole
        if not os.path.lexists(partial / JOURNAL):
            return
        if isinstance(reason, OutputError):
            raise
        raise OutputError("a whole result", f"{out}, where a command was killed while it put its result in "
                                            "place, and which "
                          f"cannot be written: {reason.strerror or reason}",
                          "free space, or let somebody who may write there run the command") from None


def in_use(out: Path) -> bool:
    """Whether a command is at work in ``out``; on Windows: whether one has begun and did not end well."""
    try:
        lock = open_regular(partial_folder(out) / LOCK)
    except OSError:
        return False
    with lock, contextlib.suppress(ImportError):
        import fcntl
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False
    return True


def check_free(out: Path, overwrite: bool, resume: bool = False,
               keep: tuple[str, ...] = (CHECKPOINT,)) -> None:
    """Raise OutputError now for what :func:`output_folder` would refuse; its arguments. Nothing is made or
    removed.
    """
    settle(out)
    _check_free(out, overwrite, resume, keep)
    check_output(out / MANIFEST)
    if in_use(out):
        raise _others(out)


def _others(out: Path) -> OutputError:
    return OutputError("an output folder of its own for each run", f"{out}, in use by another run",
                       "wait for it, or choose another folder")


def _check_free(out: Path, overwrite: bool, resume: bool, keep: tuple[str, ...]) -> None:
    partial = partial_folder(out)
    if out.exists() and not out.is_dir():
        raise OutputError("a folder for the output", f"the file {out}", "choose another name")
    if out.is_dir() and not overwrite and any(entry != partial for entry in out.iterdir()):
        raise OutputError("an empty or new output folder", f"{out}, which has results",
                          "add --overwrite to replace them, or choose another folder")
    if any(os.path.lexists(partial / name) for name in keep) and not (overwrite or resume):
        raise OutputError("no unfinished run", f"the one in {out}", "--resume goes on, --overwrite starts "
                                                                    "anew")
    for place in filter(None, (inside(out, name) for name in _derived_names(out))):
        if in_use(place):
            raise _others(place)


def _locked(out: Path, patience: float = GLANCE) -> IO:
    """An open file in the partial folder that no other process has locked."""
    _check_own(out)
    lock = open_regular(partial_folder(out) / LOCK, os.O_RDWR | os.O_CREAT)
    with contextlib.suppress(ImportError):  # no fcntl on Windows
        import fcntl
        last = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock.fileno()).st_nlink:
                    return lock
                break  # the run that ends took the file away
            except BlockingIOError:
                if time.monotonic() > last:
                    break
                time.sleep(0.02)
        lock.close()
        raise _others(out)
    return lock


def _check_own(out: Path) -> None:
    """Raise OutputError for a partial folder with anything but files and folders of ours, or of the owner of
    ``out``.
    """
    partial = partial_folder(out)
    owners = {os.geteuid(), out.stat().st_uid} if hasattr(os, "geteuid") else {0}
    inner = (Path(here, name) for here, folders, names in os.walk(partial) for name in (*folders, *names))
    for path in itertools.chain([partial], inner):
        try:
            found = path.lstat()
        except FileNotFoundError:  # of a run that is at work
            continue
        what = ("a link" if stat.S_ISLNK(found.st_mode) else
                "no regular file" if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)) else
                f"of user {found.st_uid}" if found.st_uid not in owners else "")
        if what:
            raise OutputError(f"nothing but files of yours in {partial}", f"{path}, {what}",
                              "move it away, or choose another folder")


def _empty(folder: Path, keep: tuple[str, ...]) -> None:
    # as long as something is there it is locked
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name == LOCK):
        if entry.name not in keep:
            remove(entry)


def _clean(partial: Path, keep: tuple[str, ...]) -> None:
    """Take away the partial folder, but for what a later run needs."""
    with contextlib.suppress(OSError):
        _empty(partial, keep)
        if not any(os.path.lexists(partial / name) for name in keep):
            partial.rmdir()


def _put_in_place(out: Path, staged: Path, add: bool) -> None:
    """Move the new files to ``out`` and take away earlier ones of the same names, or, unless they are added,
    all of ours.
    """
    new = sorted(str(path.relative_to(staged)) for path in staged.rglob("*") if is_regular(path))
    new = [name for name in new if name not in (LOCK, LIVE)]
    mine = own_files(out)
    earlier = [name for name in mine if (name in new or not add) and is_regular(inside(out, name))]
    earlier += [] if add else itertools.chain(*derived(out).values())
    earlier += [MANIFEST] if is_regular(out / MANIFEST) else []
    (staged / MANIFEST).write_text(json.dumps(sorted({*mine, *new}) if add else new))
    Journal(out, ADDED if add else "", earlier, [*new, MANIFEST]).run()


def own_files(out: Path) -> list[str]:
    """Names of the files that earlier commands put there; none where that is not known."""
    try:
        names = load(out / MANIFEST, list, links=False)
    except (OSError, ValueError):
        return []
    return list(dict.fromkeys(name for name in names if is_own(name) and name != MANIFEST))


def derived(out: Path) -> dict[str, list[str]]:
    """Folders inside a result in which commands put what they made of it, and the names of their files in
    ``out``.

    Only what a manifest there lists, in a folder of :data:`DERIVED` beside files of the result, counts.
    """
    found = {}
    for name in _derived_names(out):
        place = inside(out, name)
        theirs = own_files(place) if place else []
        if any(Path(each).name == DERIVED[Path(name).name] for each in theirs):
            found[name] = [f"{name}/{each}" for each in (*theirs, MANIFEST)
                           if is_regular(inside(out, f"{name}/{each}"))]
    return found


def _derived_names(out: Path) -> list[str]:
    """Where there may be such folders."""
    homes = {parent for name in own_files(out) for parent in Path(name).parents}
    return sorted(str(home / folder) for home in homes for folder in DERIVED)


def _say_beside(out: Path, made_of_it: dict[str, list[str]]) -> None:
    """Say what went with an earlier result, and what lies beside the new one and is no part of it."""
    if made_of_it:
        say(f"{out}: removed, as made of the earlier result: {', '.join(made_of_it)}")
    ours = {PARTIAL, MANIFEST, *(Path(name).parts[0] for name in own_files(out))}
    if others := sorted(entry.name for entry in out.iterdir() if entry.name not in ours):
        say(f"{out}: left as it was, and no part of this result: "
            f"{', '.join(others[:5])}{' ...' * (len(others) > 5)}")
