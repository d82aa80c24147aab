"""A capture fitted by a worker: the maps of `mitsvbrdf fit`, a whole result or none, and what it printed."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import msgspec
import pytest
import torch
from batch.chaos import make_captures
from helpers import ANALYTIC, GRID
from helpers.batches import asked, make_capture

from mitsvbrdf import __version__, cli, color
from mitsvbrdf.batch import fitting
from mitsvbrdf.batch.asked import take_stock
from mitsvbrdf.batch.fitting import HELD, fit_capture
from mitsvbrdf.batch.library import Library
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.capture import read_capture
from mitsvbrdf.errors import MapsError
from mitsvbrdf.evaluate.placement import is_of
from mitsvbrdf.fit import Fit, HierarchicalConfig
from mitsvbrdf.io import images
from mitsvbrdf.material.made import make_material

SIDE = 16
QUICK = HierarchicalConfig(guess="min", iterations=4)
# A worker: yields of the task of a file, and what is done to it once it is warm.
WORKER = """
import json, os, signal, sys, threading
from mitsvbrdf.batch import fitting
task, deed = json.load(open(sys.argv[1])), sys.argv[2]
fit = fitting.fit_capture
def fit_capture(*words):
    if deed == "term": threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM)).start()
    if deed == "eat": held = b"1" * (1 << 30); __import__("time").sleep(60)
    if deed == "abort": os.abort()
    if deed == "print": print("its words", flush=True)
    if deed == "full": raise OSError(28, "No space left on device")
    return fit(*words)
fitting.fit_capture = fit_capture
for each in fitting.fit_task(task):
    print(json.dumps(each), file=sys.stdout, flush=True)
"""


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures")
    make_captures(folder, 2, SIDE)
    return sorted(folder.iterdir())


@pytest.fixture
def worker(captures, tmp_path):
    """A worker that fits the first capture, or another: deed -> what it yielded, its exit code and errors."""
    results = ResultStore(str(tmp_path / "library"))

    def task(capture=captures[0], **changes):
        with results.claimed() as token:
            stock = take_stock([asked(capture, QUICK, resolution=SIDE)], Library(results), True)
        return {"library": results.address, "token": token, "version": __version__, "attempt": "one",
                "material": msgspec.to_builtins(stock.work[0]), "threads": 1, "memory": None} | changes

    def work(deed="", capture=captures[0], **changes):
        (tmp_path / "task.json").write_text(json.dumps(task(capture, **changes)))
        ran = subprocess.run([sys.executable, "-c", WORKER, str(tmp_path / "task.json"), deed],
                             capture_output=True, text=True)
        return [json.loads(line) for line in ran.stdout.splitlines()], ran.returncode, ran.stderr

    work.results, work.task = results, task
    return work


def maps_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for part in ("maps", "uncertainty")
            for path in sorted((folder / part).rglob("*")) if path.is_file()}


@pytest.mark.slow
def test_a_worker_makes_the_maps_of_the_fit_command(worker, captures, tmp_path):
    (about, outcome), code, errors = worker("print")
    assert code == 0 and about["version"] == __version__ and outcome["state"] == "done", errors
    (folder,) = worker.results.names()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in the worker
    assert cli.main(["fit", str(captures[0]), "-o", str(tmp_path / "fit"), "--resolution", str(SIDE),
                     "--guess", "min", "--iterations", "4"]) == 0
    torch.set_num_threads(threads)
    assert maps_of(tmp_path / "library" / folder) == maps_of(tmp_path / "fit")
    result = worker.results.result(folder)
    assert result.row.photos == 9 and 0 < result.row.error < 0.2
    there = {str(path.relative_to(tmp_path / "library" / folder))
             for path in (tmp_path / "library" / folder).rglob("*") if path.is_file()}
    assert set(result.files) == there - {"batch.json"} and not worker.results.damage(result, hashes=True)
    assert not list((tmp_path / "library/.work").iterdir())
    assert "its words" in outcome["log"]


@pytest.mark.slow
def test_sigterm_ends_a_worker_so_that_no_half_fit_counts(worker):
    """A system that shuts down asks all its processes to end; `mitsvbrdf fit` would then keep what it has."""
    said, code, _ = worker("term")
    assert code != 0 and len(said) == 1 and worker.results.names() == []


@pytest.mark.slow
@pytest.mark.parametrize("deed, memory, words", [("eat", 1.0, HELD),
                                                 ("abort", None, "Fatal Python error: Aborted")])
def test_a_worker_that_dies_leaves_its_last_words(worker, deed, memory, words):
    said, code, _ = worker(deed, memory=memory)
    assert code < 0 and len(said) == 1
    assert words in (worker.results.store.folder / ".work/one.log").read_text()


@pytest.mark.parametrize("deed, state",
                         [pytest.param("full", "full", marks=pytest.mark.slow), ("", "failed")])
def test_what_fails_is_told_and_leaves_nothing_behind(worker, tmp_path, deed, state):
    capture = make_capture(tmp_path / "wood", [b"no photo"])
    (_, outcome), code, _ = worker(deed, capture)
    assert (outcome["state"], code, worker.results.names()) == (state, 0, [])
    assert not [path for path in (tmp_path / "library/.work").iterdir()]


@pytest.mark.parametrize("changes", [{"token": "other"}, {"version": "0.1"}])
def test_a_worker_of_another_library_or_version_does_not_fit(worker, changes, monkeypatch):
    monkeypatch.setattr(fitting, "_warm", lambda threads: None)  # which changes this process
    (said,) = fitting.fit_task(worker.task(**changes))
    assert said["version"] == __version__ and worker.results.names() == []


@pytest.mark.parametrize("unbuffered", ["", "1"])  # as Ray's workers are
def test_a_disk_that_is_full_for_the_log_too(worker, tmp_path, unbuffered):
    (tmp_path / "task.json").write_text(json.dumps(worker.task()))
    done = subprocess.run([sys.executable, "-c", """
