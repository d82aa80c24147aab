"""Find a libLLVM that Dr.Jit works with, test it in a child process, and load Mitsuba with it.

Dr.Jit takes any libLLVM it finds, and fixes its choice when it is first imported. An unsuitable libLLVM (e.g.
15 or 16 on a CPU with AVX-512) aborts the whole process at the first kernel. So a small kernel is tried in a
child process first, success is noted in the user's cache, and ``DRJIT_LIBLLVM_PATH`` is set before Dr.Jit
loads. Importing this module loads neither Dr.Jit nor Mitsuba. ``python -m mitsvbrdf.render.llvm`` prints the
library's path or, with exit code 1, what to install.
"""

import contextlib
import hashlib
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from glob import glob
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from ..errors import BackendError, OutputError
from ..io.files import write_bytes
from ..io.signals import PROCESS

VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST = 19
INTEGRATORS, FIRST = "mitsuba.python.ad.integrators", "common"  # Mitsuba's package, and what it imports first
_registered: set[str] = set()  # variants whose Python integrators are loaded
MEASURED = (19, 22)  # versions this package was developed with; the first to be tried

# The kernel of the test: fmaximum (LLVM 15 and 16 cannot select it), gather, scatter_reduce, a loop and a
# gradient, each with a known result.
PROOF = """
import drjit as dr
from drjit.llvm.ad import Float, UInt32
print(".".join(map(str, dr.detail.llvm_version())), flush=True)
i = dr.arange(UInt32, 64)
x = Float(i)
dr.enable_grad(x)
y = dr.maximum(dr.gather(Float, x, 63 - i), 31.5)
sums = dr.zeros(Float, 2)
dr.scatter_reduce(dr.ReduceOp.Add, sums, y, i & 1)
dr.backward(dr.sum(sums))
count, doubled = dr.while_loop((UInt32(0), dr.detach(sums)), lambda n, s: n < 3, lambda n, s: (n + 1, s * 2))
got = list(doubled), dr.sum(dr.grad(x))[0], dr.fmin(dr.fmax(Float(-1), 0), 2)[0]
want = [8 * sum(max(63 - n, 31.5) for n in range(start, 64, 2)) for start in (0, 1)], 32, 0
if got != want:
    raise SystemExit(f"wrong results: {got}, not {want}")
"""


class LLVM(NamedTuple):
    """A libLLVM and the result of its test."""

    path: str  # empty for the one that Dr.Jit finds by itself
    version: str  # e.g. 19.1.7; the major number alone, or empty, for a library that was not loaded
    proved: bool  # Dr.Jit's kernels gave the right numbers with it
    message: str = ""  # why it cannot be used


def use_llvm() -> LLVM:
    """A libLLVM that works, set as :data:`VARIABLE` unless Dr.Jit is loaded. BackendError: none works."""
    if importlib.util.find_spec("drjit") is None:
        raise BackendError("Dr.Jit and Mitsuba 3", "no drjit in this Python", "pip install mitsuba")
    if "drjit" in sys.modules:
        return _loaded()
    verdicts = []
    for llvm in examine():
        if llvm.proved:
            os.environ[VARIABLE] = llvm.path
            return llvm
        verdicts.append(f"{llvm.path} ({llvm.message})")
    if os.environ.get(VARIABLE):
        raise BackendError(f"{VARIABLE} to name a libLLVM that works with Dr.Jit", verdicts[0],
                           f"unset {VARIABLE} to have one searched for, or install one: {install_hint()}")
    raise BackendError(f"a libLLVM of version {OLDEST} or newer", "; ".join(verdicts) or "none",
                       f"install one: {install_hint()} (the renderer 'analytic' needs none)")


def examine() -> Iterator[LLVM]:
    """Test each libLLVM, in order of preference; if :data:`VARIABLE` is set, only the one it names."""
    if os.environ.get(VARIABLE):
        yield prove(os.environ[VARIABLE])
        return
    for path in candidates():
        major = named_version(path)
        llvm = LLVM(path, str(major), False) if 0 < major < OLDEST else prove(path)
        old = llvm.version and int(llvm.version.split(".")[0]) < OLDEST
        yield llvm._replace(proved=False, message=llvm.message or f"older than {OLDEST}") if old else llvm


def candidates() -> list[str]:
    """Real paths of libLLVM files: versions in MEASURED first, then the newest; without a number, last."""
    found = {os.path.realpath(path) for folder in _folders() for path in glob(f"{folder}/*LLVM[-.]*")
             if re.fullmatch(r"libLLVM([-.][\w.-]+)?\.(so[\d.]*|dylib)|LLVM-C\.dll", os.path.basename(path))}

    def rank(path: str) -> tuple:
        major = named_version(path)
        return MEASURED.index(major) if major in MEASURED else len(MEASURED), -major, path

    return sorted(found, key=rank)


def named_version(path: str) -> int:
    """The major version in a path (libLLVM-19.so, libLLVM.so.19.1, llvm@19/..., llvm/19.1.7/...), else 0."""
    name = re.search(r"LLVM(?:-|\.so\.)(\d+)", os.path.basename(path))
    folder = re.search(r"llvm[@/-]?(\d+)", os.path.dirname(path))
    return int((name or folder or "00")[1])


