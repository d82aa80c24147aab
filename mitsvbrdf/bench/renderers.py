"""Every renderer against the float64 truth, with its run time: one case is one BSDF, one size and one number
of views.

The twin ``analytic64`` takes part as the truth that costs what it costs. All renderers of a case run in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import torch
from torch import Tensor

from ..io.timing import in_turns, spread, timed
from ..material.corner_cases import as_bsdf
from ..material.made import make_material
from ..material.maps import SVBRDF, Bsdf
from ..measure.gradients import fixed_cotangent, render_and_gradients
from ..measure.metrics import gradient_error, relative_error
from ..measure.tolerances import ROUGH_FROM
from ..render import Renderer, make_renderer
from ..views import Views
from .code import own_code

RENDERED_MATERIAL = "inlay"
# patch sides between lens and flash, as fits find them; with it the Fresnel curve takes part
FLASH_BESIDE = 0.1

# Bytes a texel and view of a forward and backward pass, rounded up from what was measured at 256 and 512 px,
# nine views: 1060, 290, 30 and 90. A renderer that would need more than there is sits a case out.
BYTES_A_TEXEL = {"analytic64": 1200, "analytic": 350, "mitsuba": 100, "mitsuba-scene": 150}
TRUTH_BYTES_A_TEXEL = 40  # a texel and view of the truth, which stays beside them
# of all renderers together, a texel and view, forward and backward; only to say how long it will take
SECONDS_A_TEXEL = 2.5e-6

POINTS_A_SIDE = 4, 8  # points along a pixel's side for the truth of jittered pixels, extrapolated from both


@dataclass(frozen=True)
class RenderJob:
    """One case.

    Args:
        bsdf: which plugin.
        resolution: side of the maps in texels.
        views: how many.
        samples: of the traced scene, rays a pixel. Left out, every renderer draws texel centres and is held
            against them; else all are held against the average over each pixel.
        repeats: timed turns.
        variant: of Mitsuba.
    """

    bsdf: Bsdf
    resolution: int
    views: int
    samples: tuple[int, ...] = ()
    repeats: int = 5
    variant: str = "llvm_ad_rgb"

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "renderers", "bsdf": self.bsdf, "resolution": self.resolution, "views": self.views,
                "truth": "pixels" if self.samples else "texels"}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return {"samples": list(self.samples), "repeats": self.repeats, "code": own_code(__name__)}

    @property
    def title(self) -> str:
        """For the progress line."""
        what = ", jittered" if self.samples else ""
        return f"renderers, {self.bsdf}, {self.resolution} px, {self.views} views{what}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return "renderers"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        rays = sum(self.samples) + (sum(k * k for k in POINTS_A_SIDE) if self.samples else 1)
        return 3 + SECONDS_A_TEXEL * self.resolution**2 * self.views * (rays + self.repeats + 2)

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures: ``rows``, one for each renderer and number of samples, and ``skipped`` with the
        reason.
        """
        svbrdf, views = _material(self.bsdf, self.resolution), spread_views(self.views)
        engines, skipped = self._engines()
        image, gradients = exact(svbrdf, views, POINTS_A_SIDE if self.samples else (1,))
        rough = svbrdf["roughness"][..., 0] >= ROUGH_FROM
        errors = {}
        for number, (key, engine) in enumerate(engines.items()):
            got = render_and_gradients(engine, svbrdf, views)
            errors[key] = {"image": _image_error(got.image, image, rough), "gradient": max(
                gradient_error(got.gradients[name][rough], g[rough])["relative_l2"]
                for name, g in gradients.items())}
            del got
            report(0.4 * (number + 1) / len(engines))
        del image, gradients
        turns = in_turns({key: partial(_seconds, engine, svbrdf, views) for key, engine in engines.items()},
                         self.repeats, report=lambda share: report(0.4 + 0.6 * share))
        rows = []
        for name, samples in engines:
            forward, both = (spread(list(seconds)) for seconds in zip(*turns[name, samples]))
            rows.append({"renderer": name, "samples": samples, **errors[name, samples], "forward": forward,
                         "both": both})
        return {"rows": rows, "skipped": skipped}

    def _engines(self) -> tuple[Mapping[tuple[str, int], Renderer], list[dict[str, str]]]:
        engines: dict[tuple[str, int], Renderer] = {}
        skipped, available = [], memory_available()
        for name, size in BYTES_A_TEXEL.items():
            needed = (size + TRUTH_BYTES_A_TEXEL) * self.resolution**2 * self.views
            if available is not None and needed > available:
                skipped.append({"renderer": name, "why": f"needs about {needed / 2**30:.0f} GiB of memory"})
            else:
                engines[name, 1] = make_renderer(name, self.variant)  # type: ignore[arg-type]
        for samples in self.samples[1:] if self.samples[:1] == (1,) else self.samples:
            from ..render.scene import SceneRenderer
            engines["mitsuba-scene", samples] = SceneRenderer(self.variant, samples=samples)
        return engines, skipped


