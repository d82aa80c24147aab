"""Coverage of stated deviations, against errors drawn with deviations that are known."""

import numpy as np
import pytest
import torch

from mitsvbrdf.measure.coverage import coverage

# a share of 0.68 has a deviation of 0.0023 then, one of 0.1 of 0.0015; bounds are four of them
COUNT = 40_000


def drawn(times=1.0, bias=0.0):
    """Errors of deviations between 0.01 and 0.1, ``times`` as large as stated."""
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.01, 0.1, COUNT)
    return torch.from_numpy(stated * (times * rng.standard_normal(COUNT) + bias)), torch.from_numpy(stated)


def test_a_true_statement():
    found = coverage(*drawn())
    assert found["within_68"] == pytest.approx(0.6827, abs=0.01) and found["within_95"] == pytest.approx(0.95,
                                                                                                         abs=0.005)
    assert found["ranks"] == pytest.approx([0.1] * 10, abs=0.006) and sum(found["ranks"]) == pytest.approx(1)
    # Root mean square of a uniform number from 0.01 to 0.1: 0.0608; its median 0.055.
    assert found["rmse"] == pytest.approx(0.0608, rel=0.02) and found["median_sd"] == pytest.approx(0.055,
                                                                                                    rel=0.02)


def test_too_sure_not_sure_enough_and_biased():
    sure, unsure, above = (coverage(*drawn(*how))["ranks"] for how in ((2.0,), (0.5,), (1.0, 1.0)))
    # Of a normal twice as wide as stated P(|z| <= 1) is 0.3829, of one half as wide 0.9545 (tables of the
    # normal distribution).
    assert coverage(*drawn(2.0))["within_68"] == pytest.approx(0.3829, abs=0.01)
    assert coverage(*drawn(0.5))["within_68"] == pytest.approx(0.9545, abs=0.005)
    assert min(sure[0], sure[-1]) > 0.2 and max(sure[4:6]) < 0.07 and max(unsure[0],
                                                                          unsure[-1]) < 0.01 < min(
                                                                              unsure[4:6]) - 0.1
    assert above[0] > 0.3 > 10 * above[-1]  # found too large: the truth lies low