def _folders() -> list[str]:
    prefixes = {sys.prefix, os.environ.get("CONDA_PREFIX", sys.prefix)}
    return [*filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)),
            *(f"{prefix}/{lib}" for prefix in sorted(prefixes) for lib in ("lib", "Library/bin")),
            "/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib/llvm*/lib", "/usr/lib", "/usr/lib64",
            "/usr/lib64/llvm*/lib*", "/usr/local/lib", "/opt/homebrew/opt/llvm*/lib",
            "/usr/local/opt/llvm*/lib", "C:/Program Files/LLVM/bin"]


def prove(path: str) -> LLVM:
    """Test this library (empty: Dr.Jit's choice) in a child process, unless an earlier test succeeded."""
    note = _note(path)
    if note and note.is_file():
        return LLVM(path, note.read_text(), True)
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    with tempfile.TemporaryDirectory() as kernels:  # no cached kernel may replace one of this library
        environment |= {"DRJIT_CACHE_DIR": kernels} | ({VARIABLE: path} if path else {})
        try:
            child = subprocess.run([sys.executable, "-P", "-c", PROOF], env=environment,
                                   stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                   errors="replace", timeout=120)
        except (OSError, subprocess.TimeoutExpired) as reason:
            return LLVM(path, "", False, f"the trial did not run: {reason}")
    version = child.stdout.strip().removeprefix("-1.-1.-1")
    if child.returncode:
        return LLVM(path, version, False, _reason(child))
    if note:
        with contextlib.suppress(OutputError):  # without a note the trial is run again next time
            write_bytes(note, version.encode())
    return LLVM(path, version, True)


def _reason(child: subprocess.CompletedProcess[str]) -> str:
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    telling = [line for line in lines if line.startswith(("LLVM ERROR", "jit_find_library", "jit_llvm_init"))]
    words = (telling or lines[-1:] or ["no message"])[0][:200]
    return f"the trial process died: {words}" if child.returncode < 0 else words


def _note(path: str) -> Path | None:
    """The file that records a successful test; its name depends on library, Dr.Jit and machine.

    None if the library is not a known file, or the user has no home.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if not os.path.isfile(path) or not folder.is_absolute():
        return None
    real, stat = os.path.realpath(path), os.stat(path)
    facts = real, stat.st_mtime_ns, stat.st_size, importlib.metadata.version("drjit"), platform.node()
    return folder / "mitsvbrdf" / f"llvm-{hashlib.sha256(repr(facts).encode()).hexdigest()[:32]}"


def _loaded() -> LLVM:
    """The libLLVM of a Dr.Jit that is already loaded; it is too late to choose another one."""
    import drjit

    version, path = drjit.detail.llvm_version(), os.environ.get(VARIABLE, "")
    if version[0] >= OLDEST or version[0] > 0 and prove(path).proved:
        return LLVM(path, ".".join(map(str, version)), True)
    raise BackendError("Dr.Jit with a libLLVM that works", "drjit imported earlier, without",
                       f"call mitsvbrdf before importing drjit or mitsuba, or set {VARIABLE}; "
                       f"where no LLVM of version {OLDEST} or newer is installed: {install_hint()}")


def install_hint() -> str:
    """The line to type on this machine to install a libLLVM that works."""
    if not os.environ.get("CONDA_PREFIX"):
        if sys.platform in ("darwin", "win32"):
            return "brew install llvm" if sys.platform == "darwin" else "winget install LLVM.LLVM"
        if shutil.which("apt-get"):
            return f"sudo apt-get update && sudo apt-get install -y libllvm{OLDEST}"
        if shutil.which("dnf"):
            return "sudo dnf install -y llvm-libs"
    return f"conda install -c conda-forge libllvm{OLDEST}"


def set_variant(mi: ModuleType, variant: str) -> None:
    """Set Mitsuba's variant. Its Python integrators are loaded only the first time (150 ms).

    Later switches to it keep the loaded integrators, e.g. those of the surrounding program's variant.
    """
    with PROCESS:
        integrators = vars(sys.modules.get(INTEGRATORS, ModuleType(INTEGRATORS)))
        known = variant in _registered and integrators.pop(FIRST, None)  # without it: no reload
        try:
            mi.set_variant(variant)
        finally:
            if known:
                integrators.setdefault(FIRST, known)
        _registered.add(variant)


def mitsuba_module(variant: str = "llvm_ad_rgb") -> ModuleType:
    """The ``mitsuba`` module with this variant set; ``using_mitsuba`` also restores the earlier variant.
    BackendError: Mitsuba, the variant, a GPU or libLLVM is missing.
    """
    cuda = variant.startswith("cuda")
    with PROCESS:  # the first import is not thread-safe
        try:
            use_llvm()
        except BackendError:  # CUDA needs none, but the process may want LLVM later
            if not cuda:
                raise
        try:
            import mitsuba as mi
        except ImportError as reason:
            raise BackendError("Mitsuba 3", f"{reason}", "pip install mitsuba") from None
        fitting = [name for name in mi.variants() if name.endswith("_ad_rgb")]
        if variant not in fitting:
            raise BackendError(f"a Mitsuba variant of {fitting}", repr(variant), "choose one of these")
        if mi.variant() != variant:
            try:
                set_variant(mi, variant)
            except (ImportError, RuntimeError) as reason:
                fix = "use llvm_ad_rgb, which needs no GPU" if cuda else f"install libLLVM: {install_hint()}"
                raise BackendError(f"{variant} to work here", str(reason), fix) from None
        return mi


if __name__ == "__main__":
    try:
        print(use_llvm().path)
    except BackendError as error:
        raise SystemExit(str(error)) from None
