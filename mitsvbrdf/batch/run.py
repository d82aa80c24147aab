"""The loop of a batch: hand work out, note what became of it, tell how it goes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import OutputError
from ..io.progress import several
from ..io.signals import stop_signals
from .library.rows import write_library
from .manifest import Manifest
from .places.address import title_of
from .places.place import Place
from .prepare import quarantine, release, task_of
from .schedule import Scheduler, Work
from .workers.pool import Pool

TURN_SECONDS = 0.5  # at most so long nothing is looked at
PAGE_SECONDS = 5.0  # between two writings of the page, which takes at most a fiftieth of the time
PAGE_SHARE = 1 / 50
NO_SPACE = "no space is left for results"


@dataclass(frozen=True)
class Progress:
    """How a batch stands.

    Args:
        counts: how many are done, failed, running and pending.
        seconds: since it began.
        ended: how many ended since then.
        running: the names of those that run.
        before: the counts when it began.
    """

    counts: dict[str, int]
    seconds: float
    ended: int
    running: Sequence[str]
    before: Mapping[str, int] = field(default_factory=dict)

    @property
    def per_hour(self) -> float:
        """Captures that end in an hour."""
        return 3600 * self.ended / self.seconds if self.seconds else 0.0

    @property
    def left_seconds(self) -> float | None:
        """Until all have ended; None before as many have as run at a time: earlier ends say too little."""
        known = self.per_hour and self.ended >= self.counts["running"]
        return 3600 * self.left / self.per_hour if known else None

    @property
    def left(self) -> int:
        """How many have not ended."""
        return self.counts["running"] + self.counts["pending"]


Tell = Callable[[Progress, str], None]


class Batch:
    """A library that is being filled.

    Args:
        home: folder of the manifest, the page and the quarantine.
        library: where results go: the same folder, or a URL.
        place: that, opened.
        manifest: what became of each capture.
        scheduler: what is left to do.
        tell: told how it stands after each end, with a line about it, and now and then with none.
        command: what was typed, for the page of a batch that was stopped.
        clock: seconds since any moment.
    """

    def __init__(self, home: Path, library: str, place: Place, manifest: Manifest, scheduler: Scheduler,
                 tell: Tell, command: str | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.home, self.library, self.place, self.manifest = home, library, place, manifest
        self.scheduler, self.tell, self.command, self.clock = scheduler, tell, command, clock
        self.idle: dict[str, str] = {}  # hosts of workers without work
        self.attempts: dict[str, str] = {}  # by worker
        self.names: dict[str, str] = {}  # of what each worker runs
        self.hosts: dict[str, str] = {}
        # kept here too: to count 100,000 rows at each event would take most of the time
        self.counts = manifest.counts()
        self.before = dict(self.counts)
        self.started, self.ended, self.trouble = clock(), 0, ""
        self._page_due, self.going = 0.0, True

    def run(self, pool: Pool) -> bool:
        """Until all is done, or Ctrl-C: the first one waits for what runs, the second one does not.

        Returns:
            Whether it was interrupted.
        """
        with stop_signals() as stop:
            warned = False
            while len(stop) < 2:
                if not (stop or self.trouble):
                    with self._noting():
                        self._hand_out(pool)
                if not self.scheduler.running and (stop or self.trouble or not self.scheduler.waiting):
                    break
                if stop and not warned:
                    warned = True
                    running = several(len(self.scheduler.running), "fit")
                    self.tell(self.progress(), f"stopping: waiting for {running} (Ctrl-C again ends at once)")
                for event in pool.events(TURN_SECONDS):
                    with self._noting():
                        self._heard(event)
                with self._noting():
                    self._show()
        with self._noting():
            self.going = False
            self.manifest.interrupted()
            self.write_page()
        return bool(stop)

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """Where manifest or page cannot be written, nothing more is handed out, and what runs ends."""
        try:
            yield
        except OutputError as reason:
            self.trouble = self.trouble or str(reason)
            for worker in set(self.scheduler.running) - set(self.attempts):  # not begun
                self.scheduler.put_back(worker)

    def _heard(self, event: dict) -> None:
        """Take in what the pool says of a worker."""
        worker = event["worker"]
        if event["is"] == "worker":
            self.idle[worker] = self.hosts[worker] = event["host"]
        elif event["is"] == "done":
            self._finished(worker, event["outcome"])
        else:
            self.idle.pop(worker, None)
            self._lost(worker, event["reason"])

    def _hand_out(self, pool: Pool) -> None:
        """Give work to every idle worker."""
        for worker in list(self.idle):
            work = self._next(worker)
            if work is None:
                return
            attempt = self.manifest.begin(work.identity, worker, self.idle.pop(worker))
            task = task_of(self.manifest, work, attempt, self.library)
            self.attempts[worker], self.names[worker] = attempt, task["name"]
            self._moved("pending", "running")
            pool.run(worker, task)

    def _next(self, worker: str) -> Work | None:
        """The next work that is not done yet: one whose worker was lost may have let its result appear
        before.
        """
        while work := self.scheduler.hand_out(worker):
            folder = self.manifest.material(work.identity)
            record = self.place.record(folder["folder"]) if folder["attempts"] else None
            if record is None or record.get("identity") != work.identity:
                return work
            self.manifest.adopt(work.identity, record)
            release(self.home, folder["folder"])
            self.scheduler.found_done(worker)
            self._moved("pending", "done")
            self._said(work, "done", {"reason": "", "row": record["row"],
                                      "seconds": record["row"].get("seconds")})
        return None

    def _finished(self, worker: str, outcome: dict) -> None:
        attempt, _ = self.attempts.pop(worker, None), self.names.pop(worker, "")
        if attempt is None:
            return
        self.idle[worker] = self.hosts[worker]
        work = self.scheduler.running[worker]
        if outcome["state"] == "full":
            self.trouble = f"{NO_SPACE}: {outcome['reason']}; free space"
            self.scheduler.put_back(worker)
            self.manifest.end(attempt, "pending", outcome)
            self._moved("running", "pending")
            return
        verdict = self.scheduler.finished(worker, outcome["state"])
        self._noted(work, attempt, verdict, outcome)

    def _lost(self, worker: str, reason: str) -> None:
        attempt, found, _ = self.attempts.pop(worker,
                                              None), self.scheduler.lost(worker), self.names.pop(worker, "")
        if attempt and found:
            self._noted(found[0], attempt, found[1], {"state": "lost", "reason": reason, "log": ""})

    def _noted(self, work: Work, attempt: str, verdict: str, outcome: dict) -> None:
        """Write down how an attempt ended, by what lies in the library; a capture that failed goes to the
        quarantine.
        """
        material = self.manifest.material(work.identity)
        record = (self.place.record(material["folder"]) or {}) if verdict != "again" else {}
        there = record.get("identity") == work.identity
        if verdict == "done" and not there:
            verdict, outcome = "failed", outcome | {"state": "failed", "reason": "its result did not appear",
                                                    "row": None}
        elif verdict == "failed" and there:  # it died after its result had appeared
            verdict, outcome = "done", outcome | {"row": record["row"]}
        if verdict == "done":
            self.manifest.end(attempt, "done", outcome, record["attempt"])
            release(self.home, material["folder"])
        elif verdict == "failed":  # first its reason: who dies here finds it waiting
            quarantine(self.home, material, outcome["state"], outcome["reason"], outcome.get("log", ""))
            self.manifest.end(attempt, "failed", outcome)
        else:
            self.manifest.end(attempt, "pending", outcome)
        self._moved("running", "pending" if verdict == "again" else verdict)
        self._said(work, verdict, outcome)

    def _moved(self, before: str, after: str) -> None:
        """A capture is in another state now."""
        self.counts[before] -= 1
        self.counts[after] += 1

    def _said(self, work: Work, verdict: str, outcome: dict) -> None:
        """One line about a capture."""
        name = self.manifest.material(work.identity)["name"]
        self.ended += verdict != "again"
        row = outcome.get("row") or {}
        if verdict == "done":
            error = f", RMSE {row['error']:.4f}" if row.get("error") is not None else ""
            line = f"{name}: done{error}, {outcome.get('seconds') or 0:.1f} s"
        else:
            how = "" if outcome["state"] == "failed" else f" ({outcome['state']})"
            line = f"{name}: {'failed' if verdict == 'failed' else 'tried again'}{how}: {outcome['reason']}"
        self.tell(self.progress(), line)

    def progress(self) -> Progress:
        """How it stands now."""
        return Progress(dict(self.counts), self.clock() - self.started, self.ended, list(self.names.values()),
                        self.before)

    def _show(self) -> None:
        """Tell how it stands, and write the page anew where it is time."""
        self.tell(self.progress(), "")
        if self.clock() >= self._page_due:
            before = self.clock()
            self.write_page()
            took = self.clock() - before
            self._page_due = before + took + max(PAGE_SECONDS, took / PAGE_SHARE)

    def write_page(self) -> None:
        """Write ``library.json`` and ``index.html``; how fast it goes stands there only while it does."""
        stands = self.progress()
        rate = {"per_hour": stands.per_hour, "left_seconds": stands.left_seconds} if self.going else None
        write_library(self.home, self.manifest, title_of(self.library), rate, self.command)
