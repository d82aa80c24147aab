"""Training of the learned start: random materials made by code, photographed by code, and the maps that are known then."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Generator, Tensor

from .. import color
from ..capture import Capture, guess_diffuse, photograph
from ..maps import SVBRDF
from ..procedural import Paint, bevel, cell_borders, inside, noise, painted
from ..render.analytic import AnalyticRenderer
from ..views import Views, texel_positions
from .learned_start import DIRECTIONS, evidence, new_generator, save_start
from .method import cosine
from .networks import AllPhotosGenerator, seeded
from .parameters import STREAMS, to_raw, to_svbrdf
from .start import robust_start

SIDE = 64  # texels along a side of a material to train on
BATCH = 4
STEPS_PER_EXAMPLE = 16  # steps on the examples so far between two new ones, each of which costs as much as ten of them
POOL = 512  # examples kept
PHOTOMETRIC = 0.1  # weight of the re-rendering error beside the errors of the maps
LEARNING_RATE = 1e-3
LONGEST = 0.5  # norm that a gradient is cut to: one smooth texel too bright by a thousand must not undo what was learned
CHANNELS = {name: c for stream in STREAMS["roughconductor"] for name, c in stream.items()}


@dataclass(frozen=True)
class Example:
    """One material to learn from; pictures are C x R x R.

    Args:
        evidence: of its photos.
        start: raw maps of the robust start, in the order of :data:`CHANNELS`.
        truth: diffuse, specular, roughness, normal: 10 channels, linear.
        photos: N x R x R x 3 display values.
        views: as the photos were really lit.
    """

    evidence: Tensor
    start: Tensor
    truth: Tensor
    photos: Tensor
    views: Views

    def turned(self, mirror: bool, swap: bool) -> Example:
        """The same patch mirrored left to right, then along its diagonal from top left: all eight ways by repetition."""
        def turn(picture: Tensor, directions: tuple[int, ...]) -> Tensor:
            picture = picture.clone()
            for x in directions:
                picture[x:x + 2] = _turned_vector(picture[x], picture[x + 1], mirror, swap)
            picture = picture.flip(-1) if mirror else picture
            return picture.mT.contiguous() if swap else picture

        photos = self.photos.flip(2) if mirror else self.photos
        camera, light = (torch.cat((_turned_vector(*p[:, :2].T, mirror, swap).T, p[:, 2:]), dim=1)
                         for p in (self.views.camera, self.views.light))
        return Example(turn(self.evidence, DIRECTIONS), turn(self.start, (0,)), turn(self.truth, (7,)),
                       photos.transpose(1, 2).contiguous() if swap else photos,
                       replace(self.views, camera=camera, light=light))


def _turned_vector(x: Tensor, y: Tensor, mirror: bool, swap: bool) -> Tensor:
    x = -x if mirror else x
    return torch.stack((-y, -x) if swap else (x, y))


def random_material(seed: int, resolution: int = SIDE) -> SVBRDF:
    """A made material by a random recipe: one to four substances in random patterns, with relief and wear.

    The same arguments give the same maps. Ranges as those of :func:`mitsvbrdf.procedural.make_material`.
    """
    rng = Generator().manual_seed(seed)
    x, y, _ = texel_positions(2 * resolution, torch.float32).unbind(-1)
    turn = _uniform(rng, 0, 2 * math.pi)
    u, v = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)
    u, v = u + 0.02 * noise(x, y, 3, rng, 2), v + 0.02 * noise(x, y, 3, rng, 2)
    paint, steep = Paint(x), 0.35 * _uniform(rng, 0, 1) ** 1.5
    for layer in range(1 + int(_uniform(rng, 0, 4))):
        cells = 2 + int(14 * _uniform(rng, 0, 1) ** 1.5)
        pattern = PATTERNS[int(_uniform(rng, 0, len(PATTERNS)))]
        mask, profile = pattern(u.clamp(-0.5, 0.5), v.clamp(-0.5, 0.5), cells, rng)
        height = steep * _uniform(rng, -0.5, 1) / cells * profile
        grain = int(_uniform(rng, 16, 64))
        height = height + 0.2 * steep * _uniform(rng, 0, 1) ** 2 / grain * noise(x, y, grain, rng, 2)
        paint.add(1.0 if layer == 0 else mask, *_substance(x, y, mask, rng), height)
    return painted(paint).resized(resolution)


def _uniform(rng: Generator, low: float, high: float) -> float:
    return low + (high - low) * float(torch.rand((), generator=rng))


def _substance(x: Tensor, y: Tensor, mask: Tensor, rng: Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Diffuse and specular R x R x 3 and roughness R x R of a metal or, more often, a dielectric."""
    wear = 0.5 * noise(x, y, 2 + int(_uniform(rng, 0, 8)), rng, 5) + _uniform(rng, -0.5, 0.5) * mask
    tint = 1 - _uniform(rng, 0, 0.9) * torch.rand(3, generator=rng)
    kind, level = _uniform(rng, 0, 1), math.exp(_uniform(rng, math.log(0.02), math.log(0.9)))
    if kind < 0.2:
        diffuse, specular = _uniform(rng, 0, 0.1) * tint, _uniform(rng, 0.25, 0.9) * tint.sqrt()
    else:
        specular = torch.full((3,), _uniform(rng, 0.02, 0.08) if kind < 0.75 else _uniform(rng, 0.05, 0.35))
        diffuse = level * tint
    other = diffuse * (1 - _uniform(rng, 0, 1) * torch.rand(3, generator=rng))
    diffuse = torch.lerp(diffuse, other, (0.5 + wear).clamp(0, 1)[..., None])
    specular = specular * (1 + _uniform(rng, -0.6, 0.3) * wear[..., None])
    return diffuse, specular, (_uniform(rng, 0.12, 0.85) + _uniform(rng, -0.4, 0.4) * wear).clamp(0.1, 0.95)


