"""A benchmark on the workers of a batch: crashes and lost machines cost one job, and a cluster does many at a
time.

Jobs that run at the same time share the machine, and their times are those of a shared machine: compare
errors at equal seconds only within one such run, and time renderers alone.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import ClassVar, Protocol

from ..batch.schedule import Scheduler, Work
from ..batch.settings import BatchSettings
from ..batch.workers.pool import Pool, RayPool
from ..io.interrupts import stop_signals
from .jobs import AnyJob, Report, duration, key_of
from .store import Store

CHILD = (sys.executable, "-P", "-m", "mitsvbrdf.bench.child")
EVERYWHERE = "bench://"  # no folder that workers must see: the records are kept here


class AnyPlan(Protocol):
    """What was asked for, of which every process makes the same jobs: one of
    :data:`mitsvbrdf.bench.child.PLANS`.
    """

    __dataclass_fields__: ClassVar[dict]

    def jobs(self) -> tuple[list, dict, dict]:
        """All jobs, what their records share, and what was published about them."""


def run_parallel(plan: AnyPlan, jobs: Sequence[AnyJob], store: Store, settings: BatchSettings,
                 report: Report = lambda text, share: None) -> dict[str, str]:
    """Do the jobs whose records are missing and needed, several at a time, and keep each record as soon as it
    is there.

    They begin in their own order. When a run ends early, the jobs that are under way have no record. A longer
    budget may begin before a shorter one has ended by itself; then both have records, of which one job at a
    time makes the first alone.

    Args:
        plan: what the jobs come from.
        jobs: those.
        store: the file of records.
        settings: workers, their limits, and the cluster to join.
        report: told what is going on, and the share done.

    Returns:
        Why jobs have no record, by title.

    Raises:
        KeyboardInterrupt: after Ctrl-C; what was done is kept.
    """
    here = settings.address is None
    workers = settings.local_workers() if here else settings.workers
    pool = RayPool(EVERYWHERE, address=settings.address, workers=workers, threads=settings.threads,
                   memory=settings.local_memory(workers) if here and workers else settings.memory,
                   timeout=settings.timeout, dashboard=settings.dashboard, child=CHILD)
    with contextlib.closing(pool):
        return _measured(plan, {key_of(job): job for job in store.pending(list(jobs))}, store, settings, pool,
                         report)


def _measured(plan: AnyPlan, jobs: dict[str, AnyJob], store: Store, settings: BatchSettings, pool: Pool,
              report: Report) -> dict[str, str]:
    # of equal cost: first come, first served
    scheduler = Scheduler([Work(key, 0.0) for key in jobs], settings.retries)
    idle, up, failed, ended, began = set[str](), set[str](), dict[str, str](), 0, time.monotonic()
    with stop_signals() as stop:
        while scheduler.running or scheduler.waiting:
            if stop:
                raise KeyboardInterrupt
            while idle and (work := scheduler.hand_out(worker := idle.pop())):
                if store.repeats(jobs[work.identity]):
                    scheduler.found_done(worker)
                    idle.add(worker)
                    ended += 1
                    continue
                task = {"attempt": work.identity, "folder": str(Path.cwd()), "plan": [type(plan).__name__,
                                                                                      asdict(plan)],
                        "key": work.identity}
                pool.run(worker, task)
            for event in pool.events(0.5):
                worker = event["worker"]
                if event["is"] == "worker":
                    idle.add(worker)
                    up.add(worker)
                    continue
                job = jobs[scheduler.running[worker].identity] if worker in scheduler.running else None
                if event["is"] == "lost":
                    idle.discard(worker)
                    up.discard(worker)
                    lost = scheduler.lost(worker)
                    verdict, reason = (lost[1] if lost else "again"), event["reason"]
                else:
                    idle.add(worker)
                    verdict, reason = scheduler.finished(worker,
                                                         event["outcome"]["state"]), event["outcome"][
                                                             "reason"]
                    if verdict == "done" and job:
                        shared = {"workers": len(up)} if len(up) > 1 else {}
                        store.add(job.key | {"config": job.settings} | shared | event["outcome"]["row"])
                ended += verdict != "again"
                if verdict == "failed" and job:
                    failed[job.title] = reason
                left = (time.monotonic() - began) / ended * (len(jobs) - ended) if ended else None
                words = f", {duration(left)} left" if left is not None else ""
                report(f"{ended} of {len(jobs)}{words}", ended / len(jobs))
        if stop:  # while the last record was written
            raise KeyboardInterrupt
    return failed
