"""The command line as a user meets it: a whole round on made photos."""

import json
import os
import subprocess
import sys

import pytest
import torch
from helpers.commands import FAST, fails
from helpers.unfinished import unfinished
from helpers.variants import mostly_slow

from mitsvbrdf import cli
from mitsvbrdf.io import images, results
from mitsvbrdf.material.map_files import load_maps


@pytest.mark.parametrize("options, losses", [([], {"cost"}), pytest.param(
    ["--method", "hybrid", "--width", "8"], {"photometric", "diffuse", "adversarial"},
    marks=pytest.mark.slow)])
def test_a_whole_round(options, losses, shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--iterations", "6", "--resolution", "48",
                     *options]) == 0
    (wrote,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith(f"wrote {out}/"))
    named = wrote.removeprefix(f"wrote {out}/").split(", ")
    assert {"report.html", "maps/", "uncertainty/"} <= set(named) and all((out / name).exists()
                                                                          for name in named)
    written = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    for stem in ("maps/diffuse", "maps/specular", "maps/roughness", "maps/normal", "guess/diffuse",
                 *(f"rerendered/{i:02d}" for i in range(9))):
        assert {f"{stem}.exr", f"{stem}.png"} <= written
    assert {"sheet.png", "scene.xml", "fit.json", "checkpoint.safetensors"} <= written
    assert not results.partial_folder(out).exists()
    record = json.loads((out / "fit.json").read_text())
    assert record["schema_version"] == 1 and record["stopped"] == "iterations" and record["seed"] == 0
    assert record["renderer"] == "mitsuba" and record["variant"] == "llvm_ad_rgb" and record[
        "bsdf"] == "roughconductor"
    assert record["versions"]["mitsuba"] and record["machine"]["libllvm"] and record["omitted"]
    assert set(record["per_photo"]) == {f"{i:02d}" for i in range(9)}
    for entry in record["trace"][1:]:
        assert {"seconds", "iteration", "rerender_rmse"} | losses <= set(entry)

    # `evaluate` finds the same error from the files alone, with the flash offset that fit.json keeps.
    figures = tmp_path / "e.json"
    assert cli.main(["evaluate", str(out), "--capture", str(shots), "--json", str(figures)]) == 0
    found = json.loads(figures.read_text())
    assert found["rerender_rmse"] == pytest.approx(record["rerender_rmse"], rel=1e-4)
    assert set(found["per_photo"]) == set(record["per_photo"])

    assert cli.main(["evaluate", str(out), "--reference", "builtin:inlay", "--json", str(figures),
                     "--overwrite"]) == 0
    assert set(json.loads(figures.read_text())) == {"diffuse", "specular", "roughness", "normal", "mean"}

    for extra in ([], ["--diffuse", "guessed"]):
        folder = tmp_path / f"relit{len(extra)}"
        assert cli.main(["render", str(out), "--views", str(shots), "-o", str(folder), *extra]) == 0
        assert len(list(folder.glob("*.exr"))) == 9

    # Rendering the fitted maps for the views of the fit gives the files of `rerendered` but for the flash
    # offset.
    a = images.read_image(tmp_path / "relit0/00.exr", ValueError)
    b = images.read_image(out / "rerendered/00.exr", ValueError)
    assert (a - b).abs().mean() < 0.1 * b.mean()


def test_principled_writes_its_own_maps_too(shots, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--bsdf", "principled", *FAST, "--views",
                     "0,3,5"]) == 0
    for name in ("base_color", "metallic", "roughness", "normal", "diffuse", "specular"):
        assert (out / "maps" / f"{name}.exr").is_file() and (out / "maps" / f"{name}.png").is_file()
    assert load_maps(out).bsdf == "principled" and load_maps(out, "roughconductor").bsdf == "roughconductor"
    assert sorted(p.stem for p in (out / "rerendered").glob("*.png")) == ["00", "03", "05"]


