"""Fixtures that the tests of this folder share."""

import json

import pytest

from mitsvbrdf import make_material
from mitsvbrdf.capture.rig import Rig, rig_to_json
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.synth.phone import HandheldPhone, shots
from mitsvbrdf.synth.truth import Truth


@pytest.fixture
def truth(tmp_path):
    """Nine photos, a duplicate of the third and a blurred one, of smooth maps of 64 texels on 24 cm."""
    phone = HandheldPhone(megapixels=1.0)
    plan = shots(phone, spoil=("duplicate", "blurred"))
    rig = Rig(phone.lens, {shot.name: shot.pose for shot in plan}, phone.patch, "cm", "photos")
    save_maps(make_material("inlay", 16).resized(64), tmp_path / "truth" / "sample")
    odd = {shot.name: {"kind": shot.kind, "usable": False} | ({"of": shot.of} if shot.of else {})
           for shot in plan if shot.kind}
    (tmp_path / "truth" / "truth.json").write_text(json.dumps(
        {"rig": rig_to_json(rig), "intensity": [1500.0] * 3, "sample_cm": 24.0, "spoiled": odd}))
    return Truth.read(tmp_path)
