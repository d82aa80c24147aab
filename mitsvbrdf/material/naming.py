"""Find which file of a folder is which map, by the names of texture libraries, programs and research."""

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ..errors import MapsError

NAMES = tomllib.loads(Path(__file__).with_name("names.toml").read_text(encoding="utf-8"))
FILE_NAMES: dict[str, dict[str, str]] = NAMES["files"]  # naming -> map -> file name of `export`
SURFACES: dict[str, dict[str, tuple[str, float]]] = NAMES["shaders"]  # map -> input, default

# The names in SVBRDF research ("the field"). Their 8-bit files have gamma 2.2 if nothing else is stated.
FIELD = {"diffuse": ("diffuse", "dif"), "specular": ("specular", "spe"), "roughness": ("roughness", "rgh"),
         "normal": ("normal", "nom", "normal_dx", "nom_dx")}
# Suffixes of images, the best first.
SUFFIXES = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".tga", ".bmp", ".hdr")

_CODES = NAMES["encodings"]["srgb"]
_CONVENTIONS = {"gl": ("gl", "opengl", "ogl"), "dx": ("dx", "directx", "d3d")}
KINDS = {word: kind for kind, words in NAMES["words"].items() for word in words.split()} | {
    join: f"normal {convention}" for convention, marks in _CONVENTIONS.items() for mark in marks
    for normal in NAMES["words"]["normal"].split() for join in (normal + mark, mark + normal)}
# Letters in the name of a packed file: its channels. glTF's metallicRoughness: roughness in G, metallic in B.
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

    path: Path | None  # an image file; None: the map is the constant ``factor``
    channel: int | None = None  # the map's channel in a packed file
    inverted: bool = False  # whether the file contains 1 - map, as for gloss
    convention: str = ""  # of normals: gl or dx, if the file's name states it
    factor: tuple[float, ...] = (1.0,)  # multiplies the linear map: one for all channels, or one for each
    part: int | None = None  # the map's square in a strip, from the left


def kind_of(stem: str, dropped: int = 0) -> tuple[str, ...]:
    """The map that a file's name (without suffix) means, or the maps of its three or four channels; empty
    if it means no map. The first ``dropped`` words of the name are ignored.
    """
    if (short := WORKFLOW.sub("", stem)) != stem and (
            (known := kind_of(short, dropped)) or re.search(r"_[A-Z]{3,}\d*$", short)):  # map's word last
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
    gloss = kinds[1:] and kinds[-1] == "glossiness"  # after another map: Unity has it in alpha
    return (kinds[-2], "other", "other", "glossiness") if gloss else tuple(kinds[-1:])


def words(stem: str) -> list[str]:
    """The words of a name in lower case, without sizes (2K, 4096) and file types (png)."""
    parts = re.findall(r"[A-Za-z]+\d[A-Za-z0-9]*|[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", SIZES.sub(" ", stem))
    return [part.lower() for part in parts]


def sources(folder: Path) -> tuple[dict[str, Source], list[Path]]:
    """The source of each map (of SVBRDFs, and ``specular_level``), and the images that are not used.
    MapsError: two files fit one map equally well.

    Words that all names begin with, such as the material's, are ignored: ``rusty_metal_rough`` beside
    ``rusty_metal_diff`` is a roughness.
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
    """The maps in a file according to its name (:func:`kind_of`): a dict, map to source."""
    kinds = [kind.partition(" ") for kind in kind_of(path.stem, dropped)]
    return {"roughness" if name == "glossiness" else name: Source(
        path, k if len(kinds) > 1 and _CODES.get(name) != "srgb" else None, name == "glossiness", convention)
        for k, (name, _, convention) in enumerate(kinds)}


def _in_common(stems: list[str]) -> int:
    """How many leading words to ignore: all names share them. A name of only these words is a preview's."""
    each = sorted(map(words, stems), key=len)
    first = os.path.commonprefix(each)
    if len(each) > 2 and len(each[1]) > len(each[0]) == len(first):
        return len(first)
    shared = range(len(first), 0, -1) if len(stems) > 1 else ()
    return next((k for k in shared if 2 * sum(bool(kind_of(stem, k)) for stem in stems) > len(stems)), 0)


def is_of_field(chosen: Mapping[str, Source]) -> bool:
    """Whether the files have the field's names; then the maps are diffuse and specular."""
    plain = {name: name if source.part is not None else source.path.stem.lower()
             for name, source in chosen.items() if source.path}
    return "diffuse" in plain and not {"base_color", "metallic"} & set(plain) and all(
        plain[name] in names for name, names in FIELD.items() if name in plain)
