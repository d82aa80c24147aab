"""Exported materials in the programs that people open them in, under three lights: linear radiance.

Each client draws the patch from :data:`mitsvbrdf.export.residual.HEIGHT` above its centre, one pixel a texel,
with a point light and nothing else. What is compared with our analytic renderer is all that a client does:
its importer, its model, its textures.
"""

import json
import os
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import torch
from browser import FLAGS, chromium
from torch import Tensor

from mitsvbrdf.color import to_display
from mitsvbrdf.export import ExportSettings, export_material
from mitsvbrdf.export.residual import three_lights
from mitsvbrdf.io import images
from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.measure.metrics import photo_rmse
from mitsvbrdf.render import make_renderer

HERE, ROOT = Path(__file__).parent, Path(__file__).resolve().parents[2]
BLENDER = ROOT / ".venv/blender/bin/python"
TYPES = {".js": "text/javascript", ".html": "text/html", ".png": "image/png", ".json": "application/json"}

# What a client reads of the export -> why it cannot show all of a material, where that is so.
LIMITS = {
    "three.js, USD": "it doubles normals (takes the texture's scale for normalScale) and reads no texture "
                     "of the index", "Blender, USD": "its importer reads no coloured F0",
    "Blender, maps": "no F0 above 0.08, and no coloured one: Specular IOR Level ends at 1"}


def _job(folder: Path, resolution: int) -> dict:
    views = three_lights()
    return {"size": resolution, "camera": views.camera[0].tolist(), "lights": views.light.tolist(),
            "powers": views.intensity[:, 0].tolist()}


def blender(file: str) -> Callable[[Path, int], Tensor]:
    """Blender's Cycles, through the importer of the file, or a Principled BSDF of the maps in a folder."""
    def draw(folder: Path, resolution: int) -> Tensor:
        python = Path(os.environ.get("MITSVBRDF_BLENDER", BLENDER))
        if not python.exists():
            pytest.skip("needs a Python 3.11 with bpy, in MITSVBRDF_BLENDER or as ./run slow installs it")
        out = folder / "pictures"
        out.mkdir(exist_ok=True)
        job = _job(folder, resolution) | {"file": str(folder / file), "out": str(out / "blender")}
        done = subprocess.run([str(python), str(HERE / "in_blender.py"), json.dumps(job)],
                              capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        return torch.stack([images.read_image(out / f"blender{k}.exr", ValueError)
                            for k in range(len(job["lights"]))])
    return draw


@cache
def node_modules() -> Path:
    """Where three.js and model-viewer are."""
    for root in [*os.environ.get("NODE_PATH", "").split(os.pathsep), str(ROOT / ".venv/node_modules")]:
        if root and (Path(root) / "three/build/three.module.js").is_file():
            return Path(root)
    pytest.skip("needs the npm packages three and @google/model-viewer on NODE_PATH, as ./run slow installs "
                "them")


def browser(function: str, file: str) -> Callable[[Path, int], Tensor]:
    """A function of ``in_three.html`` in headless Chromium; all it asks for comes from disk."""
    def draw(folder: Path, resolution: int) -> Tensor:
        from playwright.sync_api import sync_playwright

        roots, unknown, said = {"npm": node_modules(), "out": folder, "page": HERE}, [], []

        def serve(route) -> None:
            root, _, rest = route.request.url.split("/", 3)[3].partition("/")
            path = roots.get(root, HERE / "none") / rest.split("?")[0]
            if path.is_file():
                route.fulfill(body=path.read_bytes(), content_type=TYPES.get(path.suffix,
                                                                             "application/octet-stream"))
            else:
                unknown.append(route.request.url)
                route.fulfill(status=404)

        with sync_playwright() as playwright:
            window = playwright.chromium.launch(executable_path=chromium(), args=list(FLAGS))
            try:
                page = window.new_page()
                page.on("pageerror", lambda error: said.append(str(error)))
                page.route("**/*", serve)
                page.goto("http://clients.test/page/in_three.html")
                page.wait_for_function("window.ready")
                kind = "usd" if file.endswith(".usda") else "gltf"
                job = (_job(folder, resolution)
                       | {"kind": kind, "url": f"/out/{file}", "patch": "/out/gltf/material.glb"})
                found = page.evaluate(f"job => window.{function}(job)", job)
            finally:
                window.close()
        unknown = [url for url in unknown if not url.endswith("favicon.ico")]
        assert not said and not unknown, (said, unknown)
        return torch.tensor(found).reshape(-1, resolution, resolution, 4).flip(1)[..., :3]
    return draw


def mitsuba(folder: Path, resolution: int) -> Tensor:
    """Mitsuba's own plugins, from the scene that is exported."""
    import mitsuba as mi

    views, pictures = three_lights(), []
    for view in views:
        where = {f"{name}_{axis}": f"{x:.9g}" for name, at in (("camera", view.camera), ("light", view.light))
                 for axis, x in zip("xyz", at)}
        where["intensity"] = ", ".join(f"{x:.9g}" for x in view.intensity)
        scene = mi.load_file(str(folder / "mitsuba/scene.xml"), **where)
        pictures.append(torch.tensor(mi.render(scene, spp=1).numpy()))
    return torch.stack(pictures)


CLIENTS: dict[str, Callable[[Path, int], Tensor]] = {
    "Mitsuba, scene.xml": mitsuba, "Blender, glTF": blender("gltf/material.glb"),
    "Blender, USD": blender("usd/patch.usda"), "Blender, maps": blender("maps"),
    "three.js, glTF": browser("in_three", "gltf/material.glb"),
    "three.js, MaterialX": browser("in_materialx", "materialx/material.mtlx"),
    "three.js, OpenPBR": browser("in_materialx", "materialx/openpbr.mtlx"),
    "three.js, USD": browser("in_three", "usd/patch.usda"),
    "model-viewer, glTF": browser("in_model_viewer", "gltf/material.glb"),
}


def truth(svbrdf: SVBRDF) -> Tensor:
    """What all clients should show: linear, lights x R x R x 3."""
    return make_renderer("analytic").render(svbrdf, three_lights())


def exported(svbrdf: SVBRDF, folder: Path) -> Path:
    """All formats, the maps as Blender's Node Wrangler takes them."""
    export_material(svbrdf, folder, settings=ExportSettings("patch", "polyhaven"))
    return folder


def compared(shown: Tensor, wanted: Tensor) -> dict[str, list]:
    """By light: RMSE in sRGB display values, and the mean of each channel over what it should be (linear,
    clipped at 1).
    """
    _, errors = photo_rmse(shown, to_display(wanted, "srgb"), "srgb")
    means = [picture.clamp(0, 1).mean(dim=(1, 2)) for picture in (shown.double(), wanted.double())]
    return {"rmse": errors, "means": (means[0] / means[1]).tolist()}
