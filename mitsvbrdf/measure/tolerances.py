"""The largest errors that renderers may have, each with the errors that were measured.

Three checks compare renderers with float64:

- :data:`LIMITS` of each renderer: tests that render one material (:mod:`mitsvbrdf.testing`).
- :data:`TOLERANCES` of all renderers: the cross-check, over texels of roughness :data:`ROUGH_FROM` and more
  of any material.
- :data:`SWEEP_TOLERANCES`: the sweeps to extremes. An error within the tolerance counts as exact; a larger
  one is accepted only if conditioning or a known cause explains it.
"""

from dataclasses import dataclass

UNIT_ROUNDOFF = 2.0**-24  # relative, of one float32 rounding


@dataclass(frozen=True)
class Limits:
    """The largest errors that a renderer may have; ``math.inf``: not compared.

    Args:
        image_mean: mean relative error of the image (:func:`mitsvbrdf.measure.metrics.image_error`).
        image_p999: 99.9 % of the image's values have at most this relative error.
        gradients: relative L2 error of the gradient of each map; infinite: no gradient is computed.
    """

    image_mean: float
    image_p999: float
    gradients: float


# Worst errors measured on the made materials and random ones of both BSDFs (co-located, apart, without
# falloff): analytic 1.2e-7, 7.2e-7, 9.6e-7; mitsuba 1.1e-7, 6.9e-7, 2.2e-6; mitsuba-scene 1.6e-7, 1.1e-6,
# 2.5e-6. The limits are about twice as large, for other processors.
LIMITS: dict[str, Limits] = {
    "analytic": Limits(2.5e-7, 1.5e-6, 2e-6),
    "mitsuba": Limits(2.5e-7, 1.5e-6, 5e-6),
    "mitsuba-scene": Limits(3.5e-7, 2.2e-6, 5e-6),
}

ROUGH_FROM = 0.1  # below it, highlights are so narrow that no single number bounds float32's own error
# The largest errors allowed over texels of at least that roughness, of all views; gradients of each map.
TOLERANCES = {"image": {"mean": 5e-7, "p99.9": 5e-6}, "gradients": {"relative_l2": 2e-6, "1 - cosine": 1e-9}}

# Relative L2 errors up to these count as exact. Measured without extremes: images up to 6e-7, gradients up to
# 1e-6; near the horizon 6e-6. ``float64`` is the limit for float64 itself, compared with fifty digits: it is
# the reference for the others.
SWEEP_TOLERANCES = {"image": 1e-6, "gradient": 1e-5, "float64": 1e-6}
