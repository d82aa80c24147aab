"""The process that does jobs of a benchmark for :mod:`mitsvbrdf.bench.parallel`: its tasks are kept, its
kernels warm.
"""

from __future__ import annotations

import os

from ..batch.child import main
from ..errors import ConfigError
from .jobs import AnyJob, key_of, warm_up
from .leave_out.plan import LeaveOutPlan
from .parallel import AnyPlan
from .plan import Plan
from .stiff.fits import StiffPlan

PLANS = {kind.__name__: kind for kind in (Plan, StiffPlan, LeaveOutPlan)}


def measure(task: dict) -> dict:
    """Do one job.

    Args:
        task: ``folder`` where paths start, ``plan`` (the name of its class and its fields), and the job's
            ``key`` as text.

    Returns:
        The figures of its record, and ``seconds``.
    """
    os.chdir(task["folder"])
    kind, fields = task["plan"]
    jobs = _jobs(PLANS[kind](**fields))
    job = jobs.get(task["key"])
    if job is None:
        raise ConfigError("a job of this benchmark", task["key"],
                          "use the same version and data on all nodes")
    warm_up(job, _warm)
    return job.run()


_made: list[tuple[AnyPlan, dict[str, AnyJob]]] = []
_warm: set[tuple] = set()


def _jobs(plan: AnyPlan) -> dict[str, AnyJob]:
    """The jobs of a plan by key, made once."""
    if not _made or _made[0][0] != plan:
        _made[:] = [(plan, {key_of(job): job for job in plan.jobs()[0]})]
    return _made[0][1]


if __name__ == "__main__":
    main(measure)
