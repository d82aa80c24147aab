"""The benchmark's file: written anew after every record, so that a run can stop anywhere and go on later."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import ConfigError
from ..system import files
from ..system.interrupts import undisturbed
from ..system.json_files import load
from ..system.provenance import machine, versions
from .published import Published
from .schema import SCHEMA_VERSION, Benchmark, check_benchmark, identity

PACKAGE = Path(__file__).parents[1]
# The code that shapes a record: all else may change between two runs that add to one file.
SHAPING = ("capture/**/*.py", "calibrate/*.py", "fit/**/*.py", "material/*.py", "measure/*.py", "render/*.py", "synth/*.py",
           "evaluate/*.py", "system/layout.py", "color.py", "views.py",
           "bench/paper/references.py", "bench/paper/schedule.py", "bench/paper/steps.py", "bench/peers_baseline.py",
           "bench/tasks.py", "bench/renderers.py", "bench/from_phone.py")


class Store:
    """The records of one file.

    Args:
        path: the JSON file; one that is there is gone on with.
        settings: what all its records share.
        overwrite: start anew.

    Raises:
        ConfigError: the file is no benchmark, or one of other settings, versions or machine.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any], overwrite: bool = False) -> None:
        self.path = Path(path)
        here: Benchmark = {
            "schema_version": SCHEMA_VERSION, "settings": {**settings, "code": code()}, "machine": this_machine(),
            "versions": versions() | {"mitsvbrdf": __version__}, "seeds": [], "published": {}, "records": []}
        self.content = here
        if self.path.is_file() and not overwrite:
            self.content = read_benchmark(self.path)
            self._same(here)

    def _same(self, here: Benchmark) -> None:
        for part in ("settings", "machine", "versions"):
            earlier, now = self.content[part], here[part]  # type: ignore[literal-required]
            for name in sorted({*earlier, *now}):
                if earlier.get(name) != now.get(name):
                    raise ConfigError(f"{name} {earlier.get(name)!r}, as in {self.path}", repr(now.get(name)),
                                      "--overwrite starts anew, another --json keeps both")

    @property
    def records(self) -> list[dict]:
        """All records."""
        return self.content["records"]  # type: ignore[return-value]

    def pending(self, jobs: list) -> list:
        """The jobs without a record. Records of a method or case whose settings have changed go with it."""
        wanted = {(*_whole(job.key),): job.settings for job in jobs}
        kept = [r for r in self.records if wanted.get((*_whole(r),), r["config"]) == r["config"]]
        self.content["records"] = kept  # type: ignore[typeddict-item]
        done = set(map(identity, kept))
        return [job for job in jobs if identity(job.key) not in done]

    def add(self, record: dict) -> None:
        """Keep one record, and write the file."""
        self.records.append(record)
        self.content["seeds"] = sorted({r["seed"] for r in self.records if "seed" in r})
        self.write()

    def publish(self, found: Published) -> None:
        """Add published numbers to those that are there."""
        for kind, each in found.items():
            self.content["published"].setdefault(kind, {}).update(each)

    def write(self) -> None:
        """The file as it is now: beside it first, then renamed."""
        with undisturbed():
            files.write_json(self.path, self.content)


def read_benchmark(path: Path) -> Benchmark:
    """A benchmark's file, checked.

    Raises:
        ConfigError: no such file, or another content.
    """
    try:
        return check_benchmark(load(Path(path)), str(path))
    except OSError as reason:
        raise ConfigError("a benchmark's JSON", f"{path}: {reason.strerror}", "check --json") from None
    except ValueError as reason:
        raise ConfigError("a benchmark's JSON", f"{path}: {reason}", "choose another, or --overwrite to start anew") from None


def _whole(key: Mapping[str, Any]) -> tuple:
    """The method, or the case, that a record belongs to."""
    return (key["suite"], key["method"]) if "method" in key else identity(dict(key))


def code() -> str:
    """Twelve digits that change with the code that makes the records."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in SHAPING for path in PACKAGE.glob(pattern)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def this_machine() -> dict[str, Any]:
    """:func:`mitsvbrdf.system.provenance.machine` with the processor's name and the GiB of memory, where Linux tells them."""
    model, memory = None, None
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)
        memory = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
    except (OSError, ValueError):
        pass
    return machine() | {"model": model, "memory_gib": memory}
