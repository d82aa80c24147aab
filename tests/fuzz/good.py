"""The good files that cases spoil: one of each kind that the package reads, 16 pixels a side."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
from fuzz.words import DIRECT, FIT, RELIT
from helpers.batches import asked, publish, result_of

from mitsvbrdf import cli
from mitsvbrdf.batch.asked import take_stock
from mitsvbrdf.batch.library import Library
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.capture import read_capture, write_capture
from mitsvbrdf.export import export_material
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


def make(folder: Path) -> None:
    """Make all of them; the names of the folders are the parts of a case."""
    _call(f"synth builtin:inlay -o {folder}/capture --resolution 16 --renderer analytic --noise 0.003")
    for way in (_jpeg, _text, _plain, _bench, _list):
        way(folder)
    _call(f"fit {folder}/capture -o {folder}/fit {FIT}")
    _call(f"fit {folder}/capture -o {folder}/direct {DIRECT}")
    _call(f"guess {folder}/capture -o {folder}/guessed --resolution 16")
    _call(f"relight {folder}/fit -o {folder}/relit {RELIT}")
    record = folder / "relit/relight.json"
    # where the fit lies in a case
    record.write_text(record.read_text().replace(str(folder.resolve()), "@@/in"))
    save_maps(make_material("tiles", 16), folder / "maps")
    for path in (folder / "maps").glob("*.exr"):
        (folder / "exr" / path.name).parent.mkdir(exist_ok=True)
        path.rename(folder / "exr" / path.name)
    cv2.imwrite(str(folder / "exr/light.hdr"), np.ones((8, 16, 3), np.float32))
    _documents(folder / "documents")
    _library(folder)


def _call(words: str) -> None:
    assert cli.main(words.split()) == 0, words


def _jpeg(folder: Path) -> None:
    """The capture with JPEGs."""
    write_capture(read_capture(folder / "capture"), folder / "jpeg")
    for path in sorted((folder / "jpeg/target").glob("*.png")):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()


def _text(folder: Path) -> None:
    """The capture as MaterialGAN states it."""
    stated = json.loads((folder / "capture/capture.json").read_text())
    shutil.copytree(folder / "capture/target", folder / "text")
    np.savetxt(folder / "text/camera_pos.txt", stated["camera_pos"], delimiter=",")
    np.savetxt(folder / "text/light_pos.txt", stated["light_pos"], delimiter=",")
    np.savetxt(folder / "text/light_power.txt", [stated["light_pow"]], delimiter=",")
    np.savetxt(folder / "text/image_size.txt", [[stated["im_size"]] * 2], delimiter=",")


def _plain(folder: Path) -> None:
    """Two plain photos, with EXIF: too few to find out where they were taken from."""
    from PIL import Image

    (folder / "plain").mkdir()
    pixels = np.random.default_rng(0).integers(0, 256, (2, 48, 64, 3), dtype=np.uint8)
    for number, each in enumerate(pixels):
        exif = Image.Exif()
        exif[271], exif[272], exif[274] = "Maker", "Model", 6
        exif.get_ifd(0x8769).update({34855: 100, 33434: (1, 60), 41989: 26})
        Image.fromarray(each).save(folder / f"plain/IMG_{number}.jpg", exif=exif)


def _bench(folder: Path) -> None:
    (folder / "bench").mkdir()
    record = {"method": "direct", "kind": "material", "name": "inlay", "resolution": 16, "config": {},
              "renderer": "analytic", "budget": 0.1, "seed": 0, "version": "1", "machine": {}, "seconds": 0.1,
              "wall": 0.2, "iterations": 3, "stopped": "budget", "why": None, "errors": {"mean": 0.1}}
    (folder / "bench/bench.json").write_text(json.dumps(record) + "\n")


def _list(folder: Path) -> None:
    (folder / "list").mkdir()
    (folder / "list/list.txt").write_text("# two\n../capture --iterations 1\n'../jpeg' --tag wood\n../text "
                                          "# the third\n")


def _documents(folder: Path) -> None:
    """A material as MaterialX, as GLB, and as glTF with a file of its binary chunk."""
    export_material(make_material("tiles", 16), folder, ["gltf", "materialx"])
    content = (folder / "gltf/material.glb").read_bytes()
    size = int.from_bytes(content[12:16], "little")
    about = json.loads(content[20:20 + size])
    about["buffers"][0]["uri"] = "m.bin"
    (folder / "gltf/m.gltf").write_text(json.dumps(about))
    (folder / "gltf/m.bin").write_bytes(content[28 + size:])


def _library(folder: Path) -> None:
    """Two materials that are done, and one of them as it was before its photos changed."""
    results = ResultStore(str(folder / "library"))
    written = folder / "fit/fit.json", *(folder / "fit/maps").iterdir()
    files = {str(path.relative_to(folder / "fit")): path.read_bytes() for path in written}
    with results.claimed():
        for number, name in enumerate(("wood", "stone", "wood")):
            source = folder / "shots" / name
            if not source.exists():
                shutil.copytree(folder / "capture", source)
            with (source / "capture.json").open("a") as stated:
                stated.write("\n" * (number + 1))
            for material in take_stock([asked(source)], Library(results), False).work:
                publish(results, result_of(material, date=f"2026-11-0{number + 1}T00:00:00Z"), name, files)
        Library(results).write()
    shutil.rmtree(folder / "shots")
