"""The command line as a user meets it: a whole round on made photos, and every mistake as one message with exit code 2."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import flat
from mitsvbrdf.system import images, result_folder

FAST = ["--method", "direct", "--renderer", "analytic", "--iterations", "3"]


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """A capture of nine photos of the builtin inlay, 48 px, made by `synth`."""
    folder = tmp_path_factory.mktemp("capture") / "photos"
    assert cli.main(["synth", "builtin:inlay", "-o", str(folder), "--resolution", "48", "--noise", "0.002"]) == 0
    return folder


@pytest.fixture
def copy(shots, tmp_path):
    """A copy of the capture to spoil, its JSON as a dict, and a way to write the JSON back."""
    folder = tmp_path / "shots"
    (folder / "target").mkdir(parents=True)
    for photo in (shots / "target").iterdir():
        (folder / "target" / photo.name).write_bytes(photo.read_bytes())
    stated = json.loads((shots / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps(stated))
    return folder, stated, lambda: (folder / "capture.json").write_text(json.dumps(stated))


def fails(capsys, tmp_path, arguments, *words):
    """The command exits with 2, prints one error that has these words, and leaves nothing behind."""
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert cli.main([str(a) for a in arguments]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and "Traceback" not in message
    for word in words:
        assert word in message, message
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("options, losses", [
    ([], {"cost"}), (["--method", "hybrid", "--width", "8"], {"photometric", "diffuse", "adversarial"})])
def test_a_whole_round(options, losses, shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--iterations", "12", "--resolution", "48", *options]) == 0
    written = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    for stem in ("maps/diffuse", "maps/specular", "maps/roughness", "maps/normal", "guess/diffuse",
                 *(f"rerendered/{i:02d}" for i in range(9))):
        assert {f"{stem}.exr", f"{stem}.png"} <= written
    assert {"sheet.png", "curve.svg", "scene.xml", "fit.json", "checkpoint.safetensors"} <= written
    assert not result_folder.partial_folder(out).exists()
    record = json.loads((out / "fit.json").read_text())
    assert record["schema_version"] == 1 and record["stopped"] == "iterations" and record["seed"] == 0
    assert record["renderer"] == "mitsuba" and record["variant"] == "llvm_ad_rgb" and record["bsdf"] == "roughconductor"
    assert record["versions"]["mitsuba"] and record["machine"]["libllvm"] and record["left_out"]
    assert set(record["per_photo"]) == {f"{i:02d}" for i in range(9)}
    for entry in record["trace"][1:]:
        assert {"seconds", "iteration", "rerender_rmse"} | losses <= set(entry)

    # `evaluate` finds the same error from the files alone, with the flash offset that fit.json keeps.
    figures = tmp_path / "e.json"
    assert cli.main(["evaluate", str(out), "--capture", str(shots), "--json", str(figures)]) == 0
    found = json.loads(figures.read_text())
    assert found["rerender_rmse"] == pytest.approx(record["rerender_rmse"], rel=1e-4)
    assert set(found["per_photo"]) == set(record["per_photo"])

    assert cli.main(["evaluate", str(out), "--reference", "builtin:inlay", "--json", str(figures)]) == 0
    assert set(json.loads(figures.read_text())) == {"diffuse", "specular", "roughness", "normal", "mean"}

    for extra in ([], ["--diffuse", "guessed"]):
        folder = tmp_path / f"relit{len(extra)}"
        assert cli.main(["render", str(out), "--views", str(shots), "-o", str(folder), *extra]) == 0
        assert len(list(folder.glob("*.exr"))) == 9

    # Rendering the fitted maps for the views of the fit gives the files of `rerendered` but for the flash offset.
    a = images.read_image(tmp_path / "relit0/00.exr", ValueError)
    b = images.read_image(out / "rerendered/00.exr", ValueError)
    assert (a - b).abs().mean() < 0.1 * b.mean()


def test_principled_writes_its_own_maps_too(shots, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--bsdf", "principled", *FAST, "--views", "0,3,5"]) == 0
    for name in ("base_color", "metallic", "roughness", "normal", "diffuse", "specular"):
        assert (out / "maps" / f"{name}.exr").is_file() and (out / "maps" / f"{name}.png").is_file()
    assert load_maps(out).bsdf == "principled" and load_maps(out, "roughconductor").bsdf == "roughconductor"
    assert sorted(p.stem for p in (out / "rerendered").glob("*.png")) == ["00", "03", "05"]


@pytest.mark.parametrize("bsdf", ["roughconductor", "principled"])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_plain_mitsuba_renders_the_exported_scene(bsdf, variant, shots, tmp_path):
    # Nothing of this package in that process; a photo from off centre, or a shift of wrong sign would not show. Measured:
    # 3e-6 on average.
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--bsdf", bsdf, *FAST, "--views", "1,3"]) == 0
    code = f"""
