"""Every mistake is one message with exit code 2."""

import json
import os
import shutil
import subprocess
import sys
import warnings

import cv2
import numpy as np
import pytest
import torch
from helpers.commands import FAST, fails

from mitsvbrdf import cli
from mitsvbrdf.errors import InputWarning, plain_warnings, strict
from mitsvbrdf.io import images
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.material.maps import flat


@pytest.fixture
def copy(shots, tmp_path):
    """A copy of the capture to spoil, its JSON as a dict, and a way to write the JSON back."""
    folder = shutil.copytree(shots, tmp_path / "shots")
    stated = json.loads((folder / "capture.json").read_text())
    return folder, stated, lambda: (folder / "capture.json").write_text(json.dumps(stated))


@pytest.mark.parametrize("place", ["", "maps"])
@pytest.mark.parametrize("stated", [None, "gamma 2.2", "gamma2.2", "linear"])
def test_roughness_is_counted_as_the_reference_stores_it(place, stated, tmp_path):
    # 8-bit 128 is r = 0.2195 under gamma 2.2 and 0.502 as it is; against r = 0.5 stored values differ by the
    # same 0.2278 or 0.
    folder = tmp_path / "reference" / place
    folder.mkdir(parents=True)
    for name in ("diffuse", "specular", "roughness"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((8, 8, 3), 128, np.uint8))
    cv2.imwrite(str(folder / "normal.png"), np.full((8, 8, 3), (255, 128, 128), np.uint8))
    if stated:
        (folder / "material.json").write_text(json.dumps({"encoding": {"roughness": stated}}))
    save_maps(flat(8, roughness=0.5), tmp_path / "mine")
    figures = tmp_path / "e.json"
    mine, reference = str(tmp_path / "mine"), str(tmp_path / "reference")
    assert cli.main(["evaluate", mine, "--reference", reference, "--json", str(figures)]) == 0
    expected = abs(128 / 255 - (0.5 if stated == "linear" else 0.5 ** (1 / 2.2)))
    assert json.loads(figures.read_text())["roughness"] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("text", ['{"bsdf": "gold"}', '{"bsdf": ["x"]}', '{"encoding": {"diffuse": 5}}', "[]",
                                  "{"])
def test_bad_material_json(text, tmp_path, capsys):
    save_maps(flat(8), tmp_path / "maps")
    (tmp_path / "maps/material.json").write_text(text)
    fails(capsys, tmp_path, ["render", tmp_path / "maps", "-o", tmp_path / "out"], "material.json")


