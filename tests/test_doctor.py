"""The doctor's findings, with everything there and with things missing or harmful."""

import builtins
import importlib.metadata
import json
import re
import tomllib

import pytest
from helpers import ROOT

from mitsvbrdf import doctor
from mitsvbrdf.errors import BackendError
from mitsvbrdf.render import exclusive, llvm


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_here_everything_is_there(capsys):
    assert doctor.doctor(json=True) == 0
    report = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row for row in report["rows"]}
    assert report["ok"] and rows["llvm_ad_rgb"]["ok"] and rows["libLLVM"]["ok"] is not False
    assert rows["torch"]["value"] == importlib.metadata.version("torch")
    assert rows["opencv"]["value"] == importlib.metadata.version("opencv-contrib-python-headless")
    assert "GiB" in rows["memory"]["value"] or rows["memory"]["value"] == "unknown"


def test_every_dependency_is_looked_for():
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    names = {re.match(r"[\w-]+", each)[0] for each in stated} - {"mitsuba", "drjit"}  # by name
    assert {doctor.DISTRIBUTIONS.get(module, name) for name, module in doctor.PACKAGES.items()} == names


def test_the_text_tells_the_same(capsys):
    assert doctor.doctor() == 0
    shown = capsys.readouterr().out
    assert "proved in a child process" in shown and shown.endswith("Ready for fits through Mitsuba.\n")
    assert "NO " not in shown


def lacking(monkeypatch, *missing):
    """Hides packages, and gives what the doctor then returns."""
    real = doctor.importlib.import_module

    def without(name, *rest):
        if name in missing:
            raise ModuleNotFoundError(f"No module named {name!r}")
        return real(name, *rest)

    monkeypatch.setattr(doctor.importlib, "import_module", without)
    return doctor.doctor()


@pytest.mark.parametrize("module, name", [
    ("cv2", "opencv-contrib-python-headless"), ("torch", "torch"), ("safetensors", "safetensors")])
def test_a_missing_package_is_named_with_the_line_to_type(monkeypatch, capsys, module, name):
    assert lacking(monkeypatch, module) == 1
    shown = capsys.readouterr().out
    assert f"-> pip install {name}\n" in shown and shown.endswith("see the lines with NO.\n")


def test_what_only_some_need_is_told_and_is_no_fault(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "version_of", lambda name: None if name == "ray" else "1.0")
    assert lacking(monkeypatch, "av", "flip_evaluator", "ray") == 0
    shown = capsys.readouterr().out
    assert "movie: av             cannot be imported: No module named 'av'\n" in shown and "NO " not in shown
    assert '-> pip install "mitsvbrdf[movie]"\n' in shown and '-> pip install "mitsvbrdf[flip]"\n' in shown
    assert "batch: ray            not installed\n" in shown and '-> pip install "mitsvbrdf[batch]"\n' in shown


def test_it_works_where_nothing_is_installed(monkeypatch, capsys):
    real = builtins.__import__

    def bare(name, globals=None, locals=None, fromlist=(), level=0):
        if level and "llvm" in (fromlist or ()):
            raise ModuleNotFoundError("No module named 'torch'")
        return real(name, globals, locals, fromlist, level)

    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    def nothing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(builtins, "__import__", bare)
    monkeypatch.setattr(doctor.importlib.metadata, "version", missing)
    monkeypatch.setattr(doctor.importlib, "import_module", nothing)
    assert doctor.doctor() == 1
    shown = capsys.readouterr().out
    assert "-> pip install mitsuba" in shown and "not tried: No module named 'torch'" in shown


def test_refused_libraries_are_listed_with_the_reason(monkeypatch):
    old = llvm.LLVM("/a/libLLVM-15.so", "15", False, "older than 19")
    new = llvm.LLVM("/a/libLLVM-19.so", "19.1.7", True)
    monkeypatch.setattr(llvm, "examine", lambda: iter([old, new]))
    found = [(row.value, row.ok) for row in doctor.diagnose() if row.name == "libLLVM"]
    assert found == [("15 /a/libLLVM-15.so: older than 19", None),
                     ("19.1.7 /a/libLLVM-19.so: proved in a child process", True)]


def test_without_a_library_the_hint_is_the_fix(monkeypatch):
    def none(variant):
        raise BackendError("a libLLVM", "none", "type this line")

    monkeypatch.setattr(llvm, "examine", lambda: iter([]))
    monkeypatch.setattr(exclusive, "mitsuba_module", none)
    (row,) = [row for row in doctor.diagnose() if row.name == "llvm_ad_rgb"]
    assert (row.ok, row.fix) == (False, "type this line")


def test_an_unusable_gpu_is_no_crash():
    (row,) = [row for row in doctor.diagnose("cuda_ad_rgb") if row.name == "cuda_ad_rgb"]
    assert row.ok or "llvm_ad_rgb" in row.fix
