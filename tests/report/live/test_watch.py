"""The page that follows a fit: from before it starts to after it ends, however it ends."""

import signal
import subprocess
import sys

import pytest
import torch
from helpers import ROOT
from helpers.live_fits import FAST, fit_into, served, state_of
from helpers.unfinished import unfinished

from mitsvbrdf.fit.checkpoint import load_tensors, save_tensors
from mitsvbrdf.io import files, results
from mitsvbrdf.report.live import Watch

# ---- the page follows a fit ----

def test_a_fit_is_followed_from_before_it_starts_to_after_it_ends(tmp_path, capture, every_step):
    out, seen, pictures, rows = tmp_path / "out", [], [], []

    def look(entry, share):
        seen.append(state_of(ask))
        rows.append(entry)
        if seen[-1]["fit"]:
            pictures.append(ask(f"/maps/diffuse.png?{seen[-1]['fit']['version']}")[2])

    with served(out) as ask:
        before = state_of(ask)
        assert before["phase"] == "waiting" and str(out) in before["says"] and before["fit"] is before[
            "report"] is None
        assert ask("/report.html")[0] == ask("/maps/diffuse.png")[0] == 404
        result = fit_into(out, capture, FAST, look)
        after = state_of(ask)
        assert ask("/report.html")[2].decode() == f"<p>{result.rerender_rmse}</p>"

    # The report of a measurement comes before the record of that step: the page is one measurement behind, at
    # most.
    assert [s["phase"] for s in seen] == ["starting", "running", "running", "writing"]
    assert [s["fit"]["iteration"] for s in seen[1:]] == [9, 19, 20]
    assert [s["fit"]["trace"] for s in seen[1:]] == [rows[:1], rows[:2],
                                                     rows[:3]] and rows[2] == result.trace[2]
    assert seen[1]["fit"]["latest"]["iteration"] == 9 and seen[1]["fit"]["latest"]["photometric"] > 0
    assert [round(s["fit"]["share"], 3) for s in seen[1:]] == [0.45, 0.95, 1.0]
    assert len({s["fit"]["run"] for s in seen[1:]}) == 1 and len({s["fit"]["version"] for s in seen[1:]}) == 3
    assert pictures[0] != pictures[1] != pictures[2]
    assert seen[1]["says"] == "Fitting" and "all iterations done" in seen[3]["says"]
    assert after["phase"] == "done" and after["report"] and after["fit"]["trace"] == result.trace
    assert not (out / results.LIVE).exists()
    assert results.LIVE not in results.own_files(out)
    assert not results.partial_folder(out).exists()


def test_a_fit_that_starts_anew_is_followed_again(tmp_path, capture, every_step):
    out, seen = tmp_path / "out", []
    with served(out) as ask:
        fit_into(out, capture, FAST)
        first = state_of(ask)
        fit_into(out, capture, FAST, lambda entry, share: seen.append(state_of(ask)), overwrite=True)
        last = state_of(ask)
        assert ask("/maps/diffuse.png")[0] == 404  # no running fit's any more
    assert [s["phase"] for s in seen] == ["starting", "running", "running", "writing"]
    # the earlier report is still there
    assert seen[0]["fit"] is None and seen[1]["report"] == first["report"]
    assert first["phase"] == last["phase"] == "done" and first["report"] != last["report"]


def test_resuming_starts_with_the_checkpoint_alone(tmp_path):
    unfinished(tmp_path / "out", results.CHECKPOINT, results.LIVE, "maps/half.exr", ".live-0123.safetensors")
    with results.output_folder(tmp_path / "out", False, resume=True) as folder:
        assert sorted(path.name for path in folder.iterdir()) == [results.MANIFEST, results.CHECKPOINT]


# ---- fits that end badly ----

def test_a_fit_that_fails_shows_its_last_state(tmp_path, capture, every_step):
    out, seen = tmp_path / "out", []
    with served(out) as ask:
        fit_into(out, capture, FAST)
        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, lambda *_: seen.append(state_of(ask)), overwrite=True,
                     fails=ZeroDivisionError())
        died = state_of(ask)
        assert ask("/maps/normal.png")[0] == 200
        again = []
        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, lambda *_: again.append(state_of(ask)), overwrite=True,
                     fails=ZeroDivisionError())
    assert again[0]["phase"] == "starting" and again[0]["fit"] is None  # not the state of the fit before
    assert died["phase"] == "died" and died["fit"] == seen[-1]["fit"] and died["report"]  # the earlier fit's
    assert "without a result" in died["says"] and "--resume" in died["says"]
    # Somebody who looks only now sees no maps, but that there is something to go on with.
    with served(out) as ask:
        late = state_of(ask)
    assert late["phase"] == "died" and late["fit"] is None and "--resume" in late["says"]


