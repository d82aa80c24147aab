"""What `mitsvbrdf batch` says, without a fit."""

import re
import sys

import pytest
from helpers.batches import make_capture, publish, result_of

from mitsvbrdf import cli
from mitsvbrdf.batch.asked import Stock
from mitsvbrdf.batch.library import Library
from mitsvbrdf.batch.records import Material
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.cli import batch as batch_command


def test_the_log_of_a_failure_is_named_where_there_is_one(tmp_path, capsys):
    library = Library(ResultStore(str(tmp_path)))
    for letter, name, log in (("a", "loud", "what it printed"), ("b", "mute", "")):
        library.failed(Material(identity=letter * 64, name=name, source=f"/shots/{name}"), "blurred", log)
    assert batch_command._ended(library, Stock(failed=1), False) == 1
    loud, mute, last = capsys.readouterr().out.splitlines()
    log = re.fullmatch(r"failed: loud \(/shots/loud\): blurred; its log: (.*)", loud)[1]
    assert open(log).read() == "what it printed"
    assert mute == "failed: mute (/shots/mute): blurred" and last.startswith("0 done, 2 failed")


def test_the_exit_code_is_that_of_what_was_asked_for(tmp_path):
    library = Library(ResultStore(str(tmp_path)))
    old, bad, left = (Material(identity=name * 64, name=name, source=f"/shots/{name}") for name in "abc")
    library.failed(old, "blurred")
    assert batch_command._ended(library, Stock(done=1), False) == 0
    library.failed(bad, "blurred")
    library.materials[left.folder] = left
    assert batch_command._ended(library, Stock([bad]), True) == 1
    assert batch_command._ended(library, Stock([bad, left]), True) == 130


def test_a_ray_that_is_broken_is_told_and_harms_no_library(tmp_path, capsys, monkeypatch):
    broken = tmp_path / "site/ray/__init__.py"
    broken.parent.mkdir(parents=True)
    broken.write_text("raise ImportError('libray.so: wrong ELF class')\n")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.syspath_prepend(tmp_path / "site")
    shots, earlier = make_capture(tmp_path / "shots/wood"), tmp_path / "earlier"
    publish(ResultStore(str(earlier)), result_of())
    assert cli.main(["batch", str(shots), "-o", str(earlier)]) == 2
    said = capsys.readouterr().err
    assert "libray.so: wrong ELF class" in said and "install it again" in said
    assert ResultStore(str(earlier)).result("wood-aaaaaaaa")


def test_help_says_what_is_on_and_what_must_be_given(capsys):
    with pytest.raises(SystemExit):
        cli.main(["batch", "--advanced", "--help"])
    told = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    assert "(default: )" not in told and "(default: True)" not in told
    options = {words.split()[0]: words for words in told.split(" --")}
    for option in ("no-remove-burn-in", "no-neighbours", "no-flash-offset"):
        assert "(default: on)" in options[option]
    assert "(default: off)" in options["grey-specular"]


@pytest.mark.parametrize("words", ["batch shots -o library --budget foo", "batch shots -o library --bugdet 3",
                                   "batch shots", "library shots --wher x", "crosscheck --width x"])
def test_a_mistake_names_the_help_of_its_command_and_no_other(words, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(words.split())
    named = re.findall(r"mitsvbrdf[a-z -]* --help", capsys.readouterr().err)
    assert end.value.code == 2 and set(named) == {f"mitsvbrdf {words.split()[0].replace('_', '-')} --help"}
