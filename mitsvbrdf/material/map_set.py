"""Find the files of a material in a folder by their names, and read each file in its encoding."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..errors import AssumedWarning, MapsError, MapsWarning
from ..io import images
from ..io.decode import header
from .conversion import FULL_LEVEL, as_shown
from .encoding import ENCODINGS, read_material_json
from .maps import CHANNELS, COLOURS, SVBRDF, Bsdf, finite
from .naming import ALPHA, FIELD, SUFFIXES, Source, is_of_field, kind_of, named_sources, sources
from .normals import OVERRULE, unit_normals
from .resample import resized

LEAST_ROUGHNESS = 1 / 512  # half an 8-bit step: 8-bit files hold any lower roughness as 0
RINGING = 0.05  # how far values may be outside of [0, 1], as a result of lossy coders of EXR
TINT = 0.05  # mean spread of the channels; above it, an image is coloured or contains several maps
LOWEST_F0 = 0.01  # half that of water
USUAL_SIDE = 64  # texels a side of a material without a texture
STRIPS = "tex.png", "strip.png"  # names of strips of maps in folders
FLAT = 0.5, 0.5, 1.0  # a flat normal as stored
# Position of the normals in a strip: its maps from left to right, and the encoding of 8 bits. 0 is the order
# of Deschaintre 2018, also with an input photo before the maps; 1 is that of MaterialGAN.
DESCHAINTRE = "normal", "diffuse", "roughness", "specular"
ORDERS = {0: (DESCHAINTRE, "linear"), 1: (("diffuse", "normal", "roughness", "specular"), "gamma 2.2")}


class MapSet(NamedTuple):
    """The files of a material before they are read."""

    place: Path  # the folder or file they were found in
    sources: Mapping[str, Source]  # map -> its source; f0 is the F0 of non-metals
    stated: Mapping[str, str]  # map -> its encoding, if stated by the user, material.json or a document
    habit: str = "srgb"  # the encoding of the other maps, a key of ENCODINGS
    bsdf: Bsdf | None = None  # as stated in material.json
    passed: tuple[str, ...] = ()  # names of files that are not read
    taken: float | None = None  # the share of diffuse light that is lost to the highlight; None: the F0
    remarks: tuple[str, ...] = ()  # further texts for the warning of what is assumed
    way: str = OVERRULE  # how the user overrules an encoding; {} stands for the encoding

    def code(self, name: str) -> str:
        """The encoding of a map's file: linear for EXR, else as stated, else sRGB if the file has a colour
        profile (its colours are converted), else by ``habit``. Normals: ``gl``, ``dx`` or empty.
        """
        usual, path = ENCODINGS[self.habit], self.sources.get(name, Source(None)).path
        if name != "normal" and path and path.suffix.lower() == ".exr":
            return "linear"
        if name in COLOURS and path:
            profile = header(path, MapsError).profile
            usual = ENCODINGS["srgb"] if profile and profile.icc else usual
        return self.stated.get(name, usual.get(name, "" if name == "normal" else "linear"))

    def read(self, name: str, channels: int) -> Tensor:
        """A map, linear, H x W x channels; a constant is 1 x 1 x channels."""
        source = self.sources[name]
        if source.path is None:
            return torch.tensor(source.factor).expand(1, 1, channels)
        document = self.place.is_file() and source.part is None  # a document overrides colour profiles
        value = read_map(source, name, channels, self.code(name), self.way, document)
        return value if source.factor == (1.0,) else value * torch.tensor(source.factor)


def find_maps(folder: Path) -> MapSet:
    """The map set of a folder; see :func:`mitsvbrdf.material.map_files.load_maps`."""
    if (folder / "maps").is_dir():
        folder = folder / "maps"
    if not folder.is_dir():
        raise MapsError("a folder of maps", f"no folder at {folder}",
                        "give the folder that holds diffuse, specular, ...")
    chosen, passed = sources(folder)
    if not chosen and (folder / "textures").is_dir():
        folder = folder / "textures"
        chosen, passed = sources(folder)
    about = read_material_json(folder)
    pictures = [*{*passed, *(each.path for each in chosen.values() if each.path)}]
    strips = [folder / name for name in STRIPS if "diffuse" not in chosen and (folder / name).is_file()]
    if len(pictures) == 1 and pictures[0].suffix.lower() in SUFFIXES[1:7]:  # whatever its name says
        width, height = header(pictures[0], MapsError).size
        strips += pictures if width in (4 * height, 5 * height) else []
    if strips and about.get("bsdf") != "principled":
        return strip_set(strips[0], about.get("encoding", {}))
    return MapSet(folder, chosen, about.get("encoding", {}), "gamma 2.2" if is_of_field(chosen) else "srgb",
                  about.get("bsdf"), tuple(path.name for path in passed))


def strip_set(path: Path, stated: Mapping[str, str]) -> MapSet:
    """A strip: four square maps side by side in one file, or five squares of which the last four are maps.

    The order follows from the normals: of the first two maps, the one whose mean is nearer to flat.
    MapsError: neither four nor five squares.
    """
    image = images.read_image(path, MapsError, data=True)
    side, count = image.shape[0], image.shape[1] // image.shape[0]
    if count not in (4, 5) or image.shape[1] != count * side:
        raise MapsError("a strip of four or five squares", f"{path} of {image.shape[1]} x {side}",
                        "give normal, diffuse, roughness, specular side by side")
    usual = image.mean(dim=0).reshape(count, side, -1).mean(dim=1)[-4:]
    order, habit = ORDERS[int((usual[:2] - torch.tensor(FLAT)[:image.shape[2]]).abs().sum(dim=1).argmin())]
    parts = {name: Source(path, part=count - 4 + k) for k, name in enumerate(order)}
    said = f"its last four squares are {', '.join(order)}"
    return MapSet(path, parts, stated, habit, "roughconductor", remarks=(said,))


def read_set(found: MapSet, bsdf: Bsdf | None = None) -> SVBRDF:
    """The material of a set, not checked yet; see :func:`mitsvbrdf.material.map_files.load_maps`."""
    there, asked = dict(found.sources), bsdf or found.bsdf
    colour = there.get("base_color") or there.get("diffuse")
    stated = {ours: found.stated[theirs] for ours, theirs in (("diffuse", "base_color"), (
        "base_color", "diffuse")) if ours not in there and theirs in found.stated}  # one file may be either
    found = found._replace(stated=stated | dict(found.stated))
    beside = {"diffuse", "specular", "base_color"} <= set(there)  # both parameter sets
    if _has_lobes(found) or asked == "roughconductor" and beside:
        there |= {"diffuse": there.get("diffuse", colour)} if colour else {}
        return _read(found._replace(sources=there), asked or "roughconductor")
    there |= {"base_color": colour} if colour else {}
    there.setdefault("metallic", Source(None, factor=(0.0,)))
    if level := there.get("specular_level") or there.get("specular"):
        there.setdefault("f0", level._replace(factor=(FULL_LEVEL,)))
    found = found._replace(sources=there)
    if "f0" not in there or beside or asked == "principled":
        material = _read(found, "principled")
        return material.as_roughconductor() if asked == "roughconductor" else material
    return _read(found, "principled", "f0")


def _has_lobes(found: MapSet) -> bool:
    """Whether the maps are diffuse and specular colours; else they are base colour and metallic."""
    there = found.sources
    if {"base_color", "metallic"} <= set(there):
        return False
    if is_of_field(there) or not {"base_color", "diffuse"} & set(there):
        return True
    specular = there.get("specular")
    if specular is None or specular.path is None or "metallic" in there:
        return False
    gloss = "roughness" in there and there["roughness"].inverted
    return gloss or _tint(images.read_image(specular.path, MapsError)) > TINT


def _read(found: MapSet, bsdf: Bsdf, f0: str = "") -> SVBRDF:
    """The material of one BSDF; if ``f0`` (the name of an F0 map) is given, as ``roughconductor``."""
    channels, there = dict(CHANNELS[bsdf]), found.sources
    for name in channels:
        if name not in there:
            here = ", ".join(dict.fromkeys([*(s.path.name for s in there.values() if s.path), *found.passed]))
            raise MapsError(f"{name}.exr, {name}.png or {name}.jpg",
                            f"none in {found.place}" + f" ({here})" * bool(here),
                            f"a {bsdf} material needs {', '.join(CHANNELS[bsdf])}")
    if f0:
        channels[f0] = len(there[f0].factor)
    read = {name: found.read(name, count) for name, count in channels.items()}
    maps = _of_one_size(found, read)
    _say(found, {name: there[name] for name in channels}, maps)
    if not f0:
        return SVBRDF(bsdf, maps)
    dielectric, most = maps.pop(f0), FULL_LEVEL if found.place.is_dir() else torch.inf  # documents: clamped
    if dielectric.min() < 0 or dielectric.max() > most:
        raise MapsError("a specular level in [0, 1]", str(there[f0].path or "numbers"), "check its encoding")
    dielectric = dielectric.clamp_max(1)
    taken = dielectric.amax(dim=-1, keepdim=True) if found.taken is None else torch.tensor(found.taken)
    return as_shown(SVBRDF(bsdf, maps), dielectric, taken)


def _of_one_size(found: MapSet, maps: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Square maps of one size. Constants are enlarged to it; maps of a document, to the largest of them."""
    sizes = {tuple(value.shape[:2]) for value in maps.values()} - {(1, 1)} or {(USUAL_SIDE, USUAL_SIDE)}
    side = max(max(sizes))
    if len(set().union(*sizes)) > 1 and not (found.place.is_file() and all(h == w for h, w in sizes)):
        raise MapsError("square maps of one size", f"sizes {sorted(sizes)} in {found.place}",
                        "resize them to one square size")
    each = {name: value if value.shape[0] == side else resized(value, side) for name, value in maps.items()}
    return each | {"normal": F.normalize(each["normal"], dim=-1) if len(sizes) > 1 else each["normal"]}


