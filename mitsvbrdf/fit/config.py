"""Settings of the fits: frozen dataclasses. Each default is stated once, in its dataclass.

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

# A setting that is on or off. --help shows the option that changes it: --no-NAME if the default is on.
Switch = Annotated[bool, arg(
    help_behavior_hint=lambda on: "This turns it off. (default: on)" if on == "True" else "(default: off)")]


def check_seed(seed: int) -> None:
    """Raise ConfigError for a seed outside 0 to 2^32 - 1."""
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

LARGE = 1024  # texels a side; larger maps get more seconds by default


@dataclass(frozen=True)
class FitConfig:
    """The settings that all methods share."""

    default_budget: ClassVar[float] = 120.0  # seconds

    bsdf: Bsdf = "roughconductor"
    """Which maps to recover: roughconductor (diffuse, specular) or principled (base colour, metallic)."""
    guess: GuessMethod = "robust"
    """How the guessed diffuse map is made: robust (ours), min (the paper's), mean-blur (Zhao 2020)."""
    budget: float | None = None
    """Time limit in seconds. Default: 120 (direct 60, gan 300, paper's presets none), more above 1024 px."""
    iterations: int | None = None
    """Stop after this many iterations (with --budget: whichever comes first)."""
    seed: int = 0
    """Seed of every random choice."""
    fix: tuple[str, ...] = ()
    """Hold a map fixed: NAME=VALUE (a number, r,g,b, an image file, or normal=flat). May be repeated."""
    grey_specular: Switch = False
    """Fit one grey specular value per texel instead of three channels."""

    @property
    def files(self) -> list[str]:
        """The files named in the settings."""
        return named_files(self.fix)

    def check(self) -> None:
        """Raise ConfigError for wrong types, numbers out of range, unknown choices, and conflicts."""
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
        """These settings. If no limit is given, with the method's default, which is longer for large maps."""
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
        """Whether the views stay those of the capture, stated or default (--no-calibrate)."""
        return getattr(self, "calibrate", None) is False

    @property
    def refines_views(self) -> bool | None:
        """Whether each view is refined; None: yes, except stated views of photos that follow the model."""
        return getattr(self, "calibrate", False)

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted; None: the method has no such unknown."""
        return getattr(self, "flash_offset", None)


@dataclass(frozen=True)
class HierarchicalConfig(FitConfig):
    """The default method: each texel is solved by itself; texels that look alike share their lobe."""

    materials: int = 64
    """Number of basis materials. Texels share specular and roughness within a basis material."""
    similarity: float = 0.02
    """Texels belong to basis materials of similar appearance: Gaussian weights of this standard deviation."""
    spread: float = 0.03
    """Largest prior standard deviation of a texel from its basis materials at 64 px. Real photos only."""
    relief: float = 0.02
    """Prior standard deviation of the normals' slopes at 64 px. Real photos only."""
    detail_spread: float = 0.06
    """Scale of prior deviations of full-size texels from 64 px values. 0: only diffuse moves. Real photos."""
    highlight_reach: float = 2.0
    """Lobe widths from a highlight at which a pixel has half weight. 0: equal weights. Real photos only."""
    remove_burn_in: Switch = True
    """In specular and roughness, remove patterns that follow the highlights. Real photos only."""
    noise: float | None = None
    """Noise of real photos in display values. A higher value keeps less detail. Default: cross-validation."""
    neighbours: Switch = True
    """Also start from values of neighbouring texels, tilted normals and, for exact photos, other lobes."""
    exact: bool | None = None
    """--exact: photos follow the model. --no-exact: real photos. Default: errors of a first fit decide."""
    multi_start: Switch = True
    """For exact photos, start from many roughnesses, and find lobes that texels share."""
    stationary: bool | None = None
    """The only photo shows a material that repeats itself (or --no-stationary). Default: a test decides."""
    calibrate: bool | None = None
    """Refine each camera and flash (or --no-calibrate). Default: yes, except stated views of exact photos."""
    flash_offset: Switch = True
    """Fit one sideways distance between lens and flash for all photos."""


@dataclass(frozen=True)
class HybridConfig(FitConfig):
    """A generator that sees all photos. It is trained through the renderer to reproduce them."""

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
    """Fit one sideways distance between lens and flash for all photos."""


@dataclass(frozen=True)
class DirectConfig(FitConfig):
    """The baseline: each texel is optimised on its own, from a robust start."""

    default_budget: ClassVar[float] = 60.0

    learning_rate: float = 0.05
    """Adam's step size at the start, in logits; it falls to 2 % along a cosine."""
    photometric: float = 1.0
    """Weight of the re-rendering error over all photos (|e| + 5 e^2 in display values)."""
    smooth: float = 0.01
    """Weight of the total variation of the specular and roughness maps."""
    flat: float = 0.02
    """Weight of the tilt of the normals."""
