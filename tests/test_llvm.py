"""The search for a libLLVM: what is refused, what is proved, and what a user is told. Trials run in child processes."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mitsvbrdf.errors import BackendError
from mitsvbrdf.render import llvm

OLD = [path for path in llvm.candidates() if 0 < llvm.named_version(path) < 17]


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """No answer remembered on this machine, none left behind."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def searched(tmp_path, monkeypatch):
    """The only folder searched, with no choice of the user's."""
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    monkeypatch.setattr(llvm, "_folders", lambda: [str(tmp_path)])
    return tmp_path


@pytest.fixture
def no_drjit_yet(monkeypatch):
    """As in a fresh process: earlier tests may have imported Dr.Jit."""
    monkeypatch.delitem(sys.modules, "drjit", raising=False)


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter; a variable given as "" is removed."""
    variables = {name: value for name, value in (os.environ | environment).items() if value}
    return subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, timeout=60)


def test_versions_are_read_from_paths():
    told = {"/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1": 15, "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1": 19,
            "/usr/lib/libLLVM-14.0.6.so": 14, "/opt/homebrew/Cellar/llvm/21.1.0/lib/libLLVM.dylib": 21,
            "/opt/homebrew/opt/llvm@20/lib/libLLVM.dylib": 20, "/usr/lib/llvm-19/lib/libLLVM.so.1": 19,
            "/usr/lib64/libLLVM.so": 0, "C:/Program Files/LLVM/bin/LLVM-C.dll": 0}
    assert {path: llvm.named_version(path) for path in told} == told


def test_measured_versions_come_first_and_links_count_once(searched):
    for name in ("libLLVM-23.so", "libLLVM-20.so", "libLLVM.so.22.1", "libLLVM-19.so.1", "libLLVM.dylib", "LLVM-C.dll",
                 "libLLVMCore.a", "libLLVMgold.so", "LLVMPolly.so"):
        (searched / name).touch()
    (searched / "libLLVM-19.so").symlink_to("libLLVM-19.so.1")
    assert [Path(path).name for path in llvm.candidates()] == [
        "libLLVM-19.so.1", "libLLVM.so.22.1", "libLLVM-23.so", "libLLVM-20.so", "LLVM-C.dll", "libLLVM.dylib"]


def test_a_text_file_is_no_library(searched):
    (searched / "libLLVM-19.so").write_text("not a library")
    (verdict,) = llvm.examine()
    assert not verdict.proved and "libLLVM-19.so" in verdict.message
    assert llvm.find_llvm() is None


def test_an_old_version_is_refused_without_a_trial(searched, monkeypatch):
    (searched / "libLLVM-16.so").touch()
    monkeypatch.setattr(llvm, "prove", lambda path: pytest.fail("tried"))
    assert [(verdict.version, verdict.proved) for verdict in llvm.examine()] == [("16", False)]


@pytest.mark.skipif(not OLD, reason="no old libLLVM here")
@pytest.mark.parametrize("path", OLD, ids=lambda path: Path(path).name)
def test_an_old_library_under_a_new_or_no_name_is_found_out(searched, path):
    """14 is refused by Dr.Jit; 15 aborts the child on AVX-512 and is too old elsewhere. Neither harms this process."""
    for name in ("libLLVM-19.so", "libLLVM.so"):
        (searched / name).unlink(missing_ok=True)
        os.link(path, searched / name) if os.access(path, os.W_OK) and _same_disk(path, searched) else (
            searched / name).write_bytes(Path(path).read_bytes())
    assert [verdict.proved for verdict in llvm.examine()] == [False, False]


def _same_disk(path: str, folder: Path) -> bool:
    return os.stat(path).st_dev == os.stat(folder).st_dev