def _clouds(x: Tensor, y: Tensor, cells: int, rng: Generator) -> tuple[Tensor, Tensor]:
    field = noise(x, y, cells, rng, 3)
    return inside(_uniform(rng, -0.3, 0.5) - field, _uniform(rng, 0.02, 0.5)), field


def _pebbles(x: Tensor, y: Tensor, cells: int, rng: Generator) -> tuple[Tensor, Tensor]:
    border = cell_borders(x, y, cells, rng)
    gap = _uniform(rng, 0, 0.15)
    return inside(gap - border, 0.05), bevel(gap - border, 0.3)


def _tiles(x: Tensor, y: Tensor, cells: int, rng: Generator) -> tuple[Tensor, Tensor]:
    u, v = (x + 0.5) * cells, (y + 0.5) * cells * _uniform(rng, 0.4, 1)
    u = u + 0.5 * (v.floor() % 2) * float(_uniform(rng, 0, 1) < 0.5)
    edge = _uniform(rng, 0.38, 0.48) - torch.maximum((u.frac() - 0.5).abs(), (v.frac() - 0.5).abs())
    values = torch.rand(2 * cells + 4, cells + 4, generator=rng)[u.long() % (2 * cells + 4), v.long() % (cells + 4)]
    return inside(-edge, 0.04) * (1 - _uniform(rng, 0, 1) * values), bevel(-edge, _uniform(rng, 0.03, 0.4))


def _stripes(x: Tensor, y: Tensor, cells: int, rng: Generator) -> tuple[Tensor, Tensor]:
    wave = torch.sin(2 * math.pi * cells * (x + _uniform(rng, 0, 0.2) * noise(x, 0.3 * y, 3, rng, 2)))
    return inside(_uniform(rng, -0.7, 0.7) - wave, _uniform(rng, 0.05, 1.5)), wave / 2


def _dots(x: Tensor, y: Tensor, cells: int, rng: Generator) -> tuple[Tensor, Tensor]:
    u, v = ((x + 0.5) * cells).frac() - 0.5, ((y + 0.5) * cells).frac() - 0.5
    away = torch.hypot(u, v) - _uniform(rng, 0.15, 0.45)
    return inside(away, 0.05), bevel(away, 0.2)


PATTERNS = (_clouds, _clouds, _pebbles, _tiles, _stripes, _dots)


def random_views(rng: Generator) -> tuple[Views, Views]:
    """Six to twelve photos by hand, the flash beside the lens: as a calibration states them, and as they really were."""
    count = int(_uniform(rng, 6, 13))
    camera = torch.cat((torch.rand(count, 2, generator=rng) - 0.5,
                        1 + 0.1 * (torch.rand(count, 1, generator=rng) - 0.5)), dim=1).double()
    camera[0, :2] *= 0.3
    height = _uniform(rng, 1.5, 3.2)
    camera = camera * torch.tensor([_uniform(rng, 0.7, 1.3)] * 2 + [height])
    flash = F.pad(0.04 * torch.randn(1, 2, generator=rng), (0, 1))
    stated = Views.of(camera, camera, _uniform(rng, 0.9, 1.9) * math.pi * height**2)
    return stated, replace(stated, light=camera + flash)


