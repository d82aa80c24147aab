"""Verdicts of made figures."""

import pytest

from mitsvbrdf.measure.tolerances import SWEEP_TOLERANCES
from mitsvbrdf.verify.stability.run import VERDICTS, verdict

IMAGE, GRADIENT = SWEEP_TOLERANCES["image"], SWEEP_TOLERANCES["gradient"]
GOOD = {"errors": {"image": IMAGE / 3, "roughness": GRADIENT / 3}, "not_finite": {"image": 0},
        "silenced": {"roughness": 0}}


def changed(**errors):
    return GOOD | {"errors": GOOD["errors"] | errors}


@pytest.mark.parametrize("expected, why, figures, options", [
    ("exact", "", GOOD, {}),
    ("clamped", "alpha", GOOD, {"clamps": ["alpha"]}),
    ("degraded", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 6 * GRADIENT}}),
    ("degraded", "image", changed(image=5 * IMAGE), {"limit": {"image": 6 * IMAGE}, "clamps": ["alpha"]}),
    ("wrong", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 4 * GRADIENT}}),
    ("wrong", "image", changed(image=2 * IMAGE), {}),
    ("wrong", "inf", changed(image=None), {"known": (1.0, "cause")}),
    ("limited", "cause", changed(image=2 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "image", changed(image=4 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "7 of roughness come back as 0", GOOD | {"silenced": {"roughness": 7}}, {}),
    ("not finite", "2 of image", GOOD | {"not_finite": {"image": 2}}, {"known": (1.0, "cause")}),
    ("refused", "no", {"refused": "no"}, {}),
])
def test_verdicts(expected, why, figures, options):
    kind, reason = verdict(figures, options.pop("limit", {}), **options)
    assert kind == expected and kind in VERDICTS and why in reason
