"""``python -P -m mitsvbrdf.batch.workers.gateway EVENT_FD [LOGFILE]``: the one process of a batch that is a
driver of Ray.

The supervisor's lines come on standard input, what happens goes to EVENT_FD, one JSON object a line (see
:mod:`mitsvbrdf.batch.workers.pool`); what Ray prints goes to LOGFILE. Each worker is an actor that holds a
:class:`~mitsvbrdf.batch.workers.guard.Guard`. When standard input ends, the supervisor is gone, and
everything here ends too.

Exit codes: 0 told to stop, 2 cannot start (the last event says why), 3 Ray is gone.
"""

from __future__ import annotations

import json
import logging
import math
import os
import queue
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ... import __version__
from .last_rites import outlive
from .own_ray import OwnRay
from .worker import WorkerActor

TICK_SECONDS = 2.0  # between two looks at the cluster's nodes and at idle workers
START_SECONDS = 120.0  # for Ray to start, or to be joined
HANG_SECONDS = 30.0  # a call of Ray that takes longer: the cluster is gone
STOP_SECONDS = 1.0  # for an orderly end
CHECK_ADDRESS = "check the address: that of `ray start --head`, seen from this machine"
MEND_RAY = "install it again: pip install --force-reinstall ray"
FAILED_STARTS = 5  # of workers, in a row


class CannotStart(Exception):
    """The batch cannot be run here; the reason and what to do."""

    def __init__(self, reason: str, fix: str) -> None:
        super().__init__(reason, fix)
        self.reason, self.fix = reason, fix


@dataclass
class Worker:
    """An actor: without a name until it is up, with an attempt while it runs one."""

    actor: Any
    name: str | None = None
    attempt: str | None = None
    asked: bool = False  # whether it is alive


