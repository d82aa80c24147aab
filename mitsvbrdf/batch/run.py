"""The loop of a batch: captures are handed out, what became of each is noted, and told."""

from __future__ import annotations

import contextlib
import heapq
import re
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import msgspec

from .. import __version__
from ..errors import BackendError, OutputError
from ..io.files import is_regular
from ..io.progress import several
from ..io.signals import stop_signals
from .fitting import HELD, LOG_CHARACTERS, log_path
from .library import Library
from .progress import Progress, Tell
from .records import Failure, Pending
from .settings import BatchSettings
from .tasks import RayTasks

TURN_SECONDS = 0.5  # at most so long nothing is looked at
PAGE_SECONDS = 5.0  # between two writings of the page, which takes at most a fiftieth of the time
PAGE_SHARE = 1 / 50
MOST_LOST = 8  # times that a capture's node, or its worker before the fit, may die before the capture fails
MOST_UNREADY = 20  # workers in a row that may die before a fit
LAST_WORDS = re.compile(rf"^(?:Fatal Python error: |{HELD} ).*", re.MULTILINE)


@dataclass
class Attempt:
    """A fit that runs: of which material, and since when; None before its worker is ready."""

    material: Pending
    began: float | None = None


class Batch:
    """A library that is being filled.

    The largest captures go first, so that none is waited for alone at the end. A fit that crashed, or took
    more time or memory than allowed, is tried again after all others; one that was refused is not, for it
    would be refused again. What was lost with its node, or before the fit began, is handed out again at once.

    Args:
        library: takes the results.
        work: what is left to do.
        settings: limits.
        token: that of the library, which each node must see.
        tell: told how it stands after each end, with a line about it, and now and then with none.
        command: what was typed, for the page of a batch that was stopped.
        clock: seconds since any moment.
    """

    def __init__(self, library: Library, work: Sequence[Pending], settings: BatchSettings, token: str,
                 tell: Tell, command: str | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.library, self.settings, self.token = library, settings, token
        self.tell, self.command, self.clock = tell, command, clock
        self.name = secrets.token_hex(4)  # of this run, in the names of its attempts
        self.waiting = [(0, -each.cost, number, each) for number, each in enumerate(work)]
        heapq.heapify(self.waiting)
        self.running: dict[str, Attempt] = {}
        self.tried, self.lost = Counter[str](), Counter[str]()
        self.started, self.ended, self.failed, self.unready, self.trouble = clock(), 0, 0, 0, ""
        self._count, self._page_due = len(self.waiting), 0.0
        self.memory = settings.memory if settings.address else settings.local_memory()

    def run(self, tasks: RayTasks) -> bool:
        """Until all is done, or Ctrl-C: the first one waits for what runs, the second one does not.

        Returns:
            Whether it was interrupted.

        Raises:
            BackendError: Ray ended, or a node does not fit this command.
        """
        told = False
        try:
            with stop_signals() as stop:
                while len(stop) < 2 and (self.running or self.waiting and not stop and not self.trouble):
                    with self._noting():
                        self._hand_out(tasks, bool(stop))
                    if stop and not told:
                        told = True
                        self._say(f"stopping: waiting for {several(len(self.running), 'fit')} "
                                  "(Ctrl-C again ends at once)")
                    for name, event in tasks.events(TURN_SECONDS):
                        with self._noting():
                            self._heard(tasks, name, event)
                    tasks.cancel(*self._overdue())
                    with self._noting():
                        self._show()
                return bool(stop)
        finally:
            self.library.running.clear()
            with self._noting():
                self.library.write(command=self.command)

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """Where the library cannot be written, nothing more is handed out, and what runs ends."""
        try:
            yield
        except (OutputError, OSError) as reason:
            self.trouble = self.trouble or str(reason)

    def _hand_out(self, tasks: RayTasks, stop: bool) -> None:
        """Give work to every idle worker."""
        while self.waiting and not stop and not self.trouble and len(self.running) < tasks.slots:
            material = heapq.heappop(self.waiting)[-1]
            material = msgspec.structs.replace(material, attempts=material.attempts + 1)
            name = f"{material.folder}-{self.name}-{material.attempts}"
            tasks.start(name, {
                "library": self.library.results.address, "token": self.token, "version": __version__,
                "material": msgspec.to_builtins(material), "attempt": name, "threads": self.settings.threads,
                "memory": self.memory})
            self.running[name] = Attempt(material)
            self.library.running.add(material.folder)

    def _overdue(self) -> list[str]:
        """The attempts that take more time than allowed."""
        return [name for name, each in self.running.items() if each.began is not None
                and (limit := self.settings.timeout or each.material.limit)
                and self.clock() > each.began + limit]

    def _heard(self, tasks: RayTasks, name: str, event: dict) -> None:
        """Take in what a task yielded."""
        attempt = self.running.get(name)
        if attempt is None:
            return
        if "state" not in event:
            self._check_node(event)
            attempt.began, self.unready = self.clock(), 0
            return
        overdue = name in self._overdue()
        del self.running[name]
        material = attempt.material
        self.library.running.discard(material.folder)
        if event["state"] == "cancelled" and overdue:
            limit = self.settings.timeout or material.limit
            event |= {"state": "timeout", "reason": f"killed after {limit:g} s, the limit"}
        elif event["state"] == "crashed" and attempt.began is None:  # before it looked at the capture
            event |= {"state": "lost"}
            self.unready += 1
            if self.unready > MOST_UNREADY:
                raise BackendError("workers that start", f"{self.unready} in a row that died",
                                   "run `mitsvbrdf doctor`, on all nodes")
        self._ended(material, event | self._last_words(name, event))

    def _check_node(self, about: dict) -> None:
        """Raise BackendError for a node that cannot take part."""
        if about["version"] != __version__:
            raise BackendError(f"mitsvbrdf {__version__} on all nodes",
                               f"{about['version']} on {about['host']}", "install the same version there")
        if about["token"] != self.token:
            raise BackendError("a library that all nodes see",
                               f"{self.library.results.address}, which {about['host']} does not see",
                               "put it on a file system that all nodes share, under the same path, "
                               "or give its URL")

    def _last_words(self, name: str, event: dict) -> dict:
        """What a worker that died had printed, and its reason, where it said one."""
        path = log_path(self.library.results, name)
        if "log" in event or not is_regular(path) or path is None:
            return {}
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - 4 * LOG_CHARACTERS))
            log = file.read().decode(errors="replace")[-LOG_CHARACTERS:]
        found = LAST_WORDS.findall(log)
        if not found or event["state"] != "crashed":
            return {"log": log}
        state = "memory" if found[-1].startswith(HELD) else "crashed"
        return {"log": log, "reason": found[-1], "state": state}

    def _ended(self, material: Pending, event: dict) -> None:
        """Note how an attempt ended, by what lies in the library."""
        result = self.library.results.result(material.folder)
        state, folder = event["state"], material.folder
        if result and result.identity == material.identity:  # also of a worker that died after that
            self.library.done(result)
            error = "" if result.row.error is None else f", RMSE {result.row.error:.4f}"
            self._say(f"{material.name}: done{error}, {result.row.seconds or 0:.1f} s", ended=True)
        elif state == "full":
            self.trouble = f"no space is left for results: {event['reason']}; free space"
            self._wait(material, first=True)
        elif state == "lost" and self.lost[folder] < MOST_LOST:
            self.lost[folder] += 1
            self._again(material, event, first=True)
        elif state not in ("failed", "done", "lost") and self.tried[folder] < self.settings.retries:
            self.tried[folder] += 1
            self._again(material, event)
        else:
            reason = "its result did not appear" if state == "done" else event["reason"]
            self.failed += 1
            self._say(f"{material.name}: failed{_how(state)}: {reason}", ended=True)
            failure = Failure(**material.stated(), state=state, reason=reason)
            self.library.failed(failure, event.get("log", ""))

    def _again(self, material: Pending, event: dict, first: bool = False) -> None:
        self._wait(material, first)
        self._say(f"{material.name}: tried again{_how(event['state'])}: {event['reason']}")

    def _wait(self, material: Pending, first: bool = False) -> None:
        """Let a capture wait; ``first`` among those that are as large and were tried as often."""
        self._count += 1
        heapq.heappush(self.waiting, (self.tried[material.folder], -material.cost,
                                      -self._count if first else self._count, material))

    def progress(self) -> Progress:
        """How it stands now."""
        return Progress(self.ended, len(self.waiting) + len(self.running), len(self.running), self.failed,
                        self.clock() - self.started)

    def _say(self, line: str, ended: bool = False) -> None:
        self.ended += ended
        self.tell(self.progress(), line)

    def _show(self) -> None:
        """Tell how it stands, and write the page anew where it is time."""
        self.tell(self.progress(), "")
        if (before := self.clock()) >= self._page_due:
            self.library.write(self.progress().words)
            took = self.clock() - before
            self._page_due = before + took + max(PAGE_SECONDS, took / PAGE_SHARE)


def _how(state: str) -> str:
    return "" if state == "failed" else f" ({state})"
