"""A process that imports the package once and runs each command in a fork of itself: apart from all others,
in milliseconds.

    python -m fuzz.warm ENTRY

ENTRY is a module with ``warm()``, called once, and ``main()``, called in each fork. Requests and answers are
lines of JSON; see :class:`Warm`.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

# bytes of address space that a command may take beside the imports: a machine that others use stays usable
ROOM = 4 << 30
TESTS, ROOT = Path(__file__).resolve().parents[1], Path(__file__).resolve().parents[2]


class Warm:
    """A warm process that runs the module ``entry``; ``home`` takes what programs keep for a user, Dr.Jit's
    compiled kernels say.
    """

    def __init__(self, entry: str, home: Path, number: int = 0) -> None:
        self.number = number
        home.mkdir(exist_ok=True)
        alone = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        places = os.pathsep.join(filter(None, (str(ROOT), str(TESTS), os.environ.get("PYTHONPATH"))))
        environment = os.environ | alone | {"HOME": str(home), "PYTHONPATH": places}
        self._process = subprocess.Popen([sys.executable, "-P", "-m", "fuzz.warm", entry], env=environment,
                                         text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._imports = self._answer()["imports"]

    def run(self, arguments: Sequence[str], folder: Path, said: Path, temporary: Path, seconds: float,
            grace: float) -> dict:
        """Run a command in ``folder``; file ``said`` takes what it prints, SIGINT comes after ``seconds``,
        SIGKILL ``grace`` later. Returns ``code`` (negative: the signal that ended it), ``signals`` that
        were sent, ``seconds``, ``cpu`` (seconds of it), and ``peak``, resident bytes beside the imports.
        """
        assert self._process.stdin
        request = {"arguments": arguments, "folder": str(folder), "said": str(said),
                   "temporary": str(temporary), "seconds": seconds, "grace": grace}
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        return answer | {"peak": max(0, answer["peak"] - self._imports)}

    def close(self) -> None:
        self._process.communicate()

    def _answer(self) -> dict:
        assert self._process.stdout
        return json.loads(self._process.stdout.readline())


def serve(warm: Callable[[], None], main: Callable[[], int]) -> None:
    """Answer requests until there are no more."""
    warm()
    answers = os.fdopen(os.dup(1), "w")

    def answer(content: Mapping) -> None:
        answers.write(json.dumps(content) + "\n")
        answers.flush()

    answer({"imports": _pages(1)})  # the peak of this process may be that of the one that started it
    for line in sys.stdin:
        request = json.loads(line)
        begun = time.monotonic()
        child = os.fork()
        if not child:
            _live(request, main)
        status, signals, used = _wait(child, request["seconds"], request["grace"])
        answer({"code": status, "signals": signals, "seconds": time.monotonic() - begun,
                "peak": used.ru_maxrss << 10, "cpu": used.ru_utime + used.ru_stime})


def _live(request: Mapping, main: Callable[[], int]) -> None:
    """The command, in its fork; never returns."""
    os.setsid()
    os.chdir(request["folder"])
    said = os.open(request["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    for number, target in ((0, os.open(os.devnull, os.O_RDONLY)), (1, said), (2, said)):
        os.dup2(target, number)
    resource.setrlimit(resource.RLIMIT_AS, (_pages(0) + ROOM,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.environ["TMPDIR"], tempfile.tempdir = request["temporary"], None
    sys.argv = ["mitsvbrdf", *request["arguments"]]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code = main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    os._exit(code)


def _pages(column: int) -> int:
    """Bytes of this process: all addresses (0), or what is resident (1)."""
    return int(Path("/proc/self/statm").read_text().split()[column]) * os.sysconf("SC_PAGE_SIZE")


def _wait(child: int, seconds: float, grace: float) -> tuple[int, list[str], resource.struct_rusage]:
    """Exit code, signals sent and what was used; SIGINT when the time is over, then SIGKILL."""
    sent: list[str] = []

    def end(*_: object) -> None:
        number = signal.SIGKILL if sent else signal.SIGINT
        sent.append(number.name)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, number)

    signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds, grace)
    _, status, usage = os.wait4(child, 0)
    signal.setitimer(signal.ITIMER_REAL, 0)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)  # what it started and left behind
    return os.waitstatus_to_exitcode(status), sent, usage


if __name__ == "__main__":
    module = importlib.import_module(sys.argv[1])
    serve(module.warm, module.main)