class Gateway:
    """Keeps as many workers as there should be, hands them tasks, and tells what happens.

    Args:
        events: file descriptor to write to.
        folder: takes what a Ray of its own writes.
    """

    def __init__(self, events: int, folder: Path) -> None:
        self.inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.own: OwnRay | None = None
        self.deadline = math.inf  # the main thread must be back in its loop by then
        self._events, self._folder, self._workers = events, folder, list[Worker]()
        self._names, self._failed_starts, self._ending = 0, 0, threading.Lock()
        self._options: dict = {}
        self._token: str | None = None
        self._home: str | None = None  # the node by which a cluster is joined
        self._wanted = 0

    def start(self, options: dict) -> None:
        """Start a Ray or join one, and begin to bring workers up."""
        self._options, self._names = options, options.get("first", 1) - 1
        library = options["library"]
        if "://" not in library:
            try:
                self._token = Path(library, ".token").read_text(encoding="utf-8")
            except OSError as error:
                raise CannotStart(f"{library} is no library: {error.strerror} at .token",
                                  "name the library's folder") from None
        if options["address"] is None:
            self.own = OwnRay(self._folder)
        self.deadline = time.monotonic() + START_SECONDS
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            if self.own:
                self.own.start((options["workers"] or 1) * options["threads"],
                               options.get("dashboard", False))
            else:
                self._home = _join(options["address"])
        except Exception as error:  # Ray raises what it likes
            raise CannotStart(f"Ray {'did not start' if self.own else 'is not there'}: "
                              f"{type(error).__name__}: "
                              f"{str(error)[:500]}", MEND_RAY if self.own else CHECK_ADDRESS) from error
        signal.signal(signal.SIGTERM, lambda number, frame: self.end(0))
        self.deadline = time.monotonic() + HANG_SECONDS
        self._look()
        self._fill()

    def loop(self) -> None:
        """Do what comes in, and look around every few seconds, until :meth:`end`."""
        look = time.monotonic() + TICK_SECONDS
        while True:
            if self._options:
                self.deadline = time.monotonic() + HANG_SECONDS
            try:
                self.inbox.get(timeout=TICK_SECONDS)()
            except queue.Empty:
                pass
            if self._options and time.monotonic() > look:
                look = time.monotonic() + TICK_SECONDS
                self._look()
                self._fill()
                for worker in self._workers:
                    if worker.name and not worker.attempt and not worker.asked:
                        worker.asked = True
                        self._call(worker, worker.actor.about.remote(), self._answered)

    def obey(self, order: dict) -> None:
        """Do one order of the supervisor."""
        if order["do"] == "start":
            self.start(order)
        elif order["do"] == "stop":
            self.end(0)
        elif order["do"] == "run":
            attempt = order["task"]["attempt"]
            worker = next((one for one in self._workers if one.name == order["worker"]), None)
            if worker is None:
                self.say({"is": "lost", "worker": order["worker"], "attempt": attempt,
                          "reason": "the worker is gone"})
                return
            worker.attempt = attempt
            self._call(worker, worker.actor.run.remote(order["task"]), self._done)

    def say(self, event: dict) -> None:
        """Tell the supervisor; waits as long as it does not read."""
        self.deadline = math.inf
        line = json.dumps(event).encode() + b"\n"
        while line:
            line = line[os.write(self._events, line):]
        self.deadline = time.monotonic() + HANG_SECONDS

    def end(self, code: int) -> None:
        """End everything of one's own, and this process; from any thread."""
        if not self._ending.acquire(blocking=False):
            time.sleep(STOP_SECONDS)  # another thread does it
        if not self.own and "ray" in sys.modules:
            import ray

            threading.Timer(STOP_SECONDS, os._exit, (code,)).start()
            for worker in self._workers:
                ray.kill(worker.actor)
            ray.shutdown()
        os._exit(code)

    def _call(self, worker: Worker, ref: Any, then: Callable[[Worker, Any], None]) -> None:
        """Let the main thread do something with the result; an actor that cannot give it is lost."""

        def arrived(future: Any) -> None:
            def act() -> None:
                if worker not in self._workers:
                    return
                try:
                    result = future.result()
                except Exception as error:
                    self._lost(worker, error)
                else:
                    then(worker, result)

            self.inbox.put(act)

        ref.future().add_done_callback(arrived)

    def _fill(self) -> None:
        """Start actors that are missing; take back those that wait for a place which is gone."""
        import ray

        while len(self._workers) < self._wanted:
            make = ray.remote(WorkerActor).options(num_cpus=self._options["threads"], max_restarts=0,
                                                   max_task_retries=0,
                                             scheduling_strategy="SPREAD")
            # else the default of its own node
            child = [self._options["child"]] if self._options.get("child") else []
            worker = Worker(make.remote(self._options["threads"], self._options["memory"],
                                        self._options["timeout"], *child))
            self._workers.append(worker)
            self._call(worker, worker.actor.about.remote(), self._greeted)
        for worker in [one for one in self._workers if one.name is None][:max(0,
                                                                              len(self._workers) - self._wanted)]:
            self._workers.remove(worker)
            ray.kill(worker.actor)

    def _look(self) -> None:
        """See how many workers there should be; without the node by which it was joined, a cluster is out of
        reach.
        """
        import ray

        nodes = {} if self.own else {node["NodeID"]: node["Resources"] for node in ray.nodes()
                                     if node["Alive"]}
        if self._home and self._home not in nodes:
            self.end(3)
        places = sum(int(resources.get("CPU", 0) // self._options["threads"]) for resources in nodes.values())
        self._wanted = self._options["workers"] or (1 if self.own else places)

    def _greeted(self, worker: Worker, about: dict) -> None:
        if about["version"] != __version__:
            raise CannotStart(f"{about['host']} has mitsvbrdf {about['version']}, and here is {__version__}",
                              "install the same version on all nodes")
        if self._token is None:
            self._up(worker, about)
        else:
            file = str(Path(self._options["library"], ".token"))
            self._call(worker, worker.actor.sees.remote(file, self._token),
                       lambda worker, seen: self._up(worker, about | {"seen": seen}))

    def _up(self, worker: Worker, about: dict) -> None:
        if not about.pop("seen", True):
            raise CannotStart(f"{about['host']} does not see {self._options['library']}",
                              "put the library on a file system that all nodes share, under the same path, "
                              "or give its URL")
        self._failed_starts, self._names = 0, self._names + 1
        worker.name = f"w{self._names}"
        self.say({"is": "worker", "worker": worker.name} | about)

    def _answered(self, worker: Worker, about: dict) -> None:
        worker.asked = False

    def _done(self, worker: Worker, outcome: dict) -> None:
        attempt, worker.attempt = worker.attempt, None
        self.say({"is": "done", "worker": worker.name, "attempt": attempt, "outcome": outcome})

    def _lost(self, worker: Worker, error: Exception) -> None:
        import ray

        self._workers.remove(worker)
        print(f"worker {worker.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
        ray.kill(worker.actor)
        words = [line for line in str(error).splitlines() if not line.startswith("\t")]  # Ray's table of ids
        reason = " ".join(words[-1:])[:300]
        if worker.name:
            self.say({"is": "lost", "worker": worker.name, "attempt": worker.attempt,
                      "reason": f"the worker died: {reason}"})
        else:
            self._failed_starts += 1
            if self._failed_starts == FAILED_STARTS:
                raise CannotStart(f"no worker comes up: {reason}", "install mitsvbrdf on all nodes")
        self._fill()

    def _watch(self) -> None:
        """End when Ray is gone: calls of Ray would hang for a minute."""
        while time.monotonic() < self.deadline and (self.own is None or self.own.alive()):
            time.sleep(0.1)
        if time.monotonic() >= self.deadline and not self._wanted:
            self.say({"is": "failed", "reason": f"Ray gave no answer in {START_SECONDS:g} s",
                      "fix": CHECK_ADDRESS})
        self.end(3)


def _join(address: str) -> str | None:
    """Join a cluster; return the node by which that was done, None for a client's connection."""
    import ray

    os.environ["RAY_ENABLE_UV_RUN_RUNTIME_ENV"] = "0"  # the nodes have mitsvbrdf already
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdigit():
        # Ray would try for minutes
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
    ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    return None if "://" in address else ray.get_runtime_context().get_node_id()


def _listen(gateway: Gateway, orders: int) -> None:
    """Pass the supervisor's lines on; when they end, so does all."""
    with os.fdopen(orders, encoding="utf-8") as lines:
        for line in lines:
            order = json.loads(line)
            gateway.inbox.put(lambda order=order: gateway.obey(order))  # type: ignore[misc]
    gateway.end(0)


def _live(folder: Path) -> None:
    events, orders = int(sys.argv[1]), os.dup(0)
    nothing = os.open(os.devnull, os.O_RDWR)
    log = (os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666) if len(sys.argv) > 2
           else nothing)
    for number, target in ((0, nothing), (1, log), (2, log)):
        os.dup2(target, number)
    gateway = Gateway(events, folder)
    threading.Thread(target=_listen, args=(gateway, orders), daemon=True).start()
    try:
        gateway.loop()
    except CannotStart as error:
        gateway.say({"is": "failed", "reason": error.reason, "fix": error.fix})
        gateway.end(2)
    except Exception:  # Ray, or the pipe to the supervisor, is broken
        traceback.print_exc()
        gateway.end(3)


def main() -> int:
    """See the module. The pipe of events ends when all is cleaned up."""
    os.set_inheritable(int(sys.argv[1]), False)  # nobody else may hold it
    return outlive(_live)


if __name__ == "__main__":
    sys.exit(main())
