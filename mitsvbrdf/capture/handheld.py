"""A simulated phone: raw photos of known maps, taken by hand, to test on what the road from a phone to maps brings back.

What it has of a phone: a lens with distortion, vignetting and a principal point off the middle, a flash beside it, one
manual exposure, noise, 8 bits, JPEG and EXIF. What it has not: a mosaic of colours, sharpening, noise reduction, local
tone curves, a focus that changes the lens, a lens that follows another model than :mod:`mitsvbrdf.capture.lens`. Errors
measured on it are therefore those of noise, resolution and method, not of a model that does not fit.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from .. import color, files
from ..errors import ConfigError
from ..maps import SVBRDF, save_maps
from ..procedural import make_material
from ..views import nine_view_grid
from .lens import Lens, Pose, project
from .rig import Rig, rig_to_json
from .sheet import Sheet

Spoil = Literal["blurred", "finger", "noflash", "duplicate", "rotated", "unrelated"]
USABLE = ("rotated",)  # an odd photo that nothing is wrong with

WITHOUT_SHEET = 24.0  # cm, the sample's side
SEEN = 0.48  # of the sample, the patch that poses are meant for where no sheet says; 11.5 cm
DIAGONAL_35MM = math.hypot(36, 24)
SENSOR_DIAGONAL = 9.5  # mm
FROM_METER = 0.1  # megapixels of the photo that the exposure is measured on
BRIGHTNESS, CLIPPED = 0.25, 0.02  # mean radiance of the first photo, and share of its values that may be clipped
READ, SHOT = 0.001, 2e-4  # noise: standard deviation at black, and variance over radiance (5000 electrons are white)
AMBIENT = 0.35  # radiance of the room in a photo without flash
FINGER = (0.05, 0.012, 0.008)  # radiance of a finger on the lens
OTHER, OTHER_SEED = "leather", 7  # what an unrelated photo shows


@dataclass(frozen=True)
class HandheldPhone:
    """A phone, the hand that holds it, and what lies under it. Lengths in cm, angles in degrees."""

    megapixels: float = 12.0
    """Size of the photos, 4 : 3; 12 is 4032 x 3024."""
    photos: int = 9
    """How many photos, from positions like those of the nine-view grid."""
    sheet: float | None = None
    """Size of the sheet of tags that lies on the material, over the tags' outer edges; left out: no sheet."""
    depth: float = 0.02
    """Of the material under the sheet: 0.02 is paper."""
    side: float | None = None
    """Side of the sample; left out: 24, or that of the sheet."""
    focal_35mm: float = 26.4
    """35 mm equivalent focal length, by the diagonal; EXIF rounds it to whole millimetres."""
    centre: tuple[float, float] = (6.0, -5.0)
    """Principal point from the middle, in pixels of a photo of 12 megapixels."""
    distortion: tuple[float, float] = (0.06, -0.04)
    """k1 and k2 of the lens."""
    vignetting: tuple[float, float] = (-0.25, 0.05)
    """v1 and v2 of the lens."""
    flash: tuple[float, float, float] = (1.5, 0.4, 0.0)
    """Of the light from the lens: right and down in the photo as stored, and forward."""
    tilt: float = 12.0
    """Largest angle between view and vertical."""
    grain: float = 1.0
    """Noise, over that of a phone in good light; 0: none."""
    jpeg: int = 92
    """Quality of the JPEG files; 0: PNG."""
    seed: int = 0
    """Of positions, turns, aims and noise."""

    def check(self) -> None:
        """Raise ConfigError for an option out of range."""
        numbers = [("megapixels from 0.05 to 100", self.megapixels, 0.05, 100), ("1 to 999 photos", self.photos, 1, 999),
                   ("a sheet of 5 to 100 cm", self.sheet, 5, 100), ("a depth of 0 to 5 cm", self.depth, 0, 5),
                   ("a side of 5 to 200 cm", self.side, 5, 200), ("a focal length of 10 to 200 mm", self.focal_35mm, 10, 200),
                   ("a tilt of 1 to 40 degrees", self.tilt, 1, 40), ("grain from 0 to 100", self.grain, 0, 100),
                   ("a JPEG quality of 0 to 100", self.jpeg, 0, 100)]
        for wanted, value, low, high in numbers:
            if value is not None and not low <= value <= high:
                raise ConfigError(wanted, str(value), "choose a value in this range")
        if self.sheet and self.side and self.side < Sheet(self.sheet).hole:
            raise ConfigError(f"a side of {Sheet(self.sheet).hole:g} cm or more, the sheet's hole", f"{self.side:g}",
                              "leave it out")

    @property
    def lens(self) -> Lens:
        """The lens, for photos of this size."""
        scale = math.sqrt(self.megapixels / 12)
        unit = round(1008 * scale)
        centre = (4 * unit - 1) / 2 + self.centre[0] * scale, (3 * unit - 1) / 2 + self.centre[1] * scale
        focal = self.focal_35mm / DIAGONAL_35MM * 5 * unit
        return Lens((4 * unit, 3 * unit), focal, centre, self.distortion, self.vignetting, self.flash)

    @property
    def sample(self) -> float:
        """Side of the sample, cm."""
        return self.side or (Sheet(self.sheet).outer if self.sheet else WITHOUT_SHEET)

    @property
    def patch(self) -> float:
        """Side of the square that every photo is meant to show, cm."""
        return Sheet(self.sheet).patch if self.sheet else SEEN * self.sample


