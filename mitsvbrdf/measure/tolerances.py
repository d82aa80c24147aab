"""How far renderers may be off, each number with what was measured.

Three checks hold renderers against float64, and each asks another question:

- :data:`LIMITS`: a test that renders one material (:mod:`mitsvbrdf.testing`), by renderer.
- :data:`TOLERANCES`: the cross-check, over texels of roughness :data:`ROUGH_FROM` and more of any material,
  for all renderers.
- :data:`SWEEP_TOLERANCES`: the sweeps to extremes. An error within the tolerance counts as exact;
  conditioning has to explain a larger one.
"""

from dataclasses import dataclass

UNIT_ROUNDOFF = 2.0**-24  # relative, of one float32 rounding


@dataclass(frozen=True)
class Limits:
    """How far a renderer may be off; ``math.inf`` leaves a comparison out.

    Args:
        image_mean: mean relative error of the image (:func:`mitsvbrdf.measure.metrics.image_error`).
        image_p999: relative error that 99.9 % of the image's values do not exceed.
        gradients: relative L2 error of the gradient of each map; infinite: no gradient is asked for.
    """

    image_mean: float
    image_p999: float
    gradients: float


# Measured on random materials of both BSDFs (co-located, apart, without falloff) and the made ones, worst of
# all: analytic 1.2e-7, 7.2e-7 and 9.6e-7; mitsuba 1.1e-7, 6.9e-7 and 2.2e-6; mitsuba-scene 1.6e-7, 1.1e-6 and
# 2.5e-6. About a factor of two is left for other processors.
LIMITS: dict[str, Limits] = {
    "analytic": Limits(2.5e-7, 1.5e-6, 2e-6),
    "mitsuba": Limits(2.5e-7, 1.5e-6, 5e-6),
    "mitsuba-scene": Limits(3.5e-7, 2.2e-6, 5e-6),
}

ROUGH_FROM = 0.1  # below, highlights are so narrow that no one number bounds float32's own error
# The largest errors allowed over texels of at least that roughness, of all views; gradients of each map.
TOLERANCES = {"image": {"mean": 5e-7, "p99.9": 5e-6}, "gradients": {"relative_l2": 2e-6, "1 - cosine": 1e-9}}

# Relative L2 errors that count as float32's own. Measured where nothing is extreme: images up to 6e-7,
# gradients up to 1e-6; near the horizon 6e-6. ``float64`` is the limit for float64 itself, against fifty
# digits, so that it can be the truth for the others.
SWEEP_TOLERANCES = {"image": 1e-6, "gradient": 1e-5, "float64": 1e-6}
