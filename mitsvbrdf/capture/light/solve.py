"""The most probable light, by robust least squares in rounds; once more without photos that had no flash.

The light in a photo without flash is even (:func:`evenness_of`).
"""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
from scipy.optimize import least_squares

from ..lens import Array, Lens, Pose
from ..rig import Rig
from .problem import EXPOSURE_SD, LOG_F0, Problem, exposures_of
from .samples import Samples
from .upside_down import Flashes

# errors of unknowns over errors due to noise, on known materials: their texels do not all share one lobe
MISFIT = 4.0
ROUNDS = 10  # of reweighting
SURE = 0.2  # standard deviation up to which evenness counts as measured
LEAST_LOG_NOISE = 0.002  # of log radiance
EVEN = 0.5  # with more evenness, a photo does not show where the flash is
LOCKED = 4 * EXPOSURE_SD  # if a photo differs by more from the median one, its exposure may differ
MISSED, AS_WELL = 9.0, 1.1  # to compare fits: largest (error / noise)^2; ratio of means
BELOW, ABOVE = 2.0, 3.0  # standard deviations from which negative and positive residuals count less


@dataclass(frozen=True)
class Shading:
    """The light that the shading of a rig's photos shows, and its standard deviations."""

    lens: Lens  # the rig's, with flash and vignetting
    # radiant intensity of the flash (rgb) for a log_exposure of 0; radiance 1 is display value 1
    intensity: tuple[float, float, float]
    log_exposure: dict[str, float]  # photo name to natural logarithm of the relative exposure
    # standard deviations of flash_x, flash_y, flash_z (the rig's unit), v1, v2 and log_intensity
    deviations: dict[str, float]
    exposure_deviations: dict[str, float]  # standard deviations of log_exposure
    # photo name to evenness: 0 if light falls off as a flash's, or if that is unclear; 1 if it is even
    evenness: dict[str, float]
    poses: dict[str, Pose]  # photo name to pose; turned, if the photo was saved upside down
    notes: tuple[str, ...] = ()  # what was assumed, and which photos do not count
    # photo name to factors of rgb, of photos whose white balance is not that of the others
    tint: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Found:
    """The unknowns at the optimum, and what follows from them."""

    rig: Rig
    samples: Samples
    unknowns: SimpleNamespace  # named as in the problem's layout
    deviations: SimpleNamespace
    typical: float  # median log of albedo / pi, for an intensity of 1, before the search
    level: float  # log of albedo / pi of the first texel, for an intensity of 1; paper has one texel
    level_sd: float
    colour: Array
    albedo: Array  # log of each texel's albedo / pi, for an intensity of 1; NaN where nothing is known
    evenness: dict[str, float]
    flashes: Flashes | None  # estimated from each photo of paper; None for a material
    error: Array  # of each point's log radiance
    noise: float  # its standard deviation, of points that count
    unlit: tuple[str, ...] = ()
    turned: tuple[str, ...] = ()

    @property
    def lobe(self) -> float:
        """F0 over pi of the lobe, for an intensity of 1."""
        return math.exp(self.typical + LOG_F0[0] + self.unknowns.log_f0)

    def shading(self, intensity: Array, log_intensity_sd: float, notes: tuple[str, ...]) -> Shading:
        """The result in the rig's unit; the caller gives the intensity (rgb) and its deviation."""
        names = self.samples.names
        shared = zip(("flash_x", "flash_y", "flash_z", "v1", "v2"),
                     (*self.deviations.flash.tolist(), *self.deviations.vignetting.tolist()))
        if self.turned:
            notes += (f"saved upside down, as the flash on the other side of the lens shows: "
                      f"{', '.join(self.turned)}; their poses are turned",)
        if self.unlit:
            notes += (f"light is too even in {', '.join(self.unlit)} to tell where the flash is: the others "
                      "tell it",)
        elif even := sum(e > EVEN for e in self.evenness.values()):
            notes += (f"light does not fall off as a flash's in {even} of {len(names)} photos: where it "
                      "comes from is a guess",)
        red, green, blue = (float(i) for i in intensity)
        lens = replace(self.rig.lens, flash=tuple(self.unknowns.flash.tolist()),
                       vignetting=tuple(self.unknowns.vignetting.tolist()))
        return Shading(lens, (red, green, blue), dict(zip(names, self.unknowns.exposures.tolist())),
                       dict(shared) | {"log_intensity": float(log_intensity_sd)},
                       dict(zip(names, self.deviations.exposures.tolist())), self.evenness,
                       self.rig.poses, notes)


