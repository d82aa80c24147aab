"""Reading and writing images and JSON; every write goes beside its target and is then renamed onto it."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np
import torch
from torch import Tensor

from .errors import MitsvbrdfError, OutputError
from .interrupts import undisturbed

MANIFEST = ".mitsvbrdf"  # in each folder we make: the files we put there
CHECKPOINT = "checkpoint.safetensors"
LIVE = "live.safetensors"  # what a running fit is watched through; no part of the result
LOCK = ".lock"


def read_image(path: Path, error: type[MitsvbrdfError]) -> Tensor:
    """An image file as float32 H x W x C, row 0 at the top, RGB order.

    8- and 16-bit files give display values in [0, 1]; EXR files give what they hold. Alpha is dropped.

    Args:
        path: png, jpg or exr.
        error: the error type to raise when the file is missing or is no image.
    """
    import cv2

    path = Path(path)
    if not path.is_file():
        raise error("an image file", f"no file at {path}", "check the name")
    if path.suffix.lower() == ".exr":
        return _read_exr(path, error)
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if data.size else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise error("a readable 8- or 16-bit image", f"{path}, which is none", "export it again as PNG or JPEG")
    scale = np.float32(np.iinfo(image.dtype).max)
    return torch.from_numpy(np.ascontiguousarray(image[..., ::-1]).astype(np.float32) / scale)


def _read_exr(path: Path, error: type[MitsvbrdfError]) -> Tensor:
    import OpenEXR

    try:
        channels = OpenEXR.File(str(path)).channels()
    except Exception as reason:  # OpenEXR raises plain RuntimeError and others
        raise error("a readable EXR file", f"{path}: {reason}", "export it again") from None
    for name in ("RGB", "RGBA"):
        if name in channels:
            return torch.from_numpy(np.array(channels[name].pixels[..., :3], dtype=np.float32))
    if all(c in channels for c in "RGB"):
        return torch.from_numpy(np.stack([channels[c].pixels for c in "RGB"], axis=-1).astype(np.float32))
    if len(channels) == 1:
        (channel,) = channels.values()
        return torch.from_numpy(np.array(channel.pixels, dtype=np.float32)[..., None])
    raise error("an EXR with R, G, B or one channel", f"{path} with {sorted(channels)}", "export it again")


def write_exr(path: Path, image: Tensor) -> None:
    """A float32 EXR of an H x W x 3 (R, G, B) or H x W x 1 (Y) tensor, ZIP-compressed."""
    import OpenEXR

    pixels = np.ascontiguousarray(image.detach().to(torch.float32).numpy())
    channels = {"RGB": pixels} if pixels.shape[2] == 3 else {"Y": np.ascontiguousarray(pixels[..., 0])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with beside(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as reason:  # what OpenEXR makes of a full disk
            raise OSError(str(reason)) from None


def write_png(path: Path, image: Tensor, bits: int = 8) -> None:
    """An 8- or 16-bit PNG of display values in [0, 1] (clipped), H x W x 3 or H x W x 1."""
    write_bytes(path, encode_png(image, bits))


def encode_png(image: Tensor, bits: int = 8) -> bytes:
    """The content of the file that :func:`write_png` writes."""
    import cv2

    kind = np.uint8 if bits == 8 else np.uint16
    top = np.iinfo(kind).max
    pixels = np.rint(image.detach().clamp(0, 1).to(torch.float64).numpy() * top).astype(kind)
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1] if pixels.shape[2] == 3 else pixels))
    assert ok
    return data.tobytes()


def write_json(path: Path, value: object) -> None:
    """Indented JSON; NaN and infinity are refused, since JSON has none."""
    write_bytes(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Replace a file's content in one step."""
    with beside(path) as temporary:
        temporary.write_bytes(data)


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder, renamed onto ``path`` when the block ends well, else removed.

    A symbolic link stays one: what it points to is replaced.

    Raises:
        OutputError: when the folder cannot be made or written to, or something other than a file has this name.
    """
    path, temporary = _places(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as reason:
        raise OutputError(f"to write {path}", reason.strerror or str(reason), "free space or choose another place") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_output(*paths: Path | None) -> None:
    """Raise OutputError now for files that :func:`beside` could not write once the work is done; None stands for no file.

    Nothing is left behind, and folders that are missing are not made yet.
    """
    for path in filter(None, paths):
        target, temporary = _places(path)
        try:
            probe = next(folder for folder in target.parents if os.path.lexists(folder)) / temporary.name
            probe.touch()
            probe.unlink()
        except OSError as reason:
            raise OutputError(f"to write {path}", reason.strerror or str(reason), "choose another place") from None


def _places(path: Path) -> tuple[Path, Path]:
    """The file that a path stands for, links followed, and the temporary name beside it."""
    target = Path(os.path.realpath(path))
    if os.path.lexists(target) and not target.is_file():  # a rename would replace a device or a pipe by a file
        raise OutputError("a file to write", f"{path}, which is {'a folder' if target.is_dir() else 'no regular file'}",
                          "give another name")
    return target, target.with_name(f".{target.stem}-{uuid.uuid4().hex[:8]}{target.suffix}")


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
        mine = [str(name) for name in json.loads((out / MANIFEST).read_text())]
    except (OSError, ValueError, TypeError):
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
        earlier = [str(name) for name in json.loads((out / MANIFEST).read_text())]
    except (OSError, ValueError, TypeError):
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
