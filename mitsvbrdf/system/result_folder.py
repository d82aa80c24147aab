"""Result folders that appear whole or not at all, and in which nobody else's file is lost.

A result is made in a hidden folder inside its place and then renamed; a manifest lists the files that are ours, so that
``--overwrite`` takes away those alone; a lock keeps two runs apart. An unfinished run leaves what it can be resumed from.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from ..errors import OutputError
from .files import write_bytes
from .interrupts import undisturbed
from .json_files import load

MANIFEST = ".mitsvbrdf"  # in each folder we make: the files we put there
CHECKPOINT = "checkpoint.safetensors"
LIVE = "live.safetensors"  # what a running fit is watched through; no part of the result
LOCK = ".lock"


def partial_folder(out: Path) -> Path:
    """Where a result lies while it is being made: inside ``out``, so that putting it in place is a rename."""
    return Path(out) / ".partial"


@contextlib.contextmanager
def output_folder(out: Path, overwrite: bool, resume: bool = False,
                  keep: tuple[str, ...] = (CHECKPOINT,)) -> Iterator[Path]:
    """Make the files of a result folder all or not at all.

    Yields the folder to write into (:func:`partial_folder`). When the block ends well its files move to ``out``, those that
    an earlier run put there (the manifest lists them) go, and files of anybody else stay: one that is in the way gets
    ``.old`` behind its name. When the block fails only what a later run resumes from is kept.

    Args:
        out: the folder the caller asked for.
        overwrite: whether earlier results, or an unfinished run, may be replaced.
        resume: go on in the partial folder that an interrupted run left.
        keep: files and folders to resume from.

    Raises:
        OutputError: ``out`` has results, is no folder, is in use by another run, or cannot be written.
    """
    out = Path(os.path.realpath(out))
    partial = partial_folder(out)
    try:
        if out.exists() and not out.is_dir():
            raise OutputError("a folder for the output", f"the file {out}", "choose another name")
        if out.is_dir() and not overwrite and any(entry != partial for entry in out.iterdir()):
            raise OutputError("an empty or new output folder", f"{out}, which has results",
                              "add --overwrite to replace them, or choose another folder")
        if any((partial / name).exists() for name in keep) and not (overwrite or resume):
            raise OutputError("no unfinished run", f"the one in {out}", "--resume goes on, --overwrite starts anew")
        made = not out.exists()
        partial.mkdir(parents=True, exist_ok=True)
        lock = _locked(partial)
        _empty(partial, keep=(LOCK, *keep) if resume else (LOCK,))
    except OSError as reason:
        raise OutputError(f"a place to write at {out}", reason.strerror or str(reason),
                          "free space, or choose a folder you may write to") from None
    done = False
    try:
        yield partial
        with undisturbed():
            _put_in_place(partial, out)
        done = True
    except OSError as reason:
        raise OutputError(f"to write {out}", reason.strerror or str(reason), "free space or choose another place") from None
    finally:
        if os.name == "nt":
            lock.close()  # Windows removes no open file
        if done or not any((partial / name).exists() for name in keep):
            shutil.rmtree(partial, ignore_errors=True)
            if made and not done:
                with contextlib.suppress(OSError):
                    out.rmdir()
        else:
            _empty(partial, keep)
        lock.close()  # now that nothing of a next run can be taken away


def make_room(out: Path, names: Sequence[str]) -> None:
    """Let files of these names (relative to ``out``) belong to our results, so that ``--overwrite`` takes them away again.

    A file of anybody else that has such a name gets ``.old`` behind it.

    Raises:
        OutputError: ``out`` cannot be written.
    """
    out = Path(out)
    try:
        mine = [str(name) for name in load(out / MANIFEST, list)]
    except (OSError, ValueError):
        mine = []
    try:
        for name in names:
            if name not in mine and os.path.lexists(out / name):
                os.replace(out / name, _spare_name(out / name))
    except OSError as reason:
        raise OutputError(f"to write {out}", reason.strerror or str(reason), "choose a folder you may write to") from None
    write_bytes(out / MANIFEST, json.dumps(sorted({*mine, *names})).encode())


def _locked(partial: Path) -> IO:
    """An open file in the partial folder that no other process has locked."""
    lock = (partial / LOCK).open("w")
    with contextlib.suppress(ImportError):  # no fcntl on Windows
        import fcntl
        for left in (2, 1, 0):
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock.fileno()).st_nlink:
                    return lock
                break  # the run that ends took the file away
            except BlockingIOError:
                if left:
                    time.sleep(0.02)  # in_use may be asking
        lock.close()
        raise OutputError("an output folder of its own for each run", f"{partial.parent}, in use by another run",
                          "wait for it, or choose another folder")
    return lock


def in_use(out: Path) -> bool:
    """Whether a command is at work in ``out``; on Windows: whether one has begun and did not end well."""
    try:
        lock = (partial_folder(out) / LOCK).open()
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


def _empty(folder: Path, keep: tuple[str, ...]) -> None:
    for entry in folder.iterdir():
        if entry.name not in keep:
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def _put_in_place(partial: Path, out: Path) -> None:
    """Move the files of the partial folder to ``out`` and take away what the manifest there lists; undone if it fails."""
    new = sorted(str(p.relative_to(partial)) for p in partial.rglob("*") if p.is_file() and p.name not in (LOCK, LIVE))
    try:
        earlier = [str(name) for name in load(out / MANIFEST, list)]
    except (OSError, ValueError):
        earlier = []
    earlier = [name for name in (*earlier, MANIFEST) if (out / name).is_file() and ".." not in Path(name).parts]
    moves = [(out / name, partial / ".earlier" / name) for name in dict.fromkeys(earlier)]
    moves += [(out / name, _spare_name(out / name)) for name in new if name not in earlier and os.path.lexists(out / name)]
    (partial / MANIFEST).write_text(json.dumps(new))
    moves += [(partial / name, out / name) for name in (*new, MANIFEST)]
    undo: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, target)
            undo.append((target, source))
    except BaseException:
        for target, source in reversed(undo):
            source.parent.mkdir(parents=True, exist_ok=True)
            os.replace(target, source)
        raise
    for folder in sorted({(out / name).parent for name in earlier} - {out}, reverse=True):
        with contextlib.suppress(OSError):
            folder.rmdir()  # only where nothing is left in it


def _spare_name(path: Path) -> Path:
    names = (path.with_name(f"{path.name}.old{count or ''}") for count in itertools.count())
    return next(name for name in names if not os.path.lexists(name))
