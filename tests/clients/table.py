"""``python -m clients.table``: clients.json and the pictures of docs/results, from exports in real programs.

Run in ``tests``; FITS are further materials. ``python docs/results/clients.py`` makes the page.
"""

import argparse
import json
import tempfile
from pathlib import Path

import torch
from clients.programs import CLIENTS, compared, exported, truth
from helpers.exported import gilt_plates
from PIL import Image

from mitsvbrdf.bench.run import version
from mitsvbrdf.color import to_display
from mitsvbrdf.io import files
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps
from mitsvbrdf.material.maps import SVBRDF

PICTURED = 160  # pixels a side


def measured(materials: dict[str, SVBRDF], pictured: tuple[str, ...], pictures: Path) -> dict:
    """Every material in every client; sheets of those pictured."""
    found: dict[str, dict] = {}
    for name, material in materials.items():
        with tempfile.TemporaryDirectory() as folder:
            exported(material, Path(folder))
            wanted, rows, found[name] = truth(material), {}, {}
            for client, draw in CLIENTS.items():
                shown = draw(Path(folder), material.resolution)
                found[name][client] = compared(shown, wanted)
                rows[client] = shown
                print(name, client, found[name][client], flush=True)
        if name in pictured:
            sheet = [torch.cat([images_of(light) for light in each], dim=1) for each in (wanted,
                                                                                         *rows.values())]
            levels = (255 * torch.cat(sheet, dim=0)).round().to(torch.uint8).numpy()
            Image.fromarray(levels).save(pictures / f"clients-{name}.jpg", quality=90)
    return found


def images_of(picture: torch.Tensor) -> torch.Tensor:
    """Display values at the size of the sheet."""
    shown = to_display(picture.float(), "srgb").clamp(0, 1)
    return torch.nn.functional.interpolate(shown.movedim(-1, 0)[None], (PICTURED, PICTURED),
                                           mode="area")[0].movedim(0, -1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fits", nargs="*", type=Path, help="folders of fits")
    parser.add_argument("--pictured", default="", help="names of materials that get a sheet, by commas")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for clients.json and pictures")
    given = parser.parse_args()
    materials = {"gilt plates": gilt_plates(256), "inlay": make_material("inlay", 256)}
    materials |= {folder.name: load_maps(folder) for folder in given.fits}
    pictured = tuple(name for name in given.pictured.split(",") if name in materials)
    record = {"materials": measured(materials, pictured, given.out), "pictured": pictured,
              "version": version()}
    files.write_bytes(given.out / "clients.json", (json.dumps(record, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
