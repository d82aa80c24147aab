"""The search for a libLLVM: what is refused, proved and said. Trials run in child processes."""

import importlib.metadata
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


def proved_here():
    """The first libLLVM that is proved to work, or None."""
    return next((each for each in llvm.examine() if each.proved), None)


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter; a variable given as "" is removed."""
    variables = {name: value for name, value in (os.environ | environment).items() if value}
    return subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True,
                          timeout=60)


def test_versions_are_read_from_paths():
    told = {"/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1": 15, "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1": 19,
            "/usr/lib/libLLVM-14.0.6.so": 14, "/opt/homebrew/Cellar/llvm/21.1.0/lib/libLLVM.dylib": 21,
            "/opt/homebrew/opt/llvm@20/lib/libLLVM.dylib": 20, "/usr/lib/llvm-19/lib/libLLVM.so": 19,
            "/usr/lib64/libLLVM.so": 0, "C:/Program Files/LLVM/bin/LLVM-C.dll": 0}
    assert {path: llvm.named_version(path) for path in told} == told


def test_measured_versions_come_first_and_links_count_once(searched):
    for name in ("libLLVM-23.so", "libLLVM-20.so", "libLLVM.so.22.1", "libLLVM-19.so.1", "libLLVM.dylib",
                 "LLVM-C.dll", "libLLVMCore.a", "libLLVMgold.so", "LLVMPolly.so"):
        (searched / name).touch()
    (searched / "libLLVM-19.so").symlink_to("libLLVM-19.so.1")
    assert [Path(path).name for path in llvm.candidates()] == [
        "libLLVM-19.so.1", "libLLVM.so.22.1", "libLLVM-23.so", "libLLVM-20.so", "LLVM-C.dll", "libLLVM.dylib"]


def test_a_text_file_is_no_library(searched):
    (searched / "libLLVM-19.so").write_text("not a library")
    (verdict,) = llvm.examine()
    assert not verdict.proved and "libLLVM-19.so" in verdict.message
    assert proved_here() is None


def test_an_old_version_is_refused_without_a_trial(searched, monkeypatch):
    (searched / "libLLVM-16.so").touch()
    monkeypatch.setattr(llvm, "prove", lambda path: pytest.fail("tried"))
    assert [(verdict.version, verdict.proved) for verdict in llvm.examine()] == [("16", False)]


@pytest.mark.skipif(not OLD, reason="no old libLLVM here")
@pytest.mark.parametrize("path", OLD, ids=lambda path: Path(path).name)
def test_an_old_library_whose_name_does_not_tell_is_found_out(searched, monkeypatch, path):
    """Dr.Jit refuses 14; 15 aborts the child on AVX-512. Neither harms this process."""
    monkeypatch.setattr(llvm, "candidates", lambda: [path])
    monkeypatch.setattr(llvm, "named_version", lambda path: 0)
    (verdict,) = llvm.examine()
    assert not verdict.proved and verdict.message


@pytest.mark.parametrize("value", ["/nowhere/libLLVM-19.so", *OLD[:1]])
def test_the_users_own_choice_is_never_replaced(monkeypatch, no_drjit_yet, value):
    monkeypatch.setenv(llvm.VARIABLE, value)
    with pytest.raises(BackendError, match=llvm.VARIABLE) as error:
        llvm.use_llvm()
    assert value in error.value.got and f"unset {llvm.VARIABLE}" in error.value.fix
    assert os.environ[llvm.VARIABLE] == value


def test_without_any_the_line_to_type_is_told(searched, monkeypatch, no_drjit_yet):
    monkeypatch.delenv("CONDA_PREFIX", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(llvm.shutil, "which", lambda name: "/usr/bin/apt-get" if name == "apt-get" else None)
    with pytest.raises(BackendError, match="sudo apt-get update && sudo apt-get install -y libllvm19"):
        llvm.use_llvm()
    assert llvm.VARIABLE not in os.environ


@pytest.mark.parametrize("platform, tool, prefix, line", [
    ("linux", "dnf", "", "sudo dnf install -y llvm-libs"), ("darwin", "brew", "", "brew install llvm"),
    ("linux", "apt-get", "/opt/conda", "conda install -c conda-forge libllvm19")])
def test_the_line_fits_the_platform(monkeypatch, platform, tool, prefix, line):
    monkeypatch.setenv("CONDA_PREFIX", prefix)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(llvm.shutil, "which", lambda name: f"/usr/bin/{name}" if name == tool else None)
    assert llvm.install_hint() == line


def test_without_drjit_its_install_line_is_told(monkeypatch, no_drjit_yet):
    monkeypatch.setattr(llvm.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BackendError, match="pip install mitsuba"):
        llvm.use_llvm()


def test_an_unknown_variant_is_refused():
    with pytest.raises(BackendError, match="llvm_ad_rgb"):
        llvm.mitsuba_module("llvm_ad_rbg")


def test_a_fresh_process_gets_a_proved_library_and_the_variant():
    child = python("import os, sys; from mitsvbrdf.render.llvm import mitsuba_module\n"
                   "assert not {'drjit', 'mitsuba'} & set(sys.modules)\n"
                   "before = dict(os.environ); mi = mitsuba_module(); assert mitsuba_module() is mi\n"
                   "print({n for n in os.environ if os.environ[n] != before.get(n)}, mi.variant(), "
                   "mi.Float(2) * 2)", DRJIT_LIBLLVM_PATH="")
    assert child.stdout.strip() == "{'DRJIT_LIBLLVM_PATH'} llvm_ad_rgb [4]", child.stderr


@pytest.mark.slow
def test_a_drjit_imported_before_is_not_fought():
    found = proved_here()
    child = python("import os, drjit; from mitsvbrdf.render.llvm import use_llvm; llvm = use_llvm()\n"
                   "print(llvm.proved, llvm.path, llvm.version)", DRJIT_LIBLLVM_PATH=found.path)
    assert child.stdout.split() == ["True", found.path, found.version], child.stderr


@pytest.mark.slow
def test_a_drjit_imported_before_without_llvm_is_reported():
    child = python("import drjit; from mitsvbrdf.render.llvm import use_llvm; use_llvm()",
                   DRJIT_LIBLLVM_PATH="/nowhere")
    assert child.returncode == 1 and "BackendError" in child.stderr and "imported earlier" in child.stderr


def test_a_good_answer_is_remembered_until_the_file_or_drjit_changes(searched, monkeypatch):
    library = searched / "libLLVM-19.so"
    library.touch()
    trials = []

    def trial(*arguments, **options):
        trials.append(arguments)
        return subprocess.CompletedProcess([], 0, "19.1.7\n", "")

    monkeypatch.setattr(llvm.subprocess, "run", trial)
    good = llvm.LLVM(str(library), "19.1.7", True)
    assert llvm.prove(str(library)) == llvm.prove(str(library)) == good and len(trials) == 1
    library.write_text("another")
    assert llvm.prove(str(library)) == good and len(trials) == 2
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "99")
    assert llvm.prove(str(library)) == good and len(trials) == 3


def test_a_cache_that_cannot_be_written_costs_a_trial_only(searched, monkeypatch):
    library = searched / "libLLVM-19.so"
    library.touch()
    monkeypatch.setattr(llvm.subprocess, "run",
                        lambda *a, **o: subprocess.CompletedProcess([], 0, "19.1.7\n", ""))
    monkeypatch.setenv("XDG_CACHE_HOME", str(library))  # a file: no folder can be made in it
    assert llvm.prove(str(library)).proved


def test_a_bad_answer_is_tried_again(searched, monkeypatch):
    library = searched / "libLLVM-19.so"
    library.touch()
    answers = iter([subprocess.CompletedProcess([], -6, "", "LLVM ERROR: out of memory"),
                    subprocess.CompletedProcess([], 0, "19.1.7\n", "")])
    monkeypatch.setattr(llvm.subprocess, "run", lambda *a, **o: next(answers))
    first, second = llvm.prove(str(library)), llvm.prove(str(library))
    assert not first.proved and "LLVM ERROR: out of memory" in first.message and second.proved


def test_wrong_numbers_are_no_proof(monkeypatch):
    """The trial compares: with one number changed, the library that works is refused."""
    path = proved_here().path
    monkeypatch.setattr(llvm, "PROOF", llvm.PROOF.replace("31.5) for", "30.5) for"))
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    verdict = llvm.prove(path)
    assert not verdict.proved and "wrong results" in verdict.message


@pytest.mark.slow
def test_as_a_program_it_prints_the_path_or_the_hint():
    program = [sys.executable, "-m", "mitsvbrdf.render.llvm"]
    good = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert good.returncode == 0 and os.path.isfile(good.stdout.strip())
    bad = subprocess.run(program, capture_output=True, text=True, timeout=60,
                         env=os.environ | {llvm.VARIABLE: "/nowhere"})
    assert bad.returncode == 1 and llvm.install_hint() in bad.stderr and not bad.stdout
