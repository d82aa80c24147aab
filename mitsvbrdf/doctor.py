"""What is installed here, whether it suffices for fits through Mitsuba, and how to get what is missing.

An unsuitable libLLVM would abort the process, so each is tried in a child process before Mitsuba is loaded.
"""

import importlib
import math
import os
import platform
import sys
from dataclasses import asdict, dataclass
from json import dumps

from .errors import BackendError
from .io.provenance import memory_gib, usable_cores, version_of

PACKAGES = {"torch": "torch", "numpy": "numpy", "opencv": "cv2", "OpenEXR": "OpenEXR",
            "safetensors": "safetensors", "scipy": "scipy", "matplotlib": "matplotlib", "jinja2": "jinja2",
            "pillow": "PIL", "simplejpeg": "simplejpeg", "imagecodecs": "imagecodecs", "filelock": "filelock",
            "msgspec": "msgspec", "pandas": "pandas", "tyro": "tyro", "rich": "rich"}
# extra -> the module that it installs
EXTRAS = {"flip": "flip_evaluator", "movie": "av", "heic": "pillow_heif", "raw": "rawpy", "batch": "ray",
          "s3": "s3fs"}
DISTRIBUTIONS = {"cv2": "opencv-contrib-python-headless", "PIL": "pillow", "flip_evaluator": "flip-evaluator",
                 "pillow_heif": "pillow-heif"}


@dataclass(frozen=True)
class Row:
    """One finding."""

    name: str  # what was looked at
    value: str  # what was found
    ok: bool | None = None  # whether it suffices; None for plain information
    fix: str = ""  # what to do, if possible as a line to type


def diagnose(variant: str = "llvm_ad_rgb") -> list[Row]:
    """All findings, from the interpreter up to a Mitsuba variant that renders."""
    python = f"{platform.python_version()} ({sys.executable})"
    fresh = sys.version_info >= (3, 11)
    rows = [Row("Python", python, fresh, "" if fresh else "install Python 3.11 or newer"),
            Row("mitsvbrdf", version_of("mitsvbrdf") or "not installed, run from its folder"),
            *(_package(name, module) for name, module in PACKAGES.items()),
            *(_extra(name, module) for name, module in EXTRAS.items()), *_mitsuba(variant)]
    torch, (total, free) = sys.modules.get("torch"), memory_gib()
    memory = f"{total:.1f} GiB, {free:.1f} GiB available" if math.isfinite(total) else "unknown"
    own = f", torch uses {torch.get_num_threads()}" if torch else ""
    return [*rows, Row("threads", f"{os.cpu_count()} CPUs, {usable_cores()} usable{own}"),
            Row("memory", memory)]


def doctor(json: bool = False, variant: str = "llvm_ad_rgb") -> int:
    """Print the findings, as text or as JSON; 0 when fits through Mitsuba can run here, else 1."""
    rows = diagnose(variant)
    well = all(row.ok is not False for row in rows)
    if json:
        print(dumps({"ok": well, "rows": [asdict(row) for row in rows]}, indent=1))
        return 0 if well else 1
    # plain text works without rich, and pastes well into a bug report
    for row in rows:
        print(f"{ {True: 'ok', False: 'NO', None: ''}[row.ok]:3}{row.name:22}{row.value}")
        if row.fix:
            print(f"{'':25}-> {row.fix}")
    print("Ready for fits through Mitsuba." if well else
          "Not ready for fits through Mitsuba: see the lines with NO.")
    return 0 if well else 1


def _package(name: str, module: str) -> Row:
    distribution = DISTRIBUTIONS.get(module, module)
    try:
        found = importlib.import_module(module)
    except Exception as reason:  # a broken binary raises OSError and others; all mean that it cannot be used
        return Row(name, f"cannot be imported: {reason}", False, f"pip install {distribution}")
    return Row(name, version_of(distribution) or str(getattr(found, "__version__", "version unknown")), True)


def _extra(name: str, module: str) -> Row:
    """A package that only some files or figures need; without it all else works."""
    distribution = DISTRIBUTIONS.get(module, module)
    found = _package(f"{name}: {distribution}", module)
    value = found.value if version_of(distribution) else "not installed"
    return found if found.ok else Row(found.name, value, None, f'pip install "mitsvbrdf[{name}]"')


def _mitsuba(variant: str) -> list[Row]:
    """Rows of Mitsuba, Dr.Jit, each libLLVM and the variant. An LLVM variant needs a libLLVM that works."""
    versions = {name: version_of(name) for name in ("mitsuba", "drjit")}
    rows = [Row(name, version, True) if version else Row(name, "not installed", False, "pip install mitsuba")
            for name, version in versions.items()]
    try:
        from .render import llvm
        from .render.exclusive import using_mitsuba
    except ImportError as reason:
        return [*rows, Row(variant, f"not tried: {reason}", False)]
    rows += [Row("libLLVM",
                 f"{found.version or '?'} {found.path}: {found.message or 'proved in a child process'}",
                 found.proved or None) for found in (llvm.examine() if versions["drjit"] else ())]
    try:
        with using_mitsuba(variant) as mi:
            import drjit as dr
            works = f"{float(mi.Float(1)[0] + 1):.0f} = 1 + 1, Dr.Jit threads: {dr.thread_count()}"
            return [*rows, Row(variant, works, True),
                    Row("CUDA for cuda_ad_rgb", "yes" if dr.has_backend(dr.JitBackend.CUDA) else "no")]
    except BackendError as reason:
        return [*rows, Row(variant, f"not available: {reason.got}", False, reason.fix)]
