"""Whatever an input holds, a command ends with 0, 2 or 130, says so in a line and touches nothing beside OUT.

A case that fails is kept in a file, which `python -m fuzz FILE` runs again; once mended it goes into
``cases/``.
"""

import json
import os
import stat

import pytest
from fuzz.campaign import Campaign
from fuzz.case import KNOWN, Case, snapshot
from fuzz.changes import apply
from fuzz.groups import GROUPS

PROCESSES = min(4, len(os.sched_getaffinity(0)))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    found = Campaign(folder, PROCESSES, folder / "failed")
    found.make_good()
    yield found
    found.close()


@pytest.mark.slow
def test_the_good_files_are_good(campaign):
    """Else every case would be refused for the same reason."""
    for name in sorted(GROUPS):
        calls = {case.arguments: case for case in campaign.group(name)} if name != "option" else {}
        for case in calls.values():
            result = campaign.run(Case(case.group, case.parts, (), case.arguments, case.out, case.lasting))
            assert not result.wrong, (case.arguments, result.said)
            # No workers, two raw photos, a folder that is there already: refused for these reasons alone.
            there = (name == "folder" and "../in/guessed" in case.arguments
                     and "--overwrite" not in case.arguments)
            expected = 2 if there or case.arguments[0] in ("batch", "capture") else 0
            assert result.answer["code"] == expected, (case.arguments, result.said)


@pytest.mark.slow
def test_what_failed_once_holds(campaign):
    known = sorted(KNOWN.glob("*.json"))
    for path in known:
        result = campaign.run(Case.read(path))
        assert not result.wrong, (path.name, result.wrong, result.said)


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_no_input_breaks_the_rules(group, campaign, capsys):
    tally = campaign.run_all(campaign.group(group)[::4])  # all of them: python -m fuzz all
    with capsys.disabled():
        print(f"\nfuzz, {group}: {tally}")
    assert not tally.failed, str(tally)


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    """Processes that run commands which break the rules."""
    folder = tmp_path_factory.mktemp("wrong")
    (folder / "good/part").mkdir(parents=True)
    (folder / "good/part/file.json").write_text('{"a": [1, 2]}')
    found = Campaign(folder, 1, folder / "failed", "fuzz.wrong")
    yield found
    found.close()


@pytest.mark.parametrize("deed, words", [
    ("nothing", None), ("refuse", None), ("interrupted", None), ("write", None), ("raise", "a traceback"),
    ("one", "exit code 1"), ("silent", "without a word"), ("die", "ended by signal 6"),
    ("hang", "no end by itself"),
    ("deaf", "no end after Ctrl-C"), ("fill", "GiB of memory"), ("touch", "outside/secret.txt changed"),
    ("replace", "outside/secret.txt changed"), ("make", "work/beside made"),
    ("remove", "outside/folder/keep.txt removed"),
    ("follow", "outside/secret.txt changed"), ("relink", "in/part/link changed"), ("leave", "tmp/left made")])
def test_each_rule_is_held_against_the_commands(deed, words, wrong, monkeypatch):
    waits = {"SECONDS": 0.3, "GRACE": 0.3} if deed in ("hang", "deaf") else {}
    for name, value in {"MEMORY": 1e8, **waits}.items():
        monkeypatch.setattr(f"fuzz.case.{name}", value)
    link = {"do": "link", "path": "in/part/link", "to": "outside/secret.txt"}
    result = wrong.run(Case("wrong", ("part",), (link,), (deed,)))
    assert not result.wrong if words is None else words in "; ".join(result.wrong), result


def test_long_options_may_be_interrupted_but_must_end(wrong, monkeypatch):
    monkeypatch.setattr("fuzz.case.LASTING", 0.3)
    monkeypatch.setattr("fuzz.case.GRACE", 0.3)
    for deed, held in (("hang", True), ("deaf", False)):
        assert (not wrong.run(Case("wrong", (), (), (deed,), lasting=True)).wrong) == held


def test_a_case_that_fails_is_kept_without_what_it_does_not_need(wrong):
    needless = {"do": "put", "path": "in/part/more.txt", "text": "x"}
    needed = {"do": "state", "path": "in/part/file.json", "steps": [0, 1], "raw": "NaN"}
    held, fails = Case("wrong", (), (), ("nothing",)), Case("wrong", ("part",), (needless, needed, needless),
                                                            ("if NaN",))
    tally = wrong.run_all([held, fails])
    assert (tally.tried, tally.held) == (2, 1)
    (files,) = tally.failed.values()
    kept = Case.read(files[0])
    assert kept.changes == (needed,) and kept.arguments == ("if NaN",)
    assert "a traceback" in wrong.run(kept).wrong


def test_changes_do_what_they_say(tmp_path):
    def after(change, name="a/file", content=b'{"a": {"b": [1, 2]}}'):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.unlink(missing_ok=True)
        path.write_bytes(content)
        apply(tmp_path, change)
        return path

    assert after({"do": "flip", "under": "a", "nth": 7, "at": -1, "bit": 0},
                 content=b"ab").read_bytes() == b"ac"
    assert after({"do": "cut", "under": "a/file", "nth": 0, "at": 1}, content=b"abc").read_bytes() == b"a"
    state = {"do": "state", "path": "a/file", "steps": [0, 0, 3]}
    assert after(state | {"raw": "NaN"}).read_text() == '{"a": {"b": [1, NaN]}}'
    assert json.loads(after(state | {"raw": None}).read_text()) == {"a": {"b": [1]}}
    assert after(state | {"raw": "[", "again": 3}).read_text() == '{"a": {"b": [1, [[[]]]]}}'
    assert after({"do": "put", "path": "a/file",
                  "text": "@@/x\udcff"}).read_bytes() == f"{tmp_path}/x".encode() + b"\xff"
    assert after({"do": "line", "path": "a/file", "nth": 3, "text": "x"},
                 content=b"1\n2\n").read_bytes() == b"1\nx"
    assert os.readlink(after({"do": "link", "path": "a/file", "to": "outside"})) == "../outside"
    assert stat.S_ISFIFO(after({"do": "pipe", "path": "a/file"}).lstat().st_mode)


def test_snapshots_see_everything_but_the_output(tmp_path):
    (tmp_path / "work/out").mkdir(parents=True)
    (tmp_path / "work/out/file").write_text("x")
    (tmp_path / "other").write_text("x")
    assert set(snapshot(tmp_path, {"work/out"})) == {"work", "other"}
