"""What `mitsvbrdf batch` says, without a fit."""

from __future__ import annotations

import contextlib
import os
import re
import sys

import pytest
from helpers.batches import asked, make_capture
from helpers.commands import fails

from mitsvbrdf import cli
from mitsvbrdf.batch.manifest import FILE, Manifest
from mitsvbrdf.batch.places.place import LocalPlace
from mitsvbrdf.batch.prepare import library_lock, quarantine, register, take_stock
from mitsvbrdf.cli import batch as batch_command


def test_the_log_of_a_failure_is_named_where_there_is_one(tmp_path, capsys):
    manifest = Manifest(tmp_path / FILE)
    captures = [make_capture(tmp_path / "shots" / name, [name.encode()]) for name in ("loud", "mute")]
    register(map(asked, captures), manifest, lambda text, share: None)
    for work in take_stock(manifest, LocalPlace(tmp_path), tmp_path, False).work:
        attempt, row = manifest.begin(work.identity, "w1", "here"), manifest.material(work.identity)
        manifest.end(attempt, "failed", {"state": "failed", "reason": "blurred"})
        quarantine(tmp_path, row, "failed", "blurred", "what it printed" if row["name"] == "loud" else "")
    assert batch_command._ended(manifest, tmp_path, False, 0) == 1
    loud, mute, last = capsys.readouterr().out.splitlines()
    log = re.fullmatch(rf"failed: loud \({captures[0]}\): blurred; its log: (.*)", loud)[1]
    assert open(log).read() == "what it printed"
    assert mute == f"failed: mute ({captures[1]}): blurred" and last.startswith("0 done, 2 failed")
    manifest.close()


def test_a_ray_that_is_broken_is_told_and_leaves_no_library(tmp_path, capsys, monkeypatch):
    broken = tmp_path / "site/ray/__init__.py"
    broken.parent.mkdir(parents=True)
    broken.write_text("import sys\nprint('built for another machine', file=sys.stderr, flush=True)\n"
                      "raise ImportError('libray.so: wrong ELF class')\n")
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    shots, earlier = make_capture(tmp_path / "shots/wood"), tmp_path / "earlier"
    words = ["libray.so: wrong ELF class", "its log ends: built for another machine", "install it again"]
    fails(capsys, tmp_path, ["batch", shots, "-o", tmp_path / "library"], *words)
    (tmp_path / "empty").mkdir()
    fails(capsys, tmp_path, ["batch", shots, "-o", tmp_path / "empty"], *words)
    library_lock(earlier)()
    with contextlib.closing(Manifest(earlier / FILE)) as manifest:
        register([asked(shots)], manifest, lambda *_: None)
    assert cli.main(["batch", str(shots), "-o", str(earlier)]) == 2
    assert (earlier / FILE).is_file()


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
