"""One child process, watched: it runs one task after the other, and whatever a task does to it, the guard
goes on.

The child stays warm between tasks. It is killed, with all that it started, when a task takes more memory or
time than it may, and started anew at the next task. It talks in lines of JSON over two pipes::

    child: {"ready": true}
    guard: {"task": {...}}
    child: {"state": "done" | "failed" | "full", "reason": "...", "row": {...} or null}

A child ends at the end of its pipe, and calls :func:`die_with_parent` first of all.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from ... import __version__

CHILD = (sys.executable, "-P", "-m", "mitsvbrdf.batch.child")
START_SECONDS = 300.0  # until a child must be ready: the imports of a cold disk
POLL_SECONDS = 0.05, 0.2  # between two looks at memory and clock: at first, and later
# a child that closed its pipe has so long to end by itself, so that its own exit code is seen
EXIT_SECONDS = 2.0
ANSWERS = ("done", "failed", "full")  # the last: no space is left for the result
LOG_CHARACTERS = 20_000
LOG_BYTES = 64 << 20  # what a child may print; beyond, its log begins anew
GIB = 1 << 30


class _Ended(Exception):
    """The child is gone, or must go: the state and the reason of the outcome."""

    def __init__(self, state: str, reason: str) -> None:
        super().__init__(state, reason)
        self.state, self.reason = state, reason


class Guard:
    """Keeps one child warm and gives it tasks.

    Memory is that of the child and of the processes below it, read from ``/proc``; on systems without it
    there is no limit on memory, and the peak is 0.

    Args:
        threads: of the child's numeric libraries.
        memory: GiB that a task may take; None is no limit.
        timeout: seconds that a task may take, without the start of the child; None: those that it states
            itself under ``limit``, if any.
        command: starts the child; the numbers of its two pipes, to read and to write, follow as the last two
            arguments.
    """

    def __init__(self, threads: int, memory: float | None, timeout: float | None,
                 command: Sequence[str] = CHILD) -> None:
        self._environment = dict.fromkeys(
            ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MITSVBRDF_THREADS"), str(threads))
        self._environment |= {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}
        self._memory, self._timeout, self._command = memory, timeout, command
        self._log = tempfile.TemporaryFile()
        # so that it can be emptied under a child that writes
        fcntl.fcntl(self._log, fcntl.F_SETFL, os.O_APPEND)
        self._child: _Child | None = None

    def about(self) -> dict:
        """Where this guard is: ``host``, ``pid`` and ``version``."""
        return {"host": socket.gethostname(), "pid": os.getpid(), "version": __version__}

    @property
    def child(self) -> int | None:
        """The number of the child's process; None while there is none."""
        return self._child.pid if self._child else None

    def run(self, task: dict) -> dict:
        """Run one task and wait for it; whatever it does to its child is in the outcome, and raises nothing.

        Args:
            task: handed to the child as it is.

        Returns:
            ``state`` (done, failed, full, crashed, timeout or memory), ``reason`` in a sentence, ``log`` (the
            tail of what the child printed), ``seconds`` of the task, ``peak_bytes`` of memory, ``row`` of the
            child, ``host``.
        """
        os.ftruncate(self._log.fileno(), 0)
        started, answer = time.monotonic(), {}
        try:
            child = self._child = self._child or _Child(self._command, self._environment, self._log.fileno())
            started = time.monotonic()
            answer = child.ask(task, self._memory, self._timeout or task.get("limit"))
            if answer.get("state") not in ANSWERS:
                raise _Ended("crashed", f"child gave an answer that nobody knows: {str(answer)[:200]}")
        except (_Ended, OSError) as end:
            answer = {"state": getattr(end, "state", "crashed"), "reason": getattr(end, "reason",
                                                                                   f"no child: {end}")}
        seconds, peak = time.monotonic() - started, self._child.peak if self._child else 0
        if answer["state"] not in ANSWERS:
            self._end_child()
        return {"state": answer["state"], "reason": str(answer.get("reason") or ""), "log": self._tail(),
                "seconds": round(seconds, 3), "peak_bytes": peak, "row": answer.get("row"),
                "host": socket.gethostname()}

    def close(self) -> None:
        """End the child, whatever it is doing."""
        self._end_child()
        self._log.close()

    def _end_child(self) -> None:
        if self._child:
            self._child.close()
            self._child = None

    def _tail(self) -> str:
        size, length = os.fstat(self._log.fileno()).st_size, 4 * LOG_CHARACTERS
        return os.pread(self._log.fileno(), length,
                        max(0, size - length)).decode(errors="replace")[-LOG_CHARACTERS:]


