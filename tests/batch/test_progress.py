"""What a batch says on the terminal while it runs."""

from __future__ import annotations

import pytest

from mitsvbrdf.batch.progress import Progress, duration, telling


@pytest.mark.parametrize("now, expected", [
    (Progress(ended=0, left=9, running=2, failed=0, seconds=60.0), "0 of 9 ended, 2 running"),
    (Progress(1, 8, 2, 0, 60.0), "1 of 9 ended, 2 running"),
    (Progress(2, 7, 2, 1, 60.0), "2 of 9 ended, 2 running, 1 failed, 120 an hour, about 4 min left"),
    (Progress(4, 1, 1, 0, 36000), "4 of 5 ended, 1 running, one in 2 h 30 min, about 2 h 30 min left"),
    (Progress(3, 0, 0, 0, 0.0), "3 of 3 ended")])
def test_a_line_counts_what_this_run_has_to_do(now, expected):
    assert now.words == expected


@pytest.mark.parametrize("seconds, expected", [
    (0.04, "0.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (89.4, "89 s"), (89.6, "1 min"), (5369, "89 min"),
    (5400, "1 h 30 min"), (7200, "2 h"), (172800, "2 days"), (190800, "2 days 5 h")])
def test_a_length_of_time_has_at_most_two_units(seconds, expected):
    assert duration(seconds) == expected


def test_lines_count_what_this_run_has_to_do(capsys):
    with telling("library") as tell:
        tell(Progress(1, 0, 0, 0, 60.0), "oak: done")
        tell(Progress(1, 0, 0, 0, 60.0), "")
    assert capsys.readouterr().out == "[1/1] oak: done\n"
