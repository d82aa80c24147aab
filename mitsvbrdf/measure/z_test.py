"""A Z-test for pictures with noise: is a path-traced picture off by more than its own noise explains?

As in Mitsuba's own test suite (``src/render/tests/test_renders.py``): a two-sided test of every value with
Sidak's correction, which is valid for any dependence between a pixel's channels. The mean of each channel
is tested too: pixels and means share the significance level evenly. docs/testing.md has the requirements on
a picture. If the variance is estimated from passes, Student's t is used and converted to a normal score;
the mean of a channel has the degrees of freedom of Welch (1947) and Satterthwaite.

Measured on made materials under an area light, 24 px, 16 passes of 4 samples, 200 seeds, significance 0.01:
leather fails 1 % of the time; glazed tiles, whose sharp highlights few samples find, 12.5 %, and 0.5 % with
``outliers=0.0025`` or with 16 samples a pass. If they are made 2 % brighter, all fail.
"""

import math
from dataclasses import dataclass, field

import torch
from scipy import stats
from torch import Tensor

from ..errors import ConfigError, MapsError

# with 64 x 64 pixels, the limit is then 18 standard deviations; with six passes 34, which misses much
FEWEST_PASSES = 8
SUM_ROUNDING = 1e-5  # rounding of float32 sums: least standard deviation, as a share of the reference's mean


@dataclass(frozen=True)
class ZTest:
    """Result of :func:`z_test`.

    Args:
        z: (image - reference) over its standard deviation, H x W x C, float64.
        z_limit: a value is outside if its |z| is larger.
        outside: share of the values outside.
        outliers: share of the values that may be outside.
        bias: the score of each channel's mean, C.
        bias_limit: the largest |bias| that passes.
    """

    z: Tensor = field(repr=False)
    z_limit: float
    outside: float
    outliers: float
    bias: Tensor
    bias_limit: float

    @property
    def passed(self) -> bool:
        """Whether no test finds a difference from the reference."""
        return self.outside <= self.outliers and bool((self.bias.abs() <= self.bias_limit).all())


def z_test(image: Tensor, variance_or_passes: Tensor, reference: Tensor, *, reference_variance: Tensor
           | float = 0.0, significance: float = 0.01, outliers: float = 0.0) -> ZTest:
    """Test a noisy picture against a reference.

    Args:
        image: H x W x C, linear, the mean of many samples a pixel.
        variance_or_passes: variance of ``image`` (that of a sample / the number of samples), H x W x C;
            or K >= 8 independent pictures whose mean is ``image``, K x H x W x C.
        reference: H x W x C, what ``image`` should be.
        reference_variance: of ``reference``, H x W x C or a number; if given, the two share no samples.
        significance: the largest probability that a correct picture fails.
        outliers: share of the values that may be outside.

    Raises:
        MapsError: shapes that differ, too few passes, an image that is not the mean of its passes, or a
            variance below 0 or not finite.
        ConfigError: a significance outside of (0, 1), or outliers outside of [0, 1).
    """
    if not 0 < significance < 1:
        raise ConfigError("a significance between 0 and 1", str(significance), "give 0.01")
    if not 0 <= outliers < 1:
        raise ConfigError("outliers from 0 to less than 1", str(outliers), "give a share, e.g. 0.0025")
    given = (image, variance_or_passes, reference, torch.as_tensor(reference_variance))
    image, spread, reference, known = (each.detach().double() for each in given)
    degrees = math.inf
    if (image.ndim != 3 or not image.numel() or not image.shape == reference.shape == spread.shape[-3:]
            or spread.ndim not in (3, 4) or known.ndim and known.shape != image.shape):
        raise MapsError("image, variances and reference of one shape H x W x C, not empty",
                        " and ".join(str(tuple(each.shape)) for each in given), "compare one view at a time")
    if spread.ndim == 4:
        passes, degrees = spread, len(spread) - 1
        if len(passes) < FEWEST_PASSES or not torch.allclose(passes.mean(dim=0), image, rtol=1e-4, atol=1e-6):
            raise MapsError(f"{FEWEST_PASSES} passes or more, whose mean the image is",
                            f"{len(passes)} passes", "render with more seeds, and give their mean as image")
        spread = passes.var(dim=0) / len(passes)
    for each in (spread, known):
        if not (torch.isfinite(each) & (each >= 0)).all():
            raise MapsError("variances that are finite and not below 0",
                            f"{float(each.min()):.3g} to {float(each.max()):.3g}",
                            "look at the samples they come from")
    off = image - reference
    least = max((SUM_ROUNDING * float(reference.abs().mean())) ** 2, torch.finfo(torch.float64).tiny)
    variance = (spread + known).clamp_min(least)
    z = _normal_score(off / variance.sqrt(), torch.tensor(degrees))
    z_limit, bias_limit = (float(stats.norm.isf(-math.expm1(math.log1p(-significance) / 2 / n) / 2))
                           for n in (z.numel(), z.shape[-1]))
    outside = float((~(z.abs() <= z_limit)).double().mean())
    total = variance.sum(dim=(0, 1))
    bias = _normal_score(off.sum(dim=(0, 1)) / total.sqrt(),
                         degrees / (spread / total).square().sum(dim=(0, 1)))
    return ZTest(z, z_limit, outside, outliers, bias, bias_limit)


def _normal_score(t: Tensor, degrees: Tensor) -> Tensor:
    """Standard normal values with the same tail probability as t statistics."""
    score = torch.as_tensor(stats.norm.isf(stats.t.sf(t.abs().cpu(), degrees.cpu())), device=t.device)
    return torch.where(degrees.isinf(), t, t.sign() * score)
