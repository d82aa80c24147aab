"""From unbounded numbers to a valid material and back: every output is in range by construction."""

from collections.abc import Mapping

import torch
from torch import Tensor

from ..material.maps import CHANNELS, SVBRDF, Bsdf

ROUGHNESS_RANGE = (0.02, 1.0)  # alpha from 4e-4; renderers clamp it at 1e-4 (principled: 1e-3)
MAX_SLOPE = 1.5  # of the normal's x and y over z: 56 degrees along an axis

# Channels of the raw maps, in the order of the paper's two streams (III.D); a normal is two slopes.
STREAMS: dict[str, tuple[dict[str, int], dict[str, int]]] = {
    "roughconductor": ({"normal": 2, "roughness": 1}, {"diffuse": 3, "specular": 3}),
    "principled": ({"normal": 2, "roughness": 1}, {"base_color": 3, "metallic": 1}),}

Streams = tuple[dict[str, int], dict[str, int]]


def streams_of(bsdf: str, fixed: Mapping[str, Tensor], grey_specular: bool = False) -> Streams:
    """The channels of the maps to fit: :data:`STREAMS` without fixed maps; a grey specular map has one."""
    first, second = ({name: 1 if grey_specular and name == "specular" else channels
                      for name, channels in stream.items() if name not in fixed} for stream in STREAMS[bsdf])
    return first, second


def to_svbrdf(bsdf: Bsdf, raw: Mapping[str, Tensor], fixed: Mapping[str, Tensor] | None = None) -> SVBRDF:
    """A material from raw maps C x R x R of unbounded numbers (normal: 2 x R x R), and fixed maps R x R x C.

    A grey specular map, 1 x R x R, is expanded to three channels: renderers detect its last stride of 0.
    """
    return from_units(bsdf, {name: torch.tanh(x) for name, x in before_tanh(raw).items()}, fixed)


def before_tanh(raw: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The inputs of Tanh for these raw maps: half of each, since raw maps are logits; the normal itself."""
    return {name: x if name == "normal" else x / 2 for name, x in raw.items()}


def from_units(bsdf: Bsdf, units: Mapping[str, Tensor], fixed: Mapping[str, Tensor] | None = None) -> SVBRDF:
    """As :func:`to_svbrdf`, from outputs of Tanh, in (-1, 1), as in the paper."""
    maps = dict(fixed or {})
    for name, x in units.items():
        x = x.permute(1, 2, 0)
        if name == "normal":
            steep = torch.cat((MAX_SLOPE * x, torch.ones_like(x[..., :1])), dim=-1)
            maps[name] = torch.nn.functional.normalize(steep, dim=-1)
        else:
            low, high = ROUGHNESS_RANGE if name == "roughness" else (0.0, 1.0)
            maps[name] = (low + (high - low) * (x + 1) / 2).expand(*x.shape[:2], CHANNELS[bsdf][name])
    return SVBRDF(bsdf, {name: maps[name] for name in CHANNELS[bsdf]})


def to_raw(svbrdf: SVBRDF, streams: Streams | None = None) -> dict[str, Tensor]:
    """The inverse of :func:`to_svbrdf`: name -> C x R x R. Values are clamped just inside their ranges.

    Only the maps in ``streams`` are converted; default: all.
    """
    first, second = streams or STREAMS[svbrdf.bsdf]
    raw = {}
    for name, value in svbrdf.maps.items():
        if name not in first | second:
            continue
        if name == "normal":
            slopes = (value[..., :2] / value[..., 2:].clamp_min(0.1) / MAX_SLOPE).clamp(-0.99, 0.99)
            x = torch.atanh(slopes)
        elif name == "roughness":
            low, high = ROUGHNESS_RANGE
            x = torch.logit(((value - low) / (high - low)).clamp(0.01, 0.99))
        else:
            if (first | second)[name] < value.shape[-1]:
                value = value.mean(dim=-1, keepdim=True)
            x = torch.logit(value.clamp(0.002, 0.998))
        raw[name] = x.permute(2, 0, 1).contiguous()
    return raw
