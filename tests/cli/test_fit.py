"""What `fit` says before it begins and when it has ended."""

from types import SimpleNamespace

import pytest

from mitsvbrdf import cli
from mitsvbrdf.cli.fit import _say_result
from mitsvbrdf.fit.config import HierarchicalConfig

ENDED = {"calibrated_rmse": None, "per_photo": [0.01], "rerender_rmse": 0.01, "profile": None,
         "deviations": {}, "warnings": (),
         "trace": [{"seconds": 31.4, "iteration": 90}]}
SHOTS = SimpleNamespace(names=("00",), views=SimpleNamespace(falloff="inverse-square"))


@pytest.mark.parametrize("stopped, before, words", [
    ("settled", None, "settled after 31 s: it ended by itself"), ("settled", 60, "settled after 31 s"),
    ("settled", 90, "nothing was left to do"), ("budget", None, None),
    ("interrupted", None, "the best result so far")])
def test_how_it_ended(stopped, before, words, capsys):
    _say_result(SimpleNamespace(**ENDED, stopped=stopped), SHOTS, before)
    said = capsys.readouterr().out
    assert ("settled" in said) == bool(words and words.startswith("settled")) and (words
                                                                                   or "Re-rendering RMSE") in said


def test_help_says_what_its_figures_are_and_when_it_ends(capsys):
    with pytest.raises(SystemExit):
        cli.main(["fit", "--help"])
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert f"after {HierarchicalConfig.default_budget:.0f} s at the latest" in said
    assert "squared errors over the noise" in said and "Cost has no unit" in said
