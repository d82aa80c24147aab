"""What `fit` says before it begins and when it has ended."""

import importlib
import shutil
from types import SimpleNamespace

import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.cli.fit import PROCESS, _say_result, check_room, with_flags
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit.checkpoint import load_tensors

ENDED = {"calibrated_rmse": None, "per_photo": [0.01], "rerender_rmse": 0.01, "deviations": {},
         "deviations_with_look_alikes": {}, "warnings": (),
         "record": {"confidence": {}, "calibration": {"log_power_sd": None}},
         "trace": [{"seconds": 31.4, "iteration": 90}]}
SHOTS = SimpleNamespace(names=("00",), views=SimpleNamespace(falloff="inverse-square"))


@pytest.mark.parametrize("stopped, before, words", [
    ("settled", None, "settled after 31 s: it ended by itself"), ("settled", 60, "settled after 31 s"),
    ("settled", 90, "settled after 31 s"), ("budget", 90, "nothing was left to do"), ("budget", 60, None),
    ("budget", None, None), ("unstable", 90, None), ("interrupted", None, "the best result so far")])
def test_how_it_ended(stopped, before, words, capsys):
    _say_result(SimpleNamespace(**ENDED, stopped=stopped), SHOTS,
                before and {"iteration": before, "trace": ENDED["trace"], "lacked": []})
    said = capsys.readouterr().out
    assert ("settled" in said) == bool(words and words.startswith("settled"))
    assert ("nothing was left" in said) == bool(words and words.startswith("nothing"))
    assert (words or "Re-rendering RMSE") in said


@pytest.mark.parametrize("sd, said", [(None, ""), (0.4, "light power, known to a factor of 1.5;")])
def test_the_light_power_is_beside_the_deviations_where_it_is_guessed(sd, said, capsys):
    told = {"record": {"confidence": {}, "calibration": {"log_power_sd": sd}}, "stopped": "settled"}
    _say_result(SimpleNamespace(**ENDED | told), SHOTS, None)
    shown = capsys.readouterr().out
    assert said in shown and ("light power" in shown) is bool(sd)


def test_help_shows_research_options_only_when_asked(capsys):
    for advanced in ((), ("--advanced",)):
        with pytest.raises(SystemExit) as stop:
            cli.main(["fit", *advanced, "--help"])
        shown = capsys.readouterr().out
        assert stop.value.code == 0 and "--budget" in shown
        assert ("--highlight-reach" in shown) == bool(advanced)


def test_the_first_stage_of_two_by_either_name(shots, tmp_path, capsys, monkeypatch):
    options = ["--resolution", "16", "--renderer", "analytic", "--iterations", "1", "--width", "4"]
    named = ["fit", str(shots), "-o", str(tmp_path / "a.safetensors"), "--method", "gan", "--preset",
             "paper-two-stage", "--pretrain"]
    assert cli.main([*named, *options]) == 0 and "early" not in capsys.readouterr().out
    assert cli.main(["pretrain", str(shots), "-o", str(tmp_path / "b.safetensors"), *options]) == 0
    assert "pretrain is now fit --method gan" in capsys.readouterr().err
    first, second = (load_tensors(tmp_path / name)[0] for name in ("a.safetensors", "b.safetensors"))
    assert first and all(torch.equal(first[name], value) for name, value in second.items())
    assert cli.main(["fit", str(shots), "-o", str(tmp_path / "c.safetensors"), "--pretrain"]) == 2
    assert "--method gan beside --pretrain" in capsys.readouterr().err
    monkeypatch.setattr("mitsvbrdf.fit.loop.Loop.run", lambda loop: "interrupted")
    assert cli.main([*named, *options, "--overwrite"]) == 0 and "ended early" in capsys.readouterr().out


def test_flags_that_the_fit_decides_unless_told():
    for name in ("exact", "stationary", "calibrate"):
        for flag, value in ((f"--{name}", "True"), (f"--no-{name}", "False")):
            assert with_flags(["photos", flag, "-o", "out"]) == ["photos", f"--{name}", value, "-o", "out"]
    assert with_flags(["--exact", "False"]) == ["--exact", "False"]
    assert with_flags(["--no-neighbours"]) == ["--no-neighbours"]


@pytest.fixture
def machine(monkeypatch):
    """Sets the GiB of memory and disk that are free, and the bytes of a texel in each."""
    module = importlib.import_module("mitsvbrdf.cli.fit")

    def has(memory, disk=1000.0, held=1, written=0):
        monkeypatch.setattr(module, "memory_gib", lambda: (2 * memory, memory))
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=int(disk * 2**30)))
        monkeypatch.setattr(module, "HELD", (held - 9, 1))
        monkeypatch.setattr(module, "WRITTEN", (written - 9, 1))
    return has


def test_what_fits_into_memory_and_onto_the_disk_is_named(machine, tmp_path):
    machine(PROCESS + 4, held=256, written=1000)
    check_room(4096, 9, tmp_path / "new" / "out")  # 4 GiB in 4 GiB
    machine(PROCESS + 3.9, held=256)
    with pytest.raises(ConfigError, match="4.7 GiB of memory for 4096 px, got 4.6 GiB; "
                                          "--resolution 4032 fits"):  # 63 times 64; 4044 is the root
        check_room(4096, 9, tmp_path)
    machine(1000, disk=2, written=512)
    with pytest.raises(ConfigError, match="8.0 GiB of space on the disk of .*out for 4096 px, got 2.0 GiB; "
                                          "--resolution 2048 fits"):
        check_room(4096, 9, tmp_path / "out")
    machine(0.1)
    with pytest.raises(ConfigError, match="; free some"):
        check_room(64, 9, tmp_path)


def test_a_fit_without_room_says_it_in_one_line_and_leaves_nothing(machine, shots, tmp_path, capsys):
    machine(PROCESS)
    assert cli.main(["fit", str(shots), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not list(tmp_path.iterdir())
