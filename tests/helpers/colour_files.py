"""Pictures in known colour spaces, by the formulas of their standards."""

import struct
import zlib

import imagecodecs
import numpy as np
import OpenEXR
from PIL import Image

SRGB = 0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290
ACES = 0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767  # SMPTE ST 2065-1
# x and y of red, green, blue and white, and a power (None: sRGB's curve), as their standards have them
SPACES = {"Display P3": ((0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290), None),
          "Adobe RGB": ((0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290), 563 / 256),
          "Rec. 2020": ((0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290), None),
          "ProPhoto": ((0.7347, 0.2653, 0.1596, 0.8404, 0.0366, 0.0001, 0.3457, 0.3585), 1.8)}
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def decode(display):
    return np.where(display <= 0.04045, display / 12.92, ((np.maximum(display, 0) + 0.055) / 1.055) ** 2.4)


def encode(linear, power=None):
    if power:
        return np.maximum(linear, 0) ** (1 / power)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


def to_d50(corners):
    """Linear RGB to XYZ under D50 (Bradford), the space in which profiles meet."""
    x, y = np.reshape(corners, (4, 2)).T
    xyz = np.stack((x / y, np.ones(4), (1 - x - y) / y))
    matrix = xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3])
    cones = BRADFORD @ (0.9642, 1, 0.8249) / (BRADFORD @ xyz[:, 3])
    return np.linalg.inv(BRADFORD) @ np.diag(cones) @ BRADFORD @ matrix


def encoded_in(display, space, curve=True):
    """Values of sRGB (linear ones of Rec. 709 without ``curve``) as a space, or corners, has them."""
    corners, power = SPACES[space] if isinstance(space, str) else (space, None)
    linear = decode(display) if curve else display
    found = linear @ (np.linalg.inv(to_d50(corners)) @ to_d50(SRGB)).T
    return encode(found, power) if curve else found


def icc_of(corners, power):
    curve = {"gamma": power} if power else {"transferfunction": decode(np.linspace(0, 1, 4096)).astype("f4")}
    return imagecodecs.cms_profile("rgb", whitepoint=corners[6:], primaries=corners[:6], **curve)


def save_in(path, display, space, bits=8, **options):
    """A picture of sRGB's display values, stored in a space with its profile."""
    icc, top = icc_of(*SPACES[space]), 2**bits - 1
    pixels = (encoded_in(display, space).clip(0, 1) * top).round().astype(f"u{bits // 8}")
    if bits == 16:
        if path.suffix == ".tif":
            path.write_bytes(tiff(pixels, icc))
        else:
            path.write_bytes(with_profile(imagecodecs.png_encode(pixels), icc))
        return path
    if path.suffix == ".heic":
        import pillow_heif

        pillow_heif.register_heif_opener()
    how = {".jpg": {"quality": 97, "subsampling": 0}, ".heic": {"quality": 95, "chroma": 444},
           ".webp": {"lossless": True}}.get(path.suffix, {})
    Image.fromarray(pixels).save(path, icc_profile=icc, **how, **options)
    return path


def tiff(pixels, icc):
    """The least of a TIFF: one uncompressed strip of 16 bits, RGB or RGBA, and a profile."""
    height, width, channels = pixels.shape
    entries = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, channels, 0), (259, 3, 1, 1), (262, 3, 1, 2),
               (273, 4, 1, 0), (277, 3, 1, channels), (278, 4, 1, height), (279, 4, 1, pixels.nbytes)]
    entries += [(338, 3, 1, 2)] * (channels == 4) + [(34675, 7, len(icc), 0)] * bool(icc)
    depths = struct.pack(f"<{channels}H", *[16] * channels)
    begin = 8 + 2 + 12 * len(entries) + 4
    places = {258: begin, 34675: begin + len(depths), 273: begin + len(depths) + len(icc)}
    table = b"".join(struct.pack("<HHII", tag, kind, count, places.get(tag, value))
                     for tag, kind, count, value in entries)
    return (b"II*\0" + struct.pack("<IH", 8, len(entries)) + table + bytes(4) + depths + icc
            + pixels.astype("<u2").tobytes())


def with_profile(png, icc):
    return with_chunk(png, b"iCCP", b"ICC\0\0" + zlib.compress(icc))


def with_chunk(png, kind, content):
    """A PNG with one more chunk before its pixels."""
    chunk = kind + content
    return (png[:33] + struct.pack(">I", len(content)) + chunk + struct.pack(">I", zlib.crc32(chunk))
            + png[33:])


def with_chromaticities(path, linear, corners):
    """An EXR that states chromaticities, which OpenEXR for Python reads and cannot write."""
    OpenEXR.File({"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage},
                 {"RGB": np.ascontiguousarray(linear, np.float32)}).write(str(path))
    data, at = path.read_bytes(), 8
    stated = b"chromaticities\0" * 2 + struct.pack("<i8f", 32, *corners)
    while data[at]:  # name, type, size, value
        at = data.index(b"\0", data.index(b"\0", at) + 1) + 1
        at += 4 + struct.unpack("<i", data[at:at + 4])[0]
    rows = np.frombuffer(data[at + 1:at + 1 + 8 * len(linear)], "<u8") + len(stated)
    path.write_bytes(data[:8] + stated + data[8:at + 1] + rows.tobytes() + data[at + 1 + rows.nbytes:])
