"""Materials made by code: for the demo, the tests and a newcomer's first fit. Nothing is downloaded.

Each material is a function of continuous patch coordinates and a random generator, so every resolution shows
the same structure. It is drawn with two or more samples along a texel's side, then area-averaged. Relief is a
height in patch sides. The first functions here are brushes; their coordinates are patch sides from the
centre. :func:`painted` converts a :class:`Paint` to maps.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Generator, Tensor

from ..errors import ConfigError
from ..io.entry import entry
from ..views import strips, texel_positions
from .maps import SVBRDF
from .resample import resized

Colour = tuple[float, float, float]
Value = Tensor | float | tuple[float, ...]

# The largest slope of the relief, 30 degrees: a flash near the lens hardly lights steeper surfaces.
STEEPEST = math.tan(math.radians(30))


def painted(paint: Paint) -> dict[str, Tensor]:
    """The maps of some rows of a painted material, clamped to the ranges in :func:`make_material`."""
    down, right = torch.gradient(paint.height, spacing=1 / paint.height.shape[1])
    slope = torch.stack((right, -down), dim=-1)
    slope = slope * (STEEPEST / slope.norm(dim=-1, keepdim=True).clamp_min(STEEPEST))
    specular = paint.specular.clamp(0.02, 0.95)
    return {
        "diffuse": torch.minimum(paint.diffuse.clamp(0, 0.95), 1 - specular), "specular": specular,
        "roughness": paint.roughness.clamp(0.08, 1),
        "normal": F.normalize(torch.cat((-slope, torch.ones_like(slope[..., :1])), dim=-1), dim=-1)}


class Paint:
    """A material painted layer over layer on a flat black ground of the size of ``x``."""

    def __init__(self, x: Tensor) -> None:
        self.height, self.roughness = torch.zeros_like(x), torch.zeros_like(x)[..., None]
        self.diffuse = self.specular = self.roughness.expand(*x.shape, 3)

    def add(self, mask: Tensor | float, diffuse: Value, specular: Value, roughness: Value,
            height: Tensor | float) -> Paint:
        """Add a layer of opacity ``mask`` (R x R); values are numbers, colours, R x R or R x R x 3."""
        mask = torch.as_tensor(mask).expand_as(self.height)
        for name, new in {"diffuse": diffuse, "specular": specular, "roughness": roughness}.items():
            new = torch.as_tensor(new)
            new = new[..., None] if new.shape == mask.shape else new
            setattr(self, name, torch.lerp(getattr(self, name), new, mask[..., None]))
        self.height = self.height + mask * (height - self.height)
        return self


def noise(x: Tensor, y: Tensor, cells: int, rng: Generator, octaves: int = 4) -> Tensor:
    """Fractal value noise at x, y (patch sides): R x R, mean near 0, mostly within [-1, 1].

    The first octave has ``cells`` random values along a patch side. Each further octave has twice as many, of
    half the strength.
    """
    grid = 2 * torch.stack((x, y), dim=-1)[None]
    values = [torch.rand(1, 1, cells << i, cells << i, generator=rng) * 2 - 1 for i in range(octaves)]
    return sum(F.grid_sample(v, grid, "bicubic", "reflection", align_corners=False)[0, 0] / 2**i
               for i, v in enumerate(values))


def cell_borders(x: Tensor, y: Tensor, n: int, rng: Generator) -> Tensor:
    """Distance, in cells, to the border in n x n Worley cells: (second - least distance to a seed) / 2."""
    seeds = torch.rand(n + 2, n + 2, 2, generator=rng)
    u, v = (x.clamp(-0.499, 0.499) + 0.5) * n, (y.clamp(-0.499, 0.499) + 0.5) * n
    i, j = u.long(), v.long()
    around = [(a, b, seeds[j + b + 1, i + a + 1]) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    distances = torch.stack([torch.hypot(i + a + s[..., 0] - u, j + b + s[..., 1] - v) for a, b, s in around])
    nearest, second = distances.topk(2, dim=0, largest=False).values
    return (second - nearest) / 2


def inside(distance: Tensor, soft: float = 0.003) -> Tensor:
    """A mask: 1 where a signed distance is negative, else 0, with an edge ``soft`` wide."""
    return (0.5 - distance / soft).clamp(0, 1)


def bevel(distance: Tensor, width: float) -> Tensor:
    """A ramp from 0 at the edge of a shape to 1 at ``width`` inside."""
    return (-distance / width).clamp(0, 1)


def mix(first: Colour, second: Colour, share: Tensor) -> Tensor:
    """A mixed colour, R x R x 3: ``first`` at share 0, ``second`` at share 1."""
    return torch.lerp(torch.tensor(first), torch.tensor(second), share.clamp(0, 1)[..., None])


def star(x: Tensor, y: Tensor, points: int, outer: float, inner: float, turn: float = 0.0) -> Tensor:
    """Distance to the edge of a star with these two radii, negative inside."""
    half = math.pi / points
    angle, r = (torch.atan2(y, x) - turn + half).remainder(2 * half) - half, torch.hypot(x, y)
    run, rise = outer - inner * math.cos(half), inner * math.sin(half)
    return ((r * torch.cos(angle) - outer) * rise + r * torch.sin(angle).abs() * run) / math.hypot(run, rise)


GOLD, COPPER, STEEL = (0.91, 0.70, 0.34), (0.84, 0.50, 0.36), (0.56, 0.55, 0.53)


@entry()
def make_material(name: str, resolution: int = 256, seed: int = 0) -> SVBRDF:
    """A made material, as ``roughconductor`` maps R x R x C, float32, linear.

    Diffuse is in [0, 0.95], specular in [0.02, 0.95], their sum at most 1, roughness in [0.08, 1]; normals
    are unit vectors with z > 0. The same arguments give the same maps; another seed gives other grain,
    scratches and shades.

    Args:
        name: a key of :data:`MATERIALS`.
        resolution: R, texels along a side, at least 2.
        seed: seed of the random numbers.

    Raises:
        ConfigError: unknown name, or a resolution below 2.
    """
    if name not in MATERIALS:
        raise ConfigError(f"a made material of {list(MATERIALS)}", repr(name), "choose one of these")
    if resolution < 2:
        raise ConfigError("a resolution of 2 or more", str(resolution), "ask for e.g. 256")
    times, made = max(2, 512 // resolution), []
    for rows in strips(resolution):  # memory stays small
        first, last = rows.start * times, rows.stop * times
        around = slice(max(0, first - 1), last + 1)  # slopes need the neighbouring rows
        x, y, _ = texel_positions(resolution * times, torch.float32, around).unbind(-1)
        fine = painted(MATERIALS[name](x, y, torch.Generator().manual_seed(seed)))
        maps = {name: resized(value[first - around.start:last - around.start], resolution,
                              rows.stop - rows.start) for name, value in fine.items()}
        made.append(maps | {"normal": F.normalize(maps["normal"], dim=-1)})
    return SVBRDF("roughconductor", {name: torch.cat([maps[name] for maps in made]) for name in made[0]})


def inlay(x: Tensor, y: Tensor, rng: Generator) -> Paint:
    """A walnut panel with a compass rose of metals on enamel, a carved frame, a glazed medallion."""
    r, ax, ay = torch.hypot(x, y), x.abs(), y.abs()
    edge, wear, cloud = torch.maximum(ax, ay), noise(x, y, 6, rng, 5), noise(x, y, 5, rng, 5)
    bend = y + 0.07 * noise(0.35 * x, 0.8 * y, 4, rng, 3) + 0.25 * (x + 0.15) ** 2
    year = (bend * 13).remainder(1) ** 2 * (0.8 + 0.4 * torch.sin(bend * 19))
    fibre, pores = noise(0.03 * x, bend, 160, rng, 2), bevel(0.7 - noise(0.12 * x, bend, 128, rng, 2), 0.3)
    grain = 0.3 + 0.5 * year + 0.3 * fibre + 0.25 * cloud + 0.4 * pores
    groove = bevel((edge - 0.455).abs() - 0.014, 0.014)
    wood = mix((0.23, 0.105, 0.045), (0.055, 0.022, 0.011), grain) * (1 - 0.5 * groove[..., None])
    paint = Paint(x).add(1.0, wood, 0.04, 0.52 + 0.12 * grain,
                         0.0002 * fibre - 0.0007 * pores - 0.007 * groove)

    def metal(distance: Tensor, colour: Colour, height: Tensor) -> None:
        paint.add(inside(distance - 0.003), (0.012, 0.009, 0.007), 0.03, 0.8, -0.001)
        paint.add(inside(distance), 0.012 + 0.01 * wear.abs(),
                  mix(colour, (0.45, 0.30, 0.17), 0.5 * wear - 0.15), 0.22 + 0.1 * wear.abs(), height)

    def wire(distance: Tensor, width: float, colour: Colour = GOLD) -> None:
        off = distance.abs() - width / 2
        metal(off, colour, 0.25 * width * bevel(off, width / 2).sqrt())

    # The frame: a brass line inside the carved groove, and fans of arcs in its corners.
    wire(edge - 0.415, 0.009)
    for radius, colour in ((0.065, COPPER), (0.1, GOLD), (0.135, COPPER)):
        wire(torch.where(edge < 0.412, torch.hypot(ax - 0.415, ay - 0.415) - radius, 1.0), 0.006, colour)

    # The rose: enamel, an hour ring of beads, and three faceted stars.
    paint.add(inside(r - 0.305), mix((0.004, 0.045, 0.06), (0.012, 0.12, 0.125), 0.45 + 0.5 * cloud), 0.045,
              0.2 + 0.04 * cloud, -0.001 + 0.0008 * cloud)
    wire(r - 0.305, 0.014)
    wire(r - 0.235, 0.007, COPPER)
    hours = torch.atan2(y, x) * 16 / math.pi
    bead = torch.hypot(r - 0.27, (hours - hours.round()) * 0.27 * math.pi / 16)
    size = torch.where(hours.round() % 4 == 0, 0.013, 0.006)
    metal(bead - size, GOLD, 0.3 * (size**2 - bead**2).clamp_min(0).sqrt())
    for rim, colour in ((star(x, y, 8, 0.165, 0.06, math.pi / 8), STEEL),
                        (star(x, y, 4, 0.2, 0.065, math.pi / 4), COPPER), (star(x, y, 4, 0.285, 0.06), GOLD)):
        metal(rim, colour, 0.001 + 0.22 * (-rim).clamp_min(0))

    # The medallion, over the frame: a domed glazed tile with a painted flower.
    mx, my = x - 0.335, y + 0.335
    m = torch.hypot(mx, my)
    petal = m - 0.058 - 0.026 * torch.cos(6 * torch.atan2(my, mx))
    lines = inside(torch.minimum((m - 0.098).abs(), petal.abs()) - 0.003, 0.004)
    wash = inside(petal + 0.014, 0.012) * (0.75 + 0.4 * cloud).clamp(0, 1)
    glaze = mix((0.75, 0.72, 0.63), (0.02, 0.06, 0.3), torch.maximum(lines, wash) * inside(0.014 - m, 0.004))
    paint.add(inside(m - 0.112), glaze, 0.045, 0.13 + 0.03 * wear.abs(),
              0.004 + 1.1 * (0.112**2 - m**2).clamp_min(0))
    wire(m - 0.117, 0.014)
    return paint


def tiles(x: Tensor, y: Tensor, rng: Generator) -> Paint:
    """Five by five glazed tiles, each tilted a little, in sandy grout."""
    u, v = (x + 0.5) * 5, (y + 0.5) * 5
    hue, tilt_x, tilt_y, pale = torch.rand(5, 5, 4, generator=rng)[v.long(), u.long()].unbind(-1)
    fu, fv = u.frac() - 0.5, v.frac() - 0.5
    edge = (torch.hypot((fu.abs() - 0.36).clamp_min(0), (fv.abs() - 0.36).clamp_min(0)) - 0.1) / 5
    sand, cloud = noise(x, y, 64, rng, 3), noise(x, y + 0.3 * hue, 6, rng, 5)
    glaze = torch.where((pale > 0.8)[..., None], mix((0.62, 0.52, 0.34), (0.75, 0.68, 0.52),
                                                     0.5 + 0.35 * cloud),
                        mix((0.012, 0.14, 0.19), (0.07, 0.36, 0.36), 0.05 + 0.9 * hue + 0.35 * cloud))
    grout = mix((0.30, 0.27, 0.23), (0.46, 0.42, 0.36), 0.5 + 0.4 * sand)
    return Paint(x).add(1.0, grout, 0.03, 0.85, 0.0008 * sand).add(
        inside(edge), glaze * (0.65 + 0.35 * bevel(edge, 0.02)[..., None]), 0.05, 0.14 + 0.08 * cloud.abs(),
        0.006 + 0.006 * bevel(edge, 0.016).sqrt() + 0.04 * ((tilt_x - 0.5) * fu + (tilt_y - 0.5) * fv)
        + 0.0004 * cloud)


def leather(x: Tensor, y: Tensor, rng: Generator) -> Paint:
    """Dark pebbled leather with a few long creases: a semi-rough dielectric."""
    border = cell_borders(x + 0.012 * noise(x, y, 8, rng, 3), y + 0.012 * noise(x, y, 8, rng, 3), 26, rng)
    pebble = 1 - (1 - (border / 0.3).clamp(0, 1)) ** 2
    age, pores = noise(x, y, 4, rng, 5), noise(x, y, 128, rng, 2)
    crease = inside(noise(0.7 * x + 0.3 * y, y - 0.4 * x, 4, rng, 3).abs() - 0.015, 0.05)
    worn = 0.5 * pebble + 0.7 * age - 0.1
    lit = 0.35 + 0.65 * pebble * (1 - 0.6 * crease)
    colour = mix((0.045, 0.016, 0.009), (0.17, 0.066, 0.030), worn) * lit[..., None]
    return Paint(x).add(1.0, colour, 0.045, 0.74 - 0.22 * worn.clamp(0, 1) - 0.12 * pebble,
                        0.0036 * pebble - 0.004 * crease + 0.00025 * pores)


def plates(x: Tensor, y: Tensor, rng: Generator) -> Paint:
    """Four riveted plates of painted steel: scratches, rust along the seams, polished spots."""
    large, fine, spots = noise(x, y, 3, rng, 6), noise(x, y, 48, rng, 3), noise(x, y, 7, rng, 2)
    qx, qy = 0.25 - (x.abs() - 0.25).abs(), 0.25 - (y.abs() - 0.25).abs()
    seam, rivet = torch.minimum(qx, qy), torch.hypot(qx - 0.035, qy - 0.035)
    height = 0.006 * bevel(0.002 - seam, 0.012) + 0.5 * (0.014**2 - rivet**2).clamp_min(0).sqrt()
    height, polished = height + 0.0003 * noise(x, y, 32, rng, 3), inside(0.8 - spots, 0.1)
    colour = mix((0.055, 0.12, 0.10), (0.10, 0.19, 0.15), 0.5 + 0.5 * large) * (1 - 0.3 * polished[..., None])
    paint = Paint(x).add(1.0, colour, 0.045, torch.lerp(0.36 + 0.06 * large, torch.tensor(0.1), polished),
                         height)
    for left, low, turn, long, wide in torch.rand(45, 5, generator=rng).tolist():
        angle, half = 0.5 + 7 * (turn - 0.5) ** 3, 0.02 + 0.15 * long**3
        along = (x - left + 0.5) * math.cos(angle) + (y - low + 0.5) * math.sin(angle)
        across = (y - low + 0.5) * math.cos(angle) - (x - left + 0.5) * math.sin(angle)
        scratch = inside(torch.hypot((along.abs() - half).clamp_min(0), across) - 0.0006 - 0.0014 * wide**2)
        paint.add(scratch, 0.03, STEEL, 0.25, height - 0.0006)
    rust = large + 0.25 * fine + 0.9 * torch.exp(-seam / 0.012) * (0.4 + large)
    paint.add(inside(0.7 - rust, 0.06), 0.04, STEEL, 0.34, height - 0.0012)
    colour = mix((0.09, 0.028, 0.010), (0.36, 0.14, 0.045), 0.5 + 0.5 * fine)
    return paint.add(inside(0.82 - rust, 0.06), colour, 0.03, 0.88, height + 0.0016 * fine)


MATERIALS: dict[str, Callable[[Tensor, Tensor, Generator], Paint]] = {
    "inlay": inlay, "tiles": tiles, "leather": leather, "plates": plates}
