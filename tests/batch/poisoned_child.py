"""The child of a batch, of which some captures make it do terrible things: those that hold a file
``poison.txt``.
"""

import ctypes
import os
import signal
import time
from pathlib import Path

from mitsvbrdf.batch.child import fit_into_library, main


def perform(task: dict) -> dict:
    poison = Path(task["capture"]) / "poison.txt"
    what = poison.read_text() if poison.is_file() else ""
    if what == "hang":
        time.sleep(3600)
    elif what == "eat":
        eaten = [b"x" * (1 << 28) for _ in range(32)]  # 8 GiB
        return {"eaten": len(eaten)}
    elif what == "abort":
        os.abort()
    elif what == "segfault":
        ctypes.string_at(0)
    elif what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif what == "exit":
        os._exit(7)
    return fit_into_library(task)


if __name__ == "__main__":
    main(perform)
