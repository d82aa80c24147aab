"""A rig in its file: plain numbers, by name."""

import json

from mitsvbrdf.capture.lens import Lens, Pose
from mitsvbrdf.capture.rig import Rig, rig_to_json


def test_a_rig_is_plain_json():
    lens = Lens((4032, 3024), 3000.5, (2010.0, 1500.25), (0.06, -0.04), (-0.25, 0.05), (1.5, 0.4, 0.0))
    pose = Pose.looking_at((3, -2, 25), (0.4, 0.1, 0), 0.2)
    rig = Rig(lens, {"b.png": pose}, 11.52, "cm", "sheet", {"b.png": 0.25}, {"c.jpg": "blurred"})
    back = json.loads(json.dumps(rig_to_json(rig)))
    assert back["lens"] == {"size": [4032, 3024], "focal": 3000.5, "centre": [2010.0, 1500.25],
                            "distortion": [0.06, -0.04], "vignetting": [-0.25, 0.05],
                            "flash": [1.5, 0.4, 0.0]}
    assert back["poses"] == {"b.png": {"position": pose.position.tolist(),
                                       "rotation": pose.rotation.tolist()}}
    assert (back["size"], back["unit"], back["source"]) == (11.52, "cm", "sheet")
    assert (back["errors"], back["rejected"], back["notes"]) == ({"b.png": 0.25}, {"c.jpg": "blurred"}, [])
