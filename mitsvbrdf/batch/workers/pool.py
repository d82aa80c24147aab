"""What the supervisor hands work to: workers with names, that come and go.

Events are the lines of the gateway::

    {"is": "worker", "worker": "w3", "host": "...", "pid": 1, "version": "..."}          up and idle
    {"is": "done", "worker": "w3", "attempt": "...", "outcome": {...}}                  see Guard.run; idle
    again {"is": "lost", "worker": "w3", "attempt": "..." or None, "reason": "one sentence"}  gone, never to
    come back under this name

and its orders are ``{"do": "start", ...}``, ``{"do": "run", "worker": "w3", "task": {...}}`` and ``{"do":
"stop"}``.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from ...errors import BackendError

GATEWAY = (sys.executable, "-P", "-m", "mitsvbrdf.batch.workers.gateway")
DEATHS = 5  # of the gateway in a row, without one task done between
# seconds before the gateway is started anew; the first pause is 1 s, each is twice the one before
LONGEST_PAUSE = 30.0
STOP_SECONDS = 1.3  # the gateway may take so long to end in order, and once more after SIGTERM


class Pool(Protocol):
    """Workers, and what happens to them."""

    def run(self, worker: str, task: dict) -> None:
        """Hand a task to a worker that is idle; returns at once."""

    def events(self, seconds: float) -> list[dict]:
        """What has happened since the last call; waits so long for something to happen."""

    def close(self) -> None:
        """End all workers, whatever they do."""


def require_ray() -> None:
    """Raise BackendError where there is no Ray."""
    if importlib.util.find_spec("ray") is None:
        raise BackendError("Ray", "no module ray", "pip install 'mitsvbrdf[batch]'")


class RayPool:
    """Workers that are actors of Ray, behind a gateway: a process of its own that is started anew when it
    dies.

    Args:
        library: the folder, or its URL.
        address: of a cluster; None starts a Ray of its own on this machine.
        workers: how many; None is one, in a cluster as many as its CPUs allow.
        threads: of each worker.
        memory: GiB that a task may take; None is no limit.
        timeout: seconds that a task may take; None: those that it states itself under ``limit``, if any.
        dashboard: whether Ray shows its dashboard.
        log: takes what Ray prints.
        child: the command line of a worker's child; None is the package's own.
        gateway: the command line of the gateway.

    Raises:
        BackendError: where there is no Ray.
    """

    def __init__(self, library: str, *, address: str | None = None, workers: int | None = None,
                 threads: int = 1,
                 memory: float | None = None, timeout: float | None = None, dashboard: bool = False,
                 log: Path | None = None, child: Sequence[str] | None = None,
                 gateway: Sequence[str] = GATEWAY) -> None:
        require_ray()
        self._start = {"do": "start", "address": address, "workers": workers, "threads": threads,
                       "memory": memory,
                       "timeout": timeout, "library": library, "dashboard": dashboard,
                       "child": child and list(child)}
        self._command, self._log = gateway, [str(log)] if log else []
        # workers that ever came up; deaths of the gateway since the last task done
        self._named, self._deaths = 0, 0
        self._reason = ""  # of the gateway, why it could not start
        self._running: dict[str, str | None] = {}  # the workers, each with its attempt
        self._waiting: list[dict] = []
        self._gateway: _Gateway | None = None
        self._restart = 0.0  # when
        self._open()

    def run(self, worker: str, task: dict) -> None:
        """Hand a task to a worker that is idle; returns at once. If the worker is gone meanwhile, an event
        says so.
        """
        if worker not in self._running:
            self._waiting.append(_lost(worker, task["attempt"], "the worker is gone"))
            return
        self._running[worker] = task["attempt"]
        if self._gateway:
            self._gateway.tell({"do": "run", "worker": worker, "task": task})

    def events(self, seconds: float) -> list[dict]:
        """What has happened since the last call; waits at most so long, and returns with the first that
        happens.

        Raises:
            BackendError: when the gateway cannot start at all, or dies again and again.
        """
        until = time.monotonic() + seconds
        while True:
            left = max(0.0, until - time.monotonic()) * (not self._waiting)
            if self._gateway is None:
                pause = self._restart - time.monotonic()
                if pause <= 0:
                    self._open()
                else:
                    time.sleep(min(pause, left))
            elif (lines := self._gateway.listen(left)) is None:
                self._died()
            else:
                for line in lines:
                    self._note(json.loads(line))
            if self._waiting or time.monotonic() >= until:
                found, self._waiting = self._waiting, []
                return found

    def close(self) -> None:
        """End all workers, whatever they do; never hangs."""
        if self._gateway:
            self._gateway.tell({"do": "stop"})
            self._gateway.end()
            self._gateway = None
        self._running, self._restart = {}, float("inf")

    def _open(self) -> None:
        self._gateway = _Gateway([*self._command], self._log)
        self._gateway.tell(self._start | {"first": self._named + 1})

    def _note(self, event: dict) -> None:
        """Keep the books; every event but the last words of a gateway is for the caller."""
        if event["is"] == "failed":
            self._reason = event["reason"]
            if not self._named:  # it never worked: to try again would not help
                self.close()
                raise BackendError("Ray and its workers to start", event["reason"] + self._last_words(),
                                   event["fix"])
            return
        if event["is"] == "worker":
            self._named += 1
            self._running[event["worker"]] = None
        elif event["is"] == "done":
            self._running[event["worker"]], self._deaths = None, 0
        elif event["is"] == "lost" and self._running.pop(event["worker"], "") == "":
            return  # told already
        self._waiting.append(event)

    def _died(self) -> None:
        assert self._gateway
        code = self._gateway.end()
        reason = self._reason or f"the gateway to Ray ended with code {code}"
        self._gateway, self._reason = None, ""
        self._waiting += [_lost(worker, attempt, reason) for worker, attempt in self._running.items()]
        self._running, self._deaths = {}, self._deaths + 1
        if self._deaths == DEATHS:
            raise BackendError("Ray to stay up", f"{DEATHS} ends in a row, the last: "
                                                 f"{reason}{self._last_words()}",
                               "install Ray again, or mend its cluster")
        self._restart = time.monotonic() + min(2.0 ** (self._deaths - 1), LONGEST_PAUSE)


    def _last_words(self) -> str:
        """What the log ends with, and its name where it stays: it goes with a library that came to
        nothing.
        """
        try:
            lines = "".join(Path(log).read_text(errors="replace") for log in self._log).splitlines()
        except OSError:
            return ""
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        name = f", {self._log[0]}," if self._named else ""
        return f" (its log{name} ends: {last[:300]})" if last else ""


def _lost(worker: str, attempt: str | None, reason: str) -> dict:
    return {"is": "lost", "worker": worker, "attempt": attempt, "reason": reason}


class _Gateway:
    """The process in a session of its own, so that Ctrl-C does not reach it, and the two pipes."""

    def __init__(self, command: list[str], log: list[str]) -> None:
        self._events, theirs = os.pipe()
        os.set_blocking(self._events, False)
        self._unread = b""
        try:
            self._process = subprocess.Popen([*command, str(theirs), *log], stdin=subprocess.PIPE,
                                             stdout=subprocess.DEVNULL,
                                             stderr=subprocess.DEVNULL, pass_fds=(theirs,),
                                             start_new_session=True)
        except OSError:
            os.close(self._events)
            raise
        finally:
            os.close(theirs)

    def tell(self, order: dict) -> None:
        """Send an order; to one who is dead nothing happens."""
        assert self._process.stdin
        with contextlib.suppress(BrokenPipeError):
            os.write(self._process.stdin.fileno(), json.dumps(order).encode() + b"\n")

    def listen(self, seconds: float) -> list[bytes] | None:
        """The lines that have come, waiting at most so long for the first; None when it is dead."""
        if not select.select([self._events], [], [], seconds)[0]:
            return []
        with contextlib.suppress(BlockingIOError):
            while some := os.read(self._events, 1 << 20):
                self._unread += some
            if b"\n" not in self._unread:
                return None
        *lines, self._unread = self._unread.split(b"\n")
        return lines

    def end(self) -> int:
        """Wait a little for its end, then ask for it, then kill it with all of its group; its exit code."""
        for ask in (self._process.terminate, lambda: None):
            deadline = time.monotonic() + STOP_SECONDS
            while not os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if time.monotonic() > deadline:
                    ask()
                    break
                time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)  # not reaped yet: the number is nobody else's
        with self._process:  # closes the pipe
            pass
        os.close(self._events)
        return self._process.returncode
