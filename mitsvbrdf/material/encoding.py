"""Encodings of map files, as stated in ``material.json`` or by the user, in the words of any library."""

import re
from difflib import get_close_matches
from pathlib import Path
from typing import Literal

from ..errors import ConfigError, MapsError
from ..io.json import error_text, load
from .maps import CHANNELS, TITLES
from .naming import KINDS, NAMES

NormalConvention = Literal["gl", "dx"]

# A name used in material.json and --encoding: the encoding that each map then has.
ENCODINGS: dict[str, dict[str, str]] = NAMES["encodings"]
_SPELLINGS = {word: code for code, words in NAMES["spellings"].items() for word in words.split()}
_CONVENTIONS = {"dx": r"\bdx\b|directx|d3d|[+]?\s*y\s*down|-\s*y", "gl": r"\bgl\b|opengl|[+]\s*y|y\s*up"}


def read_material_json(folder: Path) -> dict:
    """The content of ``material.json`` in a folder; an empty dict if there is none.

    Its ``encoding`` has our names of maps and encodings; normals have ``gl``, ``dx`` or an empty text.
    """
    path = Path(folder) / "material.json"
    if not path.is_file():
        return {}
    try:
        stated = load(path)
        if misspelt := [key for key in stated if key not in ("bsdf", "encoding")
                        and get_close_matches(key.lower(), ("bsdf", "encoding"), cutoff=0.8)]:
            raise ValueError(f"unknown key {misspelt[0]!r}; bsdf and encoding are known")
        if stated.get("bsdf", "principled") not in list(CHANNELS):
            raise ValueError(f"its bsdf is none of {list(CHANNELS)}")
        codes = stated.get("encoding", {})
        if not isinstance(codes, dict) or not all(isinstance(code, str) for code in codes.values()):
            raise ValueError("its encoding is not an object of strings")
        return stated | {"encoding": dict(code_of(*item) for item in codes.items())}
    except (OSError, ValueError) as reason:
        raise MapsError("a valid material.json", f"{path}: {error_text(reason)}",
                        "mend it, or delete it to have encodings guessed by file names") from None


def asked_codes(encoding: str | None, normal: NormalConvention | None) -> dict[str, str]:
    """A dict, map to encoding, from a text like ``linear`` (all maps) or ``roughness=linear,normal=dx``."""
    asked: dict[str, str] = {}
    alone: dict[str, str] = {}  # stated for single maps
    try:
        for item in (encoding or "").split(",") if encoding is not None else []:
            name, sign, code = item.rpartition("=")
            found = dict([code_of(name, code)] if sign else ENCODINGS[code_of("diffuse", code)[1]])
            if sign and any(alone.setdefault(key, value) != value for key, value in found.items()):
                raise ValueError(f"{name} is stated twice")
            asked |= found
    except ValueError as reason:
        raise ConfigError("--encoding CODE or NAME=CODE,...", f"{encoding!r}: {reason}",
                          "e.g. --encoding roughness=linear") from None
    if normal is not None and asked.get("normal", normal) != normal:
        raise ConfigError("normals of one convention", f"{encoding} and --normal {normal}", "give one")
    return asked | ({"normal": normal} if normal else {})


def code_of(name: str, code: str) -> tuple[str, str]:
    """A map and its encoding in our words; ValueError for unknown words."""
    squeezed = re.sub(r"[^a-z0-9]", "", name.lower())
    known = name if name in TITLES else KINDS.get(squeezed, "").partition(" ")[0]
    if known not in TITLES:
        raise ValueError(f"encoding.{name} is none of the maps {', '.join(TITLES)}")
    if known == "normal":
        if conventions := [key for key, mark in _CONVENTIONS.items() if re.search(mark, code.lower())]:
            return known, conventions[0]
        if re.search(r"n\s*\+\s*1|linear|raw|data|non", code.lower()):
            return known, ""
        raise ValueError(f"encoding.{name} is {code!r}, neither OpenGL (gl) nor DirectX (dx)")
    found = _SPELLINGS.get(re.sub(r"[^a-z0-9]", "", code.lower()))
    if found is None:
        raise ValueError(f"encoding.{name} is {code!r}, none of {', '.join(ENCODINGS)}")
    return known, found