@pytest.mark.parametrize("bsdf", mostly_slow(["roughconductor", "principled"], "roughconductor"))
def test_plain_mitsuba_renders_the_exported_scene(bsdf, shots, tmp_path):
    # Nothing of this package in that process; a photo from off centre, or a shift of wrong sign would not
    # show. Measured: 3e-6 on average.
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(out), "--bsdf", bsdf, *FAST, "--views", "1,3"]) == 0
    code = f"""
import drjit, mitsuba as mi, numpy as np; drjit.set_thread_count(2)  # on one core load_file waits for ever
for variant in "llvm_ad_rgb", "scalar_rgb":
    mi.set_variant(variant)
    image = np.array(mi.render(mi.load_file({str(out / 'scene.xml')!r}, parallel=False)))
    expected = np.array(mi.Bitmap({str(out / 'rerendered/01.exr')!r}))
    error = (np.abs(image - expected) / expected.clip(1e-4)).mean()
    assert error < 3e-5, (variant, error)
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=os.environ)


@pytest.mark.slow
def test_resume_goes_on_and_needs_a_checkpoint(shots, tmp_path, capsys):
    out, whole = tmp_path / "out", tmp_path / "whole"
    # Nothing here hangs on how much of the run is done: more iterations go on as if they had been asked for
    # at once.
    gan = ["--method", "gan", "--width", "4", "--renderer", "analytic",
           "--views", "0,3", "--resolution", "32"]
    fails(capsys, tmp_path, ["fit", shots, "-o", out, "--resume", *FAST], "checkpoint")
    assert cli.main(["fit", str(shots), "-o", str(out), *gan, "--iterations", "2"]) == 0
    assert cli.main(["fit", str(shots), "-o", str(out), *gan, "--iterations", "4", "--resume"]) == 0
    assert cli.main(["fit", str(shots), "-o", str(whole), *gan, "--iterations", "4"]) == 0
    a, b = (load_maps(p) for p in (out, whole))
    assert all(torch.equal(a[name], b[name]) for name in a.maps)


@pytest.mark.parametrize("generator", mostly_slow(["all-photos", "two-stream"], "two-stream"))
def test_crops_of_one_photo_are_enough(shots, tmp_path, generator):
    # Stationary materials: patches of the one photo stand for the many; the maps are as large as the photo.
    out = tmp_path / "out"
    gan = ["--method", "gan", "--width", "4", "--generator", generator, "--iterations", "6"]
    assert cli.main(["fit", str(shots), "-o", str(out), *gan, "--views", "0", "--crop", "32", "--resolution",
                     "48"]) == 0
    record = json.loads((out / "fit.json").read_text())
    assert record["config"]["crop"] == 32 and list(record["per_photo"]) == ["00"]
    maps = load_maps(out)
    assert maps.resolution == 48 and all(bool(torch.isfinite(value).all()) for value in maps.maps.values())


def test_an_unfinished_fit_is_not_thrown_away(shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["fit", str(shots), "-o", str(tmp_path / "done"), *FAST]) == 0
    partial = unfinished(out)
    (tmp_path / "done" / results.CHECKPOINT).rename(partial / results.CHECKPOINT)
    for command in (["fit", shots, "-o", out, *FAST], ["guess", shots, "-o", out]):
        fails(capsys, tmp_path, command, "--resume")
    assert cli.main(["fit", str(shots), "-o", str(out), *FAST, "--resume"]) == 0
    assert not partial.exists() and (out / "fit.json").is_file()


def test_results_are_only_replaced_when_asked(shots, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["guess", str(shots), "-o", str(out), "--method", "min"]) == 0
    for command in (["fit", shots, "-o", out, *FAST], ["guess", shots, "-o", out],
                    ["render", "builtin:tiles", "-o", out], ["synth", "builtin:tiles", "-o", out]):
        fails(capsys, tmp_path, command, "--overwrite")
    assert cli.main(["guess", str(shots), "-o", str(out), "--overwrite"]) == 0


def test_results_do_not_go_among_the_photos(shots, tmp_path, capsys):
    for out in (shots, shots / "target"):
        fails(capsys, tmp_path, ["fit", shots, "-o", out, "--overwrite", *FAST], "photos")


def test_evaluate_and_render_remember_how_the_fit_saw_its_photos(shots, tmp_path):
    out, relit, figures = tmp_path / "out", tmp_path / "relit", tmp_path / "e.json"
    command = ["fit", str(shots), "-o", str(out), *FAST, "--falloff", "none", "--transfer", "srgb",
               "--resolution", "48"]
    assert cli.main(command) == 0
    assert cli.main(["render", str(out / "maps"), "--views", str(shots), "-o", str(relit), "--renderer",
                     "analytic"]) == 0
    for kind in ("exr", "png"):
        a, b = (images.read_image(folder / f"05.{kind}", ValueError) for folder in (relit,
                                                                                    out / "rerendered"))
        assert (a - b).abs().max() < (1e-4 * b.max() if kind == "exr" else 1.5 / 255)
    assert cli.main(["evaluate", str(out), "--capture", str(shots), "--json", str(figures)]) == 0
    expected = json.loads((out / "fit.json").read_text())["rerender_rmse"]
    assert json.loads(figures.read_text())["rerender_rmse"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("command, resumes", [("fit", True), ("crosscheck", False), ("stability", False)])
def test_only_a_fit_goes_on_after_ctrl_c(command, resumes, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("tyro.cli", interrupted)
    assert cli.main([command]) == 130
    said = capsys.readouterr().err
    assert said.startswith("interrupted") and said.count("\n") == 1 and ("--resume" in said) == resumes
