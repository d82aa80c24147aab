"""What is done to good files: each change is a dictionary, so that a case can be kept as JSON.

``do`` names the function, the other keys are its arguments. A file is named by the folder it is ``under`` (or
by itself) and its number ``nth`` there; numbers are counted round, so that any number fits any folder. ``@@``
stands for the case's folder.
"""

import contextlib
import json
import os
import re
import shutil
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

HOLE = "what a raw value takes the place of"
CHANGES: dict[str, Callable[..., None]] = {}


def apply(folder: Path, change: Mapping) -> None:
    """Make one change in the folder of a case; one that earlier changes left no room for is none."""
    options = {name: value.replace("@@", str(folder)) if isinstance(value, str) else value
               for name, value in change.items()}
    with contextlib.suppress(OSError):
        CHANGES[options.pop("do")](folder, **options)


def _change(function: Callable[..., None]) -> Callable[..., None]:
    CHANGES[function.__name__] = function
    return function


def _file(folder: Path, under: str, nth: int = 0) -> Path:
    start = folder / under
    inside = (path for path in start.rglob("*") if path.is_file() and not path.is_symlink())
    found = [start] if start.is_file() else sorted(inside)
    return found[nth % len(found)] if found else start / "nothing"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_file() or not path.exists():  # a pipe would wait
        path.write_bytes(content)


@_change
def flip(folder: Path, under: str, nth: int, at: int, bit: int) -> None:
    """Turn one bit around; negative places count from the end."""
    path = _file(folder, under, nth)
    if data := bytearray(path.read_bytes() if path.exists() else b""):
        data[at % len(data)] ^= 1 << bit
        path.write_bytes(data)


@_change
def cut(folder: Path, under: str, nth: int, at: int) -> None:
    path = _file(folder, under, nth)
    if path.exists():
        os.truncate(path, at % (path.stat().st_size + 1))


@_change
def put(folder: Path, path: str, text: str = "", again: int = 1, code: str = "utf-8") -> None:
    """Give a file this content; text with lone surrogates stands for bytes that are no UTF-8."""
    _write(folder / path, text.encode(code, "surrogateescape" if code == "utf-8" else "replace") * again)


@_change
def line(folder: Path, path: str, nth: int, text: str) -> None:
    """Put other words in the place of a line."""
    target = folder / path
    lines = target.read_bytes().decode(errors="surrogateescape").splitlines() if target.is_file() else []
    if not lines:
        return
    lines[nth % len(lines)] = text
    target.write_bytes("\n".join(lines).encode(errors="surrogateescape"))


@_change
def copy(folder: Path, source: str, nth: int, path: str) -> None:
    """Put a file, of another kind perhaps, in the place of this one."""
    found = _file(folder, source, nth)
    if found.is_file():
        _write(folder / path, found.read_bytes())


@_change
def absent(folder: Path, path: str) -> None:
    target = folder / path
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)
    else:
        target.unlink(missing_ok=True)


@_change
def link(folder: Path, path: str, to: str) -> None:
    """Put a symbolic link in the place of a file or folder."""
    absent(folder, path)
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    (folder / path).symlink_to(os.path.relpath(folder / to, (folder / path).parent))


@_change
def pipe(folder: Path, path: str) -> None:
    """Put a named pipe that nobody writes to in the place of a file or folder."""
    absent(folder, path)
    (folder / path).parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(folder / path)


@_change
def folder(folder: Path, path: str) -> None:
    absent(folder, path)
    (folder / path).mkdir(parents=True)


def _walk(value: Any, steps: Sequence[int]) -> tuple[Any, Any]:
    """The container and the key that steps through a JSON value lead to; (None, None) where it has no
    parts.
    """
    found: tuple[Any, Any] = None, None
    for step in steps:
        if not isinstance(value, (dict, list)) or not value:
            break
        keys = list(value) if isinstance(value, dict) else range(len(value))
        found = value, keys[step % len(keys)]
        value = value[found[1]]
    return found


def _edited(text: str, steps: Sequence[int], raw: str | None, again: int = 1) -> str:
    """JSON text with a value replaced by a raw token (repeated, of a bracket for depth), or taken out."""
    with contextlib.suppress(ValueError, RecursionError):
        value = json.loads(text)
        where, key = _walk(value, steps)
        if where is None:
            return raw or ""
        if raw is None:
            del where[key]
            return json.dumps(value)
        where[key] = HOLE
        closing = raw[::-1].translate(str.maketrans("[{", "]}")) if again > 1 else ""
        return json.dumps(value).replace(json.dumps(HOLE), raw * again + closing * again)
    return text


@_change
def state(folder: Path, path: str, steps: Sequence[int], raw: str | None, again: int = 1) -> None:
    """Change a value of a JSON file; a pattern stands for the first that matches."""
    target = next(iter(sorted(folder.glob(path))), folder / path)
    if target.is_file():
        text = _edited(target.read_bytes().decode(errors="surrogateescape"), steps, raw, again)
        target.write_bytes(text.encode(errors="surrogateescape"))


@_change
def note(folder: Path, path: str, steps: Sequence[int], raw: str | None, inside: bool) -> None:
    """Change a value of a safetensors file's header, or ``inside`` the JSON text that the package keeps
    there.
    """
    target = folder / path
    if not target.is_file():
        return
    data = target.read_bytes()
    length = struct.unpack("<Q", data[:8].ljust(8, b"\0"))[0]
    header = data[8:8 + length].decode(errors="replace")
    if inside:
        with contextlib.suppress(ValueError, KeyError):
            whole = json.loads(header)
            whole["__metadata__"]["mitsvbrdf"] = _edited(whole["__metadata__"]["mitsvbrdf"], steps, raw)
            header = json.dumps(whole)
    else:
        header = _edited(header, steps, raw)
    target.write_bytes(struct.pack("<Q", len(header.encode())) + header.encode() + data[8 + length:])


@_change
def sized(folder: Path, under: str, nth: int, width: int, height: int) -> None:
    """Let the header of a PNG, JPEG, HDR or EXR promise another size."""
    path = _file(folder, under, nth)
    data = bytearray(path.read_bytes() if path.exists() else b"")
    if data[:4] == b"\x89PNG":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif data[:2] == b"\xff\xd8":
        begin = next((k for k in range(2, len(data) - 9) if data[k] == 0xFF and data[k + 1] in (0xC0, 0xC2)),
                     0)
        data[begin + 5:begin + 9] = struct.pack(">HH", height & 0xFFFF, width & 0xFFFF)
    elif data[:2] == b"#?":
        data = bytearray(re.sub(rb"-Y \d+ \+X \d+", f"-Y {height} +X {width}".encode(), data))
    elif data[:4] == b"v/1\x01":
        for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
            if (begin := data.find(name)) > 0:
                begin += len(name) + 4
                data[begin:begin + 16] = struct.pack("<iiII", 0, 0, (width - 1) & 0xFFFFFFFF,
                                                     (height - 1) & 0xFFFFFFFF)
    if data:
        path.write_bytes(data)
