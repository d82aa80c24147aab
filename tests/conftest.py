"""Fixtures for all tests."""

import contextlib
import ctypes
import functools
import os
import signal

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # of a job in the background; the tests press Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)
# as the command does (mitsvbrdf.__main__), before torch loads
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # the workers share the cores

from collections.abc import Iterator
from pathlib import Path

import pytest

from mitsvbrdf.batch.tasks import ALONE

# Ray reads them where it is imported first, which may be in a test of something else
os.environ.update(ALONE, RAY_AUTH_TOKEN=os.urandom(32).hex())

# nothing that a test writes has to outlive a power cut, and waiting for the disk is slow
os.fsync = lambda descriptor: None
pytest.register_assert_rewrite("helpers")

# The plugin under test also comes through its entry point in an installed package; pytest loads it once.
pytest_plugins = ["mitsvbrdf.testing.plugin", "pytester"]


def pytest_configure(config: pytest.Config) -> None:
    """LLVM compiles kernels of quick tests without its optional passes, in a third of the time, and those of
    slow tests as users have them.
    """
    from mitsvbrdf.errors import BackendError
    from mitsvbrdf.render.llvm import use_llvm

    with contextlib.suppress(BackendError):  # each test says so that needs it
        if config.option.markexpr == "not slow" and (llvm := use_llvm()).version.startswith("19."):
            options = b"tests", b"-opt-bisect-limit=0", b"-opt-bisect-verbose=false", b"-regalloc=fast"
            given = (ctypes.c_char_p * len(options))(*options)
            ctypes.CDLL(llvm.path).LLVMParseCommandLineOptions(len(options), given, None)
            os.environ["DRJIT_CACHE_DIR"] = str(config.rootpath / ".pytest_cache" / "kernels")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real captures and known materials (``captures/``, ``materials/``); not in the repository.

    The environment variable MITSVBRDF_DATA names it, else it is ``../shared/data`` beside the repository.
    """
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MITSVBRDF_DATA") or beside)
    if not (folder / "captures").is_dir():
        pytest.skip(f"needs the real captures: none at {folder}; name their folder in MITSVBRDF_DATA")
    return folder


@pytest.fixture(scope="session", autouse=True)
def one_thread_a_worker() -> None:
    """Workers share the cores: a second thread of Dr.Jit waits for the other one."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        import drjit
        drjit.set_thread_count(1)


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Mitsuba loads the parts of a file beside each other; with one thread it waits for ever."""
    import drjit
    before = drjit.thread_count()
    drjit.set_thread_count(2)
    yield
    drjit.set_thread_count(before)


@pytest.fixture(scope="session", autouse=True)
def coarse_spheres() -> None:
    """The sphere of each page and each export has one ray a pixel instead of 16: a second of work less."""
    from mitsvbrdf.relight import stage

    stage.SAMPLES = 1


@pytest.fixture(scope="session", autouse=True)
def materials_painted_once() -> None:
    """A made material is painted once a process and seed: a third of a second. It becomes maps each time."""
    from mitsvbrdf.material.made import MATERIALS

    def kept(paint):
        made = {}

        @functools.wraps(paint)
        def painted(x, y, rng):
            key = len(x), x.dtype, rng.initial_seed()
            if x.shape[0] != x.shape[1] or key not in made and (len(x) > 512 or len(made) > 3):  # 8 MB each
                return paint(x, y, rng)
            if key not in made:
                made[key] = paint(x, y, rng)
            return made[key]

        return painted

    MATERIALS.update({name: kept(paint) for name, paint in MATERIALS.items()})


@pytest.fixture
def painted_anew(monkeypatch):
    """Made materials are painted each time, as outside of tests."""
    from mitsvbrdf.material.made import MATERIALS

    for name, paint in MATERIALS.items():
        monkeypatch.setitem(MATERIALS, name, paint.__wrapped__)
