"""Whatever is killed wherever: the old result is there whole, or the new one, and readers mend nothing."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import ROOT

SCRIPT = Path(__file__).parents[1] / "helpers" / "kill_points.py"
# Points that a command has at least: were the folder no longer written through these calls, there would be
# none to kill at.
SHAPES = {"fit": 30, "fit by renames": 30, "export": 15, "relight": 15, "capture": 8, "report": 20,
          "batch": 8}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_result_is_the_old_one_whole_or_the_new_one_whole(shape, tmp_path):
    done = subprocess.run([sys.executable, SCRIPT, shape, tmp_path], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    before, after, points = found["before"], found["after"], found["points"]
    assert before != after and len(points) >= SHAPES[shape]
    for point in points:
        assert point["command"] in (before, after) and not point["beside"], point
        # Without the exchange of the kernel a kill may leave the old result under another name for a while.
        assert point["reader"] == point["command"] or "renames" in shape and not point["reader"], point
    ends = [point["command"] == after for point in points]
    assert ends == sorted(ends) and {*ends} == {False, True}  # the old one up to a point, then the new one
    assert len([point for point in points if not point["reader"] and before]) == ("renames" in shape)
