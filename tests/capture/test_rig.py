"""A rig survives its file."""

import json

import numpy as np
import pytest

from mitsvbrdf.capture.lens import Lens, Pose
from mitsvbrdf.capture.rig import Rig, rig_from_json, rig_to_json
from mitsvbrdf.errors import CaptureError


def test_a_rig_survives_json():
    lens = Lens((4032, 3024), 3000.5, (2010.0, 1500.25), (0.06, -0.04), (-0.25, 0.05), (1.5, 0.4, 0.0))
    poses = {"IMG_0001.jpg": Pose.looking_at((3, -2, 25), (0.4, 0.1, 0), 0.2),
             "b.png": Pose.looking_at((0, 1, 30), (0, 0, 0))}
    rig = Rig(lens, poses, 11.52, "cm", "sheet", {"b.png": 0.25}, {"c.jpg": "blurred"})
    back = rig_from_json(json.loads(json.dumps(rig_to_json(rig))))
    assert (back.lens, back.size, back.unit, back.source) == (rig.lens, rig.size, rig.unit, rig.source)
    assert (back.errors, back.rejected, list(back.poses)) == (rig.errors, rig.rejected, list(rig.poses))
    for name, pose in poses.items():
        np.testing.assert_array_equal(back.poses[name].position, pose.position)
        np.testing.assert_array_equal(back.poses[name].rotation, pose.rotation)


@pytest.mark.parametrize("wrong",
                         [{}, {"lens": {"size": [4, 3], "focal": 2, "aperture": 1}, "poses": {}},
                          {"lens": {"size": [4, 3], "focal": 2}, "poses": {"a": {"position": [1, 2]}}}])
def test_a_rig_that_is_none_says_so(wrong):
    with pytest.raises(CaptureError, match="a rig of lens and poses"):
        rig_from_json(wrong)
