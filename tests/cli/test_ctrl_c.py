"""Ctrl-C at any moment while a command starts: exit code 130, and at most one short line."""

import importlib.abc
import importlib.util
import os
import select
import signal
import subprocess
import sys
import time

import pytest
from helpers import ROOT

from mitsvbrdf import cli
from mitsvbrdf.io import signals

COMMANDS = {
    "fit": ["fit", "photos", "-o", "{}"], "guess": ["guess", "photos", "-o", "{}"],
    "render": ["render", "builtin:tiles", "-o", "{}"],
    "relight": ["relight", "builtin:tiles", "-o", "{}", "--preset", "sphere", "--size", "16"],
    "export": ["export", "builtin:tiles", "-o", "{}", "--to", "gltf"],
    "evaluate": ["evaluate", "builtin:tiles", "--capture", "photos", "--renderer", "mitsuba"],
    "crosscheck": ["crosscheck", "--resolution", "16"], "doctor": ["doctor"]}
# the line with which the work begins, which saves what there is (tests of fit and relight hold that)
WORK = {"fit": "fit photos", "relight": "relight tiles"}
MOMENTS = int(os.environ.get("MITSVBRDF_MOMENTS", "6"))  # of each command; 50 take half an hour
# Says when our code listens: what Ctrl-C does while Python itself starts is not ours to say.
START = """
import os, signal, sys
from mitsvbrdf.__main__ import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run where Ctrl-C is not heard
real = signal.signal
def first(*words):
    signal.signal = real
    real(*words)
    os.write(9, b".")
signal.signal = first
sys.exit(main())
"""


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("start")
    assert cli.main(["synth", "builtin:inlay", "-o", str(folder / "photos"), "--resolution", "16",
                     "--renderer", "analytic"]) == 0
    return folder


def pressed(name, folder, seconds):
    """Exit code as a shell tells it, what was said, and whether the start was over before Ctrl-C came."""
    begun, begins = os.pipe()
    words = [word.format(f"out {name} {seconds:.3f}") for word in COMMANDS[name]]
    process = subprocess.Popen(["bash", "-c", f'exec "$@" 9>&{begins}', "bash", sys.executable, "-c", START,
                                *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               cwd=folder, pass_fds=(begins,), start_new_session=True, env=os.environ
                               | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"})
    os.close(begins)
    os.read(begun, 1)
    os.close(begun)
    time.sleep(seconds)
    if process.poll() is not None:  # sooner done than when its time was taken
        return process.returncode, process.communicate()[1], True
    printed = select.select([process.stdout], [], [], 0)[0] and os.read(process.stdout.fileno(), 1 << 16)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=120)[1]
    return (process.returncode if process.returncode >= 0 else 128 - process.returncode, said,
            bool(printed) and name in WORK and WORK[name].encode() in printed)


def seconds_of(name, folder):
    """How long the command runs that is let be; of a long one, what surely is its start.

    The second run counts: the first one, in a new place, compiles, and takes up to three times as long. Its
    moments would lie in the work behind the start, where Ctrl-C saves what there is.
    """
    for run in range(2):
        begun = time.perf_counter()
        words = [word.format(f"out {name} {run}") for word in COMMANDS[name]]
        subprocess.run([sys.executable, "-m", "mitsvbrdf", *words], cwd=folder, capture_output=True,
                       timeout=300, env=os.environ | {"PYTHONPATH": str(ROOT)})
    return min(time.perf_counter() - begun, 8.0)


def quiet(found):
    code, said, over = found
    return over and code == 0 or code == 130 and len(said.splitlines()) <= 1 and len(said) < 100


def test_ctrl_c_in_the_first_moments(tmp_path):
    for name, seconds in (("fit", 0.0), ("doctor", 0.1), ("render", 0.3)):
        found = pressed(name, tmp_path, seconds)
        assert quiet(found), (name, seconds, found)


@pytest.mark.parametrize("end", [lambda: 0, lambda: 1 / 0])
def test_ctrl_c_that_met_the_last_import_of_a_command_counts(end, monkeypatch, capsys):
    def run(arguments):
        importlib.import_module("waits_for_ctrl_c")
        return end()

    class Module(importlib.abc.MetaPathFinder, importlib.abc.Loader):
        """Ctrl-C is pressed while it loads."""

        def find_spec(self, name, *_):
            return importlib.util.spec_from_loader(name, self) if name == "waits_for_ctrl_c" else None

        def exec_module(self, module):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(signals, "AGAIN", 60.0)  # seconds; the command ends sooner
    monkeypatch.setattr(sys, "meta_path", [Module(), *sys.meta_path])
    monkeypatch.setattr(cli, "_run", run)
    monkeypatch.delitem(sys.modules, "waits_for_ctrl_c", raising=False)
    before = signal.signal(signal.SIGINT, signals.interrupt)
    try:
        assert cli.main(["doctor"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_at_many_moments_of_the_start(name, photos):
    whole = seconds_of(name, photos)
    found = [pressed(name, photos, 0.7 * whole * share / MOMENTS) for share in range(MOMENTS)]
    assert all(map(quiet, found)), [each for each in found if not quiet(each)]
    assert sum(over for *_, over in found) <= MOMENTS / 2
