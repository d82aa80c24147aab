"""Texture files and their descriptions: map, colour space, normal convention."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from .. import __version__
from ..io import files, images
from ..kinds import check_fields
from ..material.encoding import NormalConvention
from ..material.maps import COLOURS, shown_map

Bits = Literal[8, 16]
Naming = Literal["own", "polyhaven", "ambientcg", "substance", "materialgan", "deschaintre"]

SRGB, LINEAR = "sRGB", "linear"
NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text(encoding="utf-8"))  # by format
NORMALS = {"gl": "OpenGL, +Y up, (n + 1) / 2", "dx": "DirectX, +Y down, (n + 1) / 2"}


@dataclass(frozen=True)
class ExportSettings:
    """How a material is written.

    Args:
        name: the material's name, in file names of ``maps`` and in the GLB.
        naming: file names of ``maps``.
        normal: convention of normals in ``maps``; all other formats use OpenGL's.
        bits: of PNG files; always 8 for colours of ``usd`` and all of ``gltf``, 16 for heights and IOR.
        side: of the patch in metres, for the sizes of meshes and heights; default: the mesh has side 1, of
            any unit.
        licence: what users may do with the material; written to every ``export.json`` and to the GLB.
        repeats: whether opposite edges meet (:func:`mitsvbrdf.material.tiling.seamless`): textures then
            repeat, and heights continue across the edges.
    """

    name: str = "material"
    naming: Naming = "own"
    normal: NormalConvention = "gl"
    bits: Bits = 16
    side: float | None = None
    licence: str | None = None
    repeats: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


DEFAULTS = ExportSettings()


@dataclass(frozen=True)
class Texture:
    """The entry of a texture file in ``export.json``."""

    file: str  # its path, relative to export.json; for a texture inside another file, both names
    holds: str  # which map; for a packed texture: which map in which channel
    colour_space: str  # sRGB (transfer function of IEC 61966-2-1) or linear
    bits: int  # per channel; 32: float
    normal: str | None = None  # the convention of a normal map, else None


def stored(name: str, value: Tensor, normal: NormalConvention = "gl") -> Tensor:
    """A map as stored, in [0, 1]: colours in sRGB, others linear; normals (n + 1) / 2, with -y for ``dx``."""
    if (name, normal) == ("normal", "dx"):
        value = value * torch.tensor([1.0, -1.0, 1.0], dtype=value.dtype)
    return shown_map(name, value)


def described(file: str, name: str, bits: int, normal: NormalConvention = "gl") -> Texture:
    """The description of a map that is encoded by :func:`stored`."""
    return Texture(file, name, SRGB if name in COLOURS else LINEAR, bits,
                   NORMALS[normal] if name == "normal" else None)


def write_pngs(folder: Path, maps: Mapping[str, tuple[str, Tensor, Bits]],
               normal: NormalConvention = "gl") -> dict[str, Texture]:
    """Write PNGs of linear maps in parallel; ``maps``: name to (file, values, bits)."""
    images.write_all([partial(images.write_png, folder / file, value, bits, partial(
        stored, name, normal=normal)) for name, (file, value, bits) in maps.items()])
    return {name: described(file, name, bits, normal) for name, (file, _, bits) in maps.items()}


def rendered(template: str, **about: object) -> bytes:
    """A document, rendered from the template of this name beside this module."""
    import jinja2

    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    return jinja2.Template(text, trim_blocks=True, keep_trailing_newline=True).render(about).encode()


@dataclass(frozen=True)
class Export:
    """What was written in one format."""

    files: tuple[str, ...]  # the files to open, relative to the folder
    textures: tuple[Texture, ...]  # all textures
    notes: tuple[str, ...] = ()  # what the format cannot express, and what it expresses in another way
    # kind of conversion -> its errors; see mitsvbrdf.export.residual.residual
    conversion: dict[str, dict[str, float]] | None = None

    def write(self, folder: Path, **about: object) -> None:
        """Write ``export.json`` into the folder."""
        files.write_json(folder / "export.json", {
            "schema_version": 2, "mitsvbrdf": __version__, **about, "files": list(self.files),
            "textures": [asdict(texture) for texture in self.textures],
            "row_0": "top of the patch", "notes": list(self.notes), "conversion_rmse": self.conversion or {}})