class _Child:
    """One process from its start to its end; every wait has a deadline."""

    def __init__(self, command: Sequence[str], environment: dict[str, str], log: int) -> None:
        self.peak = 0
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        self._unread = b""
        try:
            self._process = subprocess.Popen(
                [*command, str(theirs_in), str(theirs_out)], env=os.environ | environment,
                stdin=subprocess.DEVNULL,
                stdout=log, stderr=log, pass_fds=(theirs_in, theirs_out), start_new_session=True)
        except OSError:
            os.close(self._to)
            os.close(self._from)
            raise
        finally:
            os.close(theirs_in)
            os.close(theirs_out)
        self._new, self._log = True, log

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, task: dict, memory: float | None, timeout: float | None) -> dict:
        """Give the child a task; return its answer, or raise :class:`_Ended`."""
        if self._new:
            late = f"child was not ready after {START_SECONDS:g} s"
            if "ready" not in self._answer(None, START_SECONDS, ("crashed", late)):
                raise _Ended("crashed", "child did not say that it is ready")
            self._new = False
        self.peak, resets = 0, _reset_peak(self.pid)
        try:
            os.write(self._to, json.dumps({"task": task}).encode() + b"\n")
        except BrokenPipeError:
            raise self._ended() from None
        return self._answer(memory, timeout, ("timeout", f"killed after {timeout} s, the limit"), resets)

    def _answer(self, memory: float | None, timeout: float | None, late: tuple[str, str],
                resets: bool = False) -> dict:
        deadline = time.monotonic() + (float("inf") if timeout is None else timeout)
        wait, most = POLL_SECONDS
        while b"\n" not in self._unread:
            if select.select([self._from], [], [], max(0.0, min(wait, deadline - time.monotonic())))[0]:
                some = os.read(self._from, 1 << 16)
                if not some:
                    raise self._ended()
                self._unread += some
            elif os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                raise self._ended()  # what it started still holds its pipe
            elif time.monotonic() >= deadline:
                raise _Ended(*late)
            self._weigh(memory, resets)
            if os.fstat(self._log).st_size > LOG_BYTES:
                os.ftruncate(self._log, 0)
            wait = min(1.2 * wait, most)
        line, self._unread = self._unread.split(b"\n", 1)
        self._weigh(None, resets)
        try:
            answer = json.loads(line)
        except ValueError:
            answer = line.decode(errors="replace")
        return answer if isinstance(answer, dict) else {"reason": answer}

    def _weigh(self, memory: float | None, resets: bool) -> None:
        """Look at what the child and those below it hold; over the limit it ends. A peak between two looks
        counts too.
        """
        own, *below = (_status(pid) for pid in _family(self.pid))
        used = (own["VmHWM"] if resets else own["VmRSS"]) + sum(other["VmRSS"] for other in below)
        self.peak = max(self.peak, used)
        if memory is not None and used > memory * GIB:
            raise _Ended("memory", f"killed when it held {used / GIB:.2f} GiB, the limit is {memory:g} GiB")

    def _ended(self) -> _Ended:
        """Say why the child is gone; one that only closed its pipe is killed."""
        deadline, reason = time.monotonic() + EXIT_SECONDS, ""
        while not os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            if time.monotonic() > deadline:
                reason = "closed its pipe and went on; killed"
                break
            time.sleep(0.01)
        code = self.close()
        if not reason and code < 0:
            reason = f"killed by {_signal_name(-code)}" + (
                ", by hand or by the system when memory ran out" if code == -signal.SIGKILL else "")
        return _Ended("crashed", reason or f"child ended by itself with exit code {code}")

    def close(self) -> int:
        """Kill the child's process group, and give the child's exit code; a second time only the code."""
        if self._process.returncode is None:
            try:  # not reaped yet: its number is nobody else's
                os.killpg(self.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            self._process.wait()
            os.close(self._to)
            os.close(self._from)
        return self._process.returncode


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _reset_peak(pid: int) -> bool:
    """Let the process's ``VmHWM`` begin anew; whether that can be done here."""
    try:
        Path(f"/proc/{pid}/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _family(pid: int) -> Iterator[int]:
    """The process and all below it, itself first."""
    yield pid
    try:
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                yield from _family(int(child))
    except OSError:
        pass  # gone meanwhile, or no /proc


def _status(pid: int) -> dict[str, int]:
    """The bytes of ``VmRSS`` and ``VmHWM``; zeros for a process that is gone."""
    found = {"VmRSS": 0, "VmHWM": 0}
    try:
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            name, _, value = line.partition(":")
            if name in found:
                found[name] = int(value.split()[0]) << 10
    except OSError:
        pass
    return found


def die_with_parent() -> None:
    """Let the system kill this process when its parent dies, however that dies (Linux; elsewhere nothing
    happens).
    """
    if sys.platform != "linux":
        return
    parent = os.getppid()
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it died between
        os.kill(os.getpid(), signal.SIGKILL)
