"""What is asked for of one capture: how it is fitted, and the identity of the result."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..capture.photo import SUFFIXES
from ..fit.config import FitConfig, HierarchicalConfig
from ..fit.fixed_maps import named_files
from ..fit.methods import METHODS, method_name
from ..fit.options import FitOptions, config_record
from ..io.files import file_hash
from ..io.json import load
from .captures import Entry, is_calibrated
from .stores import Store, is_url

CALIBRATION_FILES = ("capture.json", "camera_pos.txt", "image_size.txt", "light_power.txt", "light_pos.txt")
TYPICAL_SECONDS = 35.0  # of the default fit: nine photos, 256 px, one thread
PHOTOS = 9  # of a capture whose files are not at hand
ENDLESS = 3600.0  # seconds, of a fit that ends after iterations
# A limit must not end a fit that goes on, on a machine ten times slower than where these were measured, and
# on one thread.
SLOWEST = 10.0
# seconds beside the budget: reading and writing; a capture of raw photos; 80 steps of the finish
BESIDE, RAW, FINISH = 18.0, 60.0, 60.0
BUDGETS = 3.0  # a fit looks at the clock between steps, and the last of them may be long


@dataclass(frozen=True)
class Asked:
    """A capture, and how it is fitted.

    Args:
        entry: the capture.
        config: method and settings.
        options: the others.
        pages: whether its page and pictures are written.
        tags: words to find it by.
        sheet: size in cm of the printed sheet in raw photos; None where there is none.
        strict: whether damaged photos are refused.
    """

    entry: Entry
    config: FitConfig
    options: FitOptions
    pages: bool
    tags: tuple[str, ...]
    sheet: float | None = None
    strict: bool = False

    def settled(self) -> Asked:
        """Itself without options that change nothing: nobody looks for a sheet in a calibrated capture."""
        if self.sheet is not None and is_calibrated(self.entry.source):
            return replace(self, sheet=None)
        return self

    @property
    def record(self) -> dict:
        """What a worker is told, and what the identity is made of."""
        return {"config": config_record(self.config), "options": asdict(self.options), "pages": self.pages,
                "sheet": self.sheet, **({"strict": True} if self.strict else {})}

    @property
    def identity(self) -> str:
        """SHA-256, in hex, of photos, calibration, options, files that options name, and version.

        Raises:
            OSError: a file cannot be read.
        """
        source, files = self.entry.source, named_files(self.config.fix)
        files += filter(None, [getattr(self.config, "pretrained", None)])
        if is_url(source):
            contents: list[list] = Store(source).contents()
        else:
            files_of = capture_files(Path(source))
            contents = [[os.path.relpath(path, source), file_hash(path)] for path in files_of]
        named = [[name, file_hash(Path(name))] for name in files if os.path.isfile(name)]
        return _hash([__version__, self.record, contents, named])

    @property
    def identity_of_unreadable(self) -> str:
        """A hash of address and options, in the place of the identity where photos cannot be read."""
        return _hash([__version__, self.record, self.entry.source, "unreadable"])

    @property
    def words(self) -> str:
        """The options that are not the defaults, as they are typed; without tags."""
        method, kind = method_name(self.config), type(self.config)
        preset: Any = getattr(self.config, "preset", None)
        usual: Any = kind(preset=preset) if preset else kind()  # type: ignore[call-arg]
        found = ["--method", method] * (method != next(iter(METHODS)))
        found += ["--preset", preset] * (preset != getattr(kind(), "preset", None))
        found += [*_changed(self.config, usual), *_changed(self.options, FitOptions())]
        found += ["--pages", "none"] * (not self.pages) + ["--strict"] * self.strict
        return shlex.join([*found, *([] if self.sheet is None else ["--sheet", _typed(self.sheet)])])

    @property
    def cost(self) -> float:
        """A guess of its seconds, to begin with the largest."""
        limit = self.config.limited()
        if not isinstance(self.config, HierarchicalConfig):
            return limit.budget or ENDLESS
        typical = TYPICAL_SECONDS * self._photos / PHOTOS * (self.options.resolution / 256) ** 2
        return min(limit.budget or ENDLESS, typical)

    @property
    def limit(self) -> float | None:
        """Seconds after which it counts as hanging; None for a fit that ends after iterations."""
        budget, more = self.config.limited().budget, max(1.0, self._photos / PHOTOS)
        if budget is None:
            return None
        steps = self.options.detail_steps / 80 if self.options.detail != "none" else 0.0
        texels = max(1.0, (self.options.resolution / 256) ** 2)
        raw = RAW * (is_url(self.entry.source) or not is_calibrated(self.entry.source))
        return SLOWEST * (BESIDE * texels * more + raw * more + FINISH * texels * steps) + BUDGETS * budget

    @property
    def _photos(self) -> int:
        if is_url(self.entry.source):
            return PHOTOS
        return sum(path.suffix.lower() in SUFFIXES for path in capture_files(Path(self.entry.source)))


def capture_files(source: Path) -> list[Path]:
    """The files that a capture is read from: calibration and photos, by name."""
    folder = source.parent if source.is_file() else source
    folders = {folder}
    stated = source if source.is_file() else folder / "capture.json"
    try:
        folders.add(folder / load(stated)["target_dir"])
    except (OSError, ValueError, KeyError, TypeError):
        pass  # no such file, or a wrong one, which the fit will say
    inside = [path for each in folders if each.is_dir() for path in each.iterdir() if path.is_file()
              and path.name[0] != "."]
    return sorted({path for path in inside if path == source or path.name in CALIBRATION_FILES
                   or path.suffix.lower() in SUFFIXES})


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _changed(settings: Any, usual: Any) -> Iterator[str]:
    """The settings that are not the usual ones, as options and values."""
    for field in fields(settings):
        value, option = getattr(settings, field.name), field.name.replace("_", "-")
        if value == getattr(usual, field.name):
            continue
        if isinstance(value, bool):
            yield f"--{'' if value else 'no-'}{option}"
        else:
            for each in value if isinstance(value, tuple) else (value,):
                yield from (f"--{option}", _typed(each))


def _typed(value: object) -> str:
    return str(value).removesuffix(".0") if isinstance(value, float) else str(value)
