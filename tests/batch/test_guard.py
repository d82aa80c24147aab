"""A child does its worst; the guard says what it was, and the next task runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from mitsvbrdf.batch.workers import guard as guard_module
from mitsvbrdf.batch.workers.guard import LOG_CHARACTERS, Guard

FAKE = (sys.executable, "-P", str(Path(__file__).with_name("fake_child.py")))
MIB = 1 << 20
needs_proc = pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(),
                                reason="no /proc: no peak of memory")


@pytest.fixture
def make_guard():
    made = []

    def make(memory=None, timeout=60.0, command=FAKE, threads=1):
        made.append(Guard(threads, memory, timeout, command))
        return made[-1]

    yield make
    for guard in made:
        guard.close()


def task(capture: str) -> dict:
    return {"attempt": "a1", "name": "wood", "capture": capture}


def gone(pid: int, seconds: float = 30.0) -> bool:
    """Whether the process ends within so long (a zombie that nobody has reaped counts as ended)."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.02)
    return False


def test_a_child_serves_one_task_after_the_other(make_guard):
    guard = make_guard()
    first, second = guard.run(task("print:one")), guard.run(task("print:two"))
    assert first["state"] == second["state"] == "done"
    assert first["row"]["pid"] == second["row"]["pid"] and second["row"]["number"] == 2
    assert (first["log"], second["log"]) == ("one\n", "two\n")
    assert set(first) == {"state", "reason", "log", "seconds", "peak_bytes", "row", "host"}


def test_what_fails_by_itself_leaves_the_child_warm(make_guard):
    guard = make_guard()
    failed, after = guard.run(task("fail:blurred")), guard.run(task(""))
    assert (failed["state"], failed["reason"], failed["row"]) == ("failed", "blurred", None)
    assert after["state"] == "done" and after["row"]["number"] == 2


@pytest.mark.parametrize("capture, state, reason", [
    ("print:before abort", "crashed", "killed by SIGABRT"),
    ("exit:7", "crashed", "exit code 7"),
    ("kill:9", "crashed", "killed by SIGKILL"),
    ("kill:34", "crashed", "killed by SIGRTMIN"),
    ("say:hello", "crashed", "hello"),
    ("say:[1]", "crashed", "[1]"),
    ("say:{\"state\":\"crashed\"}", "crashed", "nobody knows"),
    ("sleep:600", "timeout", "killed after 0.5 s"),
])
def test_a_death_is_told_and_the_next_task_has_a_new_child(make_guard, capture, state, reason):
    guard = make_guard(timeout=0.5)
    first, bad, after = (guard.run(task(words)) for words in ("", capture, ""))
    assert bad["state"] == state and reason in bad["reason"] and bad["row"] is None
    assert after["state"] == "done" and after["row"]["number"] == 1
    assert gone(first["row"]["pid"], 0.1), "the old child must be gone when run returns"


@pytest.mark.parametrize("timeout, told", [(None, "killed after 0.2 s"), (0.1, "killed after 0.1 s")])
def test_a_task_may_state_its_own_limit_which_one_for_all_goes_before(make_guard, timeout, told):
    assert told in make_guard(timeout=timeout).run(task("sleep:600") | {"limit": 0.2})["reason"]


def test_the_log_of_a_death_holds_the_last_words_and_the_stack(make_guard):
    log = make_guard().run(task("print:last-words abort"))["log"]
    assert "last-words" in log and "Fatal Python error: Aborted" in log


def test_a_child_that_closes_its_pipe_and_goes_on_is_killed(make_guard, monkeypatch):
    monkeypatch.setattr(guard_module, "EXIT_SECONDS", 0.1)
    assert "closed its pipe" in make_guard().run(task("close"))["reason"]


def test_what_the_child_started_dies_with_it_and_does_not_hide_its_death(make_guard):
    found = make_guard().run(task("below:600 abort"))
    assert found["reason"] == "killed by SIGABRT"
    assert gone(int(found["log"].split()[0]))


def test_a_child_that_cannot_start_is_a_crash_with_its_words(make_guard):
    stillborn = make_guard(command=(*FAKE, "--stillborn")).run(task(""))
    assert stillborn["state"] == "crashed" and "exit code 1" in stillborn[
        "reason"] and "no luck" in stillborn["log"]
    missing = make_guard(command=("/no/such/python",)).run(task(""))
    assert missing["state"] == "crashed" and "/no/such/python" in missing["reason"]


def test_a_start_that_takes_too_long_ends(make_guard, monkeypatch):
    monkeypatch.setattr(guard_module, "START_SECONDS", 0.2)
    slow = make_guard(command=(sys.executable, "-c", "import time; time.sleep(600)"),
                      timeout=None).run(task(""))
    assert slow["state"] == "crashed" and "not ready" in slow["reason"]


@needs_proc
def test_memory_over_the_limit_kills_and_the_peak_is_each_tasks_own(make_guard):
    guard = make_guard(memory=0.25)
    small, large, after, over, last = (guard.run(task(words)) for words in (
        "", "take:100 free", "", "take:400 sleep:600", ""))
    assert [found["state"] for found in (small, large, after, over, last)] == ["done", "done", "done",
                                                                               "memory", "done"]
    assert large["peak_bytes"] > small["peak_bytes"] + 90 * MIB
    assert after["peak_bytes"] < small["peak_bytes"] + 30 * MIB  # what malloc keeps
    assert over["peak_bytes"] > 256 * MIB and "the limit is 0.25 GiB" in over["reason"]


@needs_proc
def test_memory_of_what_the_child_started_counts(make_guard):
    alone, both = (make_guard().run(task(words)) for words in ("sleep:0.5", "below:600 sleep:0.5"))
    assert both["peak_bytes"] > alone["peak_bytes"] + 3 * MIB


def test_the_child_has_its_threads(make_guard):
    row = make_guard(threads=3).run(task("environment:OMP_NUM_THREADS environment:MITSVBRDF_THREADS"))["row"]
    assert (row["OMP_NUM_THREADS"], row["MITSVBRDF_THREADS"]) == ("3", "3")


def test_a_long_log_is_cut_to_its_tail(make_guard):
    log = make_guard().run(task(" ".join(f"print:{'x' * 4000}{number}" for number in range(10))))["log"]
    assert len(log) == LOG_CHARACTERS and log.endswith("x9\n")


def test_the_child_dies_when_its_guard_is_killed():
    program = ("import sys; from mitsvbrdf.batch.workers.guard import Guard\n"
               f"guard = Guard(1, None, None, {FAKE!r}); print(guard.run({task('')!r})['row']['pid'], "
               "flush=True)\n"
               f"guard.run({task('sleep:600')!r})")
    holder = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    pid = int(holder.stdout.readline())
    assert not gone(pid, 0.2)
    holder.send_signal(signal.SIGKILL)
    holder.communicate()
    assert gone(pid)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no /proc: open files cannot be counted")
def test_nothing_stays_of_many_children(make_guard):
    guard = make_guard()
    guard.run(task("exit:1"))
    files, folder = len(os.listdir("/proc/self/fd")), sorted(os.listdir(tempfile.gettempdir()))
    for _ in range(10):
        guard.run(task("exit:1"))
    assert len(os.listdir("/proc/self/fd")) == files
    guard.close()
    guard.close()
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)  # no child of this process is left, not even a zombie
    assert not [name for name in set(os.listdir(tempfile.gettempdir())) - set(folder)
                if name.startswith("tmp")]
