"""A process that outlives another only to clean up after it: it kills and buries all that the other has left,
and its folder.

Ray's agents outlive a Ray that is killed, and some containers have nobody to bury orphans.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from .guard import die_with_parent

PREFIX = "mitsvbrdf-ray-"
LONGEST_TEMP = 16  # characters: Ray's sockets lie 90 characters deeper, and a socket's path has at most 107
ROUNDS, ROUND_SECONDS = 40, 0.05  # of killing: what is just being started comes too late for one


def outlive(live: Callable[[Path], None]) -> int:
    """Let a child process live; when it ends, however that happens, end all of this session and remove the
    folder.

    The child ends with this process, and at SIGTERM to it. To be called before there are threads.

    Args:
        live: what the child does; is given a private folder with a short path, and ends by ``os._exit``.

    Returns:
        The child's exit code; 128 and the signal's number if it was killed.
    """
    folder, lock = _private_folder()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER: orphans become children of this process
    child = os.fork()
    if child == 0:
        die_with_parent()
        live(folder)
        os._exit(0)
    signal.signal(signal.SIGTERM, lambda number, frame: os.kill(child, signal.SIGKILL))
    pid = status = 0
    while pid != child:  # the others are orphans
        pid, status = os.waitpid(-1, 0)
    for _ in range(ROUNDS):
        if not _kill_session():
            break
        time.sleep(ROUND_SECONDS)
    shutil.rmtree(folder, ignore_errors=True)
    os.close(lock)
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


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
    """A new folder, locked as long as this process lives; those whose holder was killed are removed."""
    parent = tempfile.gettempdir()
    parent = parent if len(parent) <= LONGEST_TEMP else "/tmp"
    for left in Path(parent).glob(f"{PREFIX}*/lock"):
        with contextlib.suppress(OSError):  # held, another user's, or gone
            with left.open() as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left.parent, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    lock = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, 0o600)
    fcntl.flock(lock, fcntl.LOCK_EX)
    return folder, lock
