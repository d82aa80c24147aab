"""What a batch says on the terminal while it runs."""

from __future__ import annotations

import pytest

from mitsvbrdf.batch.progress import telling, words
from mitsvbrdf.batch.run import Progress

BEFORE = {"done": 6, "failed": 1, "running": 0, "pending": 9}


def stands(done=0, failed=0, running=0, pending=0, seconds=60.0, ended=0, before=BEFORE) -> Progress:
    return Progress({"done": done, "failed": failed, "running": running, "pending": pending}, seconds, ended,
                    [], before)


@pytest.mark.parametrize("now, expected", [
    (stands(6, 1, 2, 7), "0 of 9 ended, 2 running (6 done and 1 failed before)"),
    (stands(7, 1, 2, 6, ended=1), "1 of 9 ended, 2 running (6 done and 1 failed before)"),
    (stands(7, 2, 2, 5, ended=2),
     "2 of 9 ended, 2 running, 1 failed, 120 an hour, about 4 min left (6 done and 1 failed before)"),
    (stands(4, 0, 1, 0, 36000, 4, {}), "4 of 5 ended, 1 running, one in 2 h 30 min, about 2 h 30 min left"),
    (stands(3, 0, 0, 0, ended=3, seconds=0.0, before={}), "3 of 3 ended")])
def test_a_line_counts_what_this_run_has_to_do(now, expected):
    assert words(now) == expected


def test_lines_count_what_this_run_has_to_do(capsys):
    with telling("library") as tell:
        tell(stands(7, 0, 0, 0, ended=1), "oak: done")
        tell(stands(7, 0, 0, 0, ended=1), "")
    assert capsys.readouterr().out == "[1/1] oak: done\n"
