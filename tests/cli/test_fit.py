"""What `fit` says before it begins and when it has ended."""

from types import SimpleNamespace

import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.cli.fit import _say_result, with_flags
from mitsvbrdf.fit.checkpoint import load_tensors

ENDED = {"calibrated_rmse": None, "per_photo": [0.01], "rerender_rmse": 0.01,
         "deviations": {}, "deviations_with_look_alikes": {}, "record": {"confidence": {}}, "warnings": (),
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


def test_help_shows_research_options_only_when_asked(capsys):
    for advanced in ((), ("--advanced",)):
        with pytest.raises(SystemExit) as stop:
            cli.main(["fit", *advanced, "--help"])
        shown = capsys.readouterr().out
        assert stop.value.code == 0 and "--budget" in shown
        assert ("--highlight-reach" in shown) == bool(advanced)


def test_the_first_stage_of_two_by_either_name(shots, tmp_path, capsys):
    options = ["--resolution", "16", "--renderer", "analytic", "--iterations", "1", "--width", "4"]
    named = ["fit", str(shots), "-o", str(tmp_path / "a.safetensors"), "--method", "gan", "--preset",
             "paper-two-stage", "--pretrain"]
    assert cli.main([*named, *options]) == 0
    assert cli.main(["pretrain", str(shots), "-o", str(tmp_path / "b.safetensors"), *options]) == 0
    assert "pretrain is now fit --method gan" in capsys.readouterr().err
    first, second = (load_tensors(tmp_path / name)[0] for name in ("a.safetensors", "b.safetensors"))
    assert first and all(torch.equal(first[name], value) for name, value in second.items())
    assert cli.main(["fit", str(shots), "-o", str(tmp_path / "c.safetensors"), "--pretrain"]) == 2
    assert "--method gan beside --pretrain" in capsys.readouterr().err


def test_flags_that_the_fit_decides_unless_told():
    for name in ("exact", "stationary", "calibrate"):
        for flag, value in ((f"--{name}", "True"), (f"--no-{name}", "False")):
            assert with_flags(["photos", flag, "-o", "out"]) == ["photos", f"--{name}", value, "-o", "out"]
    assert with_flags(["--exact", "False"]) == ["--exact", "False"]
    assert with_flags(["--no-neighbours"]) == ["--no-neighbours"]
