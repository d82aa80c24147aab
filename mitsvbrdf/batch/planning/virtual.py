"""A cluster in virtual time: workers that fit nothing, fail as real ones do, and answer the supervisor as a
pool.

Nothing sleeps: an event has a time, and the clock jumps to it. The supervisor's own work moves the clock too,
so that answers wait for it as they do for a real one.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

HOUR = 3600.0


@dataclass(frozen=True)
class Cluster:
    """Workers, what they cost, and how they fail."""

    workers: int = 1000
    """How many fit at a time."""
    nodes: int = 63
    """Machines that they are spread over: 16 on each."""
    sigma: float = 0.3
    """Spread of a fit's seconds around what was guessed: standard deviation of their logarithm."""
    slow_nodes: float = 0.05
    """Share of nodes that are slow."""
    slowness: float = 2.0
    """How much longer a fit takes there."""
    start_seconds: float = 10.0
    """A new child's first fit takes so much longer."""
    crashes: float = 0.02
    """Deaths of a child an hour of fitting: a crash, or the system's memory killer. Its worker starts a new
    one."""
    deaths: float = 0.01
    """Deaths of a worker an hour of fitting. A new one starts in its place at once."""
    node_deaths: float = 0.05
    """Deaths of each node an hour; spot machines die so."""
    notice_seconds: float = 30.0
    """Until Ray knows that a node is dead."""
    node_seconds: float = 300.0
    """Until another node is there."""
    head_deaths: float = 0.1
    """Deaths of the head an hour. All workers die with it."""
    head_seconds: float = 120.0
    """Until the head and its workers are there again."""
    hangs: float = 0.0005
    """Share of fits that never end."""
    timeout: float = 540.0
    """Seconds that a fit may take: of the default method 3 minutes and 3 times its 120 s."""
    refused: float = 0.002
    """Share of captures that cannot be fitted at all."""
    bandwidth: float = 1e9
    """Bytes a second of the shared file system, all nodes together."""
    capture_bytes: float = 4e6
    """Read by a fit."""
    result_bytes: float = 12e6
    """Written by a fit."""
    supervisor_seconds: float = 0.003
    """Of the supervisor for one fit: handed out, ended, noted, shown."""
    page_seconds: float = 8.0
    """Of the supervisor to write the page once."""
    answer_seconds: float = 0.05
    """Between a result in the library and the answer that it is there."""

    def calm(self) -> Cluster:
        """The same, where nothing fails, nothing spreads, and all but a fit takes no time."""
        none: dict[str, Any] = dict.fromkeys(
            ("sigma", "slow_nodes", "start_seconds", "crashes", "deaths", "node_deaths", "head_deaths",
             "hangs", "refused",
             "capture_bytes", "result_bytes", "supervisor_seconds", "page_seconds", "answer_seconds"), 0.0)
        return replace(self, **none)


@dataclass
class _Node:
    number: int
    slowness: float
    generation: int = 0  # of its workers; one more with each death
    back: float = 0.0  # when there is such a node again


@dataclass
class _Worker:
    name: str
    node: _Node
    cold: bool = True  # its child is not started
    attempt: str | None = None
    since: float = 0.0  # of the fit that runs
    fitting: bool = False


@dataclass
class Count:
    """What happened, in numbers and seconds."""

    spent: float = 0.0  # by workers on fits, whatever became of them
    lost: float = 0.0  # of these, on fits thrown away
    supervisor: float = 0.0
    ends: dict[str, int] = field(default_factory=dict)  # of fits, and deaths
    published: dict[str, int] = field(default_factory=dict)  # by identity, how often a result appeared

    def more(self, what: str) -> None:
        """One more of these."""
        self.ends[what] = self.ends.get(what, 0) + 1


