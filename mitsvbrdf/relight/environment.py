"""The surroundings of a preview. Up is z, and a white diffuse surface that faces up has luminance 0.8.

In an environment map (longitude and latitude) the top row is up. The middle column is +y, straight ahead for
a camera that looks along +y, and +x is right of it.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..errors import ConfigError
from ..export.mitsuba import read_scene
from ..io import images
from ..io.decode import check_size

ENVIRONMENTS = ("studio", "sunsky", "none")  # softboxes in a grey room, a clear afternoon, a single light
WHITE_LUMINANCE = 0.8  # luminance of a white diffuse surface that faces up, or faces the single light
LAMP = (-2.6, -2.0, 3.2)  # position: left of the camera, and behind it
HDR_HEADER = 4096  # first bytes of an .hdr file, which contain its size
LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)


@dataclass(frozen=True)
class Environment:
    """The light from around a scene."""

    emitters: dict[str, dict[str, Any]]  # plugin dictionaries by name
    # angle in degrees (counter-clockwise, seen from above) -> values by key of mi.traverse(scene)
    turned: Callable[[float], dict[str, Any]]


def make_environment(mi: ModuleType, name: str) -> Environment:
    """An environment by its name in :data:`ENVIRONMENTS`, or from an .exr or .hdr file.

    ConfigError: no such name; a file that is missing, unreadable, too small, not finite, negative, or black
    above the horizon.
    """
    if name == "none":
        lamp = {"type": "point", "position": LAMP,
                "intensity": {"type": "rgb", "value": WHITE_LUMINANCE * math.pi * math.hypot(*LAMP) ** 2}}
        return Environment({"light": lamp},
                           lambda angle: {"light.position": mi.Point3f(*_about_z(LAMP, angle))})
    if name == "sunsky":
        emitter = read_scene(mi, "sunsky.xml")["environment"]
        sun = tuple(emitter["sun_direction"])
        return Environment({"environment": emitter}, lambda angle: {
            "environment.sun_direction": mi.Vector3f(*_about_z(sun, angle))})
    image = studio() if name == "studio" else read_environment(name)
    white = white_luminance(image)
    if white <= 0:
        raise ConfigError("an environment with light above the horizon", f"{name}, black there",
                          "turn it upside down")

    def orientation(angle: float, transform: Any = mi.ScalarTransform4f) -> Any:
        # Mitsuba's up is y, its middle +z
        return transform().rotate([0, 0, 1], 180 + angle).rotate([1, 0, 0], 90)

    pixels = np.ascontiguousarray((image * (WHITE_LUMINANCE / white)).to(torch.float32).numpy())
    emitter = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": orientation(0)}
    return Environment({"environment": emitter},
                       lambda angle: {"environment.to_world": orientation(angle, mi.Transform4f)})


def _about_z(vector: tuple[float, ...], angle: float) -> tuple[float, ...]:
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    x, y, z = vector
    return cos * x - sin * y, sin * x + cos * y, z


def read_environment(path: str | Path) -> Tensor:
    """An environment's picture, H x W x 3, linear, float32; errors as :func:`make_environment`."""
    path = Path(path)
    if path.suffix.lower() not in (".exr", ".hdr"):
        raise ConfigError(f"an environment of {', '.join(ENVIRONMENTS)}, or an .exr or .hdr file",
                          repr(str(path)), "choose one of these")
    image = images.read_image(path, ConfigError) if path.suffix.lower() == ".exr" else _read_hdr(path)
    if image.shape[2] == 2:
        raise ConfigError("an environment with R, G, B or one channel", f"{path} with two", "export it again")
    image = image.expand(*image.shape[:2], 3)
    if image.shape[0] < 3 or image.shape[1] < 2:
        raise ConfigError("an environment of 2 x 3 pixels or more",
                          f"{path} with {image.shape[1]} x {image.shape[0]}", "give a larger one")
    if not torch.isfinite(image).all():
        raise ConfigError("an environment of finite values", f"NaN or infinity in {path}",
                          "mend or re-export it")
    if image.min() < 0:
        raise ConfigError("an environment without negative light", f"{float(image.min()):.3g} in {path}",
                          "clip it at 0")
    return image


