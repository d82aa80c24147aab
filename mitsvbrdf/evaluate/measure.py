"""What the cross-check, the sweeps and the benchmarks share: gradients under fixed random numbers, and fair timing."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from ..errors import ConfigError
from ..maps import SVBRDF
from ..render import Renderer
from ..views import Views

K, T = TypeVar("K"), TypeVar("T")


@dataclass(frozen=True)
class Measured:
    """One forward and one backward pass.

    Args:
        image: linear radiance N x R x R x 3.
        gradients: of the product of image and cotangent, by map name, each of the map's shape.
        forward: seconds of the forward pass.
        backward: seconds of the backward pass.
    """

    image: Tensor
    gradients: dict[str, Tensor]
    forward: float
    backward: float


def fixed_cotangent(shape: torch.Size, seed: int = 1) -> Tensor:
    """The same normally distributed numbers in every run, float32, so that all renderers are asked the same question."""
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def render_and_gradients(renderer: Renderer, svbrdf: SVBRDF, views: Views, cotangent: Tensor | None = None,
                         ) -> Measured:
    """Render, and differentiate the product of the image with fixed numbers with respect to every map.

    Args:
        renderer: any; ``analytic64`` gets the maps in float64, so its gradients are float64 too.
        svbrdf: the material, float32.
        views: camera and light positions.
        cotangent: N x R x R x 3; left out: :func:`fixed_cotangent`.

    Raises:
        ConfigError: the image carries no gradient.
    """
    dtype = torch.float64 if renderer.name == "analytic64" else torch.float32
    leaves = svbrdf.to(dtype).map(lambda t: t.detach().clone().requires_grad_())
    started = time.perf_counter()
    image = renderer.render(leaves, views)
    forward = time.perf_counter() - started
    if not image.requires_grad:
        raise ConfigError("an image that carries gradients to the maps", f"one of {renderer.name} without", "make the renderer "
                          "differentiable, or compare the images alone (gradients=math.inf in assert_renderers_agree)")
    cotangent = (fixed_cotangent(image.shape) if cotangent is None else cotangent).to(image)
    started = time.perf_counter()
    gradients = torch.autograd.grad(image, list(leaves.maps.values()), cotangent)
    backward = time.perf_counter() - started
    return Measured(image.detach(), dict(zip(leaves.maps, gradients)), forward, backward)


def spread(seconds: list[float]) -> dict[str, float]:
    """``median``, ``low`` and ``high`` (quartiles) of repeated timings, and how many they were."""
    quarters = statistics.quantiles(seconds, n=4, method="inclusive") if len(seconds) > 1 else [seconds[0]] * 3
    return {"median": quarters[1], "low": quarters[0], "high": quarters[2], "repeats": len(seconds)}


def side_by_side(jobs: Mapping[str, Callable[[], object]], repeats: int = 5) -> dict[str, dict[str, float]]:
    """Time several jobs fairly: each once unmeasured, then in turn (:func:`in_turns`).

    Args:
        jobs: what to run, by name.
        repeats: measured turns.

    Returns:
        :func:`spread` of the seconds of each job.
    """
    def timed(job: Callable[[], object]) -> Callable[[], float]:
        def run() -> float:
            started = time.perf_counter()
            job()
            return time.perf_counter() - started
        return run

    return {name: spread(each) for name, each in in_turns({name: timed(job) for name, job in jobs.items()}, repeats).items()}


def in_turns(jobs: Mapping[K, Callable[[], T]], repeats: int = 5, unmeasured: int = 1,
             report: Callable[[float], object] = lambda share: None) -> dict[K, list[T]]:
    """Run all jobs in turn, again and again, so that drift of the machine hits all alike.

    Args:
        jobs: what to run, by name.
        repeats: turns that count.
        unmeasured: turns before these, which compile and warm up; 0 where the jobs have run already.
        report: told the share done after each run.

    Returns:
        What each job returned in the turns that count.
    """
    found: dict[K, list[T]] = {name: [] for name in jobs}
    for turn in range(unmeasured + repeats):
        for number, (name, job) in enumerate(jobs.items(), 1):
            found[name].append(job())
            report((turn + number / len(jobs)) / (unmeasured + repeats))
    return {name: each[unmeasured:] for name, each in found.items()}
