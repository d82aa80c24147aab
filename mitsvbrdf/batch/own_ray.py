"""A Ray for one batch alone: on loopback, with a token of its own, in a private folder, gone when the batch is gone.

Only the gateway uses it. Its processes live in the gateway's session, which the gateway leads; Ray lets those that it starts
itself die with the gateway (``PR_SET_PDEATHSIG``).
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import logging
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PREFIX = "mitsvbrdf-ray-"
OBJECT_STORE_BYTES = 80 << 20  # Ray wants 75 MiB at least; it is shared memory that stays untouched
LONGEST_TEMP = 16  # characters: Ray's sockets lie 90 characters deeper, and a socket's path has at most 107
LOOPBACK = "127.0.0.1"
ALONE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # on Linux too it is this that lets Ray keep to loopback
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",  # other users of this machine reach the ports too
    "RAY_enable_worker_prestart": "0", "RAY_prestart_worker_first_driver": "0",  # else a process a CPU, which no one needs
    "RAY_enable_metrics_collection": "0",
    "RAY_memory_monitor_refresh_ms": "0",  # would kill a worker; the guard, or the system, kills the child that is to blame
}
NEEDLESS = "monitor", "log_monitor"  # the autoscaler, and a reader of logs


class OwnRay:
    """Starts Ray with as many CPUs as told, whatever the machine has; ends it without asking it."""

    def __init__(self) -> None:
        self._folder, self._lock = _private_folder()
        self._servers: list[subprocess.Popen] = []

    def start(self, cpus: int, dashboard: bool) -> None:
        """Start Ray and connect to it; must be called in the main thread, for its end is the end of Ray."""
        os.environ.pop("RAY_ADDRESS", None)
        os.environ.update(ALONE | {"RAY_AUTH_TOKEN": secrets.token_hex(32)})
        import ray

        ray.init("local", num_cpus=cpus, num_gpus=0, object_store_memory=OBJECT_STORE_BYTES, include_dashboard=dashboard,
                 log_to_driver=False, logging_level=logging.ERROR, _node_ip_address=LOOPBACK,
                 _temp_dir=str(self._folder / "ray"))  # Ray opens that folder to everybody: it is inside a private one
        if (address := ray.nodes()[0]["NodeManagerAddress"]) != LOOPBACK:
            raise RuntimeError(f"Ray listens on {address}, not on loopback alone")
        node: Any = ray._private.worker._global_node
        processes: dict[str, list[Any]] = node.all_processes
        self._servers = [info.process for kind in ("gcs_server", "raylet") for info in processes[kind]]
        for kind in NEEDLESS if dashboard else (*NEEDLESS, "dashboard"):
            for info in processes.pop(kind, []):
                info.process.kill()
                info.process.wait()

    def alive(self) -> bool:
        """Whether the two processes that Ray is made of run."""
        return all(server.poll() is None for server in self._servers)

    def end(self) -> None:
        """Kill every other process of this session, and remove the folder; a second time nothing happens."""
        _adopt_orphans()
        for server in self._servers:
            server.kill()
        for _ in range(40):  # those that are just being started come too late for one round
            if not _kill_session():
                break
            time.sleep(0.05)
        shutil.rmtree(self._folder, ignore_errors=True)


def _adopt_orphans() -> None:
    """Let what the dead leave behind become children of this process (Linux): some containers have nobody to bury them."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER


def _kill_session() -> bool:
    """Kill and bury the other processes of this session, if this process leads it; whether one was alive."""
    found = False
    for file in Path("/proc").glob("[0-9]*/stat") if os.getsid(0) == os.getpid() else ():
        with contextlib.suppress(OSError):  # gone meanwhile
            state, _, _, session = file.read_text().rpartition(")")[2].split()[:4]
            pid = int(file.parent.name)
            if int(session) == os.getpid() != pid and state != "Z":
                os.kill(pid, signal.SIGKILL)
                found = True
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    return found


def _private_folder() -> tuple[Path, int]:
    """A new folder with a lock that this process holds as long as it lives; folders whose holder is dead are removed."""
    parent = tempfile.gettempdir()
    parent = parent if len(parent) <= LONGEST_TEMP else "/tmp"
    for left in Path(parent).glob(f"{PREFIX}*/lock"):
        with contextlib.suppress(OSError):  # another user's, or gone
            with left.open() as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left.parent, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX)
    return folder, lock