def solve_light(rig: Rig, samples: Samples) -> _Found:
    """The most probable unknowns; if fewer than half of the photos have even light, without these."""
    found = _turned(_most_probable(rig, samples, counts := np.ones(len(samples.names))), counts)
    even = np.array([found.evenness[name] > EVEN for name in samples.names])
    if even.any() and 2 * even.sum() < len(even):
        found = _turned(_most_probable(rig, samples, counts := 1.0 - even), counts)
        found = replace(found, unlit=tuple(name for name, e in zip(samples.names, even) if e))
        for photo in np.flatnonzero(even):  # its exposure: from its errors under the light found
            error = found.error[samples.photo == photo]
            found.unknowns.exposures[photo] += np.median(error)
            found.deviations.exposures[photo] = noise_of(error - np.median(error), np.ones(len(error)))
    return found


def _turned(found: _Found, counts: Array) -> _Found:
    """Turn photos that surely were upside down, and find the light anew; in rounds: misfits weigh little."""
    new, signs = found, np.ones(len(counts))
    for _ in range(ROUNDS):
        if new.flashes is None or (change := new.flashes.likeliest()).min() > 0:
            break
        signs = signs * change * (np.sign((signs * change).sum()) or 1)
        turned = tuple(name for name, sign in zip(found.samples.names, signs) if sign < 0)
        poses = found.rig.poses | {name: found.rig.poses[name].upside_down() for name in turned}
        new = replace(_most_probable(replace(found.rig, poses=poses), found.samples, counts), turned=turned)
    return new if new.flashes and new.flashes.turned(signs) else found


def _most_probable(rig: Rig, samples: Samples, counts: Array) -> _Found:
    """The light with equal exposures; or with apparent ones, if these explain the photos as well.

    With equal exposures, a photo of twice the exposure looks like one large highlight. With apparent
    exposures, the search may mistake even light for a lobe.
    """
    found, exposures = _optimum(Problem(rig, samples), counts), exposures_of(rig, samples) * counts
    if np.abs(exposures).max() < LOCKED or (max(found.evenness.values()) > EVEN and counts.all()):
        return found
    other = _optimum(Problem(rig, samples, exposures), counts)
    noise = min(found.noise, other.noise)
    missed, less = (np.average(np.square(each.error / noise).clip(max=MISSED), weights=samples.weight)
                    for each in (found, other))
    return other if less < AS_WELL * missed else found


