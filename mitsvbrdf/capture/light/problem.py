"""The least-squares problem of the light. Unknowns: flash, vignetting, exposures, one lobe for all texels."""

import math

import numpy as np
from scipy.ndimage import median

from ...io.layout import Layout
from ..lens import Array
from ..rig import Rig
from .samples import Samples, falloff_of, transmission_of
from .upside_down import Flashes

# Priors, standard deviations. A phone's flash is 1 to 3 cm beside its lens, in the same plane.
FLASH_SD = {"cm": (2.0, 2.0, 0.3), "patch sides": (0.1, 0.1, 0.02)}
VIGNETTING_SD = 0.3, 0.3
EXPOSURE_SD = 0.05  # natural logarithm; a locked exposure still varies by a few per cent
LOG_ALPHA = math.log(0.3), 1.0  # the lobe's alpha, natural logarithm, and its sd
LOG_F0 = math.log(0.16), 1.5  # the lobe's F0 over the median albedo, natural logarithm, and its sd
# angles from the mirror direction: weights are LEAST_WEIGHT up to the first, 1 from the second on
MIRROR = math.radians(10), math.radians(20)
LEAST_WEIGHT = 0.05  # of points near the mirror direction: a texel may have no others
DARKEST = -7.0  # natural logarithm of albedo over the median; lower values look like 0
POLISHES = 10
ALBEDO_STEPS = 6  # of Gauss-Newton, if there is a lobe


