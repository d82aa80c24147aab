"""What the shading of photos says, once their poses are known: where the flash is, how bright, vignetting and exposures.

A diffuse point of albedo rho, seen through a lens of transmission T, sends to the photo the radiance

    L = rho / pi * I * exp(e) * cos / d^2 * T(pixel)

with I the flash's radiant intensity, e the logarithm of the photo's exposure, d the distance to the flash and cos that of the
angle between it and the upright. The logarithm is linear in all unknowns but the flash's place and vignetting. White paper
has one known albedo everywhere; a material has one of its own in each texel, the same in all photos, and beside it one GGX
lobe that all texels share. Albedo is eliminated (variable projection, Golub and Pereyra 1973): what is compared are photos
with each other. Errors above are highlights more often than not: weights fall fast there, slowly below (iteratively
reweighted least squares). Paper has no lobe; what is near its mirror direction counts little.

Residuals of neighbouring points err alike, so the noise, and how many points count as one, are measured on the residuals, as
in :mod:`mitsvbrdf.fit.calibration`. Where a material is hardly diffuse at all, both are large, and the priors remain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from .. import color
from ..errors import CaptureError
from ..views import texel_positions
from .guess import CLIPPED
from .lens import Array, Lens, Pose, on_plane, project
from .photo import Photo
from .rig import Rig

PAPER = 0.8  # albedo of white office paper; 0.75 to 0.9, ISO 2470 brightness without optical brighteners
MOST_ALBEDO = 0.8
# What materials are like, where nothing else tells the light's power: value and sd of its natural logarithm.
ALBEDO = 0.12, 1.2  # in the middle; of ten known materials 0.001 to 0.22
REFLECTANCE = 0.03, 0.6  # F0 of the lobe; dielectrics have 0.04, but one lobe for all texels finds less: 0.005 to 0.06

# Priors, standard deviations. A phone's flash is 1 to 3 cm beside its lens, in the same plane.
FLASH_SD = {"cm": (2.0, 2.0, 0.3), "patch sides": (0.1, 0.1, 0.02)}
VIGNETTING_SD = 0.3, 0.3
EXPOSURE_SD = 0.05  # natural logarithm; a locked exposure repeats itself to some per cent
FAINTEST_CORNER = 0.2  # of the transmission

LONG_SIDE, BLOCKS_ALONG = 1024, 96  # pixels of a photo that are read, and blocks along it that are paper samples
LOBE = (math.log(0.3), 1.0), (math.log(0.16), 1.5)  # natural logarithms of alpha, and of F0 over the median albedo; and sd
SIDE = 32  # texels a side of a material that are compared
DARK = 0.03  # display values below are noise
DIM = 0.1  # display value at which noise in the logarithm is as large as the model's error
MIRROR = math.radians(10), math.radians(20)  # from the mirror direction: nothing counts up to here, everything from there on
LEAST_WEIGHT = 0.05  # of what lies there, so that texels with no other photo are not lost
LEAST_NOISE = 0.002  # of log radiance
BELOW, ABOVE = 2.0, 3.0  # standard deviations from where residuals count less
MISFIT = 4.0  # times: how far beyond what noise explains unknowns of known materials, which share no one lobe, were off
CELLS = 8  # a side; residuals within a cell of a photo may err alike
DARKEST = -7.0  # natural logarithm of albedo over the median: nothing tells it from 0
ALBEDO_STEPS = 6  # of Gauss-Newton, where there is a lobe
ROUNDS = 10  # of reweighting
EVEN = 0.5  # evenness from which a photo takes no part
SURE = 0.2  # standard deviation up to which evenness counts as measured


@dataclass(frozen=True)
class Shading:
    """What shading says of a rig, and how sure that is.

    Args:
        lens: the rig's, with ``flash`` and ``vignetting``.
        intensity: radiant intensity of the flash (rgb), of a photo of ``log_exposure`` 0; display value 1 is radiance 1.
        log_exposure: natural logarithm of the relative exposure, by name of the photo.
        deviations: standard deviations of ``flash_x``, ``flash_y``, ``flash_z`` (the rig's unit), ``v1``, ``v2`` and
            ``log_intensity``.
        exposure_deviations: those of ``log_exposure``.
        residuals: RMS of log radiance, by name, each point by its weight; 0 where nothing can be compared.
        evenness: by name, 0 where light falls off as a flash's, 1 where it is even; 0 too where that cannot be told.
        notes: what was assumed and left out.
    """

    lens: Lens
    intensity: tuple[float, float, float]
    log_exposure: dict[str, float]
    deviations: dict[str, float]
    exposure_deviations: dict[str, float]
    residuals: dict[str, float]
    evenness: dict[str, float]
    notes: tuple[str, ...] = ()


def shading_of_paper(rig: Rig, photos: Mapping[str, Photo | np.ndarray], transfer: color.Transfer,
                     white: Callable[[Array], np.ndarray], depth: float = 0.0, albedo: float = PAPER) -> Shading:
    """Flash, its power and colour, vignetting and exposures from white paper around the material.

    Args:
        rig: lens and poses; photos without a pose do not count.
        photos: by name; pixels H x W x 3 as stored (integers, or float in [0, 1]), the lens's size or a whole part of it.
        transfer: of the photos.
        white: for points of the world (K x 2) whether bare paper is there, K bools.
        depth: z of the paper.
        albedo: of the paper, the same in all colours: what deviates is the flash's colour.

    Raises:
        CaptureError: no photo shows white paper that is neither clipped nor dark.
    """
    seen = {}
    for name, pose in rig.poses.items():
        if name in photos:
            photo = photos[name]
            pixels = photo.pixels(LONG_SIDE) if isinstance(photo, Photo) else photo
            seen[name] = _paper(pixels, rig.lens, pose, white, depth, transfer)
    found = _solve(rig, _Samples.of(rig, seen, "white paper", glossy=False))
    intensity = np.exp(found.level + found.colour) * math.pi / albedo
    return found.shading(intensity, found.level_sd, (f"paper is taken to be white with an albedo of {albedo:g}",))


def shading_of_material(rig: Rig, photos: Mapping[str, np.ndarray], transfer: color.Transfer) -> Shading:
    """Flash, vignetting and exposures from the material itself, which looks alike from everywhere but for highlights.

    Albedo alone does not tell the light's power, but most materials are dielectrics: the power is what makes the lobe's F0
    and the median albedo most probable together (:data:`REFLECTANCE`, :data:`ALBEDO`), with no more than one texel in a
    hundred whiter than paper. A metal is taken for a dielectric under a brighter flash. The flash is taken to be white.

    Args:
        rig: lens and poses; photos without a pose do not count.
        photos: by name; rectified to the patch, R x R x 3 display values in [0, 1] with their vignetting, NaN where a
            photo does not reach.
        transfer: of the photos.

    Raises:
        CaptureError: no photo that is neither clipped nor dark.
    """
    seen = {name: _material(photos[name], rig.lens, pose, rig.size, transfer)
            for name, pose in rig.poses.items() if name in photos}
    found = _solve(rig, _Samples.of(rig, seen, "the material", glossy=True))
    middle, most = math.pi * np.exp(np.nanpercentile(found.albedo, (50, 99)))  # of albedo, for an intensity of 1
    by_albedo, by_lobe = 1 / ALBEDO[1] ** 2, 1 / (REFLECTANCE[1] ** 2 + found.deviations[-1] ** 2)
    power = (by_albedo * math.log(middle / ALBEDO[0]) + by_lobe * math.log(math.pi * found.lobe / REFLECTANCE[0]))
    intensity = max(math.exp(power / (by_albedo + by_lobe)), most / MOST_ALBEDO)
    notes = ("how bright the flash is cannot be told from these photos; it is taken to be such that highlights reflect "
             f"{math.pi * found.lobe / intensity:.1%} of it and the median albedo is {middle / intensity:.2f}",)
    return found.shading(np.full(3, intensity), 1 / math.sqrt(by_albedo + by_lobe), notes)


def undo_vignetting(linear: np.ndarray, lens: Lens, pose: Pose, size: float, transfer: color.Transfer = "srgb") -> np.ndarray:
    """A rectified photo (R x R x 3, linear) as a lens without vignetting would have seen it; what is clipped stays so.

    Args:
        linear: radiance; NaN stays.
        size: side of the patch.
        transfer: of the photo it was: tells what counts as clipped.
    """
    points = texel_positions(linear.shape[0]).numpy().reshape(-1, 3) * size
    passed = _transmission(_radius2(lens, project(lens, pose, points)), np.array(lens.vignetting))
    out = linear / passed.reshape(*linear.shape[:2], 1)
    clipped = linear >= float(color.decode(torch.tensor(CLIPPED, dtype=torch.float64), transfer))
    return np.where(clipped, np.maximum(out, linear), out).astype(linear.dtype)


@dataclass(frozen=True)
class _Seen:
    """Points of one photo: place in the world (K x 3), pixel (K x 2), linear radiance and display value (K x 3)."""

    points: Array
    pixels: Array
    linear: Array
    display: Array
    usable: np.ndarray
    texels: np.ndarray
    cells: np.ndarray


def _paper(pixels: np.ndarray, lens: Lens, pose: Pose, white: Callable[[Array], np.ndarray], depth: float,
           transfer: color.Transfer) -> _Seen:
    """Blocks of a photo that show nothing but white paper."""
    height, width = pixels.shape[:2]
    step = max(1, max(height, width) // BLOCKS_ALONG)
    rows, columns = height // step, width // step
    whole = float(np.iinfo(pixels.dtype).max) if np.issubdtype(pixels.dtype, np.integer) else 1.0
    blocks = pixels[:rows * step, :columns * step].reshape(rows, step, columns, step, 3)
    display, darkest, brightest = (f(blocks, axis=(1, 3)).reshape(-1, 3).astype(np.float64) / whole
                                   for f in (np.mean, np.min, np.max))
    row, column = (index.ravel() for index in np.mgrid[:rows, :columns])
    scale = 1 / max(1, round(lens.size[0] / width))
    here, usable = [], np.ones(len(row), dtype=bool)
    for down, right in ((0.5, 0.5), (0, 0), (0, 1), (1, 0), (1, 1)):
        at = np.stack(((column + right) * step, (row + down) * step), axis=1) / scale - 0.5
        points = on_plane(lens, pose, at, depth)
        there = np.concatenate((points, np.full_like(points[:, :1], depth)), axis=1)
        usable &= np.isfinite(project(lens, pose, there)[:, 0]) & np.asarray(white(points), dtype=bool)
        here.append((there, at))
    usable &= (brightest < CLIPPED).all(axis=1) & ((brightest - darkest).max(axis=1) < 0.25)
    cells = row * CELLS // rows * CELLS + column * CELLS // columns
    return _Seen(*here[0], _decoded(display, transfer), display, usable, np.zeros(len(row), dtype=int), cells)


def _material(photo: np.ndarray, lens: Lens, pose: Pose, size: float, transfer: color.Transfer) -> _Seen:
    """Texels of a rectified photo, averaged to SIDE x SIDE at most."""
    side = min(SIDE, photo.shape[0])
    step = photo.shape[0] // side
    blocks = np.asarray(photo, dtype=np.float64)[:side * step, :side * step].reshape(side, step, side, step, 3)
    display, brightest = blocks.mean(axis=(1, 3)).reshape(-1, 3), blocks.max(axis=(1, 3)).reshape(-1, 3)
    points = texel_positions(photo.shape[0]).numpy()[:side * step, :side * step]
    points = points.reshape(side, step, side, step, 3).mean(axis=(1, 3)).reshape(-1, 3) * size
    row, column = (index.ravel() for index in np.mgrid[:side, :side])
    usable = (brightest < CLIPPED).all(axis=1)  # NaN is no number below
    cells = row * CELLS // side * CELLS + column * CELLS // side
    return _Seen(points, project(lens, pose, points), _decoded(display, transfer), display, usable, row * side + column, cells)


def _decoded(display: Array, transfer: color.Transfer) -> Array:
    return color.decode(torch.from_numpy(display), transfer).numpy()


@dataclass(frozen=True)
class _Samples:
    """Usable points of all photos, one after the other: K values each, or K x 3.

    Args:
        names: of the photos; ``photo`` is the number of each point's.
        log: natural logarithm of the mean of its channels; ``colour`` those of the channels over it.
        weight: 1 / (1 + noise of the logarithm / error of the model)^2.
        texel: points of one texel have one albedo.
        cell: points of one cell may err alike.
        glossy: whether there may be a lobe.
    """

    names: list[str]
    photo: np.ndarray
    points: Array
    radius2: Array
    log: Array
    colour: Array
    weight: Array
    texel: np.ndarray
    cell: np.ndarray
    glossy: bool

    @classmethod
    def of(cls, rig: Rig, seen: Mapping[str, _Seen], what: str, glossy: bool) -> _Samples:
        kept = {name: s.usable & (s.display.mean(axis=1) > DARK) & np.isfinite(s.pixels).all(axis=1)
                for name, s in seen.items()}
        if not any(k.any() for k in kept.values()):
            clipped = [name for name, s in seen.items() if np.nanmax(s.display, initial=0.0) >= CLIPPED]
            raise CaptureError(f"photos that show {what} neither clipped nor dark", f"none of {len(seen)}"
                               + (f" ({len(clipped)} clipped)" if clipped else ""),
                               "take them again with another exposure, or check depth and size of the sheet")

        def joined(get: Callable[[_Seen], np.ndarray]) -> np.ndarray:
            return np.concatenate([get(s)[kept[name]] for name, s in seen.items()])

        linear, display = joined(lambda s: s.linear), joined(lambda s: s.display).mean(axis=1)
        log = np.log(linear.mean(axis=1))
        counts = [int(k.sum()) for k in kept.values()]
        photo = np.repeat(np.arange(len(seen)), counts)
        return cls(list(seen), photo, joined(lambda s: s.points), _radius2(rig.lens, joined(lambda s: s.pixels)), log,
                   np.log(linear.clip(1e-6)) - log[:, None], 1 / (1 + (DIM / display) ** 2), joined(lambda s: s.texels),
                   photo * CELLS**2 + joined(lambda s: s.cells), glossy)


@dataclass(frozen=True)
class _Found:
    """The unknowns at the optimum, and what follows."""

    rig: Rig
    samples: _Samples
    unknowns: Array  # flash x, y, z, v1, v2, exposures, lobe's alpha and level
    deviations: Array
    typical: float  # logarithm of albedo over pi, for an intensity of 1, before anything is known
    level: float  # that of paper
    level_sd: float
    colour: Array
    albedo: Array  # logarithm, over pi, of each texel, for an intensity of 1; NaN where nothing is known
    error: Array  # of each point, in log radiance
    weights: Array
    evenness: dict[str, float]
    left_out: tuple[str, ...]

    @property
    def lens(self) -> Lens:
        flash, vignetting = map(float, self.unknowns[:3]), map(float, self.unknowns[3:5])
        return replace(self.rig.lens, flash=tuple(flash), vignetting=tuple(vignetting))

    @property
    def lobe(self) -> float:
        """F0 over pi of the lobe, for an intensity of 1."""
        return math.exp(self.typical + LOBE[1][0] + self.unknowns[-1])

    def shading(self, intensity: Array, log_intensity_sd: float, notes: tuple[str, ...]) -> Shading:
        names, photo = self.samples.names, self.samples.photo
        known = ("flash_x", "flash_y", "flash_z", "v1", "v2")
        squares, total = (np.bincount(photo, w, len(names)) for w in (self.weights * self.error**2, self.weights))
        if self.left_out:
            notes += (f"no flash in {', '.join(self.left_out)}: light is even there",)
        elif even := sum(e > EVEN for e in self.evenness.values()):
            notes += (f"light does not fall off as a flash's in {even} of {len(names)} photos: where it comes from is a guess",)
        return Shading(
            self.lens, tuple(float(i) for i in intensity), dict(zip(names, map(float, self.unknowns[5:-2]))),
            dict(zip(known, map(float, self.deviations))) | {"log_intensity": float(log_intensity_sd)},
            dict(zip(names, map(float, self.deviations[5:-2]))),
            dict(zip(names, map(float, np.sqrt(squares / total.clip(1e-12))))), self.evenness, notes)


def _radius2(lens: Lens, pixels: Array) -> Array:
    return replace(lens, vignetting=(1.0, 0.0)).transmission(pixels) - 1


def _transmission(radius2: Array, vignetting: Array) -> Array:
    return (1 + vignetting[0] * radius2 + vignetting[1] * radius2**2).clip(FAINTEST_CORNER)


def _falloff(flash: Array, points: Array) -> Array:
    """Logarithm of cos / d^2 at points (K x 3) of the upright."""
    to_flash = flash - points
    return np.log(to_flash[:, 2].clip(1e-9)) - 1.5 * np.log(np.square(to_flash).sum(axis=1))


class _Problem:
    """The residuals of a rig's samples in unknowns over their prior's deviations."""

    def __init__(self, rig: Rig, samples: _Samples) -> None:
        self.samples = samples
        poses = [rig.poses[name] for name in samples.names]
        self.cameras, self.turns = np.stack([p.position for p in poses]), np.stack([p.rotation.T for p in poses])
        self.spread = np.array([*FLASH_SD[rig.unit], *VIGNETTING_SD, *[EXPOSURE_SD] * len(poses), *(sd for _, sd in LOBE)])
        apparent = samples.log - self.model(np.zeros(len(self.spread)))
        self.typical, self.start = float(np.median(apparent)), np.full(samples.texel.max() + 1, np.inf)
        np.minimum.at(self.start, samples.texel, apparent)
        self.start = np.where(np.isfinite(self.start), self.start, self.typical).clip(self.typical + DARKEST)

    def flashes(self, unknowns: Array) -> Array:
        """Places of the flash in the world, N x 3."""
        return self.cameras + self.turns @ unknowns[:3]

    def falloff(self, unknowns: Array) -> Array:
        """Logarithm of cos / d^2 at each point."""
        return _falloff(self.flashes(unknowns)[self.samples.photo], self.samples.points)

    def model(self, unknowns: Array) -> Array:
        """Logarithm of radiance over albedo / pi * I."""
        s = self.samples
        return unknowns[5:-2][s.photo] + self.falloff(unknowns) + np.log(_transmission(s.radius2, unknowns[3:5]))

    def half2(self, unknowns: Array) -> Array:
        """Squared sine of the angle between half vector and upright at each point."""
        light, eye = (x[self.samples.photo] - self.samples.points for x in (self.flashes(unknowns), self.cameras))
        half = light / np.linalg.norm(light, axis=1, keepdims=True) + eye / np.linalg.norm(eye, axis=1, keepdims=True)
        return np.square(half[:, :2]).sum(axis=1) / np.square(half).sum(axis=1)

    def away(self, unknowns: Array) -> Array:
        """Weight of each point by its angle to the mirror direction, where there is no lobe to explain what happens there."""
        if self.samples.glossy:
            return np.ones(len(self.samples.log))
        angle = 2 * np.arcsin(np.sqrt(self.half2(unknowns)))
        return ((angle - MIRROR[0]) / (MIRROR[1] - MIRROR[0])).clip(LEAST_WEIGHT, 1)

    def lobe(self, unknowns: Array) -> Array | float:
        """pi F0 D / 4 of GGX at each point, in units of the albedo over pi; shadowing left out, normals flat."""
        if not self.samples.glossy:
            return 0.0
        (alpha, _), (level, _) = LOBE
        alpha2, half2 = math.exp(2 * (alpha + unknowns[-2])), self.half2(unknowns)
        return math.exp(self.typical + level + unknowns[-1]) / 4 * alpha2 / (alpha2 * (1 - half2) + half2) ** 2

    def explain(self, unknowns: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Logarithm of albedo / pi of each texel for an intensity of 1, what suits its points best (Gauss-Newton); the
        logarithm of what the lobe multiplies each point by; and the error that is left."""
        texel, apparent, lobe = self.samples.texel, self.samples.log - self.model(unknowns), self.lobe(unknowns)
        albedo = self.start
        for _ in range(ALBEDO_STEPS if self.samples.glossy else 1):
            share = 1 / (1 + lobe / np.exp(albedo)[texel])
            step = np.bincount(texel, weights * share * (apparent - albedo[texel] + np.log(share)), len(albedo))
            step /= np.bincount(texel, weights * (share**2 + 1e-3), len(albedo)).clip(1e-12)
            albedo = np.maximum(albedo + step, self.typical + DARKEST)
        gloss = np.log1p(lobe / np.exp(albedo)[texel])
        return albedo, gloss, apparent - albedo[texel] - gloss

    def slopes(self, unknowns: Array, albedo: Array) -> Array:
        """Derivatives of each point's log radiance by the unknowns, albedo held: K x unknowns."""
        def shown(unknowns: Array) -> Array:
            return self.model(unknowns) + np.log1p(self.lobe(unknowns) / np.exp(albedo)[self.samples.texel])

        count = len(self.samples.names)
        out = np.zeros((len(self.samples.log), len(unknowns)))
        out[np.arange(len(out)), 5 + self.samples.photo] = 1  # exposures
        for k in (*range(5), *range(5 + count, 7 + count)):
            step = np.zeros(len(unknowns))
            step[k] = 1e-4 * self.spread[k]
            out[:, k] = (shown(unknowns + step) - shown(unknowns - step)) / (2 * step[k])
        return out

    def residuals(self, x: Array, weights: Array, scale: float) -> Array:
        return np.concatenate((np.sqrt(weights) / scale * self.explain(x * self.spread, weights)[-1], x))

    def jacobian(self, x: Array, weights: Array, scale: float) -> Array:
        """Of the residuals, the albedo following (Kaufman's form of variable projection, 1975)."""
        albedo, gloss, _ = self.explain(x * self.spread, weights)
        out, texel, share = self.slopes(x * self.spread, albedo), self.samples.texel, np.exp(-gloss)
        total = np.bincount(texel, weights * share**2).clip(1e-12)
        for column in out.T:
            column -= share * (np.bincount(texel, weights * share * column) / total)[texel]
        return np.concatenate((-np.sqrt(weights)[:, None] / scale * out * self.spread, np.eye(len(x))))


def _solve(rig: Rig, samples: _Samples) -> _Found:
    """The most probable unknowns; once more without the photos whose light is even, if there are any."""
    found = _most_probable(rig, samples, np.ones(len(samples.names)))
    even = np.array([found.evenness[name] > EVEN for name in samples.names])
    if even.any() and 2 * even.sum() < len(even):
        again = _most_probable(rig, samples, 1.0 - even)
        found = replace(again, left_out=tuple(name for name, e in zip(samples.names, even) if e))
    return found


def _most_probable(rig: Rig, samples: _Samples, counts: Array) -> _Found:
    from scipy.optimize import least_squares

    problem, x = _Problem(rig, samples), np.zeros(7 + len(samples.names))
    weights, scale = samples.weight * counts[samples.photo].clip(1e-9), 1.0
    for _ in range(ROUNDS):
        unknowns = x * problem.spread
        error = problem.explain(unknowns, weights)[-1]
        noise = _noise(error, weights)
        weights = samples.weight * counts[samples.photo].clip(1e-9) * problem.away(unknowns) * _trust(error / noise)
        scale = noise * math.sqrt(_alike(error, weights, samples.cell)) * (MISFIT if samples.glossy else 1.0)
        x = least_squares(problem.residuals, x, problem.jacobian, method="lm", args=(weights, scale), max_nfev=3).x
    solution = least_squares(problem.residuals, x, problem.jacobian, method="lm", args=(weights, scale), max_nfev=20)
    unknowns = solution.x * problem.spread
    albedo, gloss, error = problem.explain(unknowns, weights)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * np.outer(problem.spread, problem.spread)
    total = np.bincount(samples.texel, weights)
    colour = np.average(samples.colour, axis=0, weights=weights)
    slope = np.average(problem.slopes(unknowns, albedo), axis=0, weights=weights)
    level_sd = math.sqrt(slope @ covariance @ slope + scale**2 / weights.sum())
    return _Found(rig, samples, unknowns, np.sqrt(covariance.diagonal()), problem.typical, float(albedo[0]), level_sd, colour,
                  np.where(total > 1e-3, albedo, np.nan), error, weights, _evenness(problem, unknowns, weights, gloss), ())


def _noise(error: Array, weights: Array) -> float:
    """Standard deviation of residuals that have company, from the weighted median of their size."""
    order = np.argsort(np.abs(error))
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    return max(LEAST_NOISE, 1.4826 * float(np.abs(error)[order][min(half, len(error) - 1)]))


def _trust(size: Array) -> Array:
    """Weights of residuals over their deviation: 1 / |r| below, as Huber (1981), 1 / r^4 above, as Geman and McClure (1985)."""
    return np.where(size < 0, 1 / (np.abs(size) / BELOW).clip(1), 1 / (1 + (size / ABOVE) ** 2) ** 2)


def _alike(error: Array, weights: Array, cell: np.ndarray) -> float:
    """How many residuals count as one: the mean square of sums over cells, over that of independent ones."""
    sums, squares = (np.bincount(cell, v) for v in (weights * error, (weights * error) ** 2))
    return max(1.0, float(np.square(sums).sum() / max(squares.sum(), 1e-30)))


def _evenness(problem: _Problem, unknowns: Array, weights: Array, gloss: Array) -> dict[str, float]:
    """1 - slope of each photo's log radiance, less what other photos say of its texels, over what a flash makes of it: falloff
    and highlight, in logarithms."""
    samples, pattern = problem.samples, problem.falloff(unknowns) + gloss
    own = samples.weight * problem.away(unknowns)
    weights = np.minimum(weights, own)
    others = samples.log - problem.model(unknowns) - gloss
    total, found = np.bincount(samples.texel, weights), {}
    for number, name in enumerate(samples.names):
        at = samples.photo == number
        mine = np.bincount(samples.texel[at], (weights * others)[at], len(total))
        rest = total - np.bincount(samples.texel[at], weights[at], len(total))
        albedo = (np.bincount(samples.texel, weights * others) - mine) / rest.clip(1e-12)
        there = at & (rest > 0.1)[samples.texel]
        found[name] = _flatness(pattern[there], (others - albedo[samples.texel])[there], own[there], samples.cell[there])
    return found


def _flatness(pattern: Array, error: Array, weights: Array, cell: np.ndarray) -> float:
    """- slope of errors over the pattern, robust, in [0, 1]; 0 where its standard deviation is above SURE."""
    if len(pattern) < 20:
        return 0.0
    found = min((_line(pattern, error, weights, cell, start) for start in (0.0, -1.0)), key=lambda line: line[2])
    return min(1.0, max(0.0, -found[0])) if found[1] < SURE else 0.0


def _line(x: Array, y: Array, weights: Array, cell: np.ndarray, slope: float) -> tuple[float, float, float]:
    """A robust line: its slope, the standard deviation of that, and of the rest. It starts from ``slope``."""
    for _ in range(5):
        rest = y - slope * x
        rest = rest - np.median(rest)
        noise = _noise(rest, weights)
        trust = weights * _trust(rest / noise)
        aside = x - np.average(x, weights=trust)
        spread = max(float((trust * aside**2).sum()), 1e-12)
        slope = float((trust * aside * y).sum()) / spread
    rest = y - slope * x
    rest = rest - np.average(rest, weights=trust)
    sums = np.bincount(cell, trust * aside * rest)
    return slope, math.sqrt(float(np.square(sums).sum())) / spread if spread > 1e-9 else math.inf, _noise(rest, weights)
