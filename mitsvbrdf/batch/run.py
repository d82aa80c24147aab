"""The loop of a batch: it hands out captures, and notes and prints how each fit ended."""

import contextlib
import re
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence

import msgspec

from .. import __version__
from ..errors import BackendError, OutputError
from ..io.files import is_regular
from ..io.progress import several
from ..io.signals import stop_signals
from .fitting import HELD, LOG_CHARACTERS, log_path
from .library import Library
from .records import Material
from .settings import BatchSettings
from .tasks import RayTasks

TURN_SECONDS = 0.5  # longest wait for news of the fits in one turn of the loop
PAGE_SECONDS = 5.0  # between two writings of the page; writing takes at most a fiftieth of the time
PAGE_SHARE = 1 / 50
MOST_LOST = 8  # times that a capture is handed out again after its node, or its worker before the fit, died
MOST_UNREADY = 20  # workers in a row that may die before a fit
LAST_WORDS = re.compile(rf"^(?:Fatal Python error: |{HELD} ).*", re.MULTILINE)


class Batch:
    """A batch that fills a library.

    The longest fits go first: otherwise the batch may wait for one alone at the end. A fit that crashed, or
    took more time or memory than allowed, is tried again after all others. A fit that ended with an error is
    not tried again. A fit that was lost with its node, or before it began, is handed out again at once.
    """

    def __init__(self, library: Library, work: Sequence[Material], settings: BatchSettings, token: str,
                 tell: Callable[[str], None]) -> None:
        self.library, self.settings, self.token, self.tell = library, settings, token, tell
        self.name = secrets.token_hex(4)  # of this run; a part of the names of its attempts
        self.waiting = deque(sorted(work, key=lambda each: -each.cost))
        self.running: dict[str, Material] = {}  # name of the attempt to material
        self.began: dict[str, float] = {}  # name of the attempt to the time when its worker was ready
        self.tried, self.lost = Counter[str](), Counter[str]()
        self.started, self.ended, self.failed, self.unready, self.trouble = time.monotonic(), 0, 0, 0, ""
        self._page_due = 0.0
        self.memory = settings.memory if settings.address else settings.local_memory()

    def run(self, tasks: RayTasks) -> bool:
        """Run until all fits have ended. A first Ctrl-C waits for the running fits only, a second for none.

        Returns whether it was interrupted. BackendError: Ray ended, or a node cannot take part.
        """
        told = False
        try:
            with stop_signals() as stop:
                while len(stop) < 2 and (self.running or self.waiting and not stop and not self.trouble):
                    if not stop:
                        self._hand_out(tasks)
                    elif not told:
                        told = True
                        self._say(f"stopping: waiting for {several(len(self.running), 'fit')} "
                                  "(Ctrl-C again ends at once)")
                    for name, event in tasks.events(TURN_SECONDS):
                        with self._noting():
                            self._heard(name, event)
                    tasks.cancel(*filter(self._overdue, self.running))
                    with self._noting():
                        self._write_page()
                return bool(stop)
        finally:
            self.library.running.clear()
            with self._noting():
                self.library.write()

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """If the library cannot be written, no more fits are handed out; running fits are waited for."""
        try:
            yield
        except (OutputError, OSError) as reason:
            self.trouble = self.trouble or str(reason)

    def _hand_out(self, tasks: RayTasks) -> None:
        while self.waiting and not self.trouble and len(self.running) < tasks.slots:
            material = self.waiting.popleft()
            material = material.but(attempts=material.attempts + 1)
            name = f"{material.folder}-{self.name}-{material.attempts}"
            tasks.start(name, {
                "library": self.library.results.address, "token": self.token, "version": __version__,
                "material": msgspec.to_builtins(material), "attempt": name, "threads": self.settings.threads,
                "memory": self.memory})
            self.running[name] = material
            self.library.running.add(material.folder)

    def _overdue(self, name: str) -> float | None:
        """The time limit of an attempt, in seconds, if the attempt has exceeded it; else None."""
        limit, now = self.settings.timeout or self.running[name].limit, time.monotonic()
        return limit if limit and now > self.began.get(name, now) + limit else None

    def _heard(self, name: str, event: dict) -> None:
        if name not in self.running:
            return
        if "state" not in event:
            self._check_node(event)
            self.began[name], self.unready = time.monotonic(), 0
            return
        event |= self._last_words(name, event)
        if event["state"] == "cancelled" and (limit := self._overdue(name)):
            event |= {"state": "timeout", "reason": f"killed after {limit:g} s, the limit"}
        elif event["state"] == "crashed" and name not in self.began and "log" not in event:  # before its fit
            event |= {"state": "lost"}
            self.unready += 1
            if self.unready > MOST_UNREADY:
                raise BackendError("workers that start", f"{self.unready} in a row that died",
                                   "run `mitsvbrdf doctor`, on all nodes")
        material = self.running.pop(name)
        self.library.running.discard(material.folder)
        self._ended(material, event)

    def _check_node(self, about: dict) -> None:
        if about["version"] != __version__:
            raise BackendError(f"mitsvbrdf {__version__} on all nodes",
                               f"{about['version']} on {about['host']}", "install the same version there")
        if about["token"] != self.token:
            raise BackendError("a library that all nodes see",
                               f"{self.library.results.address}, which {about['host']} does not see",
                               "put it on a file system that all nodes share, under the same path, "
                               "or give its URL")

    def _last_words(self, name: str, event: dict) -> dict:
        """The log of a worker that died, and the reason of its death if the log states one."""
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

    def _ended(self, material: Material, event: dict) -> None:
        """Note how an attempt ended. A result in the library counts, whatever ``event`` states."""
        result = self.library.results.result(material.folder)
        state, folder, reason = event["state"], material.folder, event["reason"]
        how = "" if state == "failed" else f" ({state})"
        if result and result.identity == material.identity:  # even if the worker died after publishing
            self.library.done(result)
            error = "" if result.row.error is None else f", RMSE {result.row.error:.4f}"
            self._say(f"{material.name}: done{error}, {result.row.seconds or 0:.1f} s", ended=True)
        elif state == "full":
            self.trouble = f"no space is left for results: {reason}; free space"
            self.waiting.appendleft(material)
        elif state == "lost" and self.lost[folder] < MOST_LOST:
            self.lost[folder] += 1
            self.waiting.appendleft(material)
            self._say(f"{material.name}: tried again{how}: {reason}")
        elif state not in ("failed", "done", "lost") and self.tried[folder] < self.settings.retries:
            self.tried[folder] += 1
            self.waiting.append(material)
            self._say(f"{material.name}: tried again{how}: {reason}")
        else:
            reason = "its result did not appear" if state == "done" else reason
            self.failed += 1
            self._say(f"{material.name}: failed{how}: {reason}", ended=True)
            self.library.failed(material, reason, event.get("log", ""))

    @property
    def words(self) -> str:
        """The progress so far, as text."""
        running, left = len(self.running), len(self.waiting) + len(self.running)
        parts = [f"{self.ended:,} of {self.ended + left:,} ended",
                 *(f"{n:,} {what}" for n, what in ((running, "running"), (self.failed, "failed")) if n)]
        if self.ended >= max(1, running) and left:  # fewer fits give no estimate
            minutes = 1 + left * (time.monotonic() - self.started) / self.ended // 60
            parts.append(f"about {minutes:,.0f} min left")
        return ", ".join(parts)

    def _say(self, line: str, ended: bool = False) -> None:
        self.ended += ended
        self.tell(f"[{self.words}] {line}")

    def _write_page(self) -> None:
        if (before := time.monotonic()) >= self._page_due:
            self.library.write(self.words)
            took = time.monotonic() - before
            self._page_due = before + took + max(PAGE_SECONDS, took / PAGE_SHARE)
