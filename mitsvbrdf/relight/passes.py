"""Render a scene in independent passes, which also give an estimate of the error of their mean.

The error is RMSE in display values (sRGB, exposed, clipped to [0, 1]) over the whole frame of the final
picture. The jackknife estimates it (Tukey 1958; unequal groups as Busing et al. 1999): samples go to up to
eight groups in turn, and the final picture is compared with each picture that omits one group. The latter
has nearly all samples, so the sRGB curve and the clipping act on both almost alike. If rare bright samples
are clipped, the difference of two halves gives only 0.57 of the true error, the jackknife 0.97.

Dr.Jit compiles one kernel for all powers of two as numbers of samples, so every call takes a power of two.
"""

import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from .. import color
from ..errors import MapsError
from ..io import Report

JACKKNIFE_GROUPS = 8
SAMPLES_AT_ONCE = 2**22  # samples of one call of the renderer: about a second, the longest wait for Ctrl-C
INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Rendered:
    """A frame."""

    image: Tensor = field(repr=False)  # linear radiance H x W x 3, float32, row 0 at the top, not exposed
    samples: int  # a pixel
    seconds: float  # of all passes; the first frame of a scene includes compiling its kernel
    error: float | None  # estimated RMSE in display values; None after a single pass
    stopped: str  # why rendering ended: samples or interrupted


def shown(image: Tensor, exposure: float = 0.0) -> Tensor:
    """Linear radiance as display values: ``exposure`` stops brighter, sRGB, clipped to [0, 1]."""
    return color.to_display(image * 2.0**exposure, "srgb")


def render_passes(draw: Callable[[int, int], Tensor], samples: int, *, pixels: int, exposure: float = 0.0,
                  report: Report = lambda text, share: None, interrupted: Sequence = ()) -> Rendered:
    """Add passes until each pixel has ``samples`` samples.

    ``draw`` takes the number of the call, and samples a pixel, a power of two; it gives linear H x W x 3,
    independent of other calls. The error is that of the picture as shown, ``exposure`` stops brighter. When
    ``interrupted`` is no longer empty, drawing stops; at least one call is made. MapsError: the renderer gave
    numbers that are not finite.
    """
    started, mean, calls = time.perf_counter(), GroupedMean(), 0
    part = max(min(samples // JACKKNIFE_GROUPS, SAMPLES_AT_ONCE // pixels), 1)
    while mean.samples < samples and not (calls and interrupted):
        count = 1 << min(part, samples - mean.samples).bit_length() - 1  # the power of two at or below it
        mean.add(draw(calls, count), count)
        calls += 1
        report(f"{mean.samples} sample{'s' * (mean.samples > 1)}", mean.samples / samples)
    return Rendered(mean.image, mean.samples, time.perf_counter() - started, mean.error(exposure),
                    "samples" if mean.samples == samples else INTERRUPTED)


def render_frame(mi: ModuleType, scene: Any, samples: int, *, seed: int = 0, name: str = "",
                 **options: Any) -> Rendered:
    """Render a loaded Mitsuba scene with its own sensor, integrator and independent sampler; ``options`` are
    those of :func:`render_passes`. Frames of different names have different random numbers.
    """
    first = zlib.crc32(f"{seed} {name}".encode())

    def draw(call: int, count: int) -> Tensor:
        return torch.from_numpy(mi.render(scene, seed=(first + call) % 2**32, spp=count).numpy())

    width, height = scene.sensors()[0].film().size()
    return render_passes(draw, samples, pixels=width * height, **options)


class GroupedMean:
    """The mean of all samples. They are summed in groups, so that any group can be left out of the mean."""

    def __init__(self) -> None:
        self.sums: list[Tensor] = []
        self.counts: list[int] = []

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return sum(self.counts)

    @property
    def image(self) -> Tensor:
        """The mean, linear."""
        return torch.stack(self.sums).sum(dim=0) / self.samples

    def add(self, image: Tensor, samples: int) -> None:
        """Add the mean of new samples: as a new group up to the eighth, else to the smallest group."""
        if not bool(torch.isfinite(image).all()):
            raise MapsError("radiance that is finite", "pixels that are not",
                            "check maps and environment for NaN or infinity")
        if len(self.sums) < JACKKNIFE_GROUPS:
            self.sums.append(image * samples)
            self.counts.append(samples)
            return
        k = self.counts.index(min(self.counts))
        self.sums[k] += image * samples
        self.counts[k] += samples

    def error(self, exposure: float = 0.0) -> float | None:
        """RMSE of the mean as it is shown, by the jackknife; None with fewer than two groups."""
        if len(self.sums) < 2:
            return None
        whole = torch.stack(self.sums).sum(dim=0)
        kept = shown(whole / self.samples, exposure)
        variance = 0.0
        for one, count in zip(self.sums, self.counts):
            without = shown((whole - one) / (self.samples - count), exposure)
            variance += ((self.samples / count - 1)
                         * float((without - kept).square().mean(dtype=torch.float64)))
        return math.sqrt(variance / len(self.sums))
