"""What is measured with it and without it: from what was asked for to the list of its jobs, the same in every
process.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import ConfigError
from ...render import make_renderer
from ..plan import data_folder
from .fits import PairJob, pair_jobs
from .parts import Part, parts
from .renders import Case, render_cases
from .scenes import scenes

# What shapes these records, beside what shapes those of the benchmark.
SHAPING = tuple(f"bench/leave_out/{name}.py" for name in ("fits", "parts", "renders", "scenes"))
RENDERER, VARIANT = "mitsuba", "llvm_ad_rgb"


@dataclass(frozen=True)
class LeaveOutPlan:
    """What was asked for; plain values, so that another process can be told.

    Args:
        fits: whether parts of fits are measured too.
        resolution: of the renders.
        repeats: turns of each of their pairs.
        fit_resolution: of the fits.
        fit_repeats: turns of each of their pairs.
        parts: names of parts to measure; None is all.
        captures: folders of real photos.
    """

    fits: bool = False
    resolution: int = 256
    repeats: int = 9
    fit_resolution: int = 64
    fit_repeats: int = 3
    parts: Sequence[str] | None = None
    captures: Sequence[str] = ()

    def settings(self) -> dict:
        """What all records share.

        Raises:
            ConfigError: a number that is out of range.
        """
        if min(self.resolution, self.fit_resolution) < 8 or min(self.repeats, self.fit_repeats) < 1:
            raise ConfigError("resolutions of 8 or more and repeats of 1 or more",
                              f"{self.resolution}, {self.fit_resolution} and {self.repeats}, "
                              f"{self.fit_repeats}",
                              "try 64 and 3")
        return {"resolution": self.fit_resolution, "renderer": RENDERER, "variant": VARIANT,
                "repeats": self.fit_repeats,
                "renders_resolution": self.resolution, "renders_repeats": self.repeats}

    def renders(self) -> list[Case]:
        """What a scene may do without; these run one at a time, for they are short."""
        return render_cases(self.resolution, self.repeats)

    def jobs(self) -> tuple[list[PairJob], dict, dict]:
        """The pairs of fits, what all records share, and nothing published.

        Raises:
            ConfigError: something that was asked for does not exist or is out of range.
        """
        shared, listed = self.settings(), self._parts()
        engine = make_renderer(RENDERER, VARIANT)
        chosen = (scenes(self.fit_resolution, engine, [Path(folder) for folder in self.captures])
                  if self.fits else [])
        return pair_jobs(listed, chosen, self.fit_repeats, engine), shared, {}

    def _parts(self) -> list[Part]:
        known = parts()
        names = [part.what for part in known]
        unknown = [name for name in self.parts or () if name not in names]
        if unknown:
            raise ConfigError(f"parts of {list(dict.fromkeys(names))}", unknown[0], "check --parts")
        return [part for part in known if self.parts is None or part.what in self.parts]


def capture_folders(names: str | None, data: Path | None) -> list[str]:
    """Folders of real captures.

    Args:
        names: separated by commas; None for none.
        data: the folder with ``captures/``; None for the one that MITSVBRDF_DATA names, if any.

    Raises:
        ConfigError: one is not there.
    """
    asked = [name.strip() for name in (names or "").split(",") if name.strip()]
    root = data_folder(data) if asked else None
    inside = ({path.name: str(path) for path in sorted((root / "captures").glob("*")) if path.is_dir()}
              if root else {})
    missing = [name for name in asked if name not in inside]
    if missing:
        raise ConfigError("captures that are there", f"none called {missing[0]}",
                          "check --captures, --data and MITSVBRDF_DATA")
    return [inside[name] for name in asked]
