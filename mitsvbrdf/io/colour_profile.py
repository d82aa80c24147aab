"""Read the colour profile of a picture, and convert its pixels to sRGB or Rec. 709.

An 8- or 16-bit picture may have an ICC profile, code points of ITU-T H.273 (cICP of PNG, nclx of HEIC), gAMA
and cHRM of PNG, or Adobe RGB in EXIF. littleCMS converts its pixels to the sRGB display values that a viewer
with colour management shows. A linear picture (EXR) may have chromaticities; a matrix converts to Rec. 709.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import imagecodecs
import numpy as np
from PIL import Image, ImageCms

from ..color import RESPONSES, Operations

REC709 = 0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290  # x and y of red, green, blue and white
ADOBE_RGB = 0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290
REC601 = 0.63, 0.34, 0.31, 0.595, 0.155, 0.07, 0.3127, 0.3290
PRIMARIES = {  # code points of H.273
    1: ("Rec. 709", REC709),
    5: ("Rec. 601, 625 lines", (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 0.3127, 0.3290)),
    6: ("Rec. 601, 525 lines", REC601),
    7: ("Rec. 601, 525 lines", REC601),
    9: ("Rec. 2020", (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)),
    11: ("DCI-P3", (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.314, 0.351)),
    12: ("Display P3", (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290)),
}
GAMMAS = {4: 2.2, 5: 2.8, 8: 1.0}  # of H.273 transfer codes; viewers show video codes (1, 6, 14, 15) as sRGB
HIGH_RANGE = {16: "PQ", 18: "HLG"}
MAKE = 271  # tag of EXIF
USUAL_GAMMA = 1 / 2.2, 0.03  # a gAMA that differs from the first number by at most the second is sRGB
GREY = "1", "L", "LA", "I", "I;16", "I;16B"  # Pillow's modes of grey pictures
NEAR = 1 / 255  # a profile that changes each colour by at most this counts as sRGB
SAMPLE = 2**16  # about this many pixels are checked for colours outside of sRGB
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


class Profile(NamedTuple):
    """A colour profile other than sRGB. ``reason``: why it cannot be used; empty if it can."""

    name: str
    icc: bytes = b""
    grey: bool = False
    reason: str = ""


def profile_of(image: Image.Image, path: Path) -> Profile | None:
    """The profile in the header of a picture (not decoded yet); None: it is sRGB, or the header has none."""
    points = _cicp(path) if image.format == "PNG" else image.info.get("nclx_profile")
    icc = image.info.get("icc_profile")
    if points and (image.format == "PNG" or not icc):
        if points.get("full_range_flag") == 0 and str(exif_of(image, MAKE)).upper().startswith("SONY"):
            return Profile("limited range", reason="Sony's cameras state it wrongly; decoding clips values")
        return _of_points(points["color_primaries"], points["transfer_characteristics"])
    if icc:
        found = _of_icc(icc)
        wrong = found and found.grey and image.mode not in GREY
        return Profile(found.name, reason="for grey, in a picture of colours") if found and wrong else found
    if image.format == "PNG" and "srgb" not in image.info:
        return _of_png(image)
    return None if image.format == "PNG" else _of_exif(image)  # reading a PNG's EXIF would decode the PNG


def exif_of(image: Image.Image, tag: int, block: int = 0) -> Any:
    """The value of an EXIF tag in a block (IFD), by default the first; None if absent or unreadable."""
    try:
        found = Image.Image.getexif(image)  # PngImageFile.getexif would decode the picture
        return (found.get_ifd(block) if block else found).get(tag)
    except Exception:
        return None


def to_srgb(pixels: np.ndarray, profile: Profile) -> tuple[np.ndarray, float]:
    """Convert pixels (H x W x 3, 8 or 16 bits; equal channels if the profile is grey) to 16-bit sRGB.

    The second value is the share of pixels whose colours are outside of sRGB and were moved to its edge.
    """
    if profile.grey:
        return _transformed(np.ascontiguousarray(pixels[..., 0]), profile, np.uint16), 0.0
    source = np.ascontiguousarray(pixels)
    every = max(1, pixels[..., 0].size // SAMPLE)
    return _transformed(source, profile, np.uint16), _outside(source.reshape(-1, 3)[::every], profile)


def _outside(pixels: np.ndarray, profile: Profile) -> float:
    """Share of pixels (N x 3) outside of sRGB even if each value moves half a rounding step towards grey."""
    most = np.iinfo(pixels.dtype).max
    stored = pixels / np.float32(most)
    nearer = stored + (stored.mean(axis=1, keepdims=True) - stored).clip(-0.5 / most, 0.5 / most)
    exact = _transformed(nearer[None], profile, np.float32)
    return float(((exact < -NEAR) | (exact > 1 + NEAR)).any(axis=-1).mean())


def to_rec709(pixels: np.ndarray, chromaticities: Sequence[float]) -> np.ndarray:
    """Convert linear pixels, H x W x 3, from these chromaticities (x, y of R, G, B and white) to Rec. 709.

    Bradford's matrix adapts the white point, so white stays (1, 1, 1). ValueError: the chromaticities define
    no colour space.
    """
    cones = [BRADFORD @ (np.array((x, y, 1 - x - y)) / y) for x, y in (chromaticities[6:], REC709[6:])]
    adapted = np.linalg.inv(BRADFORD) @ np.diag(cones[1] / cones[0]) @ BRADFORD
    matrix = np.linalg.inv(_to_xyz(REC709)) @ (adapted @ _to_xyz(chromaticities))
    if not np.isfinite(matrix).all():
        raise ValueError(f"chromaticities {tuple(chromaticities)} span no colours")
    return pixels @ matrix.T.astype(pixels.dtype)


def is_rec709(chromaticities: Sequence[float]) -> bool:
    """Whether these chromaticities equal those of Rec. 709, up to the rounding in files."""
    return bool(np.allclose(chromaticities, REC709, atol=2e-3))


def _to_xyz(chromaticities: Sequence[float]) -> np.ndarray:
    """The 3 x 3 matrix from linear RGB to XYZ, scaled so that white has Y = 1; NaN: there is none."""
    x, y = np.reshape(np.asarray(chromaticities, np.float64), (4, 2)).T
    columns = np.stack((x, y, 1 - x - y))
    white = columns[:, 3] / y[3]
    try:
        return columns[:, :3] * np.linalg.solve(columns[:, :3], white)
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.nan)


def _transformed(pixels: np.ndarray, profile: Profile, kind: type) -> np.ndarray:
    # by default littleCMS interpolates 16-bit colours in a grid: errors of up to 16/255 from ProPhoto
    exactly = imagecodecs.CMS.FLAGS.NOOPTIMIZE if pixels.dtype == np.uint16 else 0
    return imagecodecs.cms_transform(pixels, profile.icc, imagecodecs.cms_profile("srgb"), outdtype=kind,
                                     colorspace="gray" if profile.grey else "rgb", outcolorspace="rgb",
                                     flags=exactly)


@cache
def _made(name: str, chromaticities: tuple[float, ...], gamma: float | None) -> Profile | None:
    """A profile of these chromaticities and this gamma (None: the curve of sRGB); None if it is sRGB."""
    curve = {"gamma": gamma} if gamma else {"transferfunction": RESPONSES["srgb"].decode(
        np.linspace(0, 1, 4096, dtype=np.float32), Operations(np.where, np.maximum))}
    try:
        return _unless_srgb(Profile(name, imagecodecs.cms_profile(
            "rgb", whitepoint=chromaticities[6:], primaries=chromaticities[:6], **curve)))
    except imagecodecs.CmsError as reason:
        return Profile(name, reason=str(reason))


def _unless_srgb(profile: Profile) -> Profile | None:
    """The profile; None if it changes all colours of a grid by :data:`NEAR` or less."""
    steps = np.linspace(0, 255, 256 if profile.grey else 9).round().astype(np.uint8)
    colours = (steps,) * 3 if profile.grey else np.meshgrid(steps, steps, steps)
    grid = np.stack(colours, axis=-1).reshape(1, -1, 3)
    return None if np.abs(to_srgb(grid, profile)[0] / 65535 - grid / 255).max() <= NEAR else profile


@cache
def _of_icc(icc: bytes) -> Profile | None:
    name = "a damaged ICC profile"
    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(icc))
        name = ImageCms.getProfileDescription(opened).strip() or "a nameless ICC profile"
        if (space := opened.profile.xcolor_space.strip()) not in ("RGB", "GRAY"):
            return Profile(name, reason=f"for {space}, neither RGB nor grey")
        return _unless_srgb(Profile(name, icc, space == "GRAY"))
    except Exception as reason:  # littleCMS and its two wrappers raise many types
        return Profile(name, reason=str(reason))


def _of_points(primaries: int, transfer: int) -> Profile | None:
    if transfer in HIGH_RANGE:
        return Profile(f"the transfer function {HIGH_RANGE[transfer]}", reason="of high dynamic range")
    if primaries not in (2, *PRIMARIES):  # 2: not stated
        return Profile(f"colour primaries {primaries} of H.273", reason="not known")
    return _made(*PRIMARIES.get(primaries, PRIMARIES[1]), GAMMAS.get(transfer))


def _of_png(image: Image.Image) -> Profile | None:
    gamma = image.info.get("gamma")
    white_first = image.info.get("chromaticity")
    corners = white_first[2:] + white_first[:2] if white_first else REC709
    other = 1 / gamma if gamma and abs(gamma - USUAL_GAMMA[0]) > USUAL_GAMMA[1] else None
    return _made("gAMA and cHRM of PNG", tuple(corners), other) if other or not is_rec709(corners) else None


def _cicp(path: Path) -> dict[str, int] | None:
    """The H.273 code points of a PNG's cICP, which Pillow does not read."""
    with open(path, "rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"cICP" and length == 4:
                found = file.read(4)
                return {"color_primaries": found[0], "transfer_characteristics": found[1]}
            if kind in (b"IDAT", b"IEND"):
                return None
            file.seek(length + 4, 1)
    return None


def _of_exif(image: Image.Image) -> Profile | None:
    """Adobe RGB, if EXIF states R03 (interoperability of DCF 2.0) or color space 2; or an unknown profile."""
    space, rules = exif_of(image, 0xA001, 0x8769), str(exif_of(image, 1, 0xA005) or "")
    if space == 2 or rules.startswith("R03"):
        return _made("Adobe RGB", ADOBE_RGB, 2.19921875)
    unknown = Profile('the color space "uncalibrated" of EXIF', reason="no profile says which it is")
    return unknown if space == 65535 and not rules else None
