"""The lock for what a process has once: Mitsuba and Dr.Jit, the first import of libraries, torch's own
defaults.
"""

from __future__ import annotations

import threading

PROCESS = threading.RLock()
