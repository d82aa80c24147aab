"""Which file of a folder is which map, by the names that texture libraries, programs and the field give."""

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ..errors import MapsError

NAMES = tomllib.loads(Path(__file__).with_name("names.toml").read_text(encoding="utf-8"))
FILE_NAMES: dict[str, dict[str, str]] = NAMES["files"]  # of each map as `export` writes it
SURFACES: dict[str, dict[str, tuple[str, float]]] = NAMES["shaders"]  # inputs and their defaults

# The field's names. Their 8-bit files have gamma 2.2 where nothing else is stated.
FIELD = {"diffuse": ("diffuse", "dif"), "specular": ("specular", "spe"), "roughness": ("roughness", "rgh"),
         "normal": ("normal", "nom", "normal_dx", "nom_dx")}
# Suffixes of images, the best first.
SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".tga", ".bmp", ".hdr")

_CODES = NAMES["encodings"]["srgb"]
_CONVENTIONS = {"gl": ("gl", "opengl", "ogl"), "dx": ("dx", "directx", "d3d")}
KINDS = {word: kind for kind, words in NAMES["words"].items() for word in words.split()} | {
    join: f"normal {convention}" for convention, marks in _CONVENTIONS.items() for mark in marks
    for normal in NAMES["words"]["normal"].split() for join in (normal + mark, mark + normal)}
# Channels of packed maps by the letters of their names. glTF's metallicRoughness has them in G and B.
_LETTERS = {"o": "occlusion", "a": "occlusion", "r": "roughness", "m": "metallic"}
PACKED = {word: tuple(_LETTERS[letter] for letter in word)
          for word in ("arm", "orm", "rma", "rmo", "mra", "mro", "ram", "rom", "mar", "mor", "amr", "omr")}
PACKED["maskmap"] = "metallic", "occlusion", "other", "glossiness"  # of Unity
SIZES = re.compile(r"(?i)(?<![a-z0-9])(\d{1,2}k|\d{3,4}(x\d{3,4})?|jpe?g|png|exr|tiff?)(?![a-z0-9])")
WORKFLOW = re.compile(r"_\d{1,2}K_(METALNESS|SPECULAR)$")  # of Poliigon: NAME_COL_2K_METALNESS
GLTF_PACKED = "other", "roughness", "metallic"
ALPHA = 3  # index of the alpha channel


class Source(NamedTuple):
    """Where a map comes from."""

    path: Path | None  # an image file; None: factor is all
    channel: int | None = None  # which of its channels, of a packed map
    inverted: bool = False  # whether it holds one minus the map, as gloss does
    convention: str = ""  # of normals, where the name states it: gl or dx
    factor: tuple[float, ...] = (1.0,)  # on the linear map, one for all channels or one each
    part: int | None = None  # which of the squares that lie side by side in the file


def kind_of(stem: str, dropped: int = 0) -> tuple[str, ...]:
    """The map that a file's name (without suffix) means, or the maps of its three or four channels; empty
    where it means none. The first ``dropped`` words of the name are ignored.
    """
    if (short := WORKFLOW.sub("", stem)) != stem and (
            (known := kind_of(short, dropped)) or re.search(r"_[A-Z]{3,}\d*$", short)):  # a map's word
        return known
    parts = words(stem)[dropped:]
    for end in (1, 2):
        if (packed := "".join(parts[-end:])) in PACKED:
            return PACKED[packed]
    kinds, end = list[str](), len(parts)
    while end:
        begin = next((k for k in range(end) if "".join(parts[k:end]) in KINDS), None)
        if begin is not None:
            kinds.insert(0, KINDS["".join(parts[begin:end])])
            end = begin
        elif kinds:
            break
        else:
            end -= 1
    if {"roughness", "metallic"} <= set(kinds):
        return tuple(kinds[-3:]) if "occlusion" in kinds[-3:] else GLTF_PACKED
    if "other" in kinds:
        return ("other",)
    gloss = kinds[1:] and kinds[-1] == "glossiness"  # beside another map: Unity has it in the alpha
    return (kinds[-2], "other", "other", "glossiness") if gloss else tuple(kinds[-1:])


def words(stem: str) -> list[str]:
    """The words of a name in small letters, without sizes such as 2K and 4096 and kinds of files."""
    parts = re.findall(r"[A-Za-z]+\d[A-Za-z0-9]*|[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", SIZES.sub(" ", stem))
    return [part.lower() for part in parts]


def sources(folder: Path) -> tuple[dict[str, Source], list[Path]]:
    """Maps by kind (those of SVBRDFs, and ``specular_level``), and the images that are none of them;
    MapsError for two files of one map.

    Words that the names begin with in common, such as the material's, mean nothing: ``rusty_metal_rough``
    beside ``rusty_metal_diff`` is a roughness.
    """
    images = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.name[0] != "."
                    and p.is_file())
    common = _in_common([path.stem for path in images if kind_of(path.stem)])
    found: dict[str, dict[tuple, list[Source]]] = {}
    for path in images:
        for name, source in named_sources(path, common).items():
            plain = FIELD.get(name, (name,))
            rank = (source.convention == "dx", source.channel is not None, source.inverted,
                    plain.index(path.stem.lower()) if path.stem.lower() in plain else len(plain),
                    SUFFIXES.index(path.suffix.lower()))
            found.setdefault(name, {}).setdefault(rank, []).append(source)
    chosen = {}
    for name, ranked in found.items():
        if name in ("occlusion", "height", "other"):
            continue
        best = ranked[min(ranked)]
        if len(best) > 1:
            raise MapsError(f"one {name} map", " and ".join(s.path.name for s in best[:3] if s.path),
                            "give a folder with the files of one material in one size")
        chosen[name] = best[0]
    return chosen, [path for path in images if path not in {source.path for source in chosen.values()}]


def named_sources(path: Path, dropped: int = 0) -> dict[str, Source]:
    """The maps that a file holds by its name (:func:`kind_of`)."""
    kinds = [kind.partition(" ") for kind in kind_of(path.stem, dropped)]
    return {"roughness" if name == "glossiness" else name: Source(
        path, k if len(kinds) > 1 and _CODES.get(name) != "srgb" else None, name == "glossiness", convention)
        for k, (name, _, convention) in enumerate(kinds)}


def _in_common(stems: list[str]) -> int:
    """How many words all names begin with. A name of these words alone belongs to a preview."""
    each = sorted(map(words, stems), key=len)
    first = os.path.commonprefix(each)
    if len(each) > 2 and len(each[1]) > len(each[0]) == len(first):
        return len(first)
    shared = range(len(first), 0, -1) if len(stems) > 1 else ()
    return next((k for k in shared if 2 * sum(bool(kind_of(stem, k)) for stem in stems) > len(stems)), 0)


def is_of_field(chosen: Mapping[str, Source]) -> bool:
    """Whether the files have the field's plain names: their maps then are diffuse and specular."""
    plain = {name: name if source.part is not None else source.path.stem.lower()
             for name, source in chosen.items() if source.path}
    return "diffuse" in plain and not {"base_color", "metallic"} & set(plain) and all(
        plain[name] in names for name, names in FIELD.items() if name in plain)
