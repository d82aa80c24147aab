"""Frames on disk: runs that end, go on and are interrupted; options that do not go."""

import contextlib
import errno
import json
import os
import re
import signal
import sys

import numpy as np
import pytest
import torch
from helpers.stages import pictures, srgb
from helpers.unfinished import unfinished
from PIL import Image

from mitsvbrdf.cli.relight import relight
from mitsvbrdf.errors import BackendError, ConfigError, MitsvbrdfError, OutputError
from mitsvbrdf.io import images, results
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.relight import frames as frames_module
from mitsvbrdf.relight.passes import render_frame

SMALL = {"size": "24", "samples": 4}


def run(out, **options):
    return relight("builtin:leather", out=out, **(SMALL | options))


def record(out):
    return json.loads((out / "relight.json").read_text())


def test_stills_open_elsewhere(tmp_path, capsys):
    assert relight("builtin:plates", out=tmp_path / "o", size="40x24", exposure=1.0) == 0
    linear = images.read_image(tmp_path / "o" / "sphere.exr", MitsvbrdfError).numpy()
    with Image.open(tmp_path / "o" / "sphere.png") as image:
        assert image.size == (40, 24) and image.mode == "RGB"
        # exposed by one stop; rounded
        assert np.abs(np.asarray(image) / 255 - srgb(2 * linear)).max() <= 0.51 / 255
    said = capsys.readouterr().out
    frame, = record(tmp_path / "o")["presets"]["sphere"]["frames"]
    assert f"128 samples a pixel, estimated error {frame['error']:.4f}" in said


class StopAfter(list):
    """Asks for an end once it has been looked at so many times."""

    def __init__(self, looks):
        super().__init__()
        self.looks = looks

    def __bool__(self):
        self.looks -= 1
        return self.looks < 0


@pytest.mark.slow
def test_resumed_frames_are_those_of_an_uninterrupted_run(tmp_path, monkeypatch, capsys):
    options = {"preset": "sphere,sweep", "frames": 3, "movie": "mp4,gif"}
    assert run(tmp_path / "whole", **options) == 0
    with monkeypatch.context() as patch:
        patch.setattr("mitsvbrdf.cli.relight.stop_signals",
                      lambda: contextlib.nullcontext(StopAfter(4 * 4 + 1)))
        assert run(tmp_path / "parts", **options) == 0
    assert "--resume" in capsys.readouterr().out
    begun = record(tmp_path / "parts")["presets"]
    assert len(begun["sphere"]["frames"]) == 3 and (tmp_path / "parts" / "sphere.mp4").is_file()
    assert [frame["stopped"] for frame in begun["sweep"]["frames"]] == ["samples", "interrupted"]
    assert len(pictures(tmp_path / "parts", "sweep")) == 2  # the one at hand as it was
    assert not (tmp_path / "parts" / "sweep.mp4").exists()
    first = (tmp_path / "parts" / "sphere" / "0000.exr").stat().st_mtime_ns
    with pytest.raises(ConfigError, match="size"):
        run(tmp_path / "parts", resume=True, **options | {"size": "25"})
    assert run(tmp_path / "parts", resume=True, **options) == 0
    assert (tmp_path / "parts" / "sphere" / "0000.exr").stat().st_mtime_ns == first  # not rendered again
    for preset in ("sphere", "sweep"):
        made, expected = pictures(tmp_path / "parts", preset), pictures(tmp_path / "whole", preset)
        assert len(made) == len(expected) == 3
        for a, b in zip(made, expected):
            assert torch.allclose(a, b, rtol=1e-5, atol=1e-7)  # threads may add in another order
        assert not torch.allclose(expected[0], expected[1], rtol=0.01)
        for kind in ("mp4", "gif"):
            assert (tmp_path / "parts" / f"{preset}.{kind}").is_file()
    assert not list(tmp_path.rglob("*.partial"))


def test_a_killed_run_goes_on_from_its_partial_folder(tmp_path):
    options = {"preset": "sweep", "frames": 2, "movie": "none"}
    run(tmp_path / "whole", **options)
    partial = unfinished(tmp_path / "killed")
    (partial / "sweep").mkdir()
    found = record(tmp_path / "whole")
    found["presets"]["sweep"]["frames"].pop()
    (partial / "relight.json").write_text(json.dumps(found))
    marked = torch.full((24, 24, 3), 0.25)
    images.write_exr(partial / "sweep" / "0000.exr", marked)
    run(tmp_path / "killed", resume=True, **options)
    kept, made = pictures(tmp_path / "killed", "sweep")
    assert torch.equal(kept, marked) and torch.allclose(made, pictures(tmp_path / "whole", "sweep")[1],
                                                        rtol=1e-5, atol=1e-7)