import json, resource, sys
from mitsvbrdf.batch import fitting
fitting._warm = lambda threads: None
def fit_capture(*_):
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # no file takes a byte
    raise OSError(28, "No space left on device")
fitting.fit_capture = fit_capture
for said in fitting.fit_task(json.load(open(sys.argv[1]))):
    print(said.get("state"))
""", str(tmp_path / "task.json")], capture_output=True, text=True,
                          env=os.environ | {"PYTHONUNBUFFERED": unbuffered})
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "full", done.stderr


def test_the_preview_is_seen_from_the_fitted_view(tmp_path):
    fit = Fit().but(svbrdf=make_material("inlay", SIDE), views=GRID.pick([3, 0]), transfer="srgb")
    fitting.write_preview(tmp_path / "preview.jpg", fit)
    shown = images.read_image(tmp_path / "preview.jpg", MapsError)
    own, other = ((color.to_display(image) - shown).abs().mean() for image in ANALYTIC.render(fit.svbrdf,
                                                                                              fit.views))
    assert own < other / 2


@pytest.mark.slow
def test_pages_change_neither_maps_nor_figures(captures, tmp_path):
    shots = shutil.copytree(captures[0], tmp_path / captures[0].name)
    shutil.copy(shots / "target/00.png", shots / "target/00 copy.png")
    record = replace(asked(shots, QUICK, resolution=SIDE, views="0,1,2,3,4,5,6")).record
    bare, full = (fit_capture(shots / "capture.json", tmp_path / str(pages), record | {"pages": pages})
                  for pages in (False, True))
    assert is_of(Fit.load(tmp_path / "True"), read_capture(shots))  # as its folder, too
    assert maps_of(tmp_path / "False") == maps_of(tmp_path / "True")
    for name in ("error", "burn_in", "warnings", "photos"):
        assert getattr(bare, name) == getattr(full, name), name
    fault = bare.warnings[0]
    assert "00 copy.png" in fault and fault in Fit.load(tmp_path / "True").record["capture"]["notes"]
    assert bare.photos == 7 and bare.held_out_error is None and full.held_out_error > 0
    written = {path.name for path in (tmp_path / "False").iterdir()}
    assert written == {"maps", "uncertainty", "fit.json", "preview.jpg"}


