"""The maps as PNG files, with the names that the target tool or texture library uses."""

import unicodedata
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import torch

from ..io import files, images
from ..material.conversion import FULL_LEVEL, layered
from ..material.encoding import ENCODINGS
from ..material.map_set import DESCHAINTRE
from ..material.maps import SVBRDF
from ..material.naming import FILE_NAMES
from ..material.relief import heights, occlusion
from .residual import shown_residual
from .textures import DEFAULTS, LINEAR, NORMALS, NOTES, Export, ExportSettings, Texture, stored, write_pngs

LONGEST = 100  # bytes of a material's name in file names; more would not fit every file system


def write_maps(folder: Path, svbrdf: SVBRDF, settings: ExportSettings = DEFAULTS) -> Export:
    """Write the maps that the naming lists: colours in sRGB, others linear; a strip is all linear.

    Some namings also list: the height integrated from the normals, plus 0.5 (on a square of side 1, displace
    with scale 1 and middle 0.5); ambient occlusion computed from this height; and occlusion, roughness and
    metallic packed in the channels of one file.
    """
    naming, normal, side = settings.naming, settings.normal, settings.side
    if naming == "deschaintre":
        return _strip(folder, svbrdf, settings)
    both, material = dict(svbrdf.as_roughconductor().maps), svbrdf
    if svbrdf.bsdf == "roughconductor":
        level = (both["specular"].mean(dim=-1, keepdim=True) / FULL_LEVEL).clamp_max(1.0)
        material = layered(svbrdf, FULL_LEVEL * level)
        both["specular_level"] = level = torch.where(material["metallic"] > 0, 0.5, level)
        lost = {"with the specular level": shown_residual(svbrdf, material, FULL_LEVEL * level),
                "without it": shown_residual(svbrdf, material)}
    else:
        lost = {"base colour as it is": shown_residual(svbrdf, svbrdf)}
    height = heights(svbrdf["normal"], settings.repeats)
    both |= {**material.maps, "occlusion": occlusion(height, settings.repeats).float()[..., None],
             "height": (height + 0.5).clamp(0, 1)[..., None]}
    both["packed"] = torch.cat((both["occlusion"], both["roughness"], both["metallic"]), dim=-1)
    unit = f"the patch's side, {side:.6g} metres" if side else "the patch's side"
    holds = {"packed": "occlusion in R, roughness in G, metallic in B",
             "height": f"height over {unit}, plus 0.5"}
    chosen = {key.removesuffix(f" {normal}"): file for key, file in FILE_NAMES[naming].items()}
    textures = write_pngs(folder, {
        key: (f"{file.replace('NAME', _safe(settings.name))}.png", both[key],
              16 if key == "height" else settings.bits)
        for key, file in chosen.items() if key in both}, normal)
    written = [replace(texture, holds=holds.get(key, key)) for key, texture in textures.items()]
    if naming in ("own", "materialgan"):  # names that load_maps knows
        files.write_json(folder / "material.json", {
            "bsdf": "roughconductor" if naming == "materialgan" else svbrdf.bsdf, "size": svbrdf.resolution,
            "encoding": {key: code for key, code in ENCODINGS["srgb"].items() if key in chosen}
            | {"normal": NORMALS[normal]}})
    lossy = "metallic" in chosen
    notes = (NOTES["maps"][svbrdf.bsdf],) * lossy + (NOTES["maps"]["gamma"],) * (naming == "materialgan")
    return Export(tuple(texture.file for texture in written), tuple(written), notes, lost if lossy else None)


def _strip(folder: Path, svbrdf: SVBRDF, settings: ExportSettings) -> Export:
    maps, file = svbrdf.as_roughconductor().maps, f"{_safe(settings.name)}.png"
    squares = [stored(name, maps[name], settings.normal) if name == "normal" else maps[name].clamp(0, 1)
               for name in DESCHAINTRE]
    images.write_png(folder / file, torch.cat([square.expand(-1, -1, 3) for square in squares], dim=1),
                     settings.bits)
    files.write_json(folder / "material.json", {"bsdf": "roughconductor", "encoding": dict.fromkeys(
        DESCHAINTRE, LINEAR) | {"normal": NORMALS[settings.normal]}})
    holds = f"{', '.join(DESCHAINTRE)} side by side"
    return Export((file,), (Texture(file, holds, LINEAR, settings.bits, NORMALS[settings.normal]),))


def _safe(name: str) -> str:
    """A name's letters and digits (of any script), - and _; if it has none, ``material`` and a hash."""
    kept = (c if unicodedata.category(c)[0] in "LMN" or c in "-_" else " "
            for c in unicodedata.normalize("NFC", name))
    safe = "_".join("".join(kept).split()).strip("_").encode()[:LONGEST].decode(errors="ignore")
    return safe or (f"material_{crc32(name.encode(errors='surrogatepass')):08x}" if name else "material")
