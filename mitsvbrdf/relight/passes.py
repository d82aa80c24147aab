"""A scene rendered in independent passes until the estimated error of their mean is small enough.

The error is RMSE in display values (sRGB, exposed, clipped to [0, 1]) over the whole frame of the picture as
it is kept. The jackknife estimates it (Tukey 1958; unequal groups as Busing et al. 1999): samples go to up to
eight groups in turn, and the kept picture is compared with the one without each group. Both hold nearly all
samples, so the sRGB curve and the clipping count as in the picture itself. Where rare bright samples are
clipped the difference of two halves is only 0.57 of the true error, the jackknife 0.97 of it.

Dr.Jit compiles one kernel for all numbers of samples that are powers of two, so every pass is made of those.
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
from ..errors import ConfigError, MapsError
from ..io import Report

JACKKNIFE_GROUPS = 8
# samples of one call of the renderer: a second or so, after which Ctrl-C and a budget are looked at
SAMPLES_AT_ONCE = 2**22
TARGET_ERROR = 0.01


@dataclass(frozen=True)
class Stop:
    """When a frame is done; one of the three, and with none given at an error of 0.01."""

    target_error: float | None = None  # estimated RMSE in display values, in (0, 1)
    budget: float | None = None  # seconds
    samples: int | None = None  # a pixel

    def __post_init__(self) -> None:
        given = [name.replace("_", " ") for name in ("target_error", "budget", "samples")
                 if getattr(self, name) is not None]
        if len(given) > 1:
            raise ConfigError("one of target error, budget and samples", " and ".join(given),
                              "give one of them")
        if not given:
            object.__setattr__(self, "target_error", TARGET_ERROR)
        if self.target_error is not None and not 0 < self.target_error < 1:
            raise ConfigError("a target error between 0 and 1", str(self.target_error), f"try {TARGET_ERROR}")
        if self.budget is not None and not 0 < self.budget < math.inf:
            raise ConfigError("a budget of more than 0 seconds", str(self.budget), "try 60")
        if self.samples is not None and self.samples < 1:
            raise ConfigError("1 sample a pixel or more", str(self.samples), "try 64")


@dataclass(frozen=True)
class Rendered:
    """A frame."""

    image: Tensor = field(repr=False)  # linear radiance H x W x 3, float32, row 0 at the top, not exposed
    samples: int  # a pixel
    seconds: float  # for all of it; the kernel is compiled in the first frame of a scene
    error: float | None  # estimated RMSE in display values; None of a single sample
    curve: tuple[dict, ...]  # seconds, samples and error each time the error was estimated
    stopped: str  # target, budget, samples or interrupted


def shown(image: Tensor, exposure: float = 0.0) -> Tensor:
    """Linear radiance as display values: exposed by so many stops, sRGB, clipped to [0, 1]."""
    return color.to_display(image * 2.0**exposure, "srgb")


def render_passes(draw: Callable[[int, int], Tensor], stop: Stop, *, pixels: int, exposure: float = 0.0,
                  report: Report = lambda text, share: None, interrupted: Sequence = ()) -> Rendered:
    """Add passes until the frame is done.

    ``draw`` takes the number of the call and samples a pixel, a power of two, and gives linear H x W x 3,
    independent from call to call. The error is that of the picture as shown, so many stops brighter.
    ``interrupted`` is not empty once somebody wants an end; one call is made in any case. MapsError: the
    renderer gave numbers that are not finite.
    """
    started = time.perf_counter()
    mean, curve, why, calls, looking, most = GroupedMean(), list[dict](), "", 0, 0.0, _power_of_two(
        max(SAMPLES_AT_ONCE // pixels, 1))
    while not why:
        goal = _goal(mean.samples, curve, stop)
        part = min(_power_of_two(max((goal - mean.samples) // JACKKNIFE_GROUPS, 1)), most)
        while mean.samples < goal and not why:
            began = time.perf_counter()
            count = min(part, _power_of_two(goal - mean.samples))
            mean.add(draw(calls, count), count)
            calls += 1
            now = time.perf_counter()
            again = now - began if calls > 1 else 0.0  # the first call also compiles
            if interrupted:
                why = "interrupted"
            elif stop.budget and now - started + again + looking > stop.budget:
                why = "budget"
            report(_line(mean.samples, curve), _share(stop, now - started, mean.samples, curve))
        began = time.perf_counter()
        error = mean.error(exposure)
        now = time.perf_counter()
        looking = now - began
        if error is not None:
            curve.append({"seconds": now - started, "samples": mean.samples, "error": error})
        if not why and stop.samples == mean.samples:
            why = "samples"
        elif not why and stop.target_error and error is not None and error <= stop.target_error:
            why = "target"
    return Rendered(mean.image, mean.samples, time.perf_counter() - started, error, tuple(curve), why)


def render_frame(mi: ModuleType, scene: Any, stop: Stop, *, seed: int = 0, name: str = "",
                 exposure: float = 0.0, report: Report = lambda text, share: None,
                 interrupted: Sequence = ()) -> Rendered:
    """Render a loaded Mitsuba scene with its own sensor, integrator and independent sampler; see
    :func:`render_passes`.

    Frames of different names have different random numbers.
    """
    first = zlib.crc32(f"{seed} {name}".encode())

    def draw(call: int, samples: int) -> Tensor:
        return torch.from_numpy(mi.render(scene, seed=(first + call) % 2**32, spp=samples).numpy())

    width, height = scene.sensors()[0].film().size()
    return render_passes(draw, stop, pixels=width * height, exposure=exposure, report=report,
                         interrupted=interrupted)


class GroupedMean:
    """The mean of all samples, kept in groups, for the mean without each group."""

    def __init__(self) -> None:
        self.sums: list[Tensor] = []
        self.counts: list[int] = []

    @property
    def samples(self) -> int:
        """So many a pixel."""
        return sum(self.counts)

    @property
    def image(self) -> Tensor:
        """The mean, linear."""
        return torch.stack(self.sums).sum(dim=0) / self.samples

    def add(self, image: Tensor, samples: int) -> None:
        """Add the mean of new samples: as a group while there are few, else to the smallest."""
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


def _power_of_two(most: int) -> int:
    return 1 << (most.bit_length() - 1)


def _goal(samples: int, curve: list[dict], stop: Stop) -> int:
    """How many samples to have next: twice as many, or as many as the law of their root says are enough."""
    goal = max(2 * samples, 2)
    if stop.samples:
        return min(goal, stop.samples)
    if stop.target_error and curve:
        needed = math.ceil(samples * (curve[-1]["error"] / stop.target_error) ** 2)
        return min(goal, max(needed, samples + 1))
    return goal


def _share(stop: Stop, seconds: float, samples: int, curve: list[dict]) -> float:
    if stop.budget:
        return min(seconds / stop.budget, 1.0)
    if stop.samples:
        return samples / stop.samples
    if not curve:
        return 0.0
    needed = curve[-1]["samples"] * (curve[-1]["error"] / stop.target_error) ** 2
    return min(samples / max(needed, 1), 1.0)


def _line(samples: int, curve: list[dict]) -> str:
    return f"{samples} sample{'s' * (samples > 1)}" + (f", error {curve[-1]['error']:.4f}" if curve else "")