def _say(found: MapSet, used: Mapping[str, Source], maps: Mapping[str, Tensor]) -> None:
    """Warn in one line: what is assumed of a map set, which maps are missing, and what is not read."""
    named = {name: source.path.name for name, source in used.items() if source.path}
    coded = {name: found.code(name) for name, file in named.items()
             if name != "normal" and name not in found.stated and not file.lower().endswith(".exr")}
    said = []
    if found.habit == "gamma 2.2" in coded.values() and "srgb" not in coded.values():
        said.append(f"{', '.join(coded)} read as gamma 2.2, since the field uses these names")
        f0 = float(maps["specular"].median())
        if "specular" in coded and f0 < LOWEST_F0 < float(linear := color.encode(maps["specular"].median())):
            said.append(f"an F0 of {f0:.2g} is below that of any material; read as linear it is {linear:.2g}")
    elif coded or found.place.is_file():
        said.append("read " + (", ".join(
            f"{name} {file}" + f" ({found.code(name)})" * (name != "normal" and not file.endswith(".exr"))
            for name, file in named.items()) or "numbers alone"))
    if "f0" in used and used["f0"].factor == (FULL_LEVEL,):
        said.append(f"F0 is {FULL_LEVEL:g} times the specular level")
    normal = used.get("normal", Source(None))
    if normal.convention == "dx" and "normal" not in found.stated:
        said.append("normals are DirectX's by their name, so y is turned around")
    elif found.place.is_file() and normal.path and found.code("normal") == "gl" and (
            kind_of(normal.path.stem)[-1:] == ("normal dx",)):
        said.append("normals are read as OpenGL's by the format, despite their name; --normal dx overrules")
    said += found.remarks
    packed = {source.path for source in used.values() if source.channel == ALPHA}
    said += [f"passed over the alpha of {path.name}" for path in {s.path for s in used.values()} - packed
             if path and path.suffix.lower() != ".exr" and header(path, MapsError).mode == "RGBA"]
    missing = [name for name, source in used.items() if source.path is None and not found.place.is_file()]
    said += [f"no {name} map, so it is 0" for name in missing]
    if said and found.passed:
        said.append(f"passed over {', '.join(found.passed)}")
    if said:
        way = f"; {found.way} overrules".format("CODE or NAME=CODE,...") if coded or found.remarks else ""
        warnings.warn(f"{found.place}: {'; '.join(said)}{way}", AssumedWarning, stacklevel=2)