import mitsuba as mi, numpy as np
mi.set_variant({variant!r})
image = np.array(mi.render(mi.load_file({str(out / 'scene.xml')!r})))
expected = np.array(mi.Bitmap({str(out / 'rerendered/01.exr')!r}))
error = (np.abs(image - expected) / expected.clip(1e-4)).mean()
assert error < 3e-5, error
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=os.environ)


def test_resume_goes_on_and_needs_a_checkpoint(shots, tmp_path, capsys):
    out, whole = tmp_path / "out", tmp_path / "whole"
    gan = ["--method", "gan", "--width", "8"]
    fails(capsys, tmp_path, ["fit", shots, "-o", out, "--resume", *FAST], "checkpoint")
    assert cli.main(["fit", str(shots), "-o", str(out), *gan, "--iterations", "4"]) == 0
    assert cli.main(["fit", str(shots), "-o", str(out), *gan, "--iterations", "8", "--resume"]) == 0
    assert cli.main(["fit", str(shots), "-o", str(whole), *gan, "--iterations", "8"]) == 0
    a, b = (load_maps(p) for p in (out, whole))
    assert all(torch.equal(a[name], b[name]) for name in a.maps)


def test_an_unfinished_fit_is_not_thrown_away(shots, tmp_path, capsys):
    out = tmp_path / "out"
    partial = result_folder.partial_folder(out)
    assert cli.main(["fit", str(shots), "-o", str(tmp_path / "done"), *FAST]) == 0
    partial.mkdir(parents=True)
    (tmp_path / "done" / result_folder.CHECKPOINT).rename(partial / result_folder.CHECKPOINT)
    for command in (["fit", shots, "-o", out, *FAST], ["guess", shots, "-o", out]):
        fails(capsys, tmp_path, command, "--resume")
    assert cli.main(["fit", str(shots), "-o", str(out), *FAST, "--resume"]) == 0
    assert not partial.exists() and (out / "fit.json").is_file()


def test_results_are_only_replaced_when_asked(shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["guess", str(shots), "-o", str(out), "--method", "min"]) == 0
    for command in (["fit", shots, "-o", out, *FAST], ["guess", shots, "-o", out], ["render", "builtin:tiles", "-o", out],
                    ["synth", "builtin:tiles", "-o", out]):
        fails(capsys, tmp_path, command, "--overwrite")
    assert cli.main(["guess", str(shots), "-o", str(out), "--overwrite"]) == 0


def test_results_do_not_go_among_the_photos(shots, tmp_path, capsys):
    for out in (shots, shots / "target"):
        fails(capsys, tmp_path, ["fit", shots, "-o", out, "--overwrite", *FAST], "photos")


def test_the_last_method_counts(shots, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--method", "gan", *FAST]) == 0
    record = json.loads((out / "fit.json").read_text())
    assert record["method"] == "direct" and record["views"]["falloff"] == "inverse-square"


def test_evaluate_and_render_remember_how_the_fit_saw_its_photos(shots, tmp_path):
    out, relit, figures = tmp_path / "out", tmp_path / "relit", tmp_path / "e.json"
    command = ["fit", str(shots), "-o", str(out), *FAST, "--falloff", "none", "--transfer", "srgb", "--resolution", "48"]
    assert cli.main(command) == 0
    assert cli.main(["render", str(out / "maps"), "--views", str(shots), "-o", str(relit), "--renderer", "analytic"]) == 0
    for kind in ("exr", "png"):
        a, b = (images.read_image(folder / f"05.{kind}", ValueError) for folder in (relit, out / "rerendered"))
        assert (a - b).abs().max() < (1e-4 * b.max() if kind == "exr" else 1.5 / 255)
    assert cli.main(["evaluate", str(out), "--capture", str(shots), "--json", str(figures)]) == 0
    expected = json.loads((out / "fit.json").read_text())["rerender_rmse"]
    assert json.loads(figures.read_text())["rerender_rmse"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("place", ["", "maps"])
@pytest.mark.parametrize("stated", [None, "gamma 2.2", "gamma2.2", "linear"])
def test_roughness_is_counted_as_the_reference_stores_it(place, stated, tmp_path):
    # 8-bit 128 is r = 0.2195 under gamma 2.2 and 0.502 as it is; against r = 0.5 stored values differ by the same 0.2278 or 0.
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


@pytest.mark.parametrize("text", ['{"bsdf": "gold"}', '{"bsdf": ["x"]}', '{"encoding": {"diffuse": 5}}', "[]", "{"])
def test_bad_material_json(text, tmp_path, capsys):
    save_maps(flat(8), tmp_path / "maps")
    (tmp_path / "maps/material.json").write_text(text)
    fails(capsys, tmp_path, ["render", tmp_path / "maps", "-o", tmp_path / "out"], "material.json")


@pytest.mark.parametrize("text", ["[1]", '{"views": []}', "{"])
def test_bad_fit_json(text, shots, tmp_path, capsys):
    save_maps(flat(8), tmp_path / "maps")
    (tmp_path / "fit.json").write_text(text)
    fails(capsys, tmp_path, ["evaluate", tmp_path / "maps", "--capture", shots, "--renderer", "analytic"], "fit.json")


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


def spoil_shape(folder, stated):
    for photo in (folder / "target").iterdir():
        cv2.imwrite(str(photo), np.zeros((48, 64, 3), np.uint8))


def spoil_pixel(folder, stated):
    for photo in (folder / "target").iterdir():
        cv2.imwrite(str(photo), np.zeros((1, 1, 3), np.uint8))


@pytest.mark.parametrize("spoil, words", [
    (spoil_photos, ["00"]), (spoil_text, ["04.jpg"]), (spoil_sizes, ["03.png"]), (spoil_rows, ["8", "9"]),
    (spoil_nan, ["camera 5"]), (spoil_below, ["camera 2", "above"]), (spoil_shape, ["square"]), (spoil_pixel, ["1 x 1"]),
])
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
    (["--iterations", "0"], "iterations"), (["--budget", "-5"], "budget"), (["--learning-rate", "-1"], "learning_rate"),
])
def test_bad_options(shots, wrong, word, tmp_path, capsys):
    command = ["fit", shots, "-o", tmp_path / "out", "--method", "direct", "--renderer", "analytic", *wrong]
    fails(capsys, tmp_path, command, word)


