"""A simulated phone: it takes raw photos of known maps, to test the way from photos to maps.

It has a lens with distortion, vignetting and a principal point off the centre, a flash beside the lens, one
manual exposure, noise, 8 bits, JPEG and EXIF. It has no colour mosaic, sharpening, noise reduction, local
tone curve or focus breathing. Its lens follows the model of :mod:`mitsvbrdf.capture.lens`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from ..capture.align.sheet import PAPER_THICKNESS, Sheet
from ..capture.lens import Lens, Pose, project
from ..errors import ConfigError
from ..views import nine_view_grid

Spoil = Literal["blurred", "finger", "noflash", "duplicate", "rotated", "unrelated"]

WITHOUT_SHEET = 24.0  # cm, the sample's side
SEEN = 0.48  # share of the sample's side that photos without a sheet are meant to show: 11.5 cm
DIAGONAL_35MM = math.hypot(36, 24)


@dataclass(frozen=True)
class HandheldPhone:
    """A phone, the hand that holds it, and what is under it. Lengths in cm, angles in degrees."""

    megapixels: float = 12.0
    """Size of a photo, whose sides are 4 : 3. 12 megapixels are 4032 x 3024."""
    photos: int = 9
    """Number of photos. They are taken near the places of the nine-view grid."""
    sheet: float | None = None
    """Side of the sheet of tags on the material, between the tags' outer edges. Default: no sheet."""
    depth: float = PAPER_THICKNESS
    """Distance of the material below the sheet's upper side. Default: the thickness of paper."""
    side: float | None = None
    """Side of the sample of material. Default: the sheet with its white rim; 24 without a sheet."""
    focal_35mm: float = 26.4
    """35 mm equivalent focal length (equal diagonals). EXIF rounds it to whole millimetres."""
    centre: tuple[float, float] = (6.0, -5.0)
    """Offset of the principal point from the middle of the photo, in pixels at 12 megapixels."""
    distortion: tuple[float, float] = (0.06, -0.04)
    """Radial distortion k1 and k2 of the lens."""
    vignetting: tuple[float, float] = (-0.25, 0.05)
    """Vignetting v1 and v2 of the lens."""
    flash: tuple[float, float, float] = (1.5, 0.4, 0.0)
    """Position of the flash relative to the lens: right and down in the photo as stored, and forward."""
    tilt: float = 12.0
    """Largest angle between viewing direction and vertical."""
    grain: float = 1.0
    """Noise of the photos, as a multiple of a phone's noise in good light. 0: none."""
    jpeg: int = 92
    """Quality of the JPEG files. 0: PNG files instead."""
    seed: int = 0
    """Seed of positions, turns, aims and noise."""

    def check(self) -> None:
        """Raise ConfigError for an option out of range."""
        for name, low, high, unit in (
                ("megapixels", 0.05, 100, ""), ("photos", 1, 999, ""), ("sheet", 5, 100, " cm"),
                ("depth", 0, 5, " cm"), ("side", 5, 200, " cm"), ("focal_35mm", 10, 200, " mm"),
                ("tilt", 1, 40, " degrees"), ("grain", 0, 100, ""), ("jpeg", 0, 100, "")):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ConfigError(f"--{name.replace('_', '-')} from {low:g} to {high:g}{unit}", str(value),
                                  "choose a value in this range")
        if self.sheet and self.side and self.side < Sheet(self.sheet).hole:
            raise ConfigError(f"a side of {Sheet(self.sheet).hole:g} cm or more, the sheet's hole",
                              f"{self.side:g}", "leave it out")

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


MOST_TRIES = 2000  # poses tried for a photo, at most, each higher than the last


@dataclass(frozen=True)
class Shot:
    """The plan of one photo: its file, the phone's pose, its fault, its EXIF orientation."""

    name: str
    pose: Pose
    kind: Spoil | None = None
    orientation: int = 1


def shots(phone: HandheldPhone, spoil: Sequence[Spoil] = ()) -> list[Shot]:
    """The photos to take: good ones first, then one for each kind of ``spoil``; names do not show which."""
    unknown = [kind for kind in spoil if kind not in get_args(Spoil)]
    if unknown or len(set(spoil)) < len(spoil):
        raise ConfigError(f"kinds of {get_args(Spoil)}, each once", ", ".join(unknown or spoil),
                          "choose from these")
    suffix = "jpg" if phone.jpeg else "png"
    found = list[Shot]()
    for kind, pose in zip((*[None] * phone.photos, *spoil), handheld_poses(phone, phone.photos + len(spoil))):
        name = f"IMG_{len(found) + 1:04d}.{suffix}"
        if kind == "duplicate":
            found.append(replace(found[min(2, phone.photos - 1)], name=name, kind=kind))
        elif kind == "rotated":  # portrait format: the flash turns with the phone, and EXIF states the turn
            quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            found.append(Shot(name, Pose(pose.position, quarter @ pose.rotation), kind, 6))
        else:
            found.append(Shot(name, pose, kind))
    return found


def handheld_poses(phone: HandheldPhone, count: int) -> list[Pose]:
    """Hand-held poses: near the nine-view grid, aimed roughly at the middle, turned a little.

    Each photo shows the whole patch, and the whole sheet if there is one; the phone is held higher until it
    does.
    """
    rng, lens = np.random.default_rng([phone.seed, 1]), phone.lens
    half = (Sheet(phone.sheet).outer if phone.sheet else phone.patch) / 2
    square = np.array([[x, y, 0.0] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))])
    grid, found = nine_view_grid().camera.numpy(), []
    for i in range(count):
        for higher in 1 + 0.005 * np.arange(MOST_TRIES):
            position = (grid[i % len(grid)] + rng.normal(0, 0.04, 3)) * phone.patch * (1, 1, higher)
            aim = np.append(position[:2] * rng.uniform(0, 1) + rng.normal(0, 0.06, 2) * phone.patch, 0.0)
            pose = Pose.looking_at(position, aim, math.radians(rng.normal(0, 4)))
            seen = project(lens, pose, square) / lens.size
            upright = -pose.rotation[2, 2] >= math.cos(math.radians(phone.tilt))
            if upright and seen.min() > 0.01 and seen.max() < 0.99:
                break
        else:
            raise ConfigError("a phone that can show the whole patch", f"none of {MOST_TRIES} poses",
                              "check centre, distortion and tilt")
        found.append(pose)
    return found
