"""Run tasks on Ray: on a Ray started for this batch alone, or on a cluster that the batch joins."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ..errors import BackendError
from .fitting import fit_task
from .settings import BatchSettings

PREFIX = "mitsvbrdf-ray-"  # of the folder of the batch's own Ray; no other user may enter it
OBJECT_STORE_BYTES = 80 << 20  # shared memory; Ray requires 75 MiB or more, the batch uses none of it
LOOPBACK = "127.0.0.1"
ALONE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # also on Linux, this keeps Ray on loopback
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",  # other users of this machine reach the ports too
    # otherwise Ray starts a process for each CPU in advance
    "RAY_enable_worker_prestart": "0", "RAY_prestart_worker_first_driver": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_worker_niceness": "0",
}
THREADS = "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"
CALLS = 200  # fits of a worker before a new worker replaces it, which frees its memory
TRIES = 3  # attempts to start Ray; one fails if a busy machine takes more than half a minute
LOOK_SECONDS = 5.0  # between two queries of a cluster's nodes
SILENT_SECONDS = 30.0  # a cluster without an answer for this time counts as gone
GONE = "run the same command again: it goes on"


class RayTasks:
    """Fits that run on Ray. A context manager: it starts Ray or joins a cluster, and ends what it started.

    ``function`` yields a dict about its worker, then the outcome. Each node loads it from its package.
    """

    def __init__(self, settings: BatchSettings,
                 function: Callable[[dict], Iterator[dict]] = fit_task) -> None:
        self.settings, self.function, self._workers = settings, function, settings.local_workers()
        self._tasks: dict[Any, str] = {}  # generator to name
        self._servers: set[int] = set()  # process ids of the batch's own Ray
        self._nodes: list[dict] = []
        self._heard = time.monotonic()

    def __enter__(self) -> RayTasks:
        with contextlib.ExitStack() as last:
            folder = Path(last.enter_context(tempfile.TemporaryDirectory(prefix=PREFIX,
                                                                               ignore_cleanup_errors=True)))
            # Ray prints what happens to workers; the batch itself prints what happens to captures
            log = last.enter_context((folder / "ray.log").open("a"))
            last.enter_context(contextlib.redirect_stdout(log))
            self._start(folder)
            import ray

            last.callback(ray.shutdown)
            self._call = ray.remote(num_cpus=self.settings.threads, max_retries=0, max_calls=CALLS,
                                    num_returns="streaming", scheduling_strategy="SPREAD")(self.function)
            self._last = last.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel(*self._tasks.values())
        self._last.close()

    @property
    def slots(self) -> int:
        """How many fits may run at a time now."""
        if self.settings.address is None:
            return self._workers
        cores = [node["Resources"].get("CPU", 0) for node in self._nodes if node["Alive"]]
        return self.settings.workers or sum(int(each // self.settings.threads) for each in cores)

    def start(self, name: str, task: dict) -> None:
        """Hand out a task."""
        self._tasks[self._call.remote(task)] = name

    def cancel(self, *names: str) -> None:
        """Kill the workers of tasks. Each task that has not ended yet then ends as ``cancelled``."""
        import ray

        for task, name in self._tasks.items():
            if name in names:
                with contextlib.suppress(ray.exceptions.RayError):
                    ray.cancel(task, force=True)

    def events(self, seconds: float) -> list[tuple[str, dict]]:
        """(name, what it yielded) of each task that has yielded something. Waits ``seconds`` at most.

        If the worker of a task is gone, its item is a ``state`` (crashed, cancelled, memory, or lost with its
        node) and a ``reason``. A task ends with its first ``state``. BackendError: Ray itself ended.
        """
        import ray

        found = list[tuple[str, dict]]()
        if not self._tasks:
            time.sleep(seconds)
        elif ray.wait(list(self._tasks), timeout=seconds)[0]:
            for task in ray.wait(list(self._tasks), num_returns=len(self._tasks), timeout=0)[0]:
                found.append((self._tasks[task], self._item(task)))
                if "state" in found[-1][1]:
                    del self._tasks[task]
        self._check()
        return found

    def _item(self, task: Any) -> dict:
        from ray import exceptions, get

        try:
            return get(next(task))
        except StopIteration:
            return {"state": "crashed", "reason": "its worker told nothing"}
        except exceptions.TaskCancelledError:
            return {"state": "cancelled", "reason": "its worker was killed"}
        except exceptions.OutOfMemoryError:
            return {"state": "memory", "reason": "its worker was killed by Ray, as memory ran out"}
        except (exceptions.NodeDiedError, exceptions.LocalRayletDiedError):
            return {"state": "lost", "reason": "its node died"}
        except exceptions.RayTaskError as reason:
            return {"state": "failed", "reason": str(reason.cause)}
        except exceptions.RayError:
            return {"state": "crashed", "reason": "its worker died, by itself, by hand, or as memory ran out"}

    def _start(self, folder: Path) -> None:
        address, here = self.settings.address, self.settings.address is None
        if here and "ray" in sys.modules and not ALONE.items() <= os.environ.items():
            raise BackendError("Ray not imported yet", "it imported before", "run `mitsvbrdf batch`")
        try:
            if here:
                self._start_own(folder)
            else:
                os.environ["RAY_ENABLE_UV_RUN_RUNTIME_ENV"] = "0"  # the nodes have mitsvbrdf already
                _reach(str(address))
                self._init(folder, address)
                import ray

                self._nodes = ray.nodes()
                threading.Thread(target=self._look, daemon=True).start()
        except Exception as error:  # Ray raises exceptions of many kinds
            raise BackendError("Ray to start" if here else f"a Ray cluster at {address}",
                f"{type(error).__name__}: {str(error)[:500]}",
                "install it again: pip install --force-reinstall ray" if here
                else "check the address: that of `ray start --head`, seen from this machine") from error

    def _start_own(self, folder: Path) -> None:
        """Start a Ray on this machine alone. It gets as many CPUs as the workers use, however many exist."""
        settings, before = self.settings, _children()
        os.environ.pop("RAY_ADDRESS", None)
        os.environ.update(ALONE)
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
        for left in reversed(range(TRIES)):
            try:
                self._init(folder, "local", num_cpus=self._workers * settings.threads, num_gpus=0,
                           object_store_memory=OBJECT_STORE_BYTES, include_dashboard=False,
                           _node_ip_address=LOOPBACK, _temp_dir=str(folder / f"ray{left}"))
                break
            except Exception as error:
                if not left or "timed out" not in str(error):
                    raise
        import ray

        if (address := ray.nodes()[0]["NodeManagerAddress"]) != LOOPBACK:
            ray.shutdown()
            raise RuntimeError(f"Ray listens on {address}, not on loopback alone")
        self._servers = _children() - before

    def _init(self, folder: Path, address: str | None, **options: Any) -> None:
        """Start or join Ray in a folder without modules, as workers may import from the current folder."""
        import ray

        env = {"env_vars": dict.fromkeys(THREADS, str(self.settings.threads))}
        try:
            with contextlib.chdir(folder):
                ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL, runtime_env=env,
                         **options)
        except BaseException:
            ray.shutdown()
            raise

    def _look(self) -> None:
        import ray

        with contextlib.suppress(Exception):  # disconnected
            while True:
                self._nodes, self._heard = ray.nodes(), time.monotonic()
                time.sleep(LOOK_SECONDS)

    def _check(self) -> None:
        if any(map(_has_ended, self._servers)):
            raise BackendError("Ray to run as long as the batch", "the end of one of its processes", GONE)
        if self.settings.address is not None and time.monotonic() > self._heard + SILENT_SECONDS:
            raise BackendError("a Ray cluster that answers", f"silence for {SILENT_SECONDS:g} s", GONE)


def require_ray() -> None:
    """Raise BackendError if the package ray is missing."""
    import importlib.util

    if importlib.util.find_spec("ray") is None:
        raise BackendError("the package ray", "none", "type: pip install 'mitsvbrdf[batch]'")


def _reach(address: str) -> None:
    """Raise OSError at once for a port that nobody listens on; Ray would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()


def _children() -> set[int]:
    """The ids of the child processes of this process; empty if the system does not list them."""
    found = set[int]()
    with contextlib.suppress(OSError):
        for thread in Path("/proc/self/task").iterdir():
            found |= set(map(int, (thread / "children").read_text().split()))
    return found


def _has_ended(child: int) -> bool:
    try:
        return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True