@dataclass(frozen=True)
class Shot:
    """What one photo is to be: its file, where the phone is, what is wrong with it, and its EXIF orientation."""

    name: str
    pose: Pose
    kind: Spoil | None = None
    orientation: int = 1
    of: str | None = field(default=None)


def shots(phone: HandheldPhone, poses: Sequence[Pose] | None = None, spoil: Sequence[Spoil] = ()) -> list[Shot]:
    """The photos to take: good ones first, then one for each way to spoil one; file names tell nothing.

    Args:
        phone: the phone.
        poses: of the good photos, instead of those of :func:`handheld_poses`.
        spoil: kinds, each at most once.

    Raises:
        ConfigError: an unknown kind, or one given twice.
    """
    unknown = [kind for kind in spoil if kind not in get_args(Spoil)]
    if unknown or len(set(spoil)) < len(spoil):
        raise ConfigError(f"kinds of {get_args(Spoil)}, each once", ", ".join(unknown or spoil), "choose from these")
    suffix = "jpg" if phone.jpeg else "png"
    drawn = handheld_poses(phone, (phone.photos if poses is None else 0) + len(spoil))
    good = drawn[: phone.photos] if poses is None else list(poses)
    found = [Shot(f"IMG_{i + 1:04d}.{suffix}", pose) for i, pose in enumerate(good)]
    copied = found[min(2, len(found) - 1)]
    for kind, pose in zip(spoil, drawn[len(drawn) - len(spoil) :]):
        name = f"IMG_{len(found) + 1:04d}.{suffix}"
        if kind == "duplicate":
            found.append(replace(copied, name=name, kind=kind, of=copied.name))
        elif kind == "rotated":  # the phone upright: its flash turns with it, and EXIF says so
            quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            found.append(Shot(name, Pose(pose.position, quarter @ pose.rotation), kind, 6))
        else:
            found.append(Shot(name, pose, kind))
    return found


def handheld_poses(phone: HandheldPhone, count: int) -> list[Pose]:
    """Where a hand would hold the phone: near the nine-view grid, aimed roughly at the middle, a little turned.

    The patch, and all of the sheet where there is one, is within each photo; the phone is held higher where it would not be.
    """
    rng, lens = np.random.default_rng([phone.seed, 1]), phone.lens
    half = (Sheet(phone.sheet).outer if phone.sheet else phone.patch) / 2
    square = np.array([[x, y, 0.0] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))])
    grid, found = nine_view_grid().camera.numpy(), []
    for i in range(count):
        higher = 1.0
        while True:
            position = (grid[i % len(grid)] + rng.normal(0, 0.04, 3)) * phone.patch * (1, 1, higher)
            aim = np.append(position[:2] * rng.uniform(0, 1) + rng.normal(0, 0.06, 2) * phone.patch, 0.0)
            pose = Pose.looking_at(position, aim, math.radians(rng.normal(0, 4)))
            seen = project(lens, pose, square) / lens.size
            if -pose.rotation[2, 2] >= math.cos(math.radians(phone.tilt)) and seen.min() > 0.01 and seen.max() < 0.99:
                break
            higher += 0.005
        found.append(pose)
    return found


def handheld_photos(svbrdf: SVBRDF, phone: HandheldPhone, renderer, poses: Sequence[Pose] | None = None,
                    spoil: Sequence[Spoil] = ()) -> tuple[Iterator[tuple[Shot, NDArray[np.uint8]]], dict[str, Any]]:
    """Photos of a material, each taken when it is asked for, and the truth about them.

    Args:
        svbrdf: the material, over the whole sample.
        phone: the phone.
        renderer: :class:`mitsvbrdf.render.handheld.HandheldRenderer`, or what makes one like it.
        poses: of the good photos; left out: held by hand.
        spoil: extra photos that something is odd about.

    Returns:
        The photos, H x W x 3 display values (sRGB, 8 bits), and what ``truth.json`` says: ``rig`` (see
        :func:`mitsvbrdf.capture.rig.rig_to_json`, of all photos, in cm), ``intensity`` of the flash (a white diffuse texel
        has the radiance I cos / (pi d^2), d in cm, where radiance 1 is display value 1), ``falloff``, ``transfer``,
        ``sample_cm``, ``sheet_cm``, ``depth_cm``, ``spoiled`` by name of the photo, and the ``phone``.

    Raises:
        ConfigError: an option out of range.
    """
    phone.check()
    plan, lens = shots(phone, poses, spoil), phone.lens
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

    rig = Rig(lens, {shot.name: shot.pose for shot in plan}, phone.patch, "cm", "sheet" if sheet else "photos")
    odd = {shot.name: {"kind": shot.kind, "usable": shot.kind in USABLE} | ({"of": shot.of} if shot.of else {})
           for shot in plan if shot.kind}
    return take(), {"rig": rig_to_json(rig), "intensity": [power] * 3, "falloff": "inverse-square", "transfer": "srgb",
                    "sample_cm": phone.sample, "sheet_cm": phone.sheet, "depth_cm": phone.depth if sheet else 0.0,
                    "spoiled": odd, "phone": asdict(phone)}


