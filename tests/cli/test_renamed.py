"""Old names work for one version: each is replaced as a whole word, and said once."""

import pytest

from mitsvbrdf import cli
from mitsvbrdf.cli import renamed as table
from mitsvbrdf.cli.renamed import with_new_names


@pytest.fixture
def names(monkeypatch):
    monkeypatch.setattr(table, "RENAMED", {"fit": {"--own": "--detail-spread", "--no-lit": "--no-lamp"}})
    monkeypatch.setattr(table, "RENAMED_COMMANDS", {"adjust": "fit"})


@pytest.mark.parametrize("given, taken", [
    (["fit", "x", "--own", "0.1"], ["fit", "x", "--detail-spread", "0.1"]),
    (["fit", "x", "--own=0.1"], ["fit", "x", "--detail-spread=0.1"]),
    (["adjust", "--no_lit"], ["fit", "--no-lamp"]),
    (["fit", "--out=--own", "--own-goal", "own"], ["fit", "--out=--own", "--own-goal", "own"]),
    (["fit", "--own=--own"], ["fit", "--detail-spread=--own"]),
    (["fit", "--", "--own"], ["fit", "--", "--own"]), (["batch", "--own"], ["batch", "--own"]),
    (["--help"], ["--help"]), ([], [])])
def test_old_names_change_as_whole_words(names, given, taken):
    assert with_new_names(given) == taken


def test_each_old_name_is_said_once(names, capsys):
    with_new_names(["adjust", "--own", "1", "--own", "2"])
    assert capsys.readouterr().err == "adjust is now fit\n--own is now --detail-spread\n"


def test_new_names_are_options_of_their_command(capsys):
    for name, options in table.RENAMED.items():
        with pytest.raises(SystemExit):
            cli.main([name, *(["--advanced"] if name in cli.FITTING else []), "--help"])
        shown = capsys.readouterr().out
        for old, new in options.items():
            assert new in shown and f"{old} " not in shown, (name, old)
