"""The maps of a MaterialX document, from its numbers and the textures beside it.

Source: MaterialX specification 1.38 and 1.39, its standard nodes, and the surface shaders of its libraries.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import torch

from .. import color
from ..errors import MapsError
from ..io.files import read_regular
from ..io.json import error_text
from .encoding import code_of
from .gltf_set import LARGEST, beside, placed_alike
from .map_set import LEAST_ROUGHNESS, MapSet
from .maps import DIELECTRIC_F0
from .naming import NAMES, SURFACES, Source

NODES = NAMES["materialx"]


def mtlx_set(path: Path) -> MapSet:
    """The one material of a document. MapsError: none or several, or a node that the reader does not know."""
    try:
        if b"<!DOCTYPE" in read_regular(path, LARGEST).replace(b"\0", b"").upper():
            raise ValueError("a DOCTYPE")
        return _Document(path).material()
    except (OSError, ValueError, LookupError, ArithmeticError, RecursionError, ET.ParseError) as reason:
        raise MapsError("a MaterialX document of one material, of image files and numbers", f"{path}: "
                        f"{error_text(reason)}", "bake it to image files, or give their folder") from None


class _Document:
    def __init__(self, path: Path) -> None:
        self.path, self.root, self.placed = path, ET.parse(path).getroot(), dict[str, str]()
        self.above = {child: parent for parent in self.root.iter() for child in parent}
        self.code, self.normal = "linear", "gl"

    def material(self) -> MapSet:
        """The document's maps, each from an input of the one surface shader."""
        wired = [_inputs(node)["surfaceshader"] for node in self.root if node.tag == "surfacematerial"]
        shaders = [_named(self.root, entry.get("nodename")) for entry in wired] or [
            node for node in self.root if node.tag in SURFACES]
        if [node.tag in SURFACES for node in shaders] != [True]:
            said = ", ".join(f"{node.tag} {node.get('name')}" for node in shaders[:9])
            raise ValueError(f"{len(shaders)} materials ({said}), expected one {' or '.join(SURFACES)}")
        inputs, found, codes = _inputs(shaders[0]), dict[str, Source](), dict[str, str]()
        remarks = [f"passed over {name}" for name, entry in inputs.items() if re.fullmatch(
            NODES["lacking"], name) and set(_numbers(entry)) != {float(name.endswith("opacity"))}]
        for ours, (name, default) in SURFACES[shaders[0].tag].items():
            self.code = "linear"
            found[ours] = self.source(inputs[name]) if name in inputs else Source(None, factor=(default,))
            codes[ours] = self.code
        weight, level, tint, index = map(found.pop, ("weight", "level", "specular_color", "index"))
        if weight.path or index.path or inputs.get("useSpecularWorkflow", self.root).get("value") == "1":
            raise ValueError("a texture of the base's weight or of the index, or the specular workflow")
        found["base_color"] = _times(found["base_color"], weight)
        if not found["roughness"].path:
            found["roughness"] = Source(None, factor=(max(*found["roughness"].factor, LEAST_ROUGHNESS),))
        if found["normal"].channel is not None or set(found["normal"].factor) - {0, 0.5, 1}:
            raise ValueError("normals that are no image of them")
        found["normal"] = found["normal"] if found["normal"].path else Source(None, factor=(0.0, 0.0, 1.0))
        step, taken = index.factor[0], None
        facing = DIELECTRIC_F0 if step == 1.5 else ((step - 1) / (step + 1))**2
        if tint.path or level.path or {*tint.factor, *level.factor, facing} != {1.0, DIELECTRIC_F0}:
            found["f0"] = _times(_times(tint, level), Source(None, factor=(facing,)))
            codes["f0"] = codes["specular_color" if tint.path else "level"]
            if not level.path and shaders[0].tag in ("standard_surface", "open_pbr_surface"):
                taken = facing * level.factor[0]
        return MapSet(self.path, found, codes | {"normal": self.normal}, taken=taken, way="--encoding {}",
                      remarks=(*remarks, *placed_alike(self.path, self.placed)))

    def source(self, entry: ET.Element) -> Source:
        """The source that an input or output is connected to, or its own numbers, linear."""
        holder = self.above[entry]
        scope = holder if entry.tag == "output" else self.above.get(holder, self.root)
        if name := entry.get("interfacename"):
            found = self.source(_inputs(scope)[name])
        elif name := entry.get("nodegraph"):
            outputs = [each for each in _named(self.root, name) if each.tag == "output"]
            found = self.source(_named(outputs, entry.get("output", outputs[0].get("name"))))
        elif name := entry.get("nodename"):
            found = self.node(_named(scope, name), entry.get("output", ""))
        else:
            code = self.coded(entry) if "color" in entry.get("type", "") else "linear"
            numbers = torch.tensor(_numbers(entry)[:3] or (0.0,))
            numbers = color.decode(numbers, code.replace(" ", ""))  # type: ignore[arg-type]
            found = Source(None, factor=tuple(numbers.tolist()))
        return _channel(found, entry.get("channel") or entry.get("channels") or "")

    def node(self, node: ET.Element, output: str) -> Source:
        """The source that a node outputs: an image or one of its channels, possibly times numbers."""
        inputs, kind, said = _inputs(node), node.tag, f"{node.tag} {node.get('name')!r}"
        if kind in NODES["images"].split():
            return _channel(self.image(node, inputs), output)
        if kind == "multiply":
            return _times(self.source(inputs["in1"]), self.source(inputs["in2"]))
        if kind not in NODES["passing"].split():
            raise ValueError(f"{said} between a shader and its image files")
        if kind in ("extract", "swizzle"):
            output = inputs["index" if kind == "extract" else "channels"].get("value", "0")
        if kind == "normalmap":
            scale, space = (inputs.get(name, ET.Element("")) for name in ("scale", "space"))
            if (_numbers(scale) or (1,)) not in ((1,), (1, 1), (1, -1)) or {"nodename", "interfacename"} & {
                    *scale.attrib} or "bitangent" in inputs or space.get("value", "tangent") != "tangent":
                raise ValueError(f"{said} with a scale, a bitangent or a space of its own")
            self.normal = "dx" if -1 in _numbers(scale) else "gl"
        return _channel(self.source(inputs["value" if kind == "constant" else "in"]), output)

    def image(self, node: ET.Element, inputs: dict[str, ET.Element]) -> Source:
        """The file of an image node."""
        file, kind, placing = inputs["file"], node.get("type", ""), NODES["placing"]
        while name := file.get("interfacename"):
            file = _inputs(self.above[self.above[file]])[name]
        name = self.inherited(file, "fileprefix") + file.get("value", "")
        path = beside(self.path, name.replace("\\", "/"))
        self.code = self.coded(file) if kind.startswith(("color", "multi")) else "linear"
        moved = {name: entry.get("value") or entry.get("nodename") for name, entry in inputs.items() if (
            set(_numbers(entry)) != {placing[name]} if name in placing else name in ("texcoord", "st") and not
            re.match(NODES["coordinates"], _named(self.above[node], entry.get("nodename")).tag))}
        exr = path.suffix.lower() == ".exr"
        if "scale" in moved and node.tag == "UsdUVTexture" or exr and self.code != "linear":
            raise ValueError(f"{node.tag} {node.get('name')!r} with a scale, or an EXR in {self.code}")
        placed = ", ".join(f"{name} {value}" for name, value in moved.items())
        if self.placed.setdefault(path.name, placed) != placed:
            raise ValueError(f"{path.name} at two places of the maps")
        found = Source(path, 0, factor=(1.0,)) if kind == "float" else Source(path, factor=(1.0,) * 3)
        for name in {"factor", "color"} & set(inputs):
            found = _times(found, self.source(inputs[name]))
        return found

    def coded(self, entry: ET.Element) -> str:
        return code_of("base_color", self.inherited(entry, "colorspace") or "linear")[1]

    def inherited(self, element: ET.Element | None, attribute: str) -> str:
        while element is not None and attribute not in element.attrib:
            element = self.above.get(element)
        return "" if element is None else element.attrib[attribute]