def _metered(scene, phone: HandheldPhone, pose: Pose) -> float:
    """Intensity of the flash, in display values: the mean of the first photo is right, or fewer of its values are clipped."""
    lens = replace(phone, megapixels=FROM_METER).lens
    radiance = scene.render(lens, pose, intensity=1.0) * _transmission(lens, 0, lens.size[1])
    return float(min(BRIGHTNESS / radiance.mean(), 1 / np.quantile(radiance, 1 - CLIPPED)))


def _transmission(lens: Lens, first: int, count: int) -> NDArray[np.float32]:
    """Of ``count`` rows of pixels, count x W x 1."""
    columns, rows = np.meshgrid(np.arange(lens.size[0]), np.arange(first, first + count))
    return lens.transmission(np.stack((columns, rows), axis=-1)).astype(np.float32)[..., None]


def spoiled(radiance: NDArray[np.float32], kind: Spoil | None) -> NDArray[np.float32]:
    """The light that a shaken camera, or one with a finger on its lens, would get; others as they are."""
    import cv2

    height, width = radiance.shape[:2]
    if kind == "blurred":  # a hand that moves: a line of 1.5 % of the photo, beside being out of focus
        length = max(3, round(0.015 * width)) | 1
        along = cv2.getRotationMatrix2D((length // 2, length // 2), 30, 1)
        line = np.zeros((length, length), dtype=np.float32)
        line[length // 2] = 1
        line = cv2.warpAffine(line, along, (length, length))
        return cv2.GaussianBlur(cv2.filter2D(radiance, -1, line / line.sum()), (0, 0), 0.002 * width)
    if kind == "finger":  # an ellipse over the left half with a soft edge
        y, x = np.mgrid[:height, :width].astype(np.float32) / width
        middle = height / width / 2
        reach = np.hypot((x - 0.08) / 0.45, (y - middle) / (1.1 * middle))
        cover = (1 / (1 + np.exp((reach - 1) * 25)))[..., None].astype(np.float32)
        return radiance * (1 - cover) + cover * np.array(FINGER, dtype=np.float32)
    return radiance


def developed(radiance: NDArray[np.float32], lens: Lens, noise: float = 1.0, seed: int | Sequence[int] = 0
              ) -> NDArray[np.uint8]:
    """Radiance at the lens as the phone stores it: vignetting, noise of light and sensor, clipping, sRGB, 8 bits.

    Args:
        radiance: H x W x 3, where 1 is white.
        lens: whose vignetting counts.
        noise: of a phone's sensor, how much.
        seed: of the noise.
    """
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
    exif.get_ifd(0x8769).update({0x829A: IFDRational(1, 60), 0x8827: 100, 0x9209: 0x10 if shot.kind == "noflash" else 0x09,
                                 0x920A: focal, 0xA405: round(phone.focal_35mm)})
    data = io.BytesIO()
    options = {"format": "JPEG", "quality": phone.jpeg} if phone.jpeg else {"format": "PNG"}
    Image.fromarray(pixels).save(data, exif=exif, **options)
    files.write_bytes(path, data.getvalue())


def write_handheld(svbrdf: SVBRDF, phone: HandheldPhone, renderer, folder: Path, spoil: Sequence[Spoil] = (),
                   poses: Sequence[Pose] | None = None, report=None, **about: object) -> dict[str, Any]:
    """Take the photos of :func:`handheld_photos` and write them, ``truth/truth.json`` and the sample's maps ``truth/maps``.

    Args:
        folder: for the photos.
        report: is told (done, of how many) after each photo.
        about: more fields for truth.json.

    Returns:
        The truth.
    """
    folder = Path(folder)
    photos, truth = handheld_photos(svbrdf, phone, renderer, poses, spoil)
    for done, (shot, pixels) in enumerate(photos, 1):
        write_photo(folder / shot.name, pixels, phone, shot)
        if report:
            report(done, len(truth["rig"]["poses"]))
    save_maps(svbrdf, folder / "truth" / "maps")
    files.write_json(folder / "truth" / "truth.json", truth | about)
    return truth | about
