"""Result folders that are written whole or not at all, without loss of other people's files.

A command writes its result to ``OUT.partial``, beside OUT. One system call (``renameat2`` of Linux) then
exchanges the two folders, so after a kill OUT is the whole old result or the whole new one. A manifest lists
our files: ``--overwrite`` replaces a folder only if it has no other files. A lock beside OUT prevents two
runs at once. A failed run leaves in ``OUT.partial`` the files that ``--resume`` needs.
"""

import contextlib
import errno
import json
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from ..errors import OutputError
from . import files
from .manifest import MANIFEST, derived, derived_places, files_of_others, is_ours, own_files, serial_of
from .progress import say
from .signals import deferred_signals

CHECKPOINT = "checkpoint.safetensors"
UNFINISHED = CHECKPOINT, "relight.json"  # files of an unfinished run of `fit` or `relight`
GLANCE = 0.05  # seconds to wait for the lock, since a call of :func:`in_use` takes it briefly


def partial_folder(out: Path) -> Path:
    """``OUT.partial``, where a result is made; if ``out`` is a link, it is beside the link's target."""
    out = Path(os.path.realpath(out))
    return out.with_name(f"{out.name}.partial")


@contextlib.contextmanager
def output_folder(out: Path, overwrite: bool, resume: bool = False, keep: tuple[str, ...] = (CHECKPOINT,),
                  add: bool = False) -> Iterator[Path]:
    """Write the files of a result folder, all or none.

    Yields the folder to write into. If the block succeeds, this folder replaces ``out``: an earlier result is
    removed as a whole, with the :data:`DERIVED` folders that commands made from it. If the block fails,
    ``out`` does not change, and :func:`partial_folder` has the files that a later run resumes from.

    Args:
        overwrite: whether an earlier result, or an unfinished run of any command, may be replaced.
        resume: whether to continue in the partial folder of a failed run, and replace an earlier result.
        keep: names of the files and folders that a run resumes from.
        add: whether to keep the files in ``out`` (as hard links in the new folder) and replace only files of
            ours that have the same name. An unfinished run is not touched.

    Raises:
        OutputError: ``out`` has results or files of others, is in use, or cannot be written or exchanged.
    """
    out = Path(os.path.realpath(out))
    staged = _added(out) if add else partial_folder(out)
    keep = () if add else keep
    with contextlib.ExitStack() as stack:
        with _told(f"a place to write at {out}"):
            out.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(files.file_lock(out, GLANCE))
            _mend(out)
            _check_free(out, overwrite, resume, keep, add)
            _begin(out, staged, keep if resume else ())
        done = False
        try:
            with _told(f"to write {out}"):
                yield staged
                with deferred_signals():
                    made_of_it = [] if add else list(derived(out))
                    _put_in_place(out, staged, add)
                    done = True
                    if made_of_it:
                        say(f"{out}: removed, as made of the earlier result: {', '.join(made_of_it)}")
        finally:
            with contextlib.suppress(OSError):  # the next run removes what is left
                _empty(staged, () if done else keep)


def check_free(out: Path, overwrite: bool, resume: bool = False) -> None:
    """Raise OutputError now if :func:`output_folder` would raise it for these arguments. Nothing is made."""
    out = Path(os.path.realpath(out))
    _check_free(out, overwrite, resume, (CHECKPOINT,))
    files.check_output(partial_folder(out) / MANIFEST)
    if files.in_use(out):
        raise files.taken(out)


def checkpoints(out: Path) -> list[Path]:
    """Checkpoints to continue from: that of the unfinished run, then that of the finished fit in ``out``."""
    partial = partial_folder(out)
    places = [out] if _is_earlier(partial, out) else [partial, out]
    return [place / CHECKPOINT for place in places if files.is_regular(place / CHECKPOINT)]


def _check_free(out: Path, overwrite: bool, resume: bool, keep: tuple[str, ...], add: bool = False) -> None:
    partial = partial_folder(out)
    if out.exists() and not out.is_dir():
        raise OutputError("a folder for the output", f"the file {out}", "choose another name")
    if os.path.ismount(out):
        raise OutputError("an output folder that can be replaced as a whole", f"{out}, a mount point",
                          f"choose a new folder in it, such as {out / 'result'}")
    with contextlib.suppress(OSError):  # the current folder is gone
        if out in (here := Path(os.getcwd()), *here.parents):
            raise OutputError("an output folder that does not hold the current folder", str(out),
                              "type cd .. until you are above it, and name it from there")
    for place in filter(None, (files.inside(out, name) for name in derived_places(out))):
        if files.in_use(place):
            raise files.taken(place)
    if out.is_dir() and not add:
        if not (overwrite or resume) and any(out.iterdir()):
            raise OutputError("an empty or new output folder", f"{out}, which has results",
                              "add --overwrite to replace them, or choose another folder")
        _check_ours(out)
    unfinished = [name for name in UNFINISHED if os.path.lexists(partial / name)]
    if unfinished and not (add or overwrite or resume and unfinished[0] in keep or _is_earlier(partial, out)):
        raise OutputError("no unfinished run", f"the one in {partial}",
                          "--resume of its command goes on, --overwrite starts anew")


def _check_ours(out: Path) -> None:
    if others := files_of_others(out):
        raise OutputError("a folder with nothing but results of mitsvbrdf to replace",
                          f"{out} with {', '.join(others[:5])}{' ...' * (len(others) > 5)}",
                          "move them away, or choose another folder")


