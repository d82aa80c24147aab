"""What a capture is told about the truth of a simulated phone."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from mitsvbrdf import make_material
from mitsvbrdf.capture import Capture, write_capture
from mitsvbrdf.capture.lens import Pose
from mitsvbrdf.capture.rig import Rig, rig_to_json
from mitsvbrdf.errors import CaptureError
from mitsvbrdf.synth.against_truth import PIXELS, compare_with_truth
from mitsvbrdf.synth.truth import Similarity, Truth, rig_of, similarity, true_capture, truth_maps
from mitsvbrdf.views import Views

MOVED = Similarity(12.0, 0.3, (0.7, -0.4))


def sheets(truth) -> Rig:
    """The good photos exactly as they were, as a sheet would say it."""
    poses = dict(list(truth.rig.poses.items())[:9])
    left_out = {"IMG_0010.jpg": "as IMG_0003.jpg", "IMG_0011.jpg": "blurred"}
    return replace(truth.rig, poses=poses, source="sheet", left_out=left_out)


def moved(rig: Rig, by: Similarity = MOVED) -> Rig:
    """The same rig in a world of its own, as photos without a sheet would give it."""
    poses = {name: Pose(by.back(pose.position), pose.rotation @ by.turn) for name, pose in rig.poses.items()}
    lens = replace(rig.lens, flash=tuple(np.array(rig.lens.flash) / by.scale))
    return Rig(lens, poses, 0.95, "patch sides", "photos", {}, rig.rejected)


@pytest.mark.parametrize("world", [lambda rig: rig, moved])
def test_an_exact_rig_has_no_errors(truth, world):
    found = compare_with_truth(world(sheets(truth)), truth)
    for value in (found["cameras"]["worst"], found["cameras_by_patch"]["worst"], found["lights"]["worst"],
                  found["rectification"]["worst"], found["lens"]["pixels"], *found["lens"]["flash"],
                  found["lens"]["vignetting"], found["lens"]["focal"] - 1):
        assert abs(value) < 1e-9
    placed = found["similarity"]
    want = MOVED if world is moved else Similarity()
    np.testing.assert_allclose([placed["scale"], math.radians(placed["degrees"]), *placed["shift"]],
                               [want.scale, want.angle, *want.shift], atol=1e-9)
    assert found["photos"]["wrongly_used"] == {} and found["photos"]["wrongly_rejected"] == {}
    assert found["photos"]["rightly_rejected"]["IMG_0011.jpg"] == {"kind": "blurred", "reason": "blurred"}
    json.dumps(found, allow_nan=False)


def test_a_camera_in_a_wrong_place(truth):
    """1 % of its distance aside, found with a sheet: its light too, and its photo is rectified that far
    off.
    """
    rig, name = sheets(truth), "IMG_0004.jpg"
    pose = rig.poses[name]
    step = 0.01 * np.linalg.norm(pose.position)
    rig.poses[name] = Pose(pose.position + (step, 0, 0), pose.rotation)
    found = compare_with_truth(rig, truth)
    assert found["cameras"]["photos"][name] == pytest.approx(0.01) == found["cameras"]["worst"]
    assert found["cameras"]["rms"] == pytest.approx(0.01 / 3)
    light = np.linalg.norm(pose.flash(rig.lens))
    assert found["lights"]["photos"][name] == pytest.approx(step / light)
    pixels = step * PIXELS / rig.size
    rectification = found["rectification"]
    assert rectification["photos"][name] == pytest.approx(pixels) == rectification["worst"]
    assert rectification["rms"] == pytest.approx(pixels / 3) == rectification["mutual"] and rectification[
        "common"] < 1e-9
    placed = similarity(moved(rig), truth)  # one wrong photo of nine moves no median
    np.testing.assert_allclose([placed.scale, placed.angle, *placed.shift],
                               [MOVED.scale, MOVED.angle, *MOVED.shift], atol=1e-9)


def test_a_patch_that_all_photos_deform(truth):
    """All cameras shifted: of a sheet's rig an error common to all, without a sheet none at all."""
    rig = sheets(truth)
    poses = {name: Pose(pose.position + (0.1, -0.2, 0), pose.rotation) for name, pose in rig.poses.items()}
    shifted = replace(rig, poses=poses)
    found = compare_with_truth(shifted, truth)["rectification"]
    pixels = math.hypot(0.1, 0.2) * PIXELS / rig.size
    assert found["common"] == pytest.approx(pixels) == found["rms"] and found["mutual"] < 1e-9
    free = compare_with_truth(moved(shifted), truth)
    assert free["rectification"]["worst"] < 1e-9 and free["cameras"]["worst"] < 1e-9