def _optimum(problem: Problem, counts: Array) -> _Found:
    rig, samples = problem.rig, problem.samples
    x = problem.begin / problem.spread
    weights, scale = samples.weight * counts[samples.photo].clip(1e-9), 1.0
    for _ in range(ROUNDS):
        unknowns = x * problem.spread
        error = problem.explain(unknowns, weights)[-1]
        noise = noise_of(error, weights)
        weights = (samples.weight * counts[samples.photo].clip(1e-9) * problem.away(unknowns)
                   * trust_of(error / noise))
        scale = noise * math.sqrt(alike(error, weights, samples.cell)) * (MISFIT if samples.glossy else 1.0)
        x = least_squares(problem.residuals, x, problem.jacobian, method="lm", args=(weights, scale),
                          max_nfev=3).x
    solution = least_squares(problem.residuals, x, problem.jacobian, method="lm", args=(weights, scale),
                             max_nfev=20)
    unknowns = solution.x * problem.spread
    albedo, gloss, error = problem.explain(unknowns, weights)
    # errors of a photo saved upside down are no highlights: positive ones get the weights of negative ones
    own = samples.weight * counts[samples.photo] * problem.away(unknowns) * trust_of(-np.abs(error) / noise)
    flashes = None if samples.glossy else problem.flashes_of_each(unknowns, own, scale)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * np.outer(problem.spread, problem.spread)
    total = np.bincount(samples.texel, weights)
    colour = np.average(samples.colour, axis=0, weights=weights)
    slope = np.average(problem.slopes(unknowns, albedo), axis=0, weights=weights)
    level_sd = math.sqrt(slope @ covariance @ slope + scale**2 / weights.sum())
    return _Found(rig, samples, problem.layout.unpack(unknowns),
                  problem.layout.unpack(np.sqrt(covariance.diagonal())),
                  problem.typical, float(albedo[0]), level_sd, colour, np.where(total > 1e-3, albedo, np.nan),
                  evenness_of(problem, unknowns, weights, gloss), flashes, error, noise)


def noise_of(error: Array, weights: Array) -> float:
    """Standard deviation of residuals, from the weighted median of their absolute values."""
    order = np.argsort(np.abs(error))
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    return max(LEAST_LOG_NOISE, 1.4826 * float(np.abs(error)[order][min(half, len(error) - 1)]))


def trust_of(size: Array) -> Array:
    """Weights: 1 / |r| for negative residuals r (Huber 1981), 1 / r^4 for positive (Geman, McClure 1985)."""
    return np.where(size < 0, 1 / (np.abs(size) / BELOW).clip(1), 1 / (1 + (size / ABOVE) ** 2) ** 2)


def alike(error: Array, weights: Array, cell: np.ndarray) -> float:
    """How many residuals count as one: squared sums of cells over squares of residuals; 1: independent."""
    sums, squares = (np.bincount(cell, v) for v in (weights * error, (weights * error) ** 2))
    return max(1.0, float(np.square(sums).sum() / max(squares.sum(), 1e-30)))


def evenness_of(problem: Problem, unknowns: Array, weights: Array, gloss: Array) -> dict[str, float]:
    """Each photo's evenness: 1 - slope of (log radiance - the others' log albedo) over a flash's pattern."""
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
        found[name] = _flatness(pattern[there], (others - albedo[samples.texel])[there], own[there],
                                samples.cell[there])
    return found


def _flatness(pattern: Array, error: Array, weights: Array, cell: np.ndarray) -> float:
    """Minus the robust slope of errors over the pattern, in [0, 1]; 0 if its deviation is SURE or more."""
    if len(pattern) < 20:
        return 0.0
    found = min((_line(pattern, error, weights, cell, start) for start in (0.0, -1.0)),
                key=lambda line: line[2])
    return min(1.0, max(0.0, -found[0])) if found[1] < SURE else 0.0


def _line(x: Array, y: Array, weights: Array, cell: np.ndarray, slope: float) -> tuple[float, float, float]:
    """A robust line, started at ``slope``: its slope, and standard deviations of slope and residuals."""
    for _ in range(5):
        rest = y - slope * x
        rest = rest - np.median(rest)
        noise = noise_of(rest, weights)
        trust = weights * trust_of(rest / noise)
        aside = x - np.average(x, weights=trust)
        spread = max(float((trust * aside**2).sum()), 1e-12)
        slope = float((trust * aside * y).sum()) / spread
    rest = y - slope * x
    rest = rest - np.average(rest, weights=trust)
    sums = np.bincount(cell, trust * aside * rest)
    deviation = math.sqrt(float(np.square(sums).sum())) / spread if spread > 1e-9 else math.inf
    return slope, deviation, noise_of(rest, weights)