class VirtualPool:
    """A pool, and the place of its results, in virtual time.

    Args:
        cluster: the workers.
        seconds: of each capture's fit on a usual node, by identity.
        seed: of all that is drawn.
    """

    def __init__(self, cluster: Cluster, seconds: Mapping[str, float], seed: int = 0) -> None:
        self.cluster, self.seconds, self.now, self.count = cluster, seconds, 0.0, Count()
        self._random = random.Random(seed)
        self._queue: list[tuple[float, int, Callable[[float], None]]] = []
        self._ready, self._order, self._disk_free, self._head_back = list[dict](), 0, 0.0, 0.0
        self._workers: dict[str, _Worker] = {}
        self._records: dict[str, dict] = {}
        self._names = 0
        slow = round(cluster.slow_nodes * cluster.nodes)
        self._nodes = [_Node(k, cluster.slowness if k < slow else 1.0) for k in range(cluster.nodes)]
        self._refused = {known for known in seconds if self._random.random() < cluster.refused}
        for node in self._nodes:
            self._fill(node, 0.0)
        self._plan(0.0, cluster.node_deaths * cluster.nodes, self._node_dies)
        self._plan(0.0, cluster.head_deaths, self._head_dies)

    def run(self, worker: str, task: dict) -> None:
        """Hand a task to a worker; the supervisor's own work for it passes here."""
        self.busy(self.cluster.supervisor_seconds)
        self._at(self.now, lambda at: self._begin(worker, task, at))

    def events(self, seconds: float) -> list[dict]:
        """What has happened; moves the clock to the next that happens, at most so far."""
        until = self.now + seconds
        while self._queue and (self._queue[0][0] <= self.now or not self._ready
                               and self._queue[0][0] <= until):
            at, _, act = heapq.heappop(self._queue)
            self.now = max(self.now, at)
            act(at)
        if not self._ready:
            self.now = until
        found, self._ready = self._ready, []
        return found

    def close(self) -> None:
        """Nothing has to be ended."""

    def record(self, folder: str) -> dict | None:
        """The record of a result that is there, as a place has it."""
        return self._records.get(folder)

    def busy(self, seconds: float) -> None:
        """The supervisor works for so long."""
        self.now += seconds
        self.count.supervisor += seconds

    def _at(self, when: float, act: Callable[[float], None]) -> None:
        self._order += 1
        heapq.heappush(self._queue, (when, self._order, act))

    def _plan(self, at: float, per_hour: float, act: Callable[[float], None]) -> None:
        """Let something without memory happen next."""
        if per_hour:
            self._at(at + self._random.expovariate(per_hour / HOUR), act)

    def _fill(self, node: _Node, at: float) -> None:
        """A node's workers come up, unless it dies before."""
        share = (self.cluster.workers // len(self._nodes)
                 + (node.number < self.cluster.workers % len(self._nodes)))
        for _ in range(share):
            self._start(node, at)

    def _start(self, node: _Node, at: float) -> None:
        generation = node.generation

        def up(at: float) -> None:
            if node.generation == generation:
                self._names += 1
                worker = _Worker(f"w{self._names}", node)
                self._workers[worker.name] = worker
                self._ready.append({"is": "worker", "worker": worker.name, "host": f"node-{node.number}"})

        self._at(at, up)

    def _begin(self, name: str, task: dict, at: float) -> None:
        worker = self._workers.get(name)
        if worker is None:
            return  # gone; the supervisor hears of it
        attempt, draw, cluster = task["attempt"], self._random, self.cluster
        worker.attempt, worker.since, worker.fitting = attempt, at, True
        begins = self._moved(at, cluster.capture_bytes) + cluster.start_seconds * worker.cold
        worker.cold = False
        length = (self.seconds[task["identity"]] * worker.node.slowness
                  * draw.lognormvariate(0.0, cluster.sigma))
        if task["identity"] in self._refused:
            self._at(begins, lambda at: self._ended(name, attempt, "failed", at))
            return
        hangs = draw.random() < cluster.hangs
        length = cluster.timeout if hangs else min(length, cluster.timeout)
        rate = (cluster.crashes + cluster.deaths) / HOUR
        if rate and (dies := draw.expovariate(rate)) < length:
            if draw.random() < cluster.deaths / (cluster.crashes + cluster.deaths):
                self._at(begins + dies, lambda at: self._worker_dies(name, attempt, at))
            else:
                self._at(begins + dies, lambda at: self._ended(name, attempt, "crashed", at))
        elif length == cluster.timeout:
            self._at(begins + length, lambda at: self._ended(name, attempt, "timeout", at))
        else:
            self._at(begins + length, lambda at: self._fitted(name, task, at))

    def _moved(self, at: float, size: float) -> float:
        """When so many bytes have crossed the network: one file after the other."""
        self._disk_free = max(self._disk_free, at) + size / self.cluster.bandwidth
        return self._disk_free

    def _fitted(self, name: str, task: dict, at: float) -> None:
        """The fit is done; its files are written, then the result appears, then the answer comes."""
        if self._runs(name, task["attempt"]):
            self._at(self._moved(at, self.cluster.result_bytes), lambda at: self._publish(name, task, at))

    def _publish(self, name: str, task: dict, at: float) -> None:
        worker = self._workers.get(name)
        if worker is None or worker.attempt != task["attempt"]:
            return
        self._pay(worker, "done", at)
        folder, known = f"{task['name']}-{task['identity'][:8]}", task["identity"]
        self.count.published[known] = self.count.published.get(known, 0) + 1
        row = {"seconds": at - worker.since, "error": None}
        self._records[folder] = {"identity": known, "attempt": task["attempt"], "row": row}
        self._at(at + self.cluster.answer_seconds, lambda at: self._answer(name, task["attempt"], "done",
                                                                           row))

    def _ended(self, name: str, attempt: str, state: str, at: float) -> None:
        """A fit has ended without a result."""
        if self._runs(name, attempt):
            worker = self._workers[name]
            self._pay(worker, state, at)
            worker.cold = state != "failed"
            self._answer(name, attempt, state, {})

    def _answer(self, name: str, attempt: str, state: str, row: dict) -> None:
        if self._runs(name, attempt):
            self._workers[name].attempt = None
            outcome = {"state": state, "reason": state, "log": "", "seconds": row.get("seconds"),
                       "peak_bytes": 0, "row": row}
            self._ready.append({"is": "done", "worker": name, "attempt": attempt, "outcome": outcome})

    def _runs(self, name: str, attempt: str) -> bool:
        return name in self._workers and self._workers[name].attempt == attempt

    def _pay(self, worker: _Worker, state: str, at: float) -> None:
        """A fit is over: its seconds count as spent, and as lost where they brought nothing."""
        self.count.more(state)
        worker.fitting = False
        self.count.spent += at - worker.since
        self.count.lost += (at - worker.since) * (state != "done")

    def _worker_dies(self, name: str, attempt: str, at: float) -> None:
        if self._runs(name, attempt):
            self._start(self._workers[name].node, at)
            self._gone([name], at, at)

    def _node_dies(self, at: float) -> None:
        self._plan(at, self.cluster.node_deaths * self.cluster.nodes, self._node_dies)
        node = self._random.choice(self._nodes)
        if node.back <= at:
            self.count.more("node deaths")
            node.back = at + self.cluster.node_seconds
            self._end_workers(node, at, at + self.cluster.notice_seconds)

    def _head_dies(self, at: float) -> None:
        self._plan(at, self.cluster.head_deaths, self._head_dies)
        if self._head_back <= at:
            self.count.more("head deaths")
            self._head_back = at + self.cluster.head_seconds
            for node in self._nodes:
                self._end_workers(node, at, at)

    def _end_workers(self, node: _Node, at: float, told: float) -> None:
        """All of a node's workers die; it has new ones when it and the head are back."""
        node.generation += 1
        self._gone([name for name, worker in self._workers.items() if worker.node is node], at, told)
        self._fill(node, max(node.back, self._head_back))

    def _gone(self, names: list[str], at: float, told: float) -> None:
        """Workers are dead; the supervisor hears of it when it is told."""
        for name in names:
            worker = self._workers.pop(name)
            if worker.fitting:
                self._pay(worker, "lost", at)
            event = {"is": "lost", "worker": name, "attempt": worker.attempt, "reason": "the worker died"}
            self._at(told, lambda at, event=event: self._ready.append(event))  # type: ignore[misc]
