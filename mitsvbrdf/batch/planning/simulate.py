"""``python -m mitsvbrdf.batch.planning.simulate -o docs/results``: what a batch on 1,000 workers would do,
told in minutes.

The loop, the scheduler and the manifest are those of ``mitsvbrdf batch``; workers and clock are virtual
(:mod:`.virtual`). What the supervisor takes for a fit is measured here, on a disk, with that loop. The same
seed gives the same figures. ``batch-simulation.json`` has them; ``batch-simulation.md`` and ``.svg`` are made
from it.
"""

from __future__ import annotations

import hashlib
import math
import random
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import tyro

from ...errors import ConfigError
from ...io import files
from ...io.json_files import read_json
from ...io.progress import say
from ...io.provenance import machine, versions
from ...io.tool import run_tool
from ..asked import TYPICAL_SECONDS
from ..manifest import FILE, Manifest
from ..places.place import Place
from ..run import Batch
from ..schedule import Scheduler, Work
from .simulate_page import figure, page
from .virtual import HOUR, Cluster, VirtualPool

Order = Literal["largest", "arrival", "smallest"]
ORDERS: tuple[Order, ...] = ("largest", "arrival", "smallest")
MEASURED = 1000  # fits that the supervisor's seconds are measured with
SHORT = 300.0  # seconds, a limit on fits that is near what they take
SLOW = 0.025  # seconds of the supervisor for a fit where each of its two commits waits 12 ms for the disk
FITS = 10  # a worker, where only the number of workers is varied


@dataclass(frozen=True)
class Load:
    """What is to be fitted."""

    captures: int = 100_000
    """How many."""
    seconds: float = TYPICAL_SECONDS
    """Of a usual fit."""
    large: float = 0.1
    """Share of captures that are fitted at twice the resolution."""
    larger: float = 4.0
    """How many times the seconds these take."""

    def guesses(self, seed: int = 0) -> dict[str, float]:
        """What each capture's fit is guessed to take, by identity, in the order of arrival."""
        draw = random.Random(seed)
        return {hashlib.sha256(str(k).encode()).hexdigest(): self.seconds * (self.larger
                                                                             if draw.random() < self.large
                                                                             else 1)
                for k in range(self.captures)}


class _Watched(Batch):
    """A batch that writes no page, but takes the time for it; knows when for the first time nothing
    waited.
    """

    tail = math.nan
    pool: VirtualPool

    def _hand_out(self, pool: Any) -> None:
        super()._hand_out(pool)
        if math.isnan(self.tail) and not self.scheduler.waiting:
            self.tail = self.clock()

    def write_page(self) -> None:
        """Only the time passes."""
        self.pool.busy(self.pool.cluster.page_seconds)