def render_jobs(sizes: tuple[int, ...], views: tuple[int, ...], samples: tuple[int, ...], repeats: int,
                variant: str = "llvm_ad_rgb") -> list[RenderJob]:
    """Both BSDFs over all sizes with nine views, over all numbers of views at 256 px (or the largest size
    below), jittered.

    Args:
        sizes: sides of the maps in texels.
        views: how many.
        samples: rays a pixel of the jittered case, whose maps have the smallest size.
        repeats: timed turns.
        variant: of Mitsuba.
    """
    middle = max((size for size in sizes if size <= 256), default=min(sizes))
    cases = ([(size, 9) for size in sizes]
             + [(middle, count) for count in views if (middle, count) != (middle, 9)])
    bsdfs: tuple[Bsdf, ...] = "roughconductor", "principled"
    return [RenderJob(bsdf, *case, repeats=repeats, variant=variant) for case in cases for bsdf in bsdfs] + [
        RenderJob(bsdf, min(sizes), 9, samples, repeats, variant) for bsdf in bsdfs if samples]


def spread_views(count: int) -> Views:
    """Views two patch sides away on a sunflower's spiral, the flash :data:`FLASH_BESIDE` beside the lens."""
    camera = torch.tensor([[0.6 * math.sqrt((k + 0.5) / count) * math.cos(2.39996 * k),
                            0.6 * math.sqrt((k + 0.5) / count) * math.sin(2.39996 * k), 2.0]
                           for k in range(count)],
                          dtype=torch.float64)
    return Views.of(camera, camera + torch.tensor([FLASH_BESIDE, 0.0, 0.0], dtype=torch.float64), math.pi * 4)


def exact(svbrdf: SVBRDF, views: Views, finer: tuple[int, ...]) -> tuple[Tensor, dict[str, Tensor]]:
    """The float64 truth, view by view to save memory: the image, and the gradients of its product with fixed
    numbers.

    Args:
        svbrdf: the material, R x R x C.
        views: N views.
        finer: (1,) for texel centres; (k, 2 k) for the average over each pixel, of k x k and 2 k x 2 k
            points, whose second-order errors cancel in (4 fine - coarse) / 3 (Richardson). Measured at 32 px,
            roughness 0.1 and more, with 4 and 8 against 48 x 48 points: 3e-7.

    Returns:
        N x R x R x 3, and by map name R x R x C.
    """
    twin, leaves = make_renderer("analytic64"), svbrdf.to(torch.float64).map(
        lambda t: t.detach().clone().requires_grad_())
    images: list[Tensor] = []
    gradients = {name: torch.zeros_like(value) for name, value in leaves.maps.items()}
    cotangent = fixed_cotangent(torch.Size((len(views), svbrdf.resolution, svbrdf.resolution, 3)))
    weights = (1.0,) if len(finer) == 1 else (-1 / 3, 4 / 3)
    for k in range(len(views)):
        for number, (points, weight) in enumerate(zip(finer, weights)):
            image = weight * _averaged(twin, leaves, views.pick([k]), points)
            found = torch.autograd.grad(image, list(leaves.maps.values()), cotangent[k:k + 1].to(image))
            for name, value in zip(leaves.maps, found):
                gradients[name] += value
            images.append(image.detach() if number == 0 else images.pop() + image.detach())
    return torch.cat(images), gradients


def _averaged(renderer: Renderer, svbrdf: SVBRDF, views: Views, points: int) -> Tensor:
    size = svbrdf.resolution
    fine = (svbrdf.map(lambda t: t.repeat_interleave(points, 0).repeat_interleave(points, 1)) if points > 1
            else svbrdf)
    return renderer.render(fine, views).reshape(len(views), size, points, size, points, 3).mean(dim=(2, 4))


def _image_error(image: Tensor, truth: Tensor, rough: Tensor) -> float:
    """Mean size of the relative error over rough texels, one view after the other to save memory."""
    return sum(float(relative_error(a, b)[rough].abs().mean()) for a, b in zip(image, truth)) / len(truth)


def _seconds(renderer: Renderer, svbrdf: SVBRDF, views: Views) -> tuple[float, float]:
    """Seconds of a picture without gradients, and of one with them, forward and backward."""
    with torch.no_grad():
        _, alone = timed(renderer.render, svbrdf, views)
    passes = render_and_gradients(renderer, svbrdf, views)
    return alone, passes.forward + passes.backward


@lru_cache(maxsize=1)
def _made(resolution: int) -> SVBRDF:
    return make_material(RENDERED_MATERIAL, resolution)


def _material(bsdf: Bsdf, resolution: int) -> SVBRDF:
    return as_bsdf(_made(resolution), bsdf)


def memory_available() -> int | None:
    """Bytes that can be had without swapping; None where the system does not say."""
    try:
        lines = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        return 1024 * int(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None
