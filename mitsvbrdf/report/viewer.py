"""The live viewer: an HTML fragment that shades a material's maps in WebGL2 as ``render/analytic.py`` does.

It has the maps as integers of 12 or 16 bits, high and low bytes apart, deflated, in base64. Eight bits
are too few: a highlight of roughness 0.1 is 0.01 wide, 1.3 steps of an 8-bit normal map.
"""

import base64
import zlib

import numpy as np

from ..material.maps import CHANNELS, COLOURS, DIELECTRIC_F0, SVBRDF, TITLES
from ..render.analytic import MIN_ALPHA
from ..render.bsdf import F0_RANGE
from .page import page_text

VIEWER_SIDE = 512  # texels along a side; maps of noise are 5.3 MB then, those of materials 2 to 4.5 MB
TOP_LEVELS = {"square": 4095, "plain": 65535, "octahedral": 65535}  # highest integer of each coding


def viewer_html(svbrdf: SVBRDF) -> str:
    """The viewer as an HTML fragment, for one place of a page that extends ``report/base.html``.

    The template marks it ``|safe``. It loads nothing from the network, opens from disk, and defines
    ``window.mitsvbrdfViewer`` (``viewer.js``). Maps above :data:`VIEWER_SIDE` are area-averaged. MapsError:
    values that are not finite or out of range.
    """
    svbrdf = svbrdf.detach().check()
    svbrdf = svbrdf.resized(min(svbrdf.resolution, VIEWER_SIDE))
    names = CHANNELS[svbrdf.bsdf]
    maps = [encode(name, svbrdf[name].cpu().double().numpy(),
                   "octahedral" if name == "normal" else "square" if name in COLOURS else "plain")
            for name in names]
    about = {"maps": [entry for entry, _ in maps], "bsdf": svbrdf.bsdf, "resolution": svbrdf.resolution,
             "f0_range": F0_RANGE, "dielectric_f0": DIELECTRIC_F0, "min_alpha": MIN_ALPHA[svbrdf.bsdf],
             "titles": {name: TITLES[name] for name in names}}
    planes = b"".join(each for _, each in maps)
    payload = base64.b64encode(zlib.compress(planes, 9)).decode()
    return page_text("report/viewer.html", about=about, payload=payload)


def encode(name: str, value: np.ndarray, coding: str) -> tuple[dict, bytes]:
    """Encode a picture H x W x C; return a description for the decoder, and the bytes.

    Each channel has integers q in [0, top] that mean c = low + q (high - low) / top, with its own low and
    high, so a constant channel is exact. The value follows from c by the coding. ``square``: it is c^2
    (colours: even steps for the eye). ``plain``: c. ``octahedral``: a unit vector (x, y, z), z > 0, from two
    channels, x + y and x - y, both divided by |x| + |y| + |z| (Cigolle et al. 2014, hemi-octahedral); its
    error is at most 3.8e-5 rad.

    The description is ``{"name", "coding", "top", "height", "width", "low": [...], "high": [...]}``. The
    bytes are, channel by channel, H x W high bytes, then H x W low bytes, row 0 at the top. In the page all
    planes follow one another, deflated in zlib's format.
    """
    if coding == "octahedral":
        x, y = np.moveaxis(value[..., :2], -1, 0) / np.abs(value).sum(-1)
        value = np.stack((x + y, x - y), axis=-1)
    elif coding == "square":
        value = np.sqrt(value)
    low, high = value.min((0, 1)), value.max((0, 1))
    span, top = np.where(high > low, high - low, 1), TOP_LEVELS[coding]
    levels = np.rint((value - low) / span * top).astype(">u2")  # high byte first
    planes = np.ascontiguousarray(levels)[..., None].view(np.uint8).transpose(2, 3, 0, 1).tobytes()
    height, width = value.shape[:2]
    return {"name": name, "coding": coding, "top": top, "height": height, "width": width,
            "low": low.tolist(), "high": high.tolist()}, planes