def make_example(seed: int, resolution: int = SIDE) -> Example:
    """Everything that training needs of one random material; the same seed gives the same."""
    rng = Generator().manual_seed(seed)
    truth = random_material(seed, resolution)
    stated, true = random_views(rng)
    shots = photograph(truth, true, AnalyticRenderer(), noise=_uniform(rng, 0, 0.01), seed=seed)
    shots = Capture(shots.photos, stated, shots.transfer)
    guess = guess_diffuse(shots)
    start = robust_start(shots, guess, "roughconductor")
    raw = to_raw(start)
    maps = torch.cat([truth[name] for name in ("diffuse", "specular", "roughness", "normal")], dim=-1)
    return Example(evidence(shots, guess, start), torch.cat([raw[name] for name in CHANNELS]), maps.permute(2, 0, 1),
                   shots.photos, true)


def map_error(svbrdf: SVBRDF, truth: Tensor) -> Tensor:
    """Sum over the four maps of the mean absolute error, encoded as :func:`mitsvbrdf.metrics.map_rmse` counts them."""
    def encoded(diffuse: Tensor, specular: Tensor, roughness: Tensor, normal: Tensor) -> list[Tensor]:
        return [color.encode(diffuse), color.encode(specular), roughness, (normal + 1) / 2]

    found = encoded(*(svbrdf[name] for name in ("diffuse", "specular", "roughness", "normal")))
    known = encoded(*truth.permute(1, 2, 0).split([3, 3, 1, 3], dim=-1))
    return torch.stack([F.l1_loss(a, b) for a, b in zip(found, known)]).sum()


def loss_of(generator: AllPhotosGenerator, examples: list[Example]) -> tuple[Tensor, Tensor]:
    """Mean error of the maps, and the mean absolute re-rendering error of the first example, in display values."""
    changes = generator.changes(torch.stack([e.evidence for e in examples]))
    found = []
    for i, example in enumerate(examples):
        start = dict(zip(CHANNELS, example.start.split(list(CHANNELS.values()))))
        found.append(to_svbrdf("roughconductor", {name: raw + changes[name][i] for name, raw in start.items()}))
    first = examples[0]
    rendered = AnalyticRenderer().render(found[0], first.views)
    return (torch.stack([map_error(m, e.truth) for m, e in zip(found, examples)]).mean(),
            F.l1_loss(color.to_display(rendered), first.photos))


def pretrain_start(out: Path, *, budget: float | None = 600.0, steps: int | None = None, seed: int = 0, width: int = 16,
                   resolution: int = SIDE, steps_per_example: int = STEPS_PER_EXAMPLE,
                   report: Callable[[str, float], None] | None = None) -> AllPhotosGenerator:
    """Train the learned start on materials made on the way, and write its weights. Ctrl-C ends the training early.

    Args:
        out: the file (.safetensors) to write.
        budget: seconds, or None.
        steps: steps, or None; with ``budget``, whichever comes first.
        seed: of materials, photos and weights; with ``steps`` alone the result depends on nothing else.
        width: channels of the generator's finest level.
        resolution: texels along a side of a material.
        steps_per_example: steps between two new materials.
        report: told (text, share done) now and then.
    """
    rng = Generator().manual_seed(seed)
    with seeded(seed):
        generator = new_generator(width).to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(generator.parameters(), lr=LEARNING_RATE)
    pool: list[Example] = []
    started, step, made, error = time.perf_counter(), 0, 0, math.nan
    try:
        while True:
            done = max((time.perf_counter() - started) / budget if budget else 0.0, step / steps if steps else 0.0)
            if done >= 1:
                break
            if step >= steps_per_example * (made - BATCH):
                pool = [*pool[-POOL + 1:], make_example((seed << 32) + made, resolution)]
                made += 1
            else:
                picked = torch.randint(len(pool), (BATCH,), generator=rng).tolist()
                turns = torch.randint(2, (BATCH, 3), generator=rng).bool().tolist()
                batch = [pool[i].turned(a, b).turned(c, False) for i, (a, b, c) in zip(picked, turns)]
                optimizer.param_groups[0]["lr"] = LEARNING_RATE * cosine(done)
                maps, photometric = loss_of(generator, batch)
                optimizer.zero_grad(set_to_none=True)
                (maps + PHOTOMETRIC * photometric).backward()
                if torch.nn.utils.clip_grad_norm_(generator.parameters(), LONGEST).isfinite():
                    optimizer.step()
                step, now = step + 1, float(maps.detach())
                error = now if math.isnan(error) else 0.98 * error + 0.02 * now
            if report:
                report(f"{made} materials, {step} steps, error of the maps {error:.4f}", done)
    except KeyboardInterrupt:
        if not step:
            raise
    save_start(out, generator, width, materials=made, steps=step, seed=seed)
    return generator
