"""The set-up script: POSIX sh, help with the right exit codes, and no work once everything is installed."""

import shutil
import subprocess
from pathlib import Path

import pytest
from helpers import ROOT

RUN = ROOT / "run"


def sh(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    words = [str(each) for each in arguments]
    return subprocess.run(words, capture_output=True, encoding="utf-8", timeout=20, **options)


@pytest.mark.parametrize("shell", [s for s in ("sh", "dash", "bash", "busybox") if shutil.which(s)])
def test_every_shell_reads_it(shell):
    extra = ["sh"] if shell == "busybox" else ["--posix"] if shell == "bash" else []
    assert sh(shell, *extra, "-n", RUN).stderr == ""
    assert sh(shell, *extra, RUN, "help").returncode == 0


def test_help_names_the_commands():
    shown, names = sh(RUN, "help").stdout, "demo test check slow docs soak setup".split()
    assert all(f"./run {name}" in shown for name in names)


@pytest.mark.parametrize("arguments", [[], ["tset"]])
def test_no_or_an_unknown_command_is_an_error_with_the_help_on_stderr(arguments):
    done = sh(RUN, *arguments)
    assert done.returncode == 2 and "usage:" in done.stderr and not done.stdout


@pytest.fixture
def checkout(tmp_path):
    """A checkout under an awkward name, set up with stand-ins that print how they are called."""
    root = tmp_path / "a chéckout"
    (root / ".venv" / "bin").mkdir(parents=True)
    for name in ("run", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, root / name)
    for name in ("python", "mitsvbrdf", "ruff", "mypy", "lint-imports"):
        program = root / ".venv" / "bin" / name
        program.write_text('#!/bin/sh\nprintf "%s|" "$PWD" "${0##*/}" "$@"\n')
        program.chmod(0o755)
    for done in ("stamp", "docs-tools", "slow-tools"):
        (root / ".venv" / done).write_text(stamp(root))
    return root


def stamp(root: Path) -> str:
    facts = (root / "pyproject.toml").read_text() + (root / "constraints.txt").read_text() + str(root)
    return sh("cksum", input=facts).stdout


def test_a_set_up_checkout_runs_at_once_from_anywhere(checkout, tmp_path):
    """PATH has no pip, apt or Python here, and HOME is unset: only starting the program can succeed."""
    environment = {"PATH": "/usr/bin:/bin", "LC_ALL": "C"}
    demo = sh(checkout / "run", "demo", "--out", "my maps", cwd=tmp_path, env=environment)
    assert demo.stdout == f"{tmp_path}|mitsvbrdf|demo|--out|my maps|", demo.stderr
    tests = sh(checkout / "run", "test", "-k", "one two", cwd=tmp_path, env=environment)
    assert tests.stdout == f"{checkout}|python|-m|pytest|-k|one two|", tests.stderr
    slow = sh(checkout / "run", "slow", cwd=tmp_path, env=environment)
    assert slow.stdout.startswith(f"{checkout}|python|-m|pytest|-n|"), slow.stderr
    assert slow.stdout.endswith("|--dist|loadfile|-m|slow|"), slow.stderr
    docs = sh(checkout / "run", "docs", cwd=tmp_path, env=environment)
    assert docs.stdout.startswith(f"{checkout}|python|-m|sphinx|") and "|-W|" in docs.stdout, docs.stderr
    assert docs.stdout.endswith("|.|out/site|") and f"{checkout}/out/site/index.html" in docs.stderr
    soak = sh(checkout / "run", "soak", "40", cwd=tmp_path, env=environment)
    assert soak.stdout.startswith(f"{checkout}|python|-m|pytest|-m|slow|"), soak.stderr
    assert "|tests/verify/test_soak.py|" in soak.stdout


def breaks(checkout: Path, *programs: str) -> None:
    for name in programs:
        (checkout / ".venv" / "bin" / name).write_text(
            f'#!/bin/sh\necho {name} found something >&2\nexit 1\n')


def test_check_says_a_line_for_each_and_goes_on_after_a_red_one(checkout):
    green = sh(checkout / "run", "check")
    assert green.stdout.split() == "style ok types ok imports ok lengths ok".split(), green.stderr
    assert green.returncode == 0
    breaks(checkout, "ruff", "lint-imports")
    red = sh(checkout / "run", "check")
    assert red.returncode == 1 and red.stdout.splitlines() == [
        "ruff found something", "style     FAILED", "types     ok",
        "lint-imports found something", "imports   FAILED", "lengths   ok"]


def test_all_tests_run_beside_the_checks_and_neither_is_forgotten(checkout):
    done = sh(checkout / "run", "test")
    assert done.returncode == 0 and "|-m|pytest|-n|" in done.stdout, done.stderr
    assert done.stdout.endswith("style     ok\ntypes     ok\nimports   ok\nlengths   ok\n")
    breaks(checkout, "mypy")
    red = sh(checkout / "run", "test")
    assert red.returncode == 1 and "types     FAILED\n" in red.stdout and "|-m|pytest|-n|" in red.stdout
    breaks(checkout, "python")
    assert sh(checkout / "run", "test").returncode == 1


def test_slow_tests_get_their_tools_once(checkout):
    (checkout / ".venv" / "slow-tools").unlink()
    tools = checkout / "tools"
    tools.mkdir()
    for tool in ("sh", "dirname", "cat", "cksum"):
        (tools / tool).symlink_to(shutil.which(tool))
    for name in ("chromium", "npm"):
        (tools / name).write_text(f'#!/bin/sh\nprintf "%s " {name} "$@" >&2\n')
        (tools / name).chmod(0o755)
    first, second = (sh(checkout / "run", "slow", env={"PATH": str(tools)}).stderr for _ in range(2))
    assert "gltf-validator" in first and "chromium" not in first and str(checkout / ".venv") in first
    assert not second


@pytest.mark.parametrize("given, used", [({"LC_ALL": "C"}, "C.UTF-8"), ({}, "C.UTF-8"),
                                         ({"LANG": "de_DE.utf8"}, "")])
def test_python_gets_a_locale_that_can_spell_the_path(checkout, given, used):
    (checkout / ".venv" / "bin" / "python").write_text('#!/bin/sh\nprintf "%s" "${LC_ALL-}"\n')
    assert sh(checkout / "run", "test", "-q", env={"PATH": "/usr/bin:/bin"} | given).stdout == used


def test_changed_requirements_are_set_up_again(checkout):
    with open(checkout / "constraints.txt", "a") as file:
        file.write("another==1\n")
    done = sh(checkout / "run", "setup", env={"PATH": "/usr/bin:/bin"})
    assert "installing the Python packages" in done.stderr
    assert (checkout / ".venv" / "stamp").read_text() == stamp(checkout)


UV_WAYS = """printf '%s\\n' "$UV_DEFAULT_INDEX" "$UV_INDEX" "$UV_FIND_LINKS" "$SSL_CERT_FILE" \
    "$UV_HTTP_TIMEOUT" "$@" >&2"""


def told(checkout: Path, settings: str | None, uv: str) -> tuple[str, list[str]]:
    """Messages of `run setup` with these settings of pip (None: unreadable) and this uv; pip's installs."""
    (checkout / ".venv" / "stamp").unlink()
    programs, calls = checkout / ".venv" / "bin", checkout / "calls"
    if settings is not None:
        (checkout / "settings").write_text(settings)
    (programs / "uv").write_text(f"#!/bin/sh\n{uv}\n")
    (programs / "uv").chmod(0o755)
    (programs / "python").write_text(f'#!/bin/sh\nroot="{checkout}"\n'
                                     'case "$*" in *"pip config list") cat "$root/settings" ;;\n'
                                     '*"pip install"*) printf "%s\\n" "$*" >>"$root/calls" ;; esac\n')
    done = sh(checkout / "run", "setup", env={"PATH": "/usr/bin:/bin"})
    assert done.returncode == 0, done.stderr
    return done.stderr, [call.rsplit("constraints.txt ", 1)[1] for call in calls.read_text().splitlines()]


@pytest.mark.parametrize("timeout", ["timeout", "default-timeout"])
def test_uv_looks_for_packages_where_pip_does(checkout, timeout):
    settings = [f":env:.{timeout}='180'", "global.index-url='https://a/simple?x=1'",
                "global.find-links='/b /c'", "global.cert='/d.crt'",
                "user.extra-index-url='\\nhttps://e\\nfile:///f'", "site.extra-index-url='https://g'",
                "user.find-links='/h'", "user.index-url='https://a/simple?x=1'", "global.retries='9'",
                "global.no-input='true'", "global.cache-dir='/i'",
                "global.disable-pip-version-check='true'\n"]
    messages, by_pip = told(checkout, "\n".join(settings), UV_WAYS)
    assert by_pip == ["uv"]
    lines, limits = messages.splitlines(), f"{checkout}/constraints.txt"
    at = lines.index("https://a/simple?x=1")
    assert lines[at + 1 : at + 5] == ["https://e file:///f https://g", "/b,/c,/h", "/d.crt", "180"]
    assert lines[at + 5 : at + 18] == [
        "pip", "install", "-q", "--python", f"{checkout}/.venv/bin/python", "--index-strategy",
        "unsafe-best-match", "-c", limits, "-b", limits, "-e", f"{checkout}[test,dev]"]


def test_uv_installs_where_pip_is_told_nothing(checkout):
    assert told(checkout, "", UV_WAYS)[1] == ["uv"]


@pytest.mark.parametrize("settings, uv", [
    ("global.no-index='true'\n", UV_WAYS), ("", "exit 2"), (None, UV_WAYS),
    ("global.index-url='https://a'\nuser.index-url='https://b'\n", UV_WAYS)])
def test_pip_installs_what_uv_does_not(checkout, settings, uv):
    messages, by_pip = told(checkout, settings, uv)
    assert by_pip == ["uv", "hatchling editables", f"--no-build-isolation -e {checkout}[test,dev]"]
    assert "pip, which" in messages


def test_without_a_fitting_python_it_says_so(tmp_path):
    for name in ("run", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    tools = tmp_path / "tools"
    tools.mkdir()
    for tool in ("sh", "dirname", "cat", "cksum"):
        (tools / tool).symlink_to(shutil.which(tool))
    done = sh(tmp_path / "run", "setup", env={"PATH": str(tools)})
    assert done.returncode == 1 and "Python 3.11 or newer" in done.stderr
    assert not (tmp_path / ".venv").exists()