def simulate(cluster: Cluster, guesses: Mapping[str, float], order: Order = "largest", seed: int = 0,
             retries: int = 2) -> dict:
    """A batch from its start to its end.

    Args:
        cluster: the workers.
        guesses: seconds of each capture's fit, by identity: those of a usual node, but for the cluster's
            spread.
        order: in which captures are handed out.
        seed: of all that is drawn.
        retries: of a fit that crashed or ran out of time.

    Returns:
        ``makespan`` in seconds, and ``ideal``, where all workers fit all the time at full speed and nothing
        fails; ``per_hour`` captures that ended; ``share`` of the ideal; ``tail`` in seconds; ``done``,
        ``failed`` and ``twice``: captures; ``attempts``; ``spent`` and ``lost`` seconds of workers,
        ``lost_share``; ``supervisor_share``, how much of the time it is busy; ``bytes`` a second on average;
        ``ends`` of fits, and deaths.
    """
    rank = {"largest": 1.0, "arrival": 0.0, "smallest": -1.0}[order]
    pool = VirtualPool(cluster, guesses, seed)
    with tempfile.TemporaryDirectory() as home:
        manifest = _manifest(Path(":memory:"), guesses)
        batch = _Watched(Path(home), home, cast(Place, pool), manifest,
                         Scheduler((Work(known, rank * cost) for known, cost in guesses.items()), retries),
                         lambda *_: None, clock=lambda: pool.now)
        batch.pool = pool
        if batch.run(pool):
            raise KeyboardInterrupt
        counts, attempts = manifest.counts(), manifest.db.execute("select count(*) from attempts").fetchone()[
            0]
        manifest.close()
    count = pool.count
    makespan = pool.now - cluster.page_seconds  # the last page is written after the end
    ideal = sum(guesses.values()) * math.exp(cluster.sigma**2 / 2) / cluster.workers
    ended = counts["done"] + counts["failed"]
    return {"order": order, "workers": cluster.workers, "captures": len(guesses), "makespan": makespan,
            "ideal": ideal,
            "per_hour": HOUR * ended / makespan, "share": ideal / makespan, "tail": makespan - batch.tail,
            "done": counts["done"], "failed": counts["failed"], "left": counts["pending"] + counts["running"],
            "twice": sum(number > 1 for number in count.published.values()),
            "published": len(count.published),
            "attempts": attempts, "spent": count.spent, "lost": count.lost,
            "lost_share": count.lost / count.spent,
            "supervisor_share": count.supervisor / makespan,
            "bytes": (cluster.capture_bytes * attempts + cluster.result_bytes * counts["done"]) / makespan,
            "ends": dict(sorted(count.ends.items()))}


def _manifest(path: Path, guesses: Mapping[str, float]) -> Manifest:
    asked = {"config": {"method": "hierarchical"}, "options": {"resolution": 256}, "folder": "."}
    manifest = Manifest(path)
    manifest.want({"identity": known, "name": f"capture-{k:06d}", "source": f"captures/{k:06d}",
                   "asked": asked, "own": "",
                   "tags": [], "cost": cost} for k, (known, cost) in enumerate(guesses.items()))
    return manifest


def measured_supervisor(workers: int, captures: int) -> dict[str, float]:
    """What the real loop takes here, with its manifest on the disk and workers that need no time.

    Returns:
        ``fit_cpu_seconds`` and ``fit_seconds`` of the wall clock for a fit; ``page_cpu_seconds`` for the page
        of so many.
    """
    guesses = Load(captures).guesses()
    some = dict(list(guesses.items())[:MEASURED])
    pool = VirtualPool(replace(Cluster(workers=workers).calm(), nodes=1), some)
    with tempfile.TemporaryDirectory() as home:
        manifest = _manifest(Path(home) / FILE, guesses)
        batch = _Watched(Path(home), home, cast(Place, pool), manifest,
                         Scheduler(Work(known, 1.0) for known in some),
                         lambda *_: None, clock=lambda: pool.now)
        batch.pool = pool
        wall, cpu = time.perf_counter(), time.process_time()
        batch.run(pool)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        before = time.process_time()
        Batch.write_page(batch)
        page_seconds = time.process_time() - before
        manifest.close()
    return {"fit_cpu_seconds": cpu / MEASURED, "fit_seconds": wall / MEASURED,
            "page_cpu_seconds": page_seconds}


def cases(cluster: Cluster) -> list[tuple[str, Cluster, Order]]:
    """What is compared, in words: the cluster as it is assumed to be, parts of its failures, and orders where
    nothing hangs.
    """
    sound = replace(cluster, hangs=0.0)
    return [("all of it", cluster, "largest"), (f"`--timeout {SHORT:g}`", replace(cluster, timeout=SHORT),
                                                "largest"),
            ("nothing hangs", sound, "largest"), ("nothing hangs; as they come", sound, "arrival"),
            ("nothing hangs; smallest first", sound, "smallest"),
            ("nothing hangs; the head dies thrice an hour", replace(sound, head_deaths=3.0), "largest")]