def test_a_fit_that_is_killed_shows_its_last_state(tmp_path, capture):
    # By a signal that nothing can be done about: all its files stay as they are, and nobody holds the lock.
    out = tmp_path / "out"
    code = f"""
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {str(ROOT / "tests")!r})
from helpers import photos_of
from helpers.live_fits import FAST, SIDE, fit_into
from mitsvbrdf.fit import live as fit_live
from mitsvbrdf.material.made import make_material
fit_live.SECONDS, fit_live.SHARE = 0.0, 1.0
capture = photos_of(make_material("inlay", SIDE))
def die(entry, share):
    if entry["iteration"] == 10:
        os.kill(os.getpid(), signal.SIGKILL)
fit_into(Path({str(out)!r}), capture, FAST, die)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    with served(out) as ask:
        died = state_of(ask)
        assert died["phase"] == "died" and died["fit"]["iteration"] == 9 and ask("/maps/diffuse.png")[
            0] == 200
        assert "anew" in died["says"]  # no checkpoint yet
        fit_into(out, capture, FAST)
        assert state_of(ask)["phase"] == "done"


def test_a_fit_that_ends_while_somebody_looks_has_not_died(tmp_path, capture, every_step, monkeypatch):
    out, states = tmp_path / "out", []
    watch = Watch(out)

    # the record was read a moment ago; now everything is in its place, and the lock is free
    def ends_just_before(folder):
        files.write_json(out / "fit.json", {})
        return False

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            with monkeypatch.context() as patch:
                patch.setattr("mitsvbrdf.report.live.watch.in_use", ends_just_before)
                states.append(watch.state()["phase"])

    with pytest.raises(ZeroDivisionError):
        fit_into(out, capture, FAST, look, fails=ZeroDivisionError())
    assert states == ["done"]


@pytest.mark.parametrize("kept", [0, 1, 7, 100, 5000, -2, -700])
def test_half_a_record_is_none(kept, tmp_path, capture, every_step):
    out, states = tmp_path / "out", []

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            states.append(state_of(ask))
            record = results.partial_folder(out) / results.LIVE
            record.write_bytes(record.read_bytes()[:kept])
            states.append(state_of(ask))
            assert ask("/maps/diffuse.png")[0] == 200

    with served(out) as ask:
        fit_into(out, capture, FAST, look)
        assert states[0] == states[1] and states[0]["phase"] == "running"
        (out / "fit.json").write_bytes((out / "fit.json").read_bytes()[:min(kept, 500)])
        half = state_of(ask)
        assert half["phase"] == "done" and half["fit"] is None and half["report"]


def test_records_of_others_do_no_harm(tmp_path, capture):
    out = tmp_path / "out"
    strange = [{}, {"bsdf": "none"}, {"bsdf": "roughconductor"}, {"bsdf": ["list"]}]
    with served(out) as ask, results.output_folder(out, False) as folder:
        for note in strange:
            save_tensors(folder / results.LIVE,
                         {"diffuse": torch.zeros(3), "../../passwd": torch.zeros(2, 2, 3)}, note)
            assert state_of(ask)["phase"] == "starting"
        out.mkdir()
        for name, content in (("fit.json", b"[]"), ("fit.json", b'{"trace": NaN}'), ("fit.json", b"\xff")):
            (out / name).write_bytes(content)
            assert state_of(ask)["phase"] == "starting"
        (out / name).unlink()


@pytest.mark.filterwarnings("error")
def test_numbers_that_neither_json_nor_a_picture_has(tmp_path, capture, every_step):
    out = tmp_path / "out"

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            record = results.partial_folder(out) / results.LIVE
            tensors, note = load_tensors(record)
            note["trace"][0]["rerender_rmse"] = float("nan")
            note["latest"]["photometric"] = float("inf")
            save_tensors(record, tensors | {"normal": tensors["normal"] * torch.nan}, note)
            fit = state_of(ask)["fit"]
            assert ask("/maps/normal.png")[0] == 200
            assert fit["trace"][0]["rerender_rmse"] is None and fit["latest"]["photometric"] is None

    with served(out) as ask:
        fit_into(out, capture, FAST, look)