def _read_hdr(path: Path) -> Tensor:
    import cv2

    if not path.is_file():
        raise ConfigError("an image file", f"no file at {path}", "check the name")
    data = path.read_bytes()
    if size := re.search(rb"^-Y (\d{1,12}) \+X (\d{1,12})$", data[:HDR_HEADER], re.MULTILINE):
        check_size(path, (int(size[2]), int(size[1])), ConfigError)
    # OpenCV would read other formats as well.
    image = (cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if size
             else None)
    if image is None or image.dtype != np.float32:
        raise ConfigError("a readable .hdr file", f"{path}, which is none", "export it again")
    return torch.from_numpy(np.ascontiguousarray(image[..., ::-1]))


def white_luminance(image: Tensor) -> float:
    """Luminance of a white diffuse surface that faces up in this environment: its irradiance over pi.

    Rows are interpolated as Mitsuba does: the first is the zenith, the last the nadir. No row is skipped.
    """
    rows = image.mean(dim=1, dtype=torch.float64) @ LUMINANCE
    half = (len(rows) - 1) * math.ceil(1024 / (len(rows) - 1))  # steps from the zenith to the horizon
    rows = F.interpolate(rows[None, None], 2 * half + 1, mode="linear", align_corners=True)[0, 0, :half + 1]
    theta = torch.linspace(0, math.pi / 2, half + 1, dtype=torch.float64)
    return float(torch.trapezoid(rows * torch.cos(theta) * torch.sin(theta), theta)) * 2


# Direction of a softbox, half its width and height at distance 1, its radiance and colour.
SOFTBOXES = (((-0.62, -0.75, 0.72), (0.34, 0.34), 26.0, (1.0, 0.97, 0.93)),  # key: left, behind the camera
             ((1.0, -0.25, 0.30), (0.14, 0.55), 9.0, (0.92, 0.96, 1.0)),     # fill: a strip at the right
             ((0.15, 0.9, 0.80), (0.24, 0.16), 20.0, (1.0, 1.0, 1.0)))           # rim: overhead, behind


def studio(height: int = 256) -> Tensor:
    """A dark room with a lit wall ahead and three softboxes: H x 2 H x 3, linear, float64, not scaled yet."""
    theta = torch.linspace(0, math.pi, height, dtype=torch.float64)[:, None]
    phi = ((torch.arange(2 * height, dtype=torch.float64) + 0.5) / (2 * height) - 0.5)[None] * 2 * math.pi
    x, y, z = torch.broadcast_tensors(theta.sin() * phi.sin(), theta.sin() * phi.cos(), theta.cos())
    d = torch.stack((x, y, z), dim=-1)
    room = 0.10 + 0.25 * torch.sigmoid(5 * z)
    wall = 0.5 * torch.exp(-4 * (x**2 + (z - 0.05) ** 2)) * (y > 0)
    image = (room + wall)[..., None].expand(*d.shape)
    for place, (wide, high), radiance, colour in SOFTBOXES:
        axis = F.normalize(torch.tensor(place, dtype=torch.float64), dim=0)
        right = F.normalize(torch.linalg.cross(axis, torch.tensor([0, 0, 1.0]).double()), dim=0)
        up = torch.linalg.cross(right, axis)
        ahead = (d @ axis).clamp_min(1e-6)
        inside = _soft(wide - (d @ right / ahead).abs()) * _soft(high - (d @ up / ahead).abs())
        image = torch.lerp(image, radiance * torch.tensor(colour, dtype=torch.float64), inside[..., None])
    return image


def _soft(distance: Tensor) -> Tensor:
    """Smoothstep of the distance inside a shape: 0 outside, 1 from a depth of 0.03 on."""
    t = (distance / 0.03).clamp(0, 1)
    return t * t * (3 - 2 * t)
