"""A Ray for one batch alone: on loopback, with a token of its own, in a private folder.

Its end is that of the process that started it, and the work of :mod:`mitsvbrdf.batch.workers.last_rites`.
"""

from __future__ import annotations

import logging
import os
import secrets
import subprocess
from pathlib import Path
from typing import Any

OBJECT_STORE_BYTES = 80 << 20  # Ray wants 75 MiB at least; it is shared memory that stays untouched
LOOPBACK = "127.0.0.1"
ALONE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # on Linux too it is this that lets Ray keep to loopback
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",  # other users of this machine reach the ports too
    # else a process a CPU, which no one needs
    "RAY_enable_worker_prestart": "0", "RAY_prestart_worker_first_driver": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_worker_niceness": "0",
    # would kill a worker; the guard, or the system, kills the child that is to blame
    "RAY_memory_monitor_refresh_ms": "0",
}
NEEDLESS = "monitor", "log_monitor"  # the autoscaler, and a reader of logs


class OwnRay:
    """Ray with as many CPUs as told, whatever the machine has.

    Args:
        folder: takes what Ray writes; nobody else may look into it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._servers: list[subprocess.Popen] = []

    def start(self, cpus: int, dashboard: bool) -> None:
        """Start Ray and connect to it; must be called in the main thread, for its end is the end of Ray."""
        os.environ.pop("RAY_ADDRESS", None)
        os.environ.update(ALONE | {"RAY_AUTH_TOKEN": secrets.token_hex(32)})
        import ray

        ray.init("local", num_cpus=cpus, num_gpus=0, object_store_memory=OBJECT_STORE_BYTES,
                 include_dashboard=dashboard,
                 log_to_driver=False, logging_level=logging.ERROR, _node_ip_address=LOOPBACK,
                 _temp_dir=str(self._folder / "ray"))  # which Ray opens to everybody
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
