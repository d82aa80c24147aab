"""What commands share that bring a file of records up to date: its missing jobs, several at a time where
asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ..io.progress import progress_bar, say, say_written

if TYPE_CHECKING:
    from ..bench.jobs import AnyJob
    from ..bench.parallel import AnyPlan
    from ..bench.store import Store


def measure(plan: AnyPlan, jobs: Sequence[AnyJob], store: Store, workers: int | None = None,
            address: str | None = None, less: str = "") -> Mapping[str, str] | None:
    """Do the jobs that have no record and need one, and say what is going on.

    Args:
        plan: what the jobs come from.
        jobs: those.
        store: the file of records.
        workers: how many jobs run at a time; None is one.
        address: a Ray cluster to run them on.
        less: why they may take less time than is said.

    Returns:
        Why jobs have no record, by title; None after Ctrl-C.

    Raises:
        ConfigError: no such number of workers.
    """
    from ..batch.settings import BatchSettings
    from ..bench.jobs import run
    from ..bench.parallel import run_parallel

    settings = BatchSettings(workers=workers, address=address)
    settings.check()
    say(outlook(jobs, store, workers, less))
    failed: Mapping[str, str] = {}
    try:
        with progress_bar("measuring") as report:
            if (workers or address) and store.pending(list(jobs)):
                failed = run_parallel(plan, jobs, store, settings, report)
            else:
                failed = run(jobs, store, report)
    except KeyboardInterrupt:
        say(f"interrupted: {len(jobs) - len(store.pending(list(jobs)))} of {len(jobs)} jobs need no more "
            "than the records in "
            f"{store.path}; the same command goes on")
        return None
    store.write()
    lost = {job.title: "another run began the file anew" for job in store.pending(list(jobs))
            if job.title not in failed}
    failed = {**failed, **lost}
    say_written(store.path)
    for title, reason in failed.items():
        say(f"no record: {title}: {reason}")
    return failed


def outlook(jobs: Sequence[AnyJob], store: Store, workers: int | None = None, less: str = "") -> str:
    """How many jobs have what they need, and how long the others take, in words; arguments as of
    :func:`measure`.
    """
    from ..bench.jobs import duration

    missing = store.pending(list(jobs))
    rest = (f"the other {len(missing)} take about "
            f"{duration(sum(job.cost for job in missing) / (workers or 1))}{less}"
            if missing else "nothing to do")
    void = len(store.outdated)
    gone = (f"; records of other settings or code of a method, which go when the first new one comes: {void}"
            if void else "")
    return f"{len(jobs) - len(missing)} of {len(jobs)} jobs need no more than the records in {store.path}; {rest}{gone}"
