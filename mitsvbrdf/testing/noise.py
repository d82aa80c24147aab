"""A Z-test for pictures with noise: is a path-traced picture off by more than its own noise explains?

As in Mitsuba's own test suite (``src/render/tests/test_renders.py``): a two-sided test of every value with
Sidak's correction. The mean of each channel is tested too, since a small bias hides in the noise of each
pixel but not of all. Pixels and means share the significance level evenly.

Assumed:

- Pixels are independent: a box filter, one sample stream each. (Channels of a pixel may depend on each other:
  Sidak's correction holds for two-sided tests of jointly normal values, however correlated.)
- The picture is the mean of so many samples that its values are near normal even 4 to 5 standard deviations
  out. Fireflies are not; ``outliers`` lets a share of the values off, 0.0025 in Mitsuba's suite.
- The variance is that of the picture under test, or is estimated from independent passes of it, best 16 or
  more with several samples each. Student's t, turned into a normal score (Wallace 1959), allows for the
  estimate.

Measured on made materials under an area light, 24 px, 16 passes of 4 samples, 200 seeds, significance 0.01:
leather fails 1 % of the time; glazed tiles, whose sharp highlights few samples find, 12.5 %, and 0.5 % with
``outliers=0.0025`` or with 16 samples a pass. Made 2 % brighter, all fail.
"""

from __future__ import annotations

from torch import Tensor

from ..measure.z_test import z_test
from .page import Figure, Row, failure, heat, view_rows


def assert_z_test(image: Tensor, variance_or_passes: Tensor, reference: Tensor, *, reference_variance: Tensor
                  | float = 0.0, significance: float = 0.01, outliers: float = 0.0) -> None:
    """Fail unless :func:`z_test` passes; arguments and errors as there.

    Raises:
        AssertionError: how many values are outside or which channel is biased, and a page that shows where.
    """
    __tracebackhide__ = True
    found = z_test(image, variance_or_passes, reference, reference_variance=reference_variance,
                   significance=significance, outliers=outliers)
    if found.passed:
        return
    figures = [Figure(f"share of the values beyond {found.z_limit:.2f} standard deviations", found.outside,
                      outliers)]
    figures += [Figure(f"mean of channel {k}, standard deviations off", abs(score), found.bias_limit)
                for k, score in enumerate(found.bias.tolist())]
    means = [float(each.double().mean()) for each in (image, reference)]
    rows = view_rows(image[None], reference[None], "picture") if image.shape[-1] == 3 else []
    rows.append(Row("standard deviations", [heat("of the worst channel", found.z.abs().amax(dim=-1))]))
    raise failure("picture differs from its reference by more than its noise", figures, rows,
                  ["mean of the image {:.6g}, of the reference {:.6g}".format(*means)])
