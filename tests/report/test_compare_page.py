"""The comparison of methods: which errors are ranked."""

import pytest

from mitsvbrdf.report.compare_page import _table


@pytest.mark.parametrize("differs", ["", "transfer", "falloff", "same_views"])
def test_errors_that_were_counted_in_different_ways_are_not_ranked(differs):
    one = {"rerender_rmse": 0.1, "calibrated": {"rerender_rmse": 0.1}, "refined": {"rerender_rmse": 0.1},
           "per_photo": {"00": 0.1}, "held_out": [], "fitted_views": [], "flash_offset": None,
           "transfer": "srgb", "falloff": "inverse-square"}
    record = {"methods": [one, one | ({differs: "other"} if differs else {})], "reference": None,
              "photos": ["00"], "same_views": differs != "same_views"}
    marked = [row["best"] for group in _table(record) for row in group["rows"]]
    assert len(marked) == 3 and (marked == [None] * 3) is bool(differs)
