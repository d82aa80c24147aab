"""What is asked for of one capture: how it is to be fitted."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from ..capture.photo import SUFFIXES
from ..fit.config import FitConfig, HierarchicalConfig
from ..fit.methods import METHODS, method_name
from ..fit.options import FitOptions, config_record
from .entries import Entry
from .identity import capture_files, is_calibrated
from .places.address import is_url

TYPICAL_SECONDS = 35.0  # of the default fit: nine photos, 256 px, one thread
PHOTOS = 9  # of a capture whose files are not at hand
ENDLESS = 3600.0  # seconds, of a fit that ends after iterations
# A limit must not end a fit that goes on, on a machine ten times slower than where these were measured, and
# on one thread.
SLOWEST = 10.0
# seconds beside the budget: reading and writing; a capture of raw photos; 80 steps
BESIDE, RAW, FINISH = 18.0, 60.0, 60.0
BUDGETS = 3.0  # a fit looks at the clock between steps, and the last of them may be long


@dataclass(frozen=True)
class Asked:
    """A capture, and how it is to be fitted.

    Args:
        entry: the capture.
        config: method and settings.
        options: the others.
        pages: whether its page and pictures are written.
        tags: words to find it by.
        sheet: size in cm of the printed sheet in raw photos; None where there is none.
        strict: whether photos that are damaged are refused.
    """

    entry: Entry
    config: FitConfig
    options: FitOptions
    pages: bool
    tags: tuple[str, ...]
    sheet: float | None = None
    strict: bool = False

    @property
    def record(self) -> dict:
        """What a worker is told, and what the identity is made of."""
        return {"config": config_record(self.config), "options": asdict(self.options), "pages": self.pages,
                "sheet": self.sheet, **({"strict": True} if self.strict else {})}

    @property
    def words(self) -> str:
        """The options that are not the defaults, as they are typed; without tags."""
        method, kind = method_name(self.config), type(self.config)
        preset: Any = getattr(self.config, "preset", None)
        usual: Any = kind(preset=preset) if preset else kind()  # type: ignore[call-arg]
        found = ["--method", method] * (method != next(iter(METHODS)))
        found += ["--preset", preset] * (preset != getattr(kind(), "preset", None))
        found += [*_changed(self.config, usual), *_changed(self.options, FitOptions()),
                  *["--pages", "none"] * (not self.pages)]
        found += ["--strict"] * self.strict
        return shlex.join([*found, *([] if self.sheet is None else ["--sheet", _typed(self.sheet)])])

    @property
    def cost(self) -> float:
        """A guess of its seconds, to begin with the largest."""
        limit = self.config.limited()
        if not isinstance(self.config, HierarchicalConfig):
            return limit.budget or ENDLESS
        return min(limit.budget or ENDLESS,
                   TYPICAL_SECONDS * self._photos / PHOTOS * (self.options.resolution / 256) ** 2)

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
