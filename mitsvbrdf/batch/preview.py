"""A small lit picture of a material, for looking through many."""

from __future__ import annotations

from pathlib import Path

import torch

from .. import color
from ..io.files import write_bytes
from ..material.maps import SVBRDF
from ..render import make_renderer
from ..views import Views

SIDE = 192  # pixels
# patch sides: a highlight on the patch, and light aslant that shows relief
LIGHTS = ((-0.35, 0.35, 1.3), (0.9, 0.5, 1.2))
CAMERA = (0.0, 0.0, 2.2)
BRIGHT = 0.9  # quantile of the radiance that becomes mid-bright
QUALITY = 85


def write_preview(path: Path, svbrdf: SVBRDF, side: int = SIDE) -> None:
    """A JPEG of the patch under two point lights, seen from above.

    Args:
        path: of the file.
        svbrdf: the material.
        side: pixels a side; maps that are smaller are enlarged.
    """
    import cv2
    import numpy as np

    material = svbrdf.resized(min(side, svbrdf.resolution))
    views = Views.of([CAMERA] * len(LIGHTS), LIGHTS, [(1.0, 1.0, 1.0), (0.45, 0.45, 0.45)], 1.0)
    with torch.no_grad():
        radiance = make_renderer("analytic").render(material, views).sum(dim=0)
    level = float(radiance.mean(dim=-1).quantile(BRIGHT)) or 1.0
    display = color.to_display(radiance * (0.45 / level), "srgb")
    pixels = np.rint(display.numpy()[..., ::-1] * 255).clip(0, 255).astype(np.uint8)
    if pixels.shape[0] < side:
        pixels = cv2.resize(pixels, (side, side), interpolation=cv2.INTER_CUBIC)
    ok, data = cv2.imencode(".jpg", np.ascontiguousarray(pixels), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert ok
    write_bytes(path, data.tobytes())
