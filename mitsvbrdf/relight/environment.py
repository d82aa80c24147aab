"""What surrounds a preview. Up is z, and a white diffuse surface that faces up has luminance 0.8.

In a picture of an environment (longitude and latitude) the top row is up, the middle column is +y, which is straight ahead of
a camera that looks along +y, and +x is right of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .. import files
from ..errors import ConfigError
from .scene_file import read_scene

ENVIRONMENTS = {"studio": "three softboxes in a grey room, made by code", "sunsky": "a clear afternoon (Hosek and Wilkie)",
                "none": "a single light"}
WHITE = 0.8  # luminance of a white diffuse surface that faces up
LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)


@dataclass(frozen=True)
class Environment:
    """An environment for a scene.

    Args:
        emitter: its plugin dictionary.
        turned: angle in degrees (counter-clockwise, seen from above) -> values by key of ``mi.traverse(scene)``, where the
            emitter is called ``environment``.
        dark_below: nothing shines below the horizon.
    """

    emitter: dict[str, Any]
    turned: Callable[[float], dict[str, Any]]
    dark_below: bool


def make_environment(mi, name: str) -> Environment:
    """An environment by its name in :data:`ENVIRONMENTS` (but ``none``), or from an .exr or .hdr file.

    Raises:
        ConfigError: no such name; a file that is missing, unreadable, too small, not finite, negative, or black above the
            horizon.
    """
    if name == "sunsky":
        emitter = read_scene(mi, "sunsky.xml")["environment"]
        sun = np.array(emitter["sun_direction"], dtype=float)

        def sun_turned(angle: float) -> dict[str, Any]:
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            x, y, z = sun
            return {"environment.sun_direction": mi.Vector3f(c * x - s * y, s * x + c * y, z)}

        return Environment(emitter, sun_turned, dark_below=True)
    image = studio() if name == "studio" else read_environment(name)
    white = white_luminance(image)
    if white <= 0:
        raise ConfigError("an environment with light above the horizon", f"{name}, black there", "turn it upside down")

    def orientation(angle: float, transform=mi.ScalarTransform4f):
        return transform().rotate([0, 0, 1], 180 + angle).rotate([1, 0, 0], 90)  # Mitsuba's up is y, its middle +z

    pixels = np.ascontiguousarray((image * (WHITE / white)).to(torch.float32).numpy())
    emitter = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": orientation(0)}
    return Environment(emitter, lambda angle: {"environment.to_world": orientation(angle, mi.Transform4f)}, dark_below=False)


def read_environment(path: str | Path) -> Tensor:
    """An environment's picture, H x W x 3, linear radiance, float32; errors as :func:`make_environment` has them."""
    path = Path(path)
    if path.suffix.lower() not in (".exr", ".hdr"):
        raise ConfigError(f"an environment of {list(ENVIRONMENTS)}, or an .exr or .hdr file", repr(str(path)),
                          "choose one of these")
    image = files.read_image(path, ConfigError) if path.suffix.lower() == ".exr" else _read_hdr(path)
    image = image.expand(*image.shape[:2], 3)
    if image.shape[0] < 3 or image.shape[1] < 2:
        raise ConfigError("an environment of 2 x 3 pixels or more", f"{path} with {image.shape[1]} x {image.shape[0]}",
                          "give a larger one")
    if not torch.isfinite(image).all():
        raise ConfigError("an environment of finite values", f"NaN or infinity in {path}", "mend or re-export it")
    if image.min() < 0:
        raise ConfigError("an environment without negative light", f"{float(image.min()):.3g} in {path}", "clip it at 0")
    return image


def _read_hdr(path: Path) -> Tensor:
    import cv2

    if not path.is_file():
        raise ConfigError("an image file", f"no file at {path}", "check the name")
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if data.size else None
    if image is None or image.dtype != np.float32:
        raise ConfigError("a readable .hdr file", f"{path}, which is none", "export it again")
    return torch.from_numpy(np.ascontiguousarray(image[..., ::-1]))


def white_luminance(image: Tensor) -> float:
    """Luminance of a white diffuse surface that faces up in this environment: its irradiance over pi.

    Rows are interpolated as Mitsuba does: the first is the zenith, the last the nadir.
    """
    rows = (image.double() @ LUMINANCE).mean(dim=1)
    angles = 2 * 1024 + 1
    rows = F.interpolate(rows[None, None], angles, mode="linear", align_corners=True)[0, 0, :1025]
    theta = torch.linspace(0, math.pi / 2, 1025, dtype=torch.float64)
    return float(torch.trapezoid(rows * torch.cos(theta) * torch.sin(theta), theta)) * 2


def directions(height: int, width: int) -> Tensor:
    """Unit vectors that the pixels of an environment's picture stand for: H x W x 3, float64."""
    theta = torch.linspace(0, math.pi, height, dtype=torch.float64)[:, None]
    phi = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5)[None] * 2 * math.pi
    return torch.stack(torch.broadcast_tensors(theta.sin() * phi.sin(), theta.sin() * phi.cos(), theta.cos()), dim=-1)


# Where a softbox hangs, how wide and high it is at distance 1 (half sides), its radiance and colour.
SOFTBOXES = (((-0.75, -0.55, 0.75), (0.42, 0.42), 9.0, (1.0, 0.97, 0.93)),  # key: left, behind the camera
             ((1.0, -0.15, 0.35), (0.16, 0.55), 4.0, (0.93, 0.97, 1.0)),    # fill: a strip at the right
             ((0.1, 0.9, 0.75), (0.6, 0.16), 7.0, (1.0, 1.0, 1.0)))         # rim: a strip overhead, behind the object


def studio(height: int = 256) -> Tensor:
    """A room of grey walls, brighter above, with three softboxes: H x 2 H x 3, linear, float64, not scaled yet."""
    d = directions(height, 2 * height)
    z = d[..., 2:]
    image = (0.10 + 0.30 * torch.sigmoid(4 * (z - 0.1))).expand(*d.shape).clone()
    for place, (wide, high), radiance, colour in SOFTBOXES:
        axis = F.normalize(torch.tensor(place, dtype=torch.float64), dim=0)
        right = F.normalize(torch.linalg.cross(axis, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)), dim=0)
        up = torch.linalg.cross(right, axis)
        ahead = (d @ axis).clamp_min(1e-6)
        inside = _soft(wide - (d @ right / ahead).abs()) * _soft(high - (d @ up / ahead).abs()) * (d @ axis > 0)
        image = torch.lerp(image, radiance * torch.tensor(colour, dtype=torch.float64), inside[..., None])
    return image


def _soft(distance: Tensor, edge: float = 0.03) -> Tensor:
    """0 outside, 1 inside, smooth over the edge."""
    t = (distance / edge).clamp(0, 1)
    return t * t * (3 - 2 * t)