class Problem:
    """The residuals of a rig's samples, K points of M photos.

    The unknowns (``layout``) are differences from the expected values: ``flash``, position in camera axes
    (the rig's unit); ``vignetting``, v1 and v2; ``exposures``, natural logarithms, one a photo; ``log_alpha``
    and ``log_f0`` of the lobe. :meth:`residuals` and :meth:`jacobian` take them divided by ``spread``, the
    standard deviations of the prior. The search starts at ``begin``, which contains the argument
    ``exposures``. The farther such an exposure is from 0, the wider is its prior.
    """

    def __init__(self, rig: Rig, samples: Samples, exposures: Array | float = 0.0) -> None:
        self.rig, self.samples = rig, samples
        poses = [rig.poses[name] for name in samples.names]
        self.cameras = np.stack([pose.position for pose in poses])
        self.turns = np.stack([pose.rotation.T for pose in poses])
        self.layout = Layout(flash=(3,), vignetting=(2,), exposures=(len(poses),), log_alpha=(), log_f0=())
        self.spread = self.layout.pack(flash=FLASH_SD[rig.unit], vignetting=VIGNETTING_SD,
                                       exposures=np.abs(exposures).clip(EXPOSURE_SD),
                                       log_alpha=LOG_ALPHA[1], log_f0=LOG_F0[1])
        self.begin = self.layout.pack(exposures=exposures)
        apparent = samples.log - self.model(self.begin)
        self.typical, self.start = float(np.median(apparent)), np.full(samples.texel.max() + 1, np.inf)
        np.minimum.at(self.start, samples.texel, apparent)
        self.start = np.where(np.isfinite(self.start), self.start, self.typical).clip(self.typical + DARKEST)

    def flashes(self, unknowns: Array) -> Array:
        """Positions of the flash in the world, M x 3."""
        return self.cameras + self.turns @ unknowns[self.layout["flash"]]

    def falloff(self, unknowns: Array) -> Array:
        """Logarithm of cos / d^2 at each point."""
        return falloff_of(self.flashes(unknowns)[self.samples.photo], self.samples.points)

    def model(self, unknowns: Array) -> Array:
        """Logarithm of each point's diffuse radiance divided by (albedo / pi * I)."""
        s, u = self.samples, self.layout.unpack(unknowns)
        return (u.exposures[s.photo] + self.falloff(unknowns)
                + np.log(transmission_of(s.radius2, u.vignetting)))

    def half2(self, unknowns: Array) -> Array:
        """Squared sine of the angle between half vector and flat normal at each point."""
        light, eye = (x[self.samples.photo] - self.samples.points
                      for x in (self.flashes(unknowns), self.cameras))
        half = (light / np.linalg.norm(light, axis=1, keepdims=True)
                + eye / np.linalg.norm(eye, axis=1, keepdims=True))
        return np.square(half[:, :2]).sum(axis=1) / np.square(half).sum(axis=1)

    def away(self, unknowns: Array) -> Array:
        """Weight of each point: by its angle to the mirror direction if there is no lobe, else 1."""
        if self.samples.glossy:
            return np.ones(len(self.samples.log))
        angle = 2 * np.arcsin(np.sqrt(self.half2(unknowns)))
        return ((angle - MIRROR[0]) / (MIRROR[1] - MIRROR[0])).clip(LEAST_WEIGHT, 1)

    def lobe(self, unknowns: Array) -> Array | float:
        """F0 D / 4 of GGX at each point, comparable with albedo / pi; no shadowing, flat normals."""
        if not self.samples.glossy:
            return 0.0
        u, half2 = self.layout.unpack(unknowns), self.half2(unknowns)
        alpha2 = math.exp(2 * (LOG_ALPHA[0] + u.log_alpha))
        return (math.exp(self.typical + LOG_F0[0] + u.log_f0) / 4 * alpha2
                / (alpha2 * (1 - half2) + half2) ** 2)

    def explain(self, unknowns: Array, weights: Array) -> tuple[Array, Array, Array]:
        """The albedo that explains the points best (Gauss-Newton) for these unknowns.

        Returns the logarithm of albedo / pi of each texel, for an intensity of 1; the logarithm of the factor
        by which the lobe brightens each point; and the remaining error of each point.
        """
        texel, lobe = self.samples.texel, self.lobe(unknowns)
        apparent = self.samples.log - self.model(unknowns)
        albedo = self.start
        for _ in range(ALBEDO_STEPS if self.samples.glossy else 1):
            share = 1 / (1 + lobe / np.exp(albedo)[texel])
            step = np.bincount(texel, weights * share * (apparent - albedo[texel] + np.log(share)),
                               len(albedo))
            step = step / np.bincount(texel, weights * (share**2 + 1e-3), len(albedo)).clip(1e-12)
            albedo = np.maximum(albedo + step, self.typical + DARKEST)
        gloss = np.log1p(lobe / np.exp(albedo)[texel])
        return albedo, gloss, apparent - albedo[texel] - gloss

    def slopes(self, unknowns: Array, albedo: Array) -> Array:
        """Derivatives of each point's log radiance by the unknowns, for a fixed albedo: K x unknowns."""
        def shown(unknowns: Array) -> Array:
            return self.model(unknowns) + np.log1p(self.lobe(unknowns) / np.exp(albedo)[self.samples.texel])

        at, out = self.layout.numbers, np.zeros((len(self.samples.log), len(unknowns)))
        out[np.arange(len(out)), at.exposures[self.samples.photo]] = 1
        for k in (*at.flash, *at.vignetting, at.log_alpha, at.log_f0):
            step = np.zeros(len(unknowns))
            step[k] = 1e-4 * self.spread[k]
            out[:, k] = (shown(unknowns + step) - shown(unknowns - step)) / (2 * step[k])
        return out

    def residuals(self, x: Array, weights: Array, scale: float) -> Array:
        """Weighted errors of the K points over ``scale``, then the unknowns ``x`` themselves: the prior."""
        return np.concatenate((np.sqrt(weights) / scale * self.explain(x * self.spread, weights)[-1], x))

    def jacobian(self, x: Array, weights: Array, scale: float) -> Array:
        """Jacobian of the residuals; the albedo adapts to x (Kaufman's form of variable projection, 1975)."""
        albedo, gloss, _ = self.explain(x * self.spread, weights)
        out, texel, share = self.slopes(x * self.spread, albedo), self.samples.texel, np.exp(-gloss)
        total = np.bincount(texel, weights * share**2).clip(1e-12)
        for column in out.T:
            column -= share * (np.bincount(texel, weights * share * column) / total)[texel]
        return np.concatenate((-np.sqrt(weights)[:, None] / scale * out * self.spread, np.eye(len(x))))

    def flashes_of_each(self, unknowns: Array, weights: Array, scale: float) -> Flashes:
        """The flash estimated from each photo of paper alone, linearised at ``unknowns``."""
        both, places, information = self.layout.numbers.flash[:2], [], []
        albedo, _, error = self.explain(unknowns, weights)
        slopes = self.slopes(unknowns, albedo)[:, both]
        for photo in range(len(self.turns)):
            w, rows = (x[self.samples.photo == photo] for x in (weights / scale**2,
                                                                np.column_stack((slopes, error))))
            rows = rows - w @ rows / w.sum().clip(1e-12)  # removes the exposure
            square = rows.T @ (w[:, None] * rows)
            information.append(square[:2, :2] + 1e-9 * np.eye(2))
            places.append(unknowns[both] + np.linalg.solve(information[-1], square[:2, 2]))
        return Flashes(np.array(places), np.array(information), np.diag(self.spread[both] ** -2.0))


def exposures_of(rig: Rig, samples: Samples) -> Array:
    """Natural log of each photo's exposure over the median one's, by median polish (Tukey 1977)."""
    problem, texels = Problem(rig, samples), np.arange(samples.texel.max() + 1)
    shown = np.bincount(samples.photo, minlength=len(samples.names)) > 0
    apparent, exposures = samples.log - problem.model(problem.begin), np.zeros(len(samples.names))
    for _ in range(POLISHES):
        albedo = median(apparent - exposures[samples.photo], samples.texel, texels)
        exposures = median(apparent - albedo[samples.texel], samples.photo, np.arange(len(exposures)))
        exposures = np.where(shown, exposures - np.median(exposures[shown]), 0.0)
    return exposures