def swept(cluster: Cluster, load: Load, workers: Sequence[int], seed: int) -> list[dict]:
    """The same without failures for other numbers of workers, with a few fits for each, also where a disk is
    slow.
    """
    per_node = cluster.workers / cluster.nodes
    rows = []
    for taken, number in ((taken, number) for taken in (cluster.supervisor_seconds, SLOW)
                          for number in workers):
        other = replace(cluster, workers=number, nodes=max(1, round(number / per_node)), crashes=0.0,
                        deaths=0.0,
                        node_deaths=0.0, head_deaths=0.0, hangs=0.0, slow_nodes=0.0, page_seconds=0.0,
                        supervisor_seconds=taken)
        found = simulate(other, replace(load, captures=FITS * number).guesses(seed), "largest", seed)
        rows.append({"supervisor_seconds": taken, "limit": found["spent"] / found["attempts"] / taken}
                    | found)
        say(f"{rows[-1]}")
    return rows


def with_costs(cluster: Cluster, load: Load, costs: Mapping, pages: str) -> tuple[Cluster, Load]:
    """The same with what was measured: seconds and spread of fits, bytes, start of a child.

    Args:
        cluster: the workers.
        load: what is to be fitted.
        costs: of :mod:`mitsvbrdf.batch.planning.costs`.
        pages: all or none.
    """
    law = costs["law"][pages]
    usual, large = (law["base"] + law["slope"] * 9 * side**2 for side in (256, 512))
    row = max((r for r in costs["rows"] if r["pages"] == pages and r["resolution"] == 256),
              key=lambda r: r["capture_bytes"])
    start = costs["cold"]["cpu_seconds"] - costs["warm"]["cpu_seconds"]
    return (replace(cluster, sigma=costs["spread"], start_seconds=start,
                    capture_bytes=float(row["capture_bytes"]), result_bytes=float(row["result_bytes"])),
            replace(load, seconds=usual, larger=large / usual))


def main(out: Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder to write.")],
         cluster: tyro.conf.OmitArgPrefixes[Cluster] = Cluster(),  # noqa: B008  frozen
         load: tyro.conf.OmitArgPrefixes[Load] = Load(),  # noqa: B008
         costs: Annotated[Path | None, tyro.conf.arg(help="batch-costs.json: its seconds, spread and bytes "
                                                          "are taken.")] = None,
         pages: Annotated[Literal["all", "none"],
                          tyro.conf.arg(help="Whether these are of fits with their pages.")] = "none",
         measure: Annotated[bool, tyro.conf.arg(
             help="Measure the supervisor's seconds here, and take them.")] = False,
         sweep: Annotated[tuple[int, ...], tyro.conf.arg(help="Other numbers of workers.")] = (250, 1000,
                                                                                               2500),
         seed: Annotated[int, tyro.conf.arg(help="Of all that is drawn.")] = 0) -> int:
    """Simulate a batch in several cases, and other numbers of workers."""
    files.check_output(*(out / f"batch-simulation.{kind}" for kind in ("json", "md", "svg")))
    supervisor: dict | None = None
    if costs:
        cluster, load = with_costs(cluster, load, read_json(costs, ConfigError), pages)
    if measure:
        supervisor = measured_supervisor(cluster.workers, load.captures)
        cluster = replace(cluster, supervisor_seconds=supervisor["fit_cpu_seconds"],
                          page_seconds=supervisor["page_cpu_seconds"])
        say(f"supervisor: {supervisor}")
    guesses, runs = load.guesses(seed), []
    for words, other, order in cases(cluster):
        runs.append({"case": words} | simulate(other, guesses, order, seed))
        say(f"{runs[-1]}")
    record = {"schema_version": 1, "cluster": asdict(cluster), "load": asdict(load), "seed": seed,
              "supervisor": supervisor,
              "runs": runs, "sweep": swept(cluster, load, sweep, seed), "machine": machine(),
              "versions": versions()}
    files.write_json(out / "batch-simulation.json", record)
    files.write_bytes(out / "batch-simulation.md", page(record).encode())
    with files.atomic_write(out / "batch-simulation.svg") as file:
        figure(record).savefig(file, format="svg", metadata={"Date": None})
    return 0


if __name__ == "__main__":
    sys.exit(run_tool(main, "python -m mitsvbrdf.batch.planning.simulate",
                      "interrupted; nothing is written"))
