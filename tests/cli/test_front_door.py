"""The table of commands repeats what each command says of itself, and loads nothing heavy."""

import subprocess
import sys

import pytest

from mitsvbrdf import cli

HEAVY = ("torch", "scipy", "mitsuba", "matplotlib", "cv2")


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_list_has_the_first_sentence_of_each_command(name):
    command = cli.command(name)
    first, _, _ = getattr(command, "func", command).__doc__.partition("\n\n")
    assert " ".join(first.split()) == cli.summary(name)


def loaded_by(arguments, folder):
    """What a process of its own prints for these arguments, its exit code, and its heavy packages."""
    code = f"""
import sys
from mitsvbrdf.__main__ import main
sys.argv[1:] = {arguments!r}
code = 0
try:
    code = main()
except SystemExit as stop:
    code = stop.code
print("\\n", code, *sorted(set({HEAVY!r}) & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder)
    said, _, last = done.stdout.rstrip().rpartition("\n")
    status, *heavy = last.split()
    return said + done.stderr, int(status), heavy


@pytest.mark.parametrize("arguments, word, status", [
    (["--help"], "relight", 0), (["--version"], "mitsvbrdf ", 0), (["sheet", "--help"], "--paper", 0),
    (["capture", "--help"], "--sheet", 0), (["demo", "--help"], "--budget", 0),
    ([], "subcommand", 2), (["shet"], "shet", 2), (["sheet", "--papr", "a4"], "--papr", 2)])
def test_words_about_commands_load_nothing_heavy(arguments, word, status, tmp_path):
    said, code, heavy = loaded_by(arguments, tmp_path)
    assert word in said and code == status and heavy == []


def test_a_sheet_needs_no_torch(tmp_path):
    said, code, heavy = loaded_by(["sheet", "-o", "tags.svg"], tmp_path)
    assert code == 0 and "tags.svg" in said and (tmp_path / "tags.svg").is_file() and "torch" not in heavy


def test_the_shell_completes_options_of_every_command(tmp_path):
    script = tmp_path / "mitsvbrdf"
    with pytest.raises(SystemExit) as stop:
        cli.main(["--tyro-write-completion", "bash", str(script)])
    assert not stop.value.code
    code = f"""source {script}
COMP_WORDS=(mitsvbrdf "$1" "$2"); COMP_CWORD=2; COMP_LINE="mitsvbrdf $1 $2"; COMP_POINT=${{#COMP_LINE}}
_tyro_mitsvbrdf mitsvbrdf "$2" "$1"; echo "${{COMPREPLY[@]}}"
"""
    for command, begun, whole in (("export", "--nam", "--naming"), ("fit", "--bud", "--budget"),
                                  ("sheet", "--pap", "--paper")):
        done = subprocess.run(["bash", "-c", code, "bash", command, begun], capture_output=True, text=True)
        assert done.stdout.split() == [whole], (command, done)


def test_a_missing_package_is_one_error(tmp_path):
    code = """
import sys
sys.modules["torch"] = None
from mitsvbrdf.__main__ import main
sys.argv[1:] = ["guess", "photos", "-o", "out"]
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("error:") == 1 and "mitsvbrdf doctor" in done.stderr


def test_a_fault_of_our_own_is_no_missing_package(tmp_path):
    code = """
import sys
import mitsvbrdf.cli
from mitsvbrdf.__main__ import main
def broken():
    from mitsvbrdf.errors import no_such_name
mitsvbrdf.cli.main = broken
sys.exit(main())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1 and "Traceback" in done.stderr and "no_such_name" in done.stderr