def _inputs(node: ET.Element) -> dict[str, ET.Element]:
    return {entry.get("name", ""): entry for entry in node if entry.tag == "input"}


def _named(nodes: Iterable[ET.Element], name: str | None) -> ET.Element:
    if found := [node for node in nodes if node.get("name") == name and node.tag != "input"]:
        return found[0]
    raise ValueError(f"no node {name!r}")


def _numbers(entry: ET.Element) -> tuple[float, ...]:
    return tuple(float(x) for x in entry.get("value", "").replace(",", " ").split())


def _channel(source: Source, name: str) -> Source:
    """A channel of a source, by its number, its letter or the name of an output."""
    if name in ("", "out", "outcolor", "rgb", "rgba", "xyz"):
        return source
    letter = re.fullmatch(r"(?:out)?([rgbxyz012])\1*", name)
    if not letter or source.channel is not None:
        raise ValueError(f"channel {name!r} of {source.path or 'a number'}")
    k = "rgbxyz012".index(letter[1]) % 3
    return source._replace(channel=k if source.path else None, factor=(source.factor * 3)[k:k + 1])


def _times(one: Source, other: Source) -> Source:
    """The product of two sources; at least one must be one or three numbers, else ValueError."""
    if one.path and other.path:
        raise ValueError(f"a product of two images, {one.path.name} and {other.path.name}")
    size = max(len(one.factor), len(other.factor))
    pairs = [*zip(one.factor * size, other.factor * size)][:size]
    return (one if one.path else other)._replace(factor=tuple(a * b for a, b in pairs))
