"""Photos of a simulated phone: metered, vignetted, noisy, in 8 bits; some are spoiled on purpose."""

import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from .. import color
from ..capture.align.sheet import Sheet
from ..capture.lens import Lens, Pose
from ..capture.rig import Rig, rig_to_json
from ..errors import ConfigError
from ..io import files
from ..material.made import make_material
from ..material.map_files import save_maps
from ..material.maps import SVBRDF
from ..material.resample import area_averaged
from ..views import texel_positions
from .phone import DIAGONAL_35MM, HandheldPhone, Shot, Spoil, shots

SENSOR_DIAGONAL = 9.5  # mm
FROM_METER = 0.1  # megapixels of the photo that the exposure is measured on
# mean radiance of the first photo, and share of its values that may be clipped
BRIGHTNESS, MOST_CLIPPED = 0.25, 0.02
# noise: standard deviation at black, and variance over radiance (5000 electrons are white)
READ, SHOT = 0.001, 2e-4
AMBIENT = 0.35  # radiance of the room in a photo without flash
FINGER = (0.05, 0.012, 0.008)  # radiance of a finger on the lens
OTHER, OTHER_SEED = "leather", 7  # what an unrelated photo shows


def handheld_photos(svbrdf: SVBRDF, phone: HandheldPhone, renderer: Callable[..., Any],
                    spoil: Sequence[Spoil] = ()) -> tuple[Iterator[tuple[Shot, NDArray[np.uint8]]],
                                                          dict[str, Any]]:
    """Photos of a material, each taken when the iterator reaches it, and the truth about them.

    The maps cover the whole sample. ``renderer`` makes a :class:`mitsvbrdf.synth.traced.HandheldRenderer`.
    Photos are H x W x 3 display values (sRGB, 8 bits), the last ones spoiled as in ``spoil``. The truth has
    the keys of ``truth.json``: ``rig`` (see :func:`mitsvbrdf.capture.rig.rig_to_json`, of all photos, in cm),
    ``intensity`` I of the flash (a white diffuse texel has the radiance I cos / (pi d^2), d in cm; radiance 1
    is display value 1), ``falloff``, ``transfer``, ``sample_cm``, ``sheet_cm``, ``depth_cm``, ``spoiled``
    (photo name to kind), and ``phone``. ConfigError: a wrong option, or no light.
    """
    phone.check()
    plan, lens = shots(phone, spoil), phone.lens
    sheet = Sheet(phone.sheet) if phone.sheet else None
    scene = renderer(svbrdf, phone.sample, sheet, phone.depth)
    power = _metered(scene, phone, plan[0].pose)

    def take() -> Iterator[tuple[Shot, NDArray[np.uint8]]]:
        for number, shot in enumerate(plan):
            here = scene
            if shot.kind == "unrelated":
                here = renderer(make_material(OTHER, 512, OTHER_SEED), phone.sample, None, 0.0)
            light = {"ambient": AMBIENT} if shot.kind == "noflash" else {"intensity": power}
            radiance = spoiled(here.render(lens, shot.pose, seed=number, **light), shot.kind)
            yield shot, developed(radiance, lens, phone.grain, [phone.seed, 2, number])

    rig = Rig(lens, {shot.name: shot.pose for shot in plan}, phone.patch, "cm",
              "sheet" if sheet else "photos")
    return take(), {"rig": rig_to_json(rig), "intensity": [power] * 3, "falloff": "inverse-square",
                    "transfer": "srgb", "sample_cm": phone.sample, "sheet_cm": phone.sheet,
                    "depth_cm": phone.depth if sheet else 0.0,
                    "spoiled": {shot.name: shot.kind for shot in plan if shot.kind}, "phone": asdict(phone)}


def _metered(scene: Any, phone: HandheldPhone, pose: Pose) -> float:
    """Intensity of the flash that exposes the first photo well; lower if too many values would clip."""
    lens = replace(phone, megapixels=FROM_METER).lens
    radiance = scene.render(lens, pose, intensity=1.0) * _transmission(lens, 0, lens.size[1])
    mean, bright = radiance.mean(), np.quantile(radiance, 1 - MOST_CLIPPED)
    if not (mean > 0 and radiance.min() >= 0):  # NaN is invalid, too
        raise ConfigError("light in the first photo", f"radiance {radiance.min():g} to {radiance.max():g}",
                          "check --flash and --vignetting; the material may be black")
    return float(min(BRIGHTNESS / mean, 1 / bright if bright > 0 else math.inf))


def _transmission(lens: Lens, first: int, count: int) -> NDArray[np.float32]:
    """Transmission of the lens at ``count`` rows of pixels, count x W x 1."""
    columns, rows = np.meshgrid(np.arange(lens.size[0]), np.arange(first, first + count))
    return lens.transmission(np.stack((columns, rows), axis=-1)).astype(np.float32)[..., None]


