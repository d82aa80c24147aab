"""Settings of the fits: frozen dataclasses, the only home of each default.

The docstring of a field is its ``--help``: one line, since shells complete options line by line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from tyro.conf import arg

from ..capture.guess import GuessMethod
from ..errors import LARGEST, ConfigError
from ..kinds import check_fields
from ..material.maps import Bsdf
from ..views import Falloff
from . import losses
from .fixed_maps import named_files, stated_maps

POSITIVE = ("budget", "iterations", "width", "learning_rate", "normal_roughness_steps", "materials",
            "similarity", "spread", "relief", "noise", "pictures", "discriminator_rate")
MOST = {"width": 4096, "materials": 65536, "pictures": 1024}  # largest values of settings that take memory

# A setting that is on or off. Help names the option that changes it; where the default is on, that option
# begins with --no-.
Switch = Annotated[bool, arg(
    help_behavior_hint=lambda on: "This turns it off. (default: on)" if on == "True" else "(default: off)")]


def check_seed(seed: int) -> None:
    """Raise ConfigError for a seed that torch would not take."""
    if not 0 <= seed < 2**32:
        raise ConfigError("a seed from 0 to 4294967295", str(seed), "choose a smaller one")


def check_numbers(config: Any, positive: Sequence[str]) -> None:
    """Raise ConfigError for a number out of range; the settings named in ``positive`` may not be 0."""
    check_seed(config.seed)
    for name, value in vars(config).items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or name == "seed":
            continue
        least, most = "> 0" if name in positive else ">= 0", MOST.get(name, LARGEST)
        if not (value > 0 or value == 0 and name not in positive) or value > most:
            raise ConfigError(f"{name} {least} and <= {most:g}", str(value), "give such a number")

LARGE = 1024  # texels a side up to which the default seconds suffice


@dataclass(frozen=True)
class FitConfig:
    """What all methods share."""

    default_budget: ClassVar[float] = 120.0  # seconds

    bsdf: Bsdf = "roughconductor"
    """Which maps to recover: roughconductor (diffuse, specular) or principled (base colour, metallic)."""
    guess: GuessMethod = "robust"
    """How the guessed diffuse map is made: robust (ours), min (the paper's), mean-blur (Zhao 2020)."""
    budget: float | None = None
    """Stop after so many seconds. Default: 120 (direct 60, gan 300 or its preset's), more above 1024 px."""
    iterations: int | None = None
    """Stop after this many iterations (with --budget: whichever comes first)."""
    seed: int = 0
    """Seed of every random choice."""
    fix: tuple[str, ...] = ()
    """Hold a map fixed: NAME=VALUE (a number, r,g,b, an image file, or normal=flat). May be repeated."""
    grey_specular: Switch = False
    """One grey specular level a texel instead of three channels."""

    @property
    def files(self) -> list[str]:
        """The files that the settings name."""
        return named_files(self.fix)

    def check(self) -> None:
        """Raise ConfigError for wrong types, numbers out of range, and words that are no choice."""
        check_fields(self)
        for name, kind in get_type_hints(type(self)).items():
            if get_origin(kind) is Literal and getattr(self, name) not in get_args(kind):
                raise ConfigError(f"{name} of {get_args(kind)}", repr(getattr(self, name)),
                                  "choose one of these")
        stated_maps(self.fix, self.bsdf, self.grey_specular)
        if self.weights.get("photometric", 1.0) == 0 and self.weights.get("adversarial", 0.0) == 0:
            raise ConfigError("a fit that looks at the photos", "--photometric 0 and no adversarial weight",
                              "give one of them a weight > 0")
        check_numbers(self, POSITIVE)

    def limited(self, resolution: int) -> FitConfig:
        """These settings, with the method's default limit where none was given; large maps get longer."""
        if self.budget is not None or self.iterations is not None:
            return self
        limit = self.default_limit
        if "budget" in limit:
            limit = {"budget": limit["budget"] * max(1.0, resolution / LARGE)}
        return replace(self, **limit)

    @property
    def falloff(self) -> Falloff:
        """The light falloff that the method assumes."""
        return "inverse-square"

    @property
    def default_limit(self) -> dict:
        """The limit used when neither seconds nor iterations are given."""
        return {"budget": self.default_budget}

    @property
    def weights(self) -> dict[str, float]:
        """The weight of each loss that the method has."""
        own = {field.name for field in fields(self)}
        return {name: getattr(self, name) for name in losses.NAMES if name in own}

    @property
    def holds_views(self) -> bool:
        """Whether the user asks to keep the views as the capture has them, stated or not."""
        return getattr(self, "calibrate", None) is False

    @property
    def refines_views(self) -> bool | None:
        """Whether each view is refined; None: stated views only if the photos do not follow the model."""
        return getattr(self, "calibrate", False)

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted; None where the method has no such unknown."""
        return getattr(self, "flash_offset", None)


@dataclass(frozen=True)
class HierarchicalConfig(FitConfig):
    """The default method: each texel is solved by itself; texels that look alike share their lobe."""

    materials: int = 64
    """Number of basis materials. Texels share specular and roughness within a basis material."""
    similarity: float = 0.02
    """How alike texels must look to share: a standard deviation of their appearance."""
    spread: float = 0.03
    """Largest standard deviation of a texel from its look-alikes at 64 px. Real photos only."""
    relief: float = 0.02
    """Standard deviation of the slopes of normals at 64 px. Real photos only."""
    detail_spread: float = 0.06
    """Standard deviation of full-size texels from their 64 px values. 0 frees only diffuse. Real photos."""
    highlight_reach: float = 2.0
    """Lobe widths from a highlight at which pixels begin to count less. 0: all count alike. Real photos."""
    remove_burn_in: Switch = True
    """Removal of patterns that follow the highlights from specular and roughness. Real photos only."""
    noise: float | None = None
    """Noise of real photos in display values. A higher value keeps less detail. Default: cross-validation."""
    neighbours: Switch = True
    """Other starts: values of neighbouring texels, tilted normals and, of exact photos, other lobes."""
    exact: bool | None = None
    """Photos follow the model (--exact) or not (--no-exact). Default: the errors of a first fit decide."""
    multi_start: Switch = True
    """Many roughnesses as starts for exact photos, and lobes that texels share."""
    stationary: bool | None = None
    """One photo shows a material that repeats itself (or --no-stationary). Default: a test decides."""
    calibrate: bool | None = None
    """Refine camera and flash of each photo (--calibrate or --no-calibrate). Default: photos decide."""
    flash_offset: Switch = True
    """One sideways distance between lens and flash, fitted for all photos."""


@dataclass(frozen=True)
class HybridConfig(FitConfig):
    """A generator that sees all photos, trained through the renderer against all of them."""

    width: int = 16
    """Channels of the generator's finest level."""
    learning_rate: float = 5e-3
    """Adam's step size at the start; it falls to 2 % along a cosine."""
    photometric: float = 1.0
    """Weight of the re-rendering error over all photos (|e| + 5 e^2 in display values)."""
    diffuse: float = 0.05
    """Weight of the distance of the diffuse map to the guess (the paper's diffuse loss)."""
    adversarial: float = 0.002
    """Weight of the adversarial loss. 0 omits the discriminator."""
    smooth: float = 0.01
    """Weight of the total variation of the specular and roughness maps."""
    flat: float = 0.02
    """Weight of the tilt of the normals."""
    flash_offset: Switch = True
    """One sideways distance between lens and flash, fitted for all photos."""


@dataclass(frozen=True)
class DirectConfig(FitConfig):
    """The baseline: every texel on its own, from a robust start."""

    default_budget: ClassVar[float] = 60.0

    learning_rate: float = 0.05
    """Adam's step size at the start, in logits; it falls to 2 % along a cosine."""
    photometric: float = 1.0
    """Weight of the re-rendering error over all photos (|e| + 5 e^2 in display values)."""
    smooth: float = 0.01
    """Weight of the total variation of the specular and roughness maps."""
    flat: float = 0.02
    """Weight of the tilt of the normals."""