def test_noise_that_is_no_number(tmp_path, capsys):
    for noise in ("nan", "inf", "-1"):
        fails(capsys, tmp_path, ["synth", "builtin:tiles", "-o", tmp_path / "out", "--noise", noise], "noise")


def test_names_the_system_refuses(shots, tmp_path, capsys):
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / ("n" * 300), *FAST], "nnn")
    fails(capsys, tmp_path, ["fit", tmp_path / ("n" * 300), "-o", tmp_path / "out", *FAST], "nnn")
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / "out", *FAST, "--fix", "diffuse=" + "n" * 300], "diffuse", "nnn")


def test_unknown_builtin_and_neither_reference_nor_capture(tmp_path, capsys):
    fails(capsys, tmp_path, ["render", "builtin:gold", "-o", tmp_path / "out"], "gold")
    fails(capsys, tmp_path, ["evaluate", "builtin:tiles"], "--reference")


def test_output_that_cannot_be_written(shots, tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / "file", *FAST], "file")
    fails(capsys, tmp_path, ["fit", shots, "-o", tmp_path / "file/out", *FAST], "file")
    if Path("/dev/full").exists() and Path("/proc/1").exists():
        fails(capsys, tmp_path, ["fit", shots, "-o", "/proc/out", *FAST], "/proc/out")


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


@pytest.mark.parametrize("command", ["fit", "guess", "render", "evaluate", "synth", "pretrain", "doctor", "demo"])
def test_help(command, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    assert stop.value.code == 0 and "usage: mitsvbrdf" in capsys.readouterr().out


def test_help_shows_the_options_of_the_method(capsys):
    with pytest.raises(SystemExit):
        cli.main(["fit", "--method", "gan", "--help"])
    text = capsys.readouterr().out
    assert "--preset" in text and "--flash-offset" not in text


@pytest.mark.parametrize("command", [
    ["crosscheck", "--json"], ["crosscheck", "--html"], ["leave-out", "--json"], ["leave-out", "--md"], ["stability", "--json"],
    ["stability", "--html"], ["stability", "--md"], ["evaluate", "builtin:tiles", "--reference", "builtin:tiles", "--json"]])
def test_bad_outputs_are_found_before_the_work(command, tmp_path, monkeypatch, capsys):
    for name in ("verify.crosscheck.crosscheck", "verify.leave_out.measure_leave_out", "verify.stability.stability",
                 "cli.evaluate.material_of"):
        monkeypatch.setattr(f"mitsvbrdf.{name}", lambda *_, **__: pytest.fail("worked first"))
    (tmp_path / "file").write_text("mine")
    fails(capsys, tmp_path, [*command, tmp_path], "a file to write")
    fails(capsys, tmp_path, [*command, tmp_path / "file/record"], "file/record")
    if command[:2] == ["stability", "--md"]:
        fails(capsys, tmp_path, [*command, tmp_path / "file"], "without them")


@pytest.mark.parametrize("command, resumes", [("fit", True), ("crosscheck", False), ("leave-out", False), ("stability", False)])
def test_only_a_fit_goes_on_after_ctrl_c(command, resumes, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("tyro.extras.subcommand_cli_from_dict", interrupted)
    assert cli.main([command]) == 130
    said = capsys.readouterr().err
    assert said.startswith("interrupted") and said.count("\n") == 1 and ("--resume" in said) == resumes
