"""A learned start for ``hybrid``: a small generator, trained on made materials, changes the robust start.

The two-stage idea of the paper (III.F) for calibrated photos: a generator learns once, from materials made by code
(:mod:`.pretraining`), what photos usually mean, and every later fit starts from there. It looks at evidence of a fixed size,
whatever the number and the order of the photos.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from .. import color
from ..capture import Capture
from ..capture.guess import geometry, over
from ..errors import ConfigError
from ..maps import SVBRDF
from .checkpoint import load_tensors, save_tensors
from .config import HybridConfig
from .losses import CLIPPED
from .networks import AllPhotosGenerator
from .parameters import to_raw, to_svbrdf

SHIPPED = Path(__file__).with_name("learned_start.safetensors")
KIND = "learned start"
EVIDENCE = 25  # channels
DIRECTIONS = (13, 15)  # the channels where a direction's x begins; y follows
STEEP = 4.0  # brings the sines of half vectors, below 0.3 for a flash over a patch, to the size of the other channels
TINY = 1e-3


def evidence(capture: Capture, guess: Tensor, start: SVBRDF) -> Tensor:
    """What the photos say about each texel: EVIDENCE x R x R, float32, of about 0 to 1, directions of about -1 to 1.

    Sums, extremes and medians over the photos alone, so neither their number nor their order shows; giving each photo twice
    changes nothing. In this order: the guess; minimum, median and maximum of the apparent albedo (falloff and cosine undone);
    largest display value; the direction halfway to camera and light in the brightest photo, and its mean weighted by
    what exceeds the guess; how far that is spread, and how far all half vectors are; the angle of the nearest one; mean
    and largest excess over the guess; whether any photo is clipped; specular level and roughness of the robust start.

    Args:
        capture: photos and views.
        guess: guessed diffuse map, R x R x 3 linear.
        start: the robust start, a ``roughconductor`` material.
    """
    _, half, irradiance = geometry(capture.views, capture.resolution)
    half = half[..., :2]
    albedo = over(torch.pi * capture.linear, irradiance).clamp_max(4)
    excess = (albedo.mean(-1, True) - guess.mean(-1, True)).clamp_min(0)  # N x R x R x 1
    grey = albedo.mean(-1, True)
    brightest = (grey == grey.amax(dim=0)).float()
    brightest = (brightest * half).sum(dim=0) / brightest.sum(dim=0)
    share = (excess + TINY) / (excess + TINY).sum(dim=0)
    centre = (share * half).sum(dim=0)
    width = (share * (half - centre).square().sum(-1, True)).sum(dim=0).sqrt()
    sines = half.square().sum(-1, True)
    covered = (half - half.mean(dim=0)).square().sum(-1, True).mean(dim=0).sqrt()
    levels = [guess, albedo.amin(dim=0), albedo.quantile(0.5, dim=0), albedo.amax(dim=0)]
    channels = [*map(color.encode, levels), capture.photos.amax(dim=0).amax(-1, True), STEEP * brightest, STEEP * centre,
                STEEP * width, STEEP * covered, STEEP * sines.amin(dim=0).sqrt(),
                color.encode(excess.mean(dim=0)), color.encode(excess.amax(dim=0)),
                (capture.photos >= CLIPPED).any(-1, True).any(dim=0).float(),
                color.encode(start["specular"].mean(-1, True)), start["roughness"]]
    return torch.cat(channels, dim=-1).permute(2, 0, 1).contiguous()


def learned_start(capture: Capture, guess: Tensor, start: SVBRDF, source: str) -> SVBRDF:
    """The robust start as the pretrained generator changes it.

    Args:
        capture, guess, start: as in :func:`evidence`.
        source: ``shipped``, or a file of ``mitsvbrdf pretrain-hybrid``.

    Raises:
        ConfigError: no such file, or one of another kind.
    """
    generator = load_start(SHIPPED if source == "shipped" else Path(source))
    with torch.no_grad():
        changes = generator(evidence(capture, guess, start)[None])
        return to_svbrdf("roughconductor", {name: raw + changes[name] for name, raw in to_raw(start).items()}).map(
            Tensor.contiguous)


def no_learned_start(capture: Capture, config: HybridConfig) -> str | None:
    """Why a fit begins at the robust start though a learned one is asked for; None where it does not."""
    if config.bsdf != "roughconductor":
        return f"it was learned for roughconductor, not {config.bsdf}"
    return None if capture.calibrated else "the views are a stated default, not a calibration"


def new_generator(width: int) -> AllPhotosGenerator:
    """A generator that changes nothing yet; ``width`` channels at its finest level."""
    return AllPhotosGenerator(EVIDENCE, width=width, normalise=False)


def save_start(path: Path, generator: AllPhotosGenerator, width: int, **note: object) -> None:
    """The generator's weights as a safetensors file of 16-bit floats, with ``note`` in its header."""
    save_tensors(path, {name: value.half() for name, value in generator.state_dict().items()},
                 {"kind": KIND, "width": width, "evidence": EVIDENCE} | note)


def load_start(path: Path) -> AllPhotosGenerator:
    """The inverse of :func:`save_start`.

    Raises:
        ConfigError: no such file, or one of another kind.
    """
    weights, note = load_tensors(path)
    if (note.get("kind"), note.get("evidence")) != (KIND, EVIDENCE):
        raise ConfigError("a file of `mitsvbrdf pretrain-hybrid`", str(path), "make one, or leave --pretrained out")
    generator = new_generator(note["width"])
    generator.load_state_dict({name: value.float() for name, value in weights.items()})
    return generator
