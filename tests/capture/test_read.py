"""Reading and writing captures: the three formats, and a clear error for each mistake."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from helpers.stated_captures import CAMERA, LIGHT, json_capture, photos, save, text_capture

from mitsvbrdf.capture import Capture, read_capture, write_capture
from mitsvbrdf.errors import CaptureError, ConfigError
from mitsvbrdf.io import images
from mitsvbrdf.views import Views


def fails(folder, *culprits, **options):
    with pytest.raises(CaptureError) as caught:
        read_capture(folder, **options)
    for culprit in culprits:
        assert culprit in str(caught.value)


def same_views(a: Views, b: Views) -> bool:
    return (torch.equal(a.camera, b.camera) and torch.equal(a.light, b.light)
            and torch.equal(a.intensity, b.intensity) and a.size == b.size and a.falloff == b.falloff)


def test_json_capture(tmp_path):
    images = photos()
    capture = read_capture(json_capture(tmp_path, images), falloff="none")
    assert np.array_equal((capture.photos * 255).round().numpy(), images)
    assert capture.photos.dtype == torch.float32 and np.array_equal(capture.stored.numpy(), images)
    assert capture.views.camera.tolist() == CAMERA and capture.views.light.tolist() == LIGHT
    assert capture.views.intensity.tolist() == [[1500.0, 1400.0, 1300.0]] * 3
    assert (capture.views.size, capture.views.falloff, capture.transfer) == (6.848, "none", "gamma2.2")
    assert (capture.index, capture.calibrated, capture.source, capture.notes) == ((0, 1, 2), True, tmp_path,
                                                                                  ())
    assert same_views(read_capture(tmp_path / "capture.json", falloff="none").views, capture.views)


def test_json_idx_picks_rows_and_photos(tmp_path):
    images = photos()
    capture = read_capture(json_capture(tmp_path, images, idx=[2, 0], light_pos=..., light_pow=7))
    assert capture.index == (2, 0) and capture.views.camera.tolist() == [CAMERA[2], CAMERA[0]]
    assert torch.equal(capture.views.camera, capture.views.light)
    assert capture.views.intensity.tolist() == [[7.0] * 3] * 2
    assert np.array_equal((capture.photos * 255).round().numpy(), images[[2, 0]])
    json_capture(tmp_path, images, idx=[2, 10**15], camera_pos=..., light_pos=..., light_pow=...)
    (tmp_path / "target" / "00.png").rename(tmp_path / "target" / f"{10**15}.png")
    assert read_capture(tmp_path).index == (2, 10**15)  # its number needs no rows up to it


@pytest.mark.parametrize("separator", [", ", "\t"])
def test_text_capture_agrees_with_json(tmp_path, separator):
    a = read_capture(json_capture(tmp_path / "a"))
    b = read_capture(text_capture(tmp_path / "b", separator=separator))
    assert torch.equal(a.photos, b.photos) and same_views(a.views, b.views) and a.transfer == b.transfer


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_and_remarks_are_read_over(encoding, tmp_path):
    # Notepad writes the first, PowerShell's > the second, numpy.savetxt a header behind "#".
    a, b = text_capture(tmp_path / "a"), text_capture(tmp_path / "b")
    for path in b.glob("*.txt"):
        path.write_bytes(("# x y z\r\n" + path.read_text().replace("\n", "\r\n") + "\r\n").encode(encoding))
    assert same_views(read_capture(a).views, read_capture(b).views)


def test_the_own_files_of_svbrdf_diff_renderer_are_found(tmp_path):
    expected = read_capture(json_capture(tmp_path))
    stated = (tmp_path / "capture.json").read_text()
    (tmp_path / "capture.json").unlink()
    for name in ("optim_latent_256.json", "optim_pixel_256_to_512.json"):
        (tmp_path / name).write_text(stated)
    (tmp_path / "notes.json").write_text("[]")
    found = read_capture(tmp_path)
    assert same_views(found.views, expected.views) and torch.equal(found.photos, expected.photos)
    assert found.notes == ("the calibration is that of optim_latent_256.json",)
    notes = read_capture(tmp_path / "target").notes
    assert any(note.startswith("../optim_latent_256.json states views of these photos") for note in notes)
    assert str(tmp_path) not in "".join(notes)
    (tmp_path / "optim_pixel_256_to_512.json").write_text(stated.replace("6.848", "7"))
    fails(tmp_path, "optim_latent_256.json, optim_pixel_256_to_512.json", "differ")
    assert same_views(read_capture(tmp_path / "optim_latent_256.json").views, expected.views)


def test_text_capture_without_light_pos_and_with_power_rows(tmp_path):
    capture = read_capture(text_capture(tmp_path, light_pos=None, light_power="1,2,3\n4,5,6\n7,8,9"))
    assert torch.equal(capture.views.camera, capture.views.light)
    assert capture.views.intensity.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]


def test_jpeg_photos_and_other_images_beside(tmp_path):
    text_capture(tmp_path, images=photos()[:0])
    save(tmp_path, photos(), ".jpg")
    cv2.imwrite(str(tmp_path / "tex.png"), photos()[0])
    assert len(read_capture(tmp_path)) == 3


def test_transfer_explicit_wins_over_stated_over_default(tmp_path):
    json_capture(tmp_path / "a", transfer="srgb")
    assert read_capture(tmp_path / "a").transfer == "srgb"
    assert read_capture(tmp_path / "a", transfer="linear").transfer == "linear"
    save(tmp_path / "b", photos(1))
    assert read_capture(tmp_path / "b").transfer == "srgb"


def test_photos_never_grow(tmp_path):
    json_capture(tmp_path)
    own = read_capture(tmp_path, resolution=64)
    assert own.resolution == 16 and "not enlarged to 64" in own.notes[0]


def test_index_picks_photos(tmp_path):
    json_capture(tmp_path)
    assert read_capture(tmp_path, index=(2, 1)).index == (2, 1)
    fails(tmp_path, "[5]", index=(0, 5))


def test_round_trip(tmp_path):
    intensity = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 1 / 3]])
    views = Views.of(CAMERA, LIGHT, intensity, 6.848)
    shots = torch.from_numpy(photos()).float() / 255
    capture = Capture(shots, views, "srgb, gamma 1.0800, shoulder 0.1200", (4, 0, 7))  # as a fit found it
    write_capture(capture, tmp_path / "out")
    back = read_capture(tmp_path / "out")
    assert torch.equal(back.photos, shots) and same_views(back.views, views)
    assert back.index == (0, 1, 2) and back.calibrated and back.transfer == capture.transfer
    assert len(json.loads((tmp_path / "out" / "capture.json").read_text())["light_pow"]) == 3
    write_capture(capture.but(photos=shots / 9, transfer=f"linear{capture.transfer[4:]}"), tmp_path / "dark")
    assert (read_capture(tmp_path / "dark").photos - shots / 9).abs().max() < 1 / 65535


def test_round_trip_of_equal_lights_and_of_the_default_geometry(tmp_path):
    write_capture(read_capture(json_capture(tmp_path / "a")), tmp_path / "b")
    assert json.loads((tmp_path / "b" / "capture.json").read_text())["light_pow"] == [1500.0, 1400.0, 1300.0]
    save(tmp_path / "c", photos(1))
    plain = read_capture(tmp_path / "c")
    write_capture(plain.but(views=plain.views.to(torch.float32)), tmp_path / "d")
    back = read_capture(tmp_path / "d")
    assert not back.calibrated and same_views(back.views, plain.views) and back.photos.equal(plain.photos)
    brighter = replace(plain.views, intensity=2 * plain.views.intensity)
    write_capture(plain.but(views=brighter), tmp_path / "e")
    assert same_views(read_capture(tmp_path / "e").views, brighter)


def test_no_folder_and_no_photos(tmp_path):
    fails(tmp_path / "nowhere", "nowhere")
    fails(tmp_path, "none in", str(tmp_path))
    (tmp_path / "note.txt").write_text("x")
    fails(tmp_path / "note.txt", "note.txt")


@pytest.mark.parametrize("make", [json_capture, text_capture])
def test_photos_of_different_sizes_or_not_square(tmp_path, make):
    unlike = [*photos(2), photos(1, 20)[0]]
    fails(make(tmp_path / "a", unlike), "00.png", "16 x 16", "02.png", "20 x 20")
    fails(make(tmp_path / "b", photos()[:, :12]), "00.png", "16 x 12")


@pytest.mark.parametrize("make",
                         [json_capture, text_capture, lambda path, images: save(path, images) or path])
def test_one_pixel_photo(tmp_path, make):
    fails(make(tmp_path, photos(3, 1)), "00.png", "1 x 1")


def test_counts_of_rows_and_photos(tmp_path):
    images = photos(9)
    rows = [[0.0, 0.0, 9.0]] * 8
    text = "\n".join("0,0,9" for _ in range(8))
    fails(json_capture(tmp_path / "a", images, camera_pos=rows, light_pos=..., idx=list(range(9))), "9",
          "8 rows")
    fails(json_capture(tmp_path / "b", images, camera_pos=rows, light_pos=..., idx=...), "9 photos", "8 rows")
    fails(text_capture(tmp_path / "c", images, camera_pos=text, light_pos=None), "9 photos", "8 rows",
          "camera_pos.txt")
    fails(text_capture(tmp_path / "d", photos(4)), "4 photos", "3 rows")
    fails(json_capture(tmp_path / "e", light_pos=LIGHT[:2]), "light_pos", "3 cameras", "2 rows")
    fails(text_capture(tmp_path / "f", light_pos="0 0 1"), "light_pos", "1 rows")
    fails(json_capture(tmp_path / "g", light_pow=[[1, 1, 1]] * 2), "light_pow", "2 rows")


def test_photos_numbered_from_one_have_the_rows_in_order(tmp_path):
    json_capture(tmp_path, photos(3))
    for number in (2, 1, 0):
        next((tmp_path / "target").glob(f"{number:02d}.*")).rename(tmp_path / f"target/{number + 1:02d}.png")
    for calibrated in (True, False):
        stated = json.loads((tmp_path / "capture.json").read_text())
        kept = stated if calibrated else {"target_dir": stated["target_dir"]}
        (tmp_path / "capture.json").write_text(json.dumps({k: v for k, v in kept.items() if k != "idx"}))
        found = read_capture(tmp_path)
        assert found.index == (1, 2, 3) and found.calibrated == calibrated
        if calibrated:
            assert found.views.camera.tolist() == stated["camera_pos"]


@pytest.mark.parametrize("camera, intensity", [(torch.ones(3, 4), 1.0), (torch.ones(4, 3), torch.ones(3, 1)),
                                               (torch.ones(2, 2, 3), 1.0), (torch.ones(4, 3), torch.ones(4))])
def test_views_of_another_shape_are_refused(camera, intensity):
    with pytest.raises(CaptureError, match="three numbers"):
        Views.of(camera, intensity=intensity)


def test_lights_of_one_number_are_white():
    assert Views.of(torch.ones(3, 3), intensity=[[1.0], [2.0], [4.0]]).intensity.tolist() == [
        [1.0] * 3, [2.0] * 3, [4.0] * 3]


def test_photo_named_by_idx_is_missing(tmp_path):
    fails(json_capture(tmp_path, photos(2)), "02.png")
    fails(json_capture(tmp_path, target_dir="elsewhere"), "elsewhere")
    fails(json_capture(tmp_path, idx=[0, 7], camera_pos=..., light_pos=..., light_pow=...), "07.png", "idx")


def test_one_number_twice(tmp_path):
    json_capture(tmp_path)
    cv2.imwrite(str(tmp_path / "target" / "00.jpg"), photos()[0])
    fails(tmp_path, "00.jpg", "00.png")


def test_nan_and_camera_below_the_plane(tmp_path):
    nan = [0, 0, float("nan")]
    fails(json_capture(tmp_path / "a", camera_pos=[nan, *CAMERA[1:]]), "camera_pos[0][2]", "no finite number",
          "capture.json")
    fails(text_capture(tmp_path / "b", camera_pos="0,0,9\n0,nan,9\n0,0,9"), "camera_pos.txt", "nan")
    fails(json_capture(tmp_path / "c", camera_pos=[*CAMERA[:2], [0, 0, -17]]), "camera 2", "-17")
    fails(text_capture(tmp_path / "d", light_pos="0,0,9\n0,0,0\n0,0,9"), "light 1")
    fails(json_capture(tmp_path / "e", im_size=0), "size")
    fails(json_capture(tmp_path / "f", light_pow=-1), "light 0")


def test_the_result_of_a_fit_is_no_capture(tmp_path):
    images.write_png(tmp_path / "sheet.png", torch.rand(64, 64, 3))
    assert len(read_capture(tmp_path)) == 1
    (tmp_path / "fit.json").write_text("{}")
    fails(tmp_path, "the result of a fit")


@pytest.mark.parametrize("key", ["target_dir", "im_size", "camera_pos", "light_pow"])
def test_missing_key(tmp_path, key):
    fails(json_capture(tmp_path, **{key: ...}), repr(key), "capture.json")


@pytest.mark.parametrize(("key", "value"),
                         [("target_dir", 3), ("im_size", "6"), ("im_size", None), ("im_size", [1]),
                          ("idx", "0"), ("idx", []), ("idx", [0.5]), ("idx", [-1]), ("idx", [True]),
                          ("camera_pos", 3), ("camera_pos", []), ("camera_pos", [[1, 2]] * 3),
                          ("camera_pos", [[1, 2, "3"]] * 3), ("camera_pos", {"0": [1, 2, 3]}),
                          ("light_pos", None), ("light_pow", [1, 2]), ("light_pow", [[1, 2]]),
                          ("light_pow", "bright"), ("light_pow", []), ("light_pow", 10**400),
                          ("transfer", "log"), ("transfer", ["srgb"]),
                          ("transfer", "srgb, gamma 0.0, shoulder 0.0")])
def test_value_of_the_wrong_type(tmp_path, key, value):
    fails(json_capture(tmp_path, **{key: value}), key, "capture.json")


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"3", b"\xff\xfe\x00", b"[" * 100_000])
def test_broken_json(tmp_path, data):
    (json_capture(tmp_path) / "capture.json").write_bytes(data)
    fails(tmp_path, "capture.json")


@pytest.mark.parametrize(("name", "text"),
                         [("camera_pos", "a,b,c"), ("camera_pos", ""), ("camera_pos", "1,2\n3,4\n5,6"),
                          ("light_pos", "x"), ("image_size", "1 2"), ("image_size", "wide"),
                          ("image_size", None), ("light_power", None), ("light_power", "1,2")])
def test_broken_text(tmp_path, name, text):
    folder = text_capture(tmp_path, **{name: text})
    fails(folder, str(tmp_path), {"light_power": "light_pow"}.get(name, name))


def test_options_out_of_range(tmp_path):
    json_capture(tmp_path)
    for wrong in ({"resolution": 4}, {"transfer": "log"}, {"falloff": "linear"}):
        with pytest.raises(ConfigError, match=str(next(iter(wrong.values())))):
            read_capture(tmp_path, **wrong)


def test_a_lone_photo_is_read_as_the_only_one_of_its_folder(tmp_path):
    picture = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "one.png"), picture)
    alone, within = read_capture(tmp_path / "one.png"), read_capture(tmp_path)
    assert torch.equal(alone.photos, within.photos) and same_views(alone.views, within.views)
    assert alone.notes == within.notes and not alone.calibrated
    (tmp_path / "words.txt").write_text("none")
    fails(tmp_path / "words.txt", "a photo or a folder")


@pytest.mark.parametrize("names", [("diffuse.png", "normal.png", "roughness.png"),
                                   ("wood_diff_1k.jpg", "wood_nor_gl_1k.exr", "wood_rough_1k.exr")])
def test_maps_are_no_photos(tmp_path, names):
    for name in names:
        picture = cv2.imencode(".png", np.full((64, 64, 3), 128, np.uint8))[1]
        (tmp_path / name).write_bytes(picture.tobytes())  # only names tell what it is
    with pytest.raises(CaptureError, match="got the maps of a material in .*; give photos"):
        read_capture(tmp_path)
    (tmp_path / "a.glb").write_bytes(b"glTF")
    with pytest.raises(CaptureError, match="got the file .*a.glb; give photos"):
        read_capture(tmp_path / "a.glb")