def test_damaged_photos_are_named_and_refused_when_strict(copy, tmp_path, capsys):
    folder, stated, write = copy
    pixels = cv2.imread(str(folder / "target/02.png"))
    (folder / "target/02.png").unlink()
    data = cv2.imencode(".jpg", pixels)[1].tobytes()
    # too little before its end
    (folder / "target/02.jpg").write_bytes(data[: 2 * len(data) // 3] + b"\xff\xd9")
    command = ["guess", folder, "--resolution", "16", "--method", "min", "-o", tmp_path / "out"]
    fails(capsys, tmp_path, [*command, "--strict"], "02.jpg is damaged", "--strict")
    assert cli.main([str(word) for word in command]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "02.jpg" in line]
    assert len(said) == 1 and said[0].startswith("warning: ") and "02.jpg is damaged" in said[0]


@pytest.mark.parametrize("options, word", [(["fit", "PHOTOS", "--similarity", "1e300"], "similarity"),
    (["fit", "PHOTOS", "--resolution", "1000000"], "resolution"),
    (["fit", "PHOTOS", "--method", "hybrid", "--width", "999999"], "width"),
    (["capture", "PHOTOS", "--sheet", "1e300"], "sheet"),
    (["capture", "PHOTOS", "--sheet", "18", "--depth", "nan"], "depth"),
    (["synth", "builtin:tiles", "--noise", "1e300"], "noise"),
    (["synth", "builtin:tiles", "--noise", "-1"], "noise"),
    (["guess", "PHOTOS", "--resolution", "9" * 30], "resolution"),
    (["relight", "builtin:tiles", "--frames", "9999999999"], "frames"),
    (["crosscheck", "--repeats", "9999999999"], "repeats"), (["demo", "--budget", "nan"], "budget"),
    (["synth", "builtin:tiles", "--handheld", "--centre", "nan", "0"], "--centre of at most"),
    (["evaluate", "builtin:tiles", "--capture", "PHOTOS", "--resolution", "0"], "--resolution of 8 or more")])
def test_absurd_numbers(options, word, shots, tmp_path, capsys):
    command = [shots if each == "PHOTOS" else each for each in options]
    out = [] if options[0] in ("crosscheck", "evaluate") else ["-o", tmp_path / "out"]
    fails(capsys, tmp_path, [*command, *out], word)


@pytest.mark.parametrize("command", ["relight", "export"])
def test_nothing_is_written_inside_a_file(command, tmp_path, capsys):
    (tmp_path / "a.glb").touch()
    fails(capsys, tmp_path, [command, tmp_path / "a.glb"], "which is no folder", "-o FOLDER")


def test_a_warning_is_said_once(capsys):
    with plain_warnings():
        for name in ("a.jpg", "b.jpg", "a.jpg"):
            with strict(False):
                warnings.warn(f"{name} is damaged", InputWarning, stacklevel=1)
    assert capsys.readouterr().err.splitlines() == ["warning: a.jpg is damaged", "warning: b.jpg is damaged"]


def test_too_little_memory_is_one_error(tmp_path, monkeypatch, capsys):
    # What torch says is asked of it; 2^50 bytes are more than any machine has.
    for full in (lambda *_: torch.empty(2**50, dtype=torch.uint8), lambda *_: np.empty(2**60, np.uint8)):
        monkeypatch.setattr("mitsvbrdf.material.made.make_material", full)
        fails(capsys, tmp_path, ["render", "builtin:tiles", "-o", tmp_path / "out", "--renderer", "analytic"],
              "enough memory")


@pytest.mark.parametrize("text", ["[1]", '{"views": []}', "{"])
def test_bad_fit_json(text, shots, tmp_path, capsys):
    save_maps(flat(8), tmp_path / "maps")
    (tmp_path / "fit.json").write_text(text)
    fails(capsys, tmp_path, ["evaluate", tmp_path / "maps", "--capture", shots, "--renderer", "analytic"],
          "fit.json")


def spoil_text(folder, stated):
    (folder / "target/04.png").unlink()
    (folder / "target/04.jpg").write_text("this is text")


def spoil_sizes(folder, stated):
    cv2.imwrite(str(folder / "target/03.png"), np.zeros((40, 40, 3), np.uint8))


def spoil_rows(folder, stated):
    stated["camera_pos"], stated["light_pos"] = stated["camera_pos"][:8], stated["light_pos"][:8]


def spoil_nan(folder, stated):
    stated["camera_pos"][5][1] = float("nan")


def spoil_below(folder, stated):
    stated["camera_pos"][2][2] = -3.0


def spoil_photos(folder, stated):
    for photo in (folder / "target").iterdir():
        photo.unlink()


def spoil_all_sizes(height, width):
    def spoil(folder, stated):
        for photo in (folder / "target").iterdir():
            cv2.imwrite(str(photo), np.zeros((height, width, 3), np.uint8))

    return spoil


@pytest.mark.parametrize("spoil, words", [
    (spoil_photos, ["00"]), (spoil_text, ["04.jpg"]), (spoil_sizes, ["03.png"]), (spoil_rows, ["8", "9"]),
    (spoil_nan, ["camera_pos[5][1]"]), (spoil_below, ["camera 2", "above"]),
    (spoil_all_sizes(48, 64), ["square"]), (spoil_all_sizes(1, 1), ["1 x 1"])])
def test_bad_captures(copy, spoil, words, tmp_path, capsys):
    folder, stated, write = copy
    spoil(folder, stated)
    write()
    fails(capsys, tmp_path, ["fit", folder, "-o", tmp_path / "out", *FAST], *words)


def test_no_photos_at_all(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    fails(capsys, tmp_path, ["fit", tmp_path / "empty", "-o", tmp_path / "out", *FAST], "photos")
    fails(capsys, tmp_path, ["fit", tmp_path / "nowhere", "-o", tmp_path / "out", *FAST], "nowhere")


def test_bad_maps(tmp_path, capsys):
    save_maps(flat(8), tmp_path / "maps")
    spoiled = torch.full((8, 8, 3), 0.5)
    spoiled[2, 3, 1] = float("nan")
    images.write_exr(tmp_path / "maps/diffuse.exr", spoiled)
    fails(capsys, tmp_path, ["render", tmp_path / "maps", "-o", tmp_path / "out"], "NaN", "diffuse")
    fails(capsys, tmp_path, ["evaluate", tmp_path / "maps", "--reference", "builtin:tiles"], "NaN")
    (tmp_path / "maps/normal.exr").unlink()
    (tmp_path / "maps/normal.png").unlink()
    (tmp_path / "maps/diffuse.exr").unlink()
    fails(capsys, tmp_path, ["render", tmp_path / "maps", "-o", tmp_path / "out"], "normal")


@pytest.mark.parametrize("wrong, word", [
    (["--views", "0,1,77"], "77"), (["--views", "0,0,1"], "once"), (["--seed", "99999999999999"], "seed"),
    (["--views", "one"], "one"), (["--resolution", "2"], "2"),
    (["--iterations", "0"], "iterations"), (["--budget", "-5"], "budget"),
    (["--learning-rate", "-1"], "learning_rate"),])
def test_bad_options(shots, wrong, word, tmp_path, capsys):
    command = ["fit", shots, "-o", tmp_path / "out", "--method", "direct", "--renderer", "analytic", *wrong]
    fails(capsys, tmp_path, command, word)


def test_names_the_system_refuses(shots, tmp_path, capsys):
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / ("n" * 300), *FAST], "nnn")
    fails(capsys, tmp_path, ["fit", tmp_path / ("n" * 300), "-o", tmp_path / "out", *FAST], "nnn")
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / "out", *FAST, "--fix", "diffuse=" + "n" * 300],
          "diffuse", "nnn")


def test_unknown_builtin_and_neither_reference_nor_capture(tmp_path, capsys):
    fails(capsys, tmp_path, ["render", "builtin:gold", "-o", tmp_path / "out"], "gold")
    fails(capsys, tmp_path, ["evaluate", "builtin:tiles"], "--reference")


@pytest.mark.slow
def test_without_libllvm_the_analytic_renderer_still_works(shots, tmp_path):
    # A process of its own: Dr.Jit's library is chosen once per process.
    broken = tmp_path / "libLLVM-19.so"
    broken.write_text("no library")
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": str(broken)}

    def run(*arguments):
        return subprocess.run([sys.executable, "-m", "mitsvbrdf", *map(str, arguments)], env=environment,
                              capture_output=True, text=True)

    refused = run("fit", shots, "-o", tmp_path / "a", "--iterations", "2")
    assert refused.returncode == 2 and "libLLVM" in refused.stderr and "Traceback" not in refused.stderr
    assert not (tmp_path / "a").exists() and not (tmp_path / "a.partial").exists()
    assert run("fit", shots, "-o", tmp_path / "b", *FAST).returncode == 0