def _begin(out: Path, staged: Path, keep: tuple[str, ...]) -> None:
    """Make a folder to write into, empty except for files to resume from, and mark it as ours."""
    if os.path.lexists(staged):
        _check_own(out, staged, keep)
        _empty(staged, () if _is_earlier(staged, out) else keep)
    staged.mkdir(exist_ok=True)
    if not files.is_regular(staged / MANIFEST):  # at once, so that a kill leaves no folder without it
        (staged / MANIFEST).write_text(json.dumps({"serial": serial_of(out) + 1, "files": []}))


def _check_own(out: Path, staged: Path, keep: tuple[str, ...]) -> None:
    """Raise OutputError if we did not make the folder, or if files to resume from are not ours."""
    home = out if out.exists() else out.parent
    owners = {os.geteuid(), home.stat().st_uid}
    kept = [staged / name for name in keep if os.path.lexists(staged / name)]
    inner = [Path(here, name) for place in kept for here, folders, names in os.walk(place)
             for name in (*folders, *names)]
    for path in (staged, *kept, *inner):
        found = path.lstat()
        what = ("a link" if stat.S_ISLNK(found.st_mode) else
                "no regular file" if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)) else
                f"of user {found.st_uid}" if found.st_uid not in owners else "")
        if what:
            raise OutputError(f"only files of your own in {staged}", f"{path}, {what}",
                              "move it away, or choose another folder")
    if not is_ours(staged):
        raise OutputError(f"an unfinished run of mitsvbrdf, or nothing, at {staged}", "something else",
                          "move it away, or choose another output folder")


def _empty(folder: Path, keep: tuple[str, ...]) -> None:
    """Remove a folder of ours except for ``keep``; last its manifest, which marks the folder as ours."""
    if not folder.is_dir() or folder.is_symlink():
        return
    left = any(os.path.lexists(folder / name) for name in keep)
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name == MANIFEST):
        if entry.name not in (*keep, *([MANIFEST] if left else [])):
            files.remove(entry)
    if not left:
        folder.rmdir()


def _put_in_place(out: Path, staged: Path, add: bool) -> None:
    """Write the manifest, flush all files to the disk, and exchange the folders."""
    new = sorted(str(path.relative_to(staged)) for path in staged.rglob("*") if files.is_regular(path))
    new.remove(MANIFEST)
    listed, serial = ({*own_files(out), *new}, serial_of(out)) if add else (new, serial_of(out) + 1)
    if add and out.is_dir():
        _link_rest(out, staged, new)
    files.write_json(staged / MANIFEST, {"serial": serial, "files": sorted(listed)})
    for name in (*new, MANIFEST):
        files.to_disk(staged / name)
    folders = {staged, *(staged / parent for name in new for parent in Path(name).parents)}
    for folder in folders:
        _folder_to_disk(folder)
    if out.exists():
        if not add:
            _check_ours(out)  # again, as others may have added files meanwhile
        shutil.copymode(out, staged)
        files.exchange(staged, out)
    else:
        os.rename(staged, out)
    _folder_to_disk(out.parent)


def _link_rest(out: Path, staged: Path, new: list[str]) -> None:
    """Make hard links in ``staged`` to the other files of ``out``. OutputError: something is in the way."""
    mine, device = {MANIFEST, *own_files(out)}, out.stat().st_dev
    for name in (*new, MANIFEST):
        for path in (Path(name), *list(Path(name).parents)[:-1]):
            there = out / path
            ours = (name in mine and files.is_regular(there) if str(path) == name
                    else there.is_dir() and not there.is_symlink())
            if os.path.lexists(there) and not ours:
                raise OutputError("room for new files", f"{there}, made by something else", "move it away")
    for here, folders, names in os.walk(out):
        target = staged / Path(here).relative_to(out)
        if os.stat(here).st_dev != device:
            raise OutputError("a folder on one disk", f"{here}, a mount point", "unmount it, or move it away")
        target.mkdir(exist_ok=True)
        shutil.copystat(here, target)
        for name in (*names, *(name for name in folders if Path(here, name).is_symlink())):
            if not os.path.lexists(target / name):
                files.linked(Path(here, name), target / name)


def _added(out: Path) -> Path:
    return out.with_name(f".{out.name}.added")


def _mend(out: Path) -> None:
    """Clean up after a kill during an :func:`exchange` by three renames, or while files were added."""
    spare = files.spare_name(out)
    if spare.is_dir() and not spare.is_symlink() and not os.path.lexists(out):
        os.rename(spare, out)
    for left in (spare, _added(out)):
        if is_ours(left):
            _empty(left, ())


def _is_earlier(partial: Path, out: Path) -> bool:
    """Whether ``partial`` is the earlier result, because ``out`` is the new one already."""
    return serial_of(partial) < serial_of(out)


@contextlib.contextmanager
def _told(expected: str) -> Iterator[None]:
    try:
        yield
    except OSError as reason:
        fixed = reason.errno in (errno.EBUSY, errno.EXDEV)
        way_out = ("choose a folder inside of it, or another one" if fixed
                   else "free space, or choose a folder in a place you may write to")
        where = f" ({os.fsdecode(reason.filename)})" if isinstance(reason.filename, (str, bytes)) else ""
        raise OutputError(expected, f"{reason.strerror or reason}{where}", way_out) from None


def _folder_to_disk(path: Path) -> None:
    with contextlib.suppress(OSError):  # some systems cannot flush folders
        files.to_disk(path)