def test_errors_of_the_lens(truth):
    rig = moved(sheets(truth))
    lens = replace(rig.lens, focal=rig.lens.focal * 1.02, vignetting=(0.0, 0.0), flash=(0.0, 0.0, 0.0))
    found = compare_with_truth(replace(rig, lens=lens), truth)["lens"]
    assert found["focal"] == pytest.approx(1.02) and found["distortion"] == [0.0, 0.0]
    assert found["flash"] == pytest.approx([-1.5, -0.4, 0.0])
    # At the corner r = 1 nearly: 1 - 0.25 + 0.05.
    assert found["vignetting"] == pytest.approx(0.2, abs=1e-3)
    size = np.array(rig.lens.size)
    columns, rows = np.meshgrid(*(np.linspace(0, side - 1, 33) for side in size))
    from_middle = np.hypot(columns - rig.lens.middle[0], rows - rig.lens.middle[1])
    assert found["pixels"] == pytest.approx(0.02 * np.sqrt(np.square(from_middle).mean()))


def test_which_photos_were_chosen(truth):
    rig = sheets(truth)
    poses = dict(rig.poses) | {name: truth.rig.poses[name] for name in ("IMG_0010.jpg", "IMG_0011.jpg")}
    both = compare_with_truth(replace(rig, poses=poses), truth)["photos"]
    assert both["wrongly_used"] == {"IMG_0010.jpg": "duplicate", "IMG_0011.jpg": "blurred"}
    del poses["IMG_0011.jpg"], poses["IMG_0003.jpg"], poses["IMG_0001.jpg"]  # one of two alike will do
    rig = replace(rig, poses=poses, left_out={"IMG_0003.jpg": "twice", "IMG_0001.jpg": "dark"})
    one = compare_with_truth(rig, truth)["photos"]
    assert one["wrongly_used"] == {} and one["wrongly_rejected"] == {"IMG_0001.jpg": "dark"}
    assert one["rightly_rejected"]["IMG_0003.jpg"] == {"kind": "duplicate", "reason": "twice"}


def test_maps_of_just_the_patch(truth):
    """A patch of half the sample, turned by a quarter: a cut of the maps, turned, and their normals with
    it.
    """
    quarter = Similarity(12.0, math.pi / 2, (3.0, 0.0))
    rig = replace(moved(sheets(truth), quarter), size=1.0)
    found = truth_maps(truth, rig, 32)
    whole = make_material("inlay", 16).resized(64)
    # x of the rig's world is y of the true one, and its y is -x: 12 cm around (3, 0) are columns 24 to 56 of
    # 64.
    for name in ("diffuse", "specular", "roughness"):
        cut = torch.rot90(whole[name][16:48, 24:56], -1)
        # Measured: at most 0.0018, of bilinear reading twice a texel; the other way round 0.04 to 0.18
        assert float((found[name] - cut).abs().mean()) < 0.004 < float((found[name] - torch.rot90(cut,
                                                                                                  2)).abs().mean())
    unturned = torch.rot90(whole["normal"][16:48, 24:56], -1)
    turned = torch.stack((unturned[..., 1], -unturned[..., 0], unturned[..., 2]), dim=-1)
    # Measured: 0.0005; as they were 0.023, turned the other way 0.035
    assert float((found["normal"] - turned).abs().mean()) < 0.002 < float(
        (found["normal"] - unturned).abs().mean())
    assert float((found["normal"].norm(dim=-1) - 1).abs().max()) < 1e-6


def test_a_capture_with_the_true_views(truth, tmp_path):
    """The written views are wrong by a known amount: the comparison says it, and the true ones take their
    place.
    """
    rig = moved(sheets(truth))
    camera = np.stack([pose.position for pose in rig.poses.values()])
    light = np.stack([pose.flash(rig.lens) for pose in rig.poses.values()])
    power = 1500.0 / MOVED.scale**2
    views = Views.of(camera * (1, 1, 1.1), camera, [[1.2 * power] * 3] * 9, size=rig.size)
    write_capture(Capture(torch.rand(9, 16, 16, 3), views, "srgb", calibration="photos"), tmp_path / "made")
    path = tmp_path / "made" / "capture.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"rig": rig_to_json(rig)}))
    assert rig_of(path.parent).poses.keys() == rig.poses.keys()
    found = compare_with_truth(path.parent, truth)
    assert found["power"]["ratio"] == pytest.approx(1.2) and found["power"]["spread"] < 1e-9
    shot = true_capture(path.parent, truth, index=[0, 5])
    assert shot.calibration == "given" and shot.transfer == "srgb" and len(shot) == 2
    true = shot.views.in_patch_sides()
    np.testing.assert_allclose(true.camera, camera[[0, 5]] / rig.size, atol=1e-9)
    np.testing.assert_allclose(true.light, light[[0, 5]] / rig.size, atol=1e-9)
    np.testing.assert_allclose(true.intensity, power / rig.size**2, rtol=1e-9)


def test_truths_that_do_not_belong(truth, tmp_path):
    rig = sheets(truth)
    with pytest.raises(CaptureError, match="photos of"):
        compare_with_truth(replace(rig, lens=replace(rig.lens, size=(40, 30))), truth)
    with pytest.raises(CaptureError, match="photos that the truth tells of"):
        compare_with_truth(replace(rig, poses={"other.jpg": rig.poses["IMG_0001.jpg"]}), truth)
    with pytest.raises(CaptureError, match=r"truth\.json"):
        Truth.read(tmp_path / "nothing")
    with pytest.raises(CaptureError, match="capture.json with a rig"):
        rig_of(tmp_path)
    assert similarity(rig, truth) == Similarity()
