"""Who fits what next. No clock, no disk and no Ray: the same code schedules a batch and the simulation of
one.

The largest captures go first, so that none is left to be waited for at the end. A capture whose fit crashed,
ran out of time or memory is tried again after all that were not tried yet; one that the fit refused is not,
for it would be refused again. What was lost with its worker goes back to the front: that was not the
capture's fault, until it happens again and again.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

State = Literal["pending", "running", "done", "failed"]
Verdict = Literal["done", "failed", "again"]
# what an outcome says; "crashed", "timeout" and "memory" are tried again
ENDED_WELL, REFUSED = "done", "failed"


@dataclass(frozen=True)
class Work:
    """A capture to fit.

    Args:
        identity: what decides its result, hashed.
        cost: how long its fit takes beside others, in any unit.
    """

    identity: str
    cost: float


class Scheduler:
    """Hands out work and counts what became of it.

    Args:
        work: what is to be done.
        retries: how often a fit that crashed, or ran out of time or memory, is tried again.
        most_lost: how often work may be lost with its worker before it counts as failed.
    """

    def __init__(self, work: Iterable[Work], retries: int = 2, most_lost: int = 8) -> None:
        self.retries, self.most_lost = retries, most_lost
        # tries first, then the largest
        self._waiting = [(0, -each.cost, number, each) for number, each in enumerate(work)]
        heapq.heapify(self._waiting)
        self._count = len(self._waiting)
        self.running: dict[str, Work] = {}  # by worker
        self._tried: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self.ended: dict[Verdict, int] = {"done": 0, "failed": 0, "again": 0}

    @property
    def waiting(self) -> int:
        """How many wait to be handed out."""
        return len(self._waiting)

    def hand_out(self, worker: str) -> Work | None:
        """The next work for a worker; None where none waits."""
        if not self._waiting:
            return None
        self.running[worker] = heapq.heappop(self._waiting)[-1]
        return self.running[worker]

    def finished(self, worker: str, state: str) -> Verdict:
        """What becomes of a worker's work now that it has ended as ``state``."""
        work = self.running.pop(worker)
        verdict: Verdict = "done" if state == ENDED_WELL else "failed"
        if state not in (ENDED_WELL, REFUSED):
            self._tried[work.identity] = tried = self._tried.get(work.identity, 0) + 1
            if tried <= self.retries:
                verdict = "again"
                self._wait(work, tried)
        self.ended[verdict] += 1
        return verdict

    def lost(self, worker: str) -> tuple[Work, Verdict] | None:
        """A worker is gone, with the work that it had, if any."""
        work = self.running.pop(worker, None)
        if work is None:
            return None
        self._lost[work.identity] = lost = self._lost.get(work.identity, 0) + 1
        verdict: Verdict = "again" if lost <= self.most_lost else "failed"
        if verdict == "again":
            self._wait(work, self._tried.get(work.identity, 0), first=True)
        self.ended[verdict] += 1
        return work, verdict

    def found_done(self, worker: str) -> None:
        """The work just handed out turned out to be done already: its worker was lost after it had
        finished.
        """
        self.running.pop(worker)
        self.ended["done"] += 1

    def put_back(self, worker: str) -> None:
        """The work just handed out was not begun: there is no space for its result, or nobody waits for it
        any more.
        """
        work = self.running.pop(worker)
        self._wait(work, self._tried.get(work.identity, 0), first=True)

    def _wait(self, work: Work, tried: int, first: bool = False) -> None:
        """Let work wait; ``first`` among those that are as large and were tried as often."""
        heapq.heappush(self._waiting, (tried, -work.cost, -self._count if first else self._count, work))
        self._count += 1
