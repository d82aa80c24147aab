"""Reading and writing images and JSON; every write goes beside its target and is then renamed onto it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .errors import MitsvbrdfError, OutputError

MANIFEST = ".mitsvbrdf"  # in each folder we make: the names we put there


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
    import cv2

    kind = np.uint8 if bits == 8 else np.uint16
    top = np.iinfo(kind).max
    pixels = np.rint(image.detach().clamp(0, 1).to(torch.float64).numpy() * top).astype(kind)
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1] if pixels.shape[2] == 3 else pixels))
    assert ok
    write_bytes(path, data.tobytes())


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

    Raises:
        OutputError: when the folder cannot be made or written to.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as reason:
        raise OutputError(f"to write {path}", reason.strerror or str(reason), "free space or choose another place") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def partial_folder(out: Path) -> Path:
    """Where a result lies while it is being made: beside ``out``, with ``.partial`` added."""
    return out.with_name(out.name + ".partial")


@contextlib.contextmanager
def output_folder(out: Path, overwrite: bool, keep_partial: bool = False) -> Iterator[Path]:
    """Make a result folder whole or not at all.

    Yields the folder to write into (:func:`partial_folder`). When the block ends well it becomes ``out``; where ``out``
    exists, what an earlier run wrote there is replaced and all else is left alone. When the block fails the partial folder
    is removed, unless it holds a checkpoint to resume from.

    Args:
        out: the folder the caller asked for.
        overwrite: whether results in an existing ``out`` may be replaced.
        keep_partial: start from the partial folder that an interrupted run left.

    Raises:
        OutputError: ``out`` has results, is no folder, or cannot be written.
    """
    out = Path(os.path.abspath(out))
    if out.exists() and not out.is_dir():
        raise OutputError("a folder for the output", f"the file {out}", "choose another name")
    partial = partial_folder(out)
    try:
        if out.is_dir() and any(out.iterdir()) and not overwrite:
            raise OutputError("an empty or new output folder", f"{out}, which has results",
                              "add --overwrite to replace them, or choose another folder")
        if partial.exists() and not keep_partial:
            shutil.rmtree(partial)
        partial.mkdir(parents=True, exist_ok=True)
        (partial / MANIFEST).write_text("[]")
    except OSError as reason:
        raise OutputError(f"a place to write at {out}", reason.strerror or str(reason),
                          "free space, or choose a folder you may write to") from None
    try:
        yield partial
        _put_in_place(partial, out)
    except OSError as reason:
        raise OutputError(f"to write {out}", reason.strerror or str(reason), "free space or choose another place") from None
    finally:
        if partial.exists() and not (partial / "checkpoint.safetensors").exists():
            shutil.rmtree(partial, ignore_errors=True)


def _put_in_place(partial: Path, out: Path) -> None:
    """Rename the partial folder to ``out``, or its entries into it, in place of those that the manifest there lists."""
    names = sorted(entry.name for entry in partial.iterdir())
    (partial / MANIFEST).write_text(json.dumps(names))
    if not out.exists():
        os.replace(partial, out)
        return
    try:
        earlier = {str(name) for name in json.loads((out / MANIFEST).read_text())}
    except (OSError, ValueError):
        earlier = set()
    trash = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out))
    try:
        for name in sorted(earlier | set(names)):
            if os.path.basename(name) == name and os.path.lexists(out / name):
                os.replace(out / name, trash / name)
        for name in names:
            os.replace(partial / name, out / name)
    finally:
        shutil.rmtree(trash, ignore_errors=True)
    partial.rmdir()
