"""The benchmark's file: brought up to date with every record, so that a run can stop anywhere and go on
later.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import ConfigError
from ..io import files
from ..io.interrupts import stop_signals
from ..io.json_files import load
from ..io.provenance import machine, versions
from ..io.shared_file import held
from .behaviour import ended_for_good
from .code import shared_code
from .earlier import upgraded
from .published import Published
from .records import Benchmark
from .schema import SCHEMA_VERSION, check_benchmark, identity

EXACT = "config", "budget"  # of a record, what is compared with what is asked for
UNSHAPING = "mitsvbrdf"  # of the versions the one that says nothing: the code's own digits do


class Store:
    """The records of one file, which several runs may add to at the same time.

    Args:
        path: the JSON file; one that is there is gone on with.
        settings: what all its records share.
        anew: forget what is in the file, once.
        shaping: what further code shapes its records, as :data:`mitsvbrdf.bench.code.SHARED` has it.

    Raises:
        ConfigError: the file is no benchmark, or one of other settings, versions or machine.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any], anew: bool = False,
                 shaping: tuple[str, ...] = ()) -> None:
        self.path, self.anew = Path(path), anew
        used = versions() | {"mitsvbrdf": __version__, "flip-evaluator": _flip_version()}
        self.content: Benchmark = {
            "schema_version": SCHEMA_VERSION, "settings": {**settings, "code": shared_code(shaping)},
            "machine": this_machine(),
            "versions": used, "seeds": [], "published": {}, "records": []}
        self.found: Published = {}
        # records of earlier settings or code, which go when the first new one comes
        self.outdated: list[dict] = []
        self._read()

    def _read(self) -> None:
        """Take over what the file has now; it must be of the same settings."""
        if self.anew or not self.path.is_file() or not self.path.stat().st_size:
            return
        there = read_benchmark(self.path)
        for part in ("settings", "machine", "versions"):
            earlier, now = there[part], self.content[part]  # type: ignore[literal-required]
            for name in sorted({*earlier, *now}):
                if earlier.get(name) != now.get(name) and name != UNSHAPING:
                    raise ConfigError(f"{name} {earlier.get(name)!r}, as in {self.path}", repr(now.get(name)),
                                      "--anew forgets it, another --json keeps both")
        self.content = there

    @property
    def records(self) -> list[dict]:
        """All records."""
        return self.content["records"]  # type: ignore[return-value]

    def pending(self, jobs: list) -> list:
        """The jobs without a record that need one. Records of a method or case whose settings have changed go
        with it.
        """
        wanted = {(*_whole(job.key),): job.settings for job in jobs}
        kept = [r for r in self.records if wanted.get((*_whole(r),), r["config"]) == r["config"]]
        self.outdated += [r for r in self.records if r not in kept]
        self.content["records"] = kept  # type: ignore[typeddict-item]
        done = set(map(identity, kept))
        ended = self._ended()
        return [job for job in jobs if identity(job.key) not in done and not _repeats(job.key, ended)]

    def repeats(self, job: Any) -> bool:
        """Whether a fit would repeat one of a shorter budget, which ended by itself."""
        return _repeats(job.key, self._ended())

    def _ended(self) -> dict[tuple, float]:
        """The shortest budget with which a fit ended for good, by what it is a fit of."""
        found: dict[tuple, float] = {}
        for r in self.records:
            if "budget" in r and ended_for_good(r):
                found[_but_budget(r)] = min(r["budget"], found.get(_but_budget(r), math.inf))
        return found

    def add(self, record: dict) -> None:
        """Keep one record, in the file, beside what other runs have put there.

        Raises:
            ConfigError: another run measures the same method or case with other settings.
        """
        as_read = json.loads(json.dumps(record))
        self._update([{name: each if name in EXACT else short(each) for name, each in as_read.items()}])

    def publish(self, found: Published) -> None:
        """Add published numbers to those that are there."""
        self.found = found

    def write(self) -> None:
        """Bring the file up to date, and what is known of it."""
        self._update([])

    def _update(self, new: list[dict]) -> None:
        """Read, add, and replace; Ctrl-C meanwhile is heard afterwards."""
        with stop_signals() as stop:
            with held(self.path):
                self._read()
                there = [r for r in self.records if not (new and r in self.outdated)]
                for record in new:
                    self._check_alike(record, there)
                known = set(map(identity, there))
                self.content["records"] = there + [r for r in new
                                                   if identity(r) not in known]  # type: ignore[typeddict-item]
                self.content["seeds"] = sorted({r["seed"] for r in self.records if "seed" in r})
                for kind, each in self.found.items():
                    self.content["published"].setdefault(kind, {}).update(each)
                files.write_bytes(self.path, text_of(self.content).encode())
                self.anew = False
        if stop:
            raise KeyboardInterrupt

    def _check_alike(self, record: dict, there: list[dict]) -> None:
        if any(_whole(r) == _whole(record) and r["config"] != record["config"] for r in there):
            raise ConfigError("one setting of each method and case in a file",
                              f"{self.path}, to which another run adds {_whole(record)} with other settings",
                              "give one of the two another --json")


def read_benchmark(path: Path) -> Benchmark:
    """A benchmark's file, checked.

    Raises:
        ConfigError: no such file, or another content.
    """
    try:
        return check_benchmark(upgraded(load(Path(path))), str(path))
    except OSError as reason:
        raise ConfigError("a benchmark's JSON", f"{path}: {reason.strerror}", "check --json") from None
    except ValueError as reason:
        raise ConfigError("a benchmark's JSON", f"{path}: {reason}",
                          "choose another, or --anew to forget it") from None


def _whole(key: Mapping[str, Any]) -> tuple:
    """The method, or the case, that a record belongs to."""
    return (key["suite"], key["method"]) if "method" in key else identity(dict(key))


def _but_budget(key: Mapping[str, Any]) -> tuple:
    return identity({**key, "budget": None})


def _repeats(key: Mapping[str, Any], ended: Mapping[tuple, float]) -> bool:
    return "budget" in key and ended.get(_but_budget(key), math.inf) < key["budget"]


def short(value: Any) -> Any:
    """Six digits of every float, in a value that JSON has: more say nothing, and the file stays small."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {name: short(each) for name, each in value.items()}
    return [short(each) for each in value] if isinstance(value, list) else value


def text_of(content: Mapping) -> str:
    """A benchmark as JSON, a line for each record."""
    def line(value: Any) -> str:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))

    head = [f'"{name}":{line(value)}' for name, value in content.items() if name != "records"]
    return ("{" + ",\n".join([*head, '"records":[\n' + ",\n".join(map(line, content["records"])) + "]"])
            + "}\n")


def _flip_version() -> str | None:
    try:
        return importlib.metadata.version("flip-evaluator")
    except importlib.metadata.PackageNotFoundError:
        return None


def this_machine() -> dict[str, Any]:
    """:func:`mitsvbrdf.io.provenance.machine` with the processor's name and the GiB of memory, where
    Linux tells them.
    """
    model, memory = None, None
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
                     None)
        memory = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
    except (OSError, ValueError):
        pass
    return machine() | {"model": model, "memory_gib": memory}