def test_ctrl_c_ends_well(tmp_path, monkeypatch, capsys):
    def pressed(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return render_frame(*arguments, **options)

    monkeypatch.setattr(frames_module, "render_frame", pressed)
    assert run(tmp_path / "o", preset="sphere", samples=8192) == 0
    frame, = record(tmp_path / "o")["presets"]["sphere"]["frames"]
    assert frame["stopped"] == "interrupted"
    assert (tmp_path / "o" / "sphere.png").is_file()
    assert "interrupted" in capsys.readouterr().out


def test_ctrl_c_while_a_frame_is_written_is_heard(tmp_path, monkeypatch):
    def pressed(*arguments):
        signal.raise_signal(signal.SIGINT)
        return write_exr(*arguments)

    write_exr = images.write_exr
    monkeypatch.setattr(images, "write_exr", pressed)
    run(tmp_path / "o", preset="sweep", frames=2)
    frame, = record(tmp_path / "o")["presets"]["sweep"]["frames"]
    assert frame["stopped"] == "samples"  # it was whole


def test_an_end_before_the_next_frame_loses_none(tmp_path, monkeypatch):
    options = {"preset": "sweep", "frames": 2, "movie": "none"}
    run(tmp_path / "o", **options)
    with monkeypatch.context() as patch:
        patch.setattr("mitsvbrdf.cli.relight.stop_signals", lambda: contextlib.nullcontext(StopAfter(0)))
        run(tmp_path / "o", resume=True, **options | {"preset": "sweep,sphere"})
    assert len(pictures(tmp_path / "o",
                        "sweep")) == len(record(tmp_path / "o")["presets"]["sweep"]["frames"]) == 2
    run(tmp_path / "o", resume=True, **options | {"preset": "sweep,sphere"})
    assert len(record(tmp_path / "o")["presets"]["sphere"]["frames"]) == 2


def test_a_run_goes_on_only_with_what_it_had(tmp_path, monkeypatch):
    options = {"preset": "sphere", "out": tmp_path / "o", "environment": str(tmp_path / "sky.exr"), **SMALL}
    save_maps(make_material("leather", 8), tmp_path / "m")
    images.write_exr(tmp_path / "sky.exr", torch.ones(4, 8, 3))
    relight(str(tmp_path / "m"), **options)

    def refused(error, why):
        with pytest.raises(error, match=why):
            relight(str(tmp_path / "m"), resume=True, **options)
        assert not results.partial_folder(tmp_path / "o").exists() and (
            tmp_path / "o" / "sphere.png").is_file()

    with monkeypatch.context() as patch:  # no mistake of the record
        patch.setattr(frames_module.shutil, "copy2", raises(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
        refused(OutputError, "No space left")
    relight(str(tmp_path / "m"), resume=True, **options)
    images.write_exr(tmp_path / "sky.exr", torch.ones(5, 8, 3))
    refused(ConfigError, "another environment_file")
    images.write_exr(tmp_path / "sky.exr", torch.ones(4, 8, 3))
    save_maps(make_material("plates", 8), tmp_path / "m")
    refused(ConfigError, "another material")
    save_maps(make_material("leather", 8), tmp_path / "m")
    (tmp_path / "o" / "sphere.exr").unlink()
    refused(ConfigError, "without sphere.exr")


@pytest.mark.parametrize("name", ["../secret.exr", "linked/secret.exr", "link.exr", "{root}/secret.exr",
                                  "pipe.exr", 5])
def test_a_record_brings_no_file_from_outside(tmp_path, name):
    out, folder = tmp_path / "out", tmp_path / "folder"
    out.mkdir()
    folder.mkdir()
    for secret in ("secret.exr", "secret.png"):
        (tmp_path / secret).write_text("theirs")
    (out / "linked").symlink_to(tmp_path)
    (out / "link.exr").symlink_to(tmp_path / "secret.exr")
    os.mkfifo(out / "pipe.exr")
    name = name.replace("{root}", str(tmp_path)) if isinstance(name, str) else name
    frame = {"frame": 0, "file": name, "stopped": "samples"}
    for presets in ({"sphere": {"frames": [frame]}}, {"../secret": {"frames": []},
                                                      "linked/secret": {"frames": []}}):
        (out / "relight.json").write_text(json.dumps({"settings": {}, "presets": presets}))
        with contextlib.nullcontext() if "../secret" in presets else pytest.raises(ConfigError,
                                                                                   match="relight.json"):
            frames_module.go_on({}, out, folder)
        assert not list(folder.iterdir()) and (tmp_path / "secret.exr").read_text() == "theirs"


def raises(error):
    def function(*_):
        raise error
    return function


def test_explain_renders_nothing(tmp_path, capsys):
    assert run(tmp_path / "o", preset="all", explain=True) == 0
    said = capsys.readouterr().out
    assert re.search(r"^sphere omits: .+ \(.+\)$", said, re.MULTILINE) and not (tmp_path / "o").exists()


@pytest.mark.parametrize("wrong", [{"samples": 0}, {"size": "2"}, {"size": "100000"},
                                   {"size": "3x4x5"}, {"size": "big"},
                                   {"preset": "cube"}, {"movie": "avi"}, {"exposure": 99.0}, {"frames": 0},
                                   {"tiling": 0},
                                   {"environment": "no-such.exr"}, {"environment": ""}, {"seed": -1},
                                   {"out": None}, {"resume": True}])
def test_wrong_options_are_one_error_and_leave_nothing(tmp_path, wrong):
    with pytest.raises(MitsvbrdfError):
        run(**({"out": tmp_path / "o"} | wrong))
    assert not (tmp_path / "o").exists()


def test_movies_without_pyav_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(BackendError, match='pip install "mitsvbrdf.movie."'):
        run(tmp_path / "o", preset="sweep", frames=2)
    assert not (tmp_path / "o").exists()
    assert run(tmp_path / "o", preset="sweep", frames=2,
               movie="gif") == 0 and (tmp_path / "o" / "sweep.gif").is_file()


def test_one_sample_is_too_few_to_estimate_its_error(tmp_path, capsys):
    run(tmp_path / "o", preset="sphere", samples=1)
    assert "1 sample a pixel, too few to estimate the error" in capsys.readouterr().out
    assert record(tmp_path / "o")["presets"]["sphere"]["frames"][0]["error"] is None