def spoiled(radiance: NDArray[np.float32], kind: Spoil | None) -> NDArray[np.float32]:
    """The radiance, blurred as by a shaken camera or with a finger on the lens; else unchanged."""
    import cv2

    height, width = radiance.shape[:2]
    if kind == "blurred":  # motion blur along a line of 1.5 % of the width, and defocus
        length = max(3, round(0.015 * width)) | 1
        along = cv2.getRotationMatrix2D((length // 2, length // 2), 30, 1)
        line = np.zeros((length, length), dtype=np.float32)
        line[length // 2] = 1
        line = cv2.warpAffine(line, along, (length, length))
        return np.asarray(cv2.GaussianBlur(cv2.filter2D(radiance, -1, line / line.sum()), (0, 0),
                                           0.002 * width), np.float32)
    if kind == "finger":  # an ellipse over the left half with a soft edge
        y, x = np.mgrid[:height, :width].astype(np.float32) / width
        middle = height / width / 2
        reach = np.hypot((x - 0.08) / 0.45, (y - middle) / (1.1 * middle))
        cover = (1 / (1 + np.exp((reach - 1) * 25)))[..., None].astype(np.float32)
        return radiance * (1 - cover) + cover * np.array(FINGER, dtype=np.float32)
    return radiance


def developed(radiance: NDArray[np.float32], lens: Lens, noise: float = 1.0, seed: int | Sequence[int] = 0
              ) -> NDArray[np.uint8]:
    """Radiance (H x W x 3, 1 is white) as the phone stores it: vignetting, noise, clipping, sRGB, 8 bits."""
    out, rng = np.empty(radiance.shape, dtype=np.uint8), np.random.default_rng(seed)
    for first in range(0, len(out), 256):  # rows: memory stays small
        rows = slice(first, first + 256)
        light = radiance[rows] * _transmission(lens, first, len(radiance[rows]))
        if noise:
            grain = rng.standard_normal(light.shape, dtype=np.float32)
            light = light + noise * np.sqrt(READ**2 + SHOT * light) * grain
        display = color.to_display(torch.from_numpy(light).clamp_min(0), "srgb")
        out[rows] = (display * 255).round().numpy().astype(np.uint8)
    return out


def write_photo(path: Path, pixels: NDArray[np.uint8], phone: HandheldPhone, shot: Shot) -> None:
    """A JPEG (or PNG) file with the EXIF of a phone."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    exif = Image.Exif()
    exif[0x0112] = shot.orientation
    focal = IFDRational(round(phone.focal_35mm / DIAGONAL_35MM * SENSOR_DIAGONAL * 100), 100)
    exif.get_ifd(0x8769).update({0x829A: IFDRational(1, 60), 0x8827: 100,
                                 0x9209: 0x10 if shot.kind == "noflash" else 0x09,
                                 0x920A: focal, 0xA405: round(phone.focal_35mm)})
    data = io.BytesIO()
    options = {"format": "JPEG", "quality": phone.jpeg} if phone.jpeg else {"format": "PNG"}
    Image.fromarray(pixels).save(data, exif=exif, **options)
    files.write_bytes(path, data.getvalue())


def write_handheld(svbrdf: SVBRDF, phone: HandheldPhone, renderer: Callable[..., Any], folder: Path,
                   spoil: Sequence[Spoil] = (),
                   report: Callable[[int, int], object] = lambda done, count: None,
                   **about: object) -> dict[str, Any]:
    """Write the photos of :func:`handheld_photos`, ``truth/truth.json``, and the maps in ``truth/sample``.

    With a sheet, also write the maps of the patch within it, which a fit should find, to ``truth/maps``.
    Without a sheet, the patch depends on the photos. ``report`` is called with (done, total) after each
    photo. ``about``: further keys of truth.json. The truth is returned.
    """
    photos, truth = handheld_photos(svbrdf, phone, renderer, spoil)
    for done, (shot, pixels) in enumerate(photos, 1):
        write_photo(folder / shot.name, pixels, phone, shot)
        report(done, len(truth["rig"]["poses"]))
    save_maps(svbrdf, folder / "truth" / "sample")
    if phone.sheet:
        texels = max(1, round(svbrdf.resolution * phone.patch / phone.sample))
        save_maps(patch_of(svbrdf, phone.patch / phone.sample, texels), folder / "truth" / "maps")
    files.write_json(folder / "truth" / "truth.json", truth | about)
    return truth | about


def patch_of(sample: SVBRDF, share: float, resolution: int) -> SVBRDF:
    """Maps of the middle square of a sample, ``share`` of its side wide; each texel is an area average."""
    times = max(1, math.ceil(2 * share * sample.resolution / resolution))
    at = texel_positions(resolution * times)[..., :2] * share * torch.tensor([2.0, -2.0])

    def cut(value: Tensor) -> Tensor:
        fine = F.grid_sample(value.movedim(-1, 0)[None], at.float()[None], "bilinear", "border",
                             align_corners=False)
        return area_averaged(fine[0].movedim(0, -1), resolution)

    found = sample.map(cut)
    return SVBRDF(found.bsdf, dict(found.maps) | {"normal": F.normalize(found["normal"], dim=-1)})
