"""Standard streams that are closed, full or without a reader: work goes on, and files are whole."""

import errno
import os
import subprocess
import sys

import pytest
from helpers import ROOT
from helpers.commands import FAST

from mitsvbrdf import cli
from mitsvbrdf.io import progress
from mitsvbrdf.io.progress import Progress, print_numbers, print_rich, progress_bar, say
from mitsvbrdf.io.streams import Unfailing

OURS = os.environ | {"PYTHONPATH": str(ROOT)}
pytestmark = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device that is always full")


def test_what_has_no_room_is_dropped_and_the_first_failure_known():
    stream = Unfailing("/dev/full", "w")
    assert stream.write(b"abc") == 3 and stream.failure.errno == errno.ENOSPC
    first = stream.failure
    # a gap in the middle would say something else
    assert stream.write(b"later") == 5 and stream.failure is first


def run(arguments, folder, redirected=""):
    """Exit code and standard error of a command in a process of its own, its streams as a shell redirects."""
    command = ["bash", "-c", f'exec "$@" {redirected}', "bash", sys.executable, "-P", "-m", "mitsvbrdf"]
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, env=OURS)
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done.stderr
    return done.returncode, done.stderr


@pytest.mark.parametrize("redirected, reason", [(">/dev/full", "No space left"),
                                                (">&-", "Bad file descriptor")])
def test_a_command_that_only_prints_says_that_it_could_not(redirected, reason, tmp_path):
    code, said = run(["--version"], tmp_path, redirected)
    assert code == 2 and said.count("error:") == 1 and reason in said


def test_without_any_stream_a_file_is_whole_and_holds_nothing_else(tmp_path):
    assert cli.main(["sheet", "-o", str(tmp_path / "told.svg")]) == 0
    assert run(["sheet", "-o", "closed.svg"], tmp_path, "<&- >&- 2>&-") == (0, "")
    code, said = run(["sheet", "-o", "full.svg"], tmp_path, ">/dev/full")
    assert code == 0 and said.count("\n") == 1 and "No space left" in said
    assert len({(tmp_path / f"{name}.svg").read_bytes() for name in ("told", "closed", "full")}) == 1
    assert run(["sheet", "-o", "."], tmp_path, "2>/dev/full")[0] == 2  # its error is lost, not its exit code


def test_a_reader_that_has_seen_enough_is_no_mistake(tmp_path):
    script = f'"{sys.executable}" -P -m mitsvbrdf --help | true'
    done = subprocess.run(["bash", "-o", "pipefail", "-c", script], capture_output=True, text=True, env=OURS,
                          cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


class Broken:
    """A standard output of a program that calls us: full, without a reader, or closed."""

    encoding, buffer = "utf-8", None

    def __init__(self, error):
        self.error = error

    def write(self, text):
        raise self.error

    def flush(self):
        raise self.error

    def isatty(self):
        if isinstance(self.error, ValueError):  # as of a file that is closed
            raise self.error
        return False


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), BrokenPipeError(errno.EPIPE, "pipe"),
                                   ValueError("closed")])
def test_work_in_another_program_goes_on(error, monkeypatch):
    monkeypatch.setattr(progress, "console", progress._Console(highlight=False))
    monkeypatch.setattr(sys, "stdout", Broken(error))
    with Progress("fit") as report, progress_bar("bar") as bar:
        report({"seconds": 1.0, "iteration": 1, "rerender_rmse": 0.5}, 1.0)
        bar("one", 0.5)
    say("line")
    print_rich("text")
    print_numbers("title", {"a": 1.0})


@pytest.mark.slow
@pytest.mark.parametrize("redirected", [">/dev/full", ">&- 2>&-", "2>/dev/full"])
def test_a_fit_is_kept(redirected, tmp_path):
    photos = str(tmp_path / "photos")
    assert cli.main(["synth", "builtin:inlay", "-o", photos, "--resolution", "16", "--renderer",
                     "analytic"]) == 0
    code, said = run(["fit", photos, "-o", "out", *FAST], tmp_path, redirected)
    assert code == 0 and ("No space left" in said) == (redirected == ">/dev/full")
    assert (tmp_path / "out/fit.json").is_file() and (tmp_path / "out/maps/diffuse.exr").is_file()


NAME = b"caf\xe9".decode(errors="surrogateescape")  # a name in Latin-1, as Python gives it


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_names_that_are_no_text_are_refused_before_anything_else(command, capsys, monkeypatch):
    monkeypatch.setattr(cli, "command", lambda *_: pytest.fail("went on"))
    assert cli.main([command, NAME, "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert said.count("error:") == 1 and r"caf\udce9" in said


def test_so_are_folders_and_photos_of_such_names(tmp_path, monkeypatch, capsys):
    folder = tmp_path / NAME
    folder.mkdir()
    (tmp_path / f"{NAME}.jpg").write_bytes(b"photo")
    assert cli.main(["guess", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    (tmp_path / "link").symlink_to(folder)
    assert cli.main(["sheet", f"--out={tmp_path}/link/sheet.pdf"]) == 2
    monkeypatch.chdir(folder)
    assert cli.main(["sheet"]) == 2
    said = capsys.readouterr().err
    assert said.count("error:") == 3 == said.count(r"caf\udce9")


def test_a_name_met_later_is_one_error_too(monkeypatch, capsys):
    monkeypatch.setattr(cli, "_run", lambda _: len(f"photo {NAME}.png".encode()))
    assert cli.main([]) == 2 and r"photo caf\udce9.png" in capsys.readouterr().err
    monkeypatch.setattr(cli, "_run", lambda _: len("é".encode("ascii")))
    with pytest.raises(UnicodeEncodeError):  # a fault of ours
        cli.main([])


INTERRUPTED = """
import os, signal, sys, time
class Finder:  # as an extension that turns whatever goes wrong into an ImportError
    def find_spec(self, name, *rest):
        if name == "torch":
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.1)
            except BaseException:
                raise ImportError("torch failed", name="torch") from None
sys.meta_path.insert(0, Finder())
sys.argv[1:] = ["render", "builtin:tiles", "-o", "out"]
from mitsvbrdf.__main__ import main
sys.exit(main())
"""


def test_ctrl_c_waits_for_an_import(tmp_path):
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, cwd=tmp_path,
                          env=OURS)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


def test_what_a_library_makes_of_ctrl_c_is_ctrl_c(monkeypatch, capsys):
    def fails(_):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as pressed:
            raise SystemError("returned a result with an exception set") from pressed

    monkeypatch.setattr(cli, "_run", fails)
    assert cli.main([]) == 130 and capsys.readouterr().err == "interrupted\n"


def test_a_current_folder_that_was_deleted_is_one_error(tmp_path):
    script = f'mkdir gone; cd gone; rmdir ../gone; "{sys.executable}" -P -m mitsvbrdf sheet -o tags.svg'
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path, env=OURS)
    assert done.returncode == 2 and "got one that was deleted; type cd" in done.stderr.replace("\n", " ")
