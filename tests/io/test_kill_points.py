"""Whatever is killed wherever: the old result is there whole, or the new one, and who comes next is told."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import ROOT

SCRIPT = Path(__file__).parents[1] / "helpers" / "kill_points.py"
# Points that a command has at least: were the folder no longer written through these calls, there would be
# none to kill at.
SHAPES = {"fit": 30, "export": 15, "relight": 15, "capture": 10, "report": 10, "batch": 8,
          "reader": 15}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_result_is_the_old_one_whole_or_the_new_one_whole(shape, tmp_path):
    done = subprocess.run([sys.executable, SCRIPT, shape, tmp_path], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    before, after, points = found["before"], found["after"], found["points"]
    assert before != after and len(points) >= SHAPES[shape]
    ends = []
    for point in points:
        assert point["reader"] == point["command"] and point["reader"] in (before, after), point
        assert shape != "reader" or point["reader"] == after
        half = shape != "batch" and point["after the kill"] not in (before, after)
        assert not half or "was killed while it put its result in place" in point["said"]
        ends.append(point["reader"] == after)
    # The old one up to a point, and from there on the new one.
    assert ends == sorted(ends) and {*ends} == ({True} if shape == "reader" else {False, True})