def read_file(path: Path, name: str, channels: int) -> Tensor:
    """Read one map from a file of any name. A ``material.json`` beside it may state the encoding."""
    held = named_sources(path)
    plain = not held or path.stem.lower() in FIELD.get(name, ())
    stated = read_material_json(path.parent).get("encoding", {})
    found = MapSet(path.parent, {name: held.get(name, Source(path))}, stated,
                   "gamma 2.2" if plain else "srgb", way="encoding {} in a material.json beside it")
    value = found.read(name, channels)
    _say(found, found.sources, {name: value, "specular": value})
    return value


def read_map(source: Source, name: str, channels: int, code: str, way: str = OVERRULE, document: bool = False
             ) -> Tensor:
    """One map from its file, linear, H x W x ``channels``. ``code`` is the encoding of an 8- or 16-bit file;
    of normals ``gl``, ``dx`` or empty. The colour profile of that file is used only if the code is sRGB and
    the map is not from a ``document``.
    """
    assert source.path is not None
    path, exr = source.path, source.path.suffix.lower() == ".exr"
    data = name not in COLOURS or not exr and (document or code != "srgb")
    image = images.read_image(path, MapsError, data, source.channel == ALPHA)
    if source.part is not None:
        side = image.shape[0]
        image = image[:, source.part * side:(source.part + 1) * side]
    if not finite(image):
        raise MapsError("finite values", f"NaN or infinity in {path}", "mend or re-export the map")
    if name == "normal":
        return unit_normals(image, path, code or source.convention, way)
    grey = image.shape[2] == 1 or not document and _tint(image) == 0 and bool(image.min() < image.max())
    if image.shape[2] == 2 or source.channel in (1, 2) and grey:
        raise MapsError(f"{name} alone, or in a channel of several maps as the name says", f"{path}, "
                        f"{'grey' if grey else 'of two channels'}", "name it for its one map, or export RGB")
    if source.channel is not None and image.shape[2] > 1:
        image = image[..., source.channel:source.channel + 1].contiguous()
    elif channels == 1 and (tint := _tint(image)) > TINT:
        raise MapsError(f"{name} in grey", f"{path} in colours that differ by {tint:.2g}",
                        "give the grey map, or name a packed one for its channels, as in NAME_orm.png")
    if image.shape[2] != channels:
        image = image.mean(dim=2, keepdim=True).expand(*image.shape[:2], channels)
    if not exr:
        image = color.decode(image, code.replace(" ", ""))  # type: ignore[arg-type]
    image = 1 - image if source.inverted else image
    low = float(image.min())
    image = _without_ringing(image, path) if exr else image
    # 8-bit files and clamped values can have a roughness of 0: it means half an 8-bit step or less
    mirror = name == "roughness" and (not exr or low < 0 <= float(image.min()))
    return image.clamp_min(LEAST_ROUGHNESS) if mirror else image


def _tint(image: Tensor) -> float:
    return float((image.amax(dim=2) - image.amin(dim=2)).mean())


def _without_ringing(image: Tensor, path: Path) -> Tensor:
    """Clamp values of an EXR that lossy coders left slightly outside of [0, 1], and warn."""
    low, high = float(image.min()), float(image.max())
    if 0 <= low and high <= 1 or not -RINGING <= low or not high <= 1 + RINGING:
        return image
    count = int(((image < 0) | (image > 1)).sum())
    warnings.warn(f"{path}: {count} of {image.numel()} values are slightly outside of [0, 1] ({low:.3g} to "
                  f"{high:.3g}), as lossy coders leave them; clamped", MapsWarning, stacklevel=2)
    return image.clamp(0, 1)
