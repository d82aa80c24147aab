"""Settings of the fits: frozen dataclasses, the only home of each default; a field's docstring is its
--help.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar, Literal, get_args, get_origin, get_type_hints

from tyro.conf import arg

from ..capture.guess import GuessMethod
from ..errors import LARGEST, ConfigError
from ..material.maps import Bsdf
from ..views import Falloff
from . import losses
from .fixed_maps import stated_maps

POSITIVE = ("budget", "iterations", "width", "learning_rate", "normal_roughness_steps", "materials",
            "likeness",
            "spread", "relief", "noise", "pictures", "discriminator_rate")
MOST = {"width": 4096, "materials": 65536, "pictures": 1024}  # what takes memory

# A setting that is on or off. Help names the option that changes it, which for one that is on begins with
# --no-.
Switch = Annotated[bool, arg(
    help_behavior_hint=lambda usual: f"(default: {'on' if usual == 'True' else 'off'})")]


def check_seed(seed: int) -> None:
    """Raise ConfigError for a seed that torch would not take."""
    if not 0 <= seed < 2**32:
        raise ConfigError("a seed from 0 to 4294967295", str(seed), "choose a smaller one")


@dataclass(frozen=True)
class FitConfig:
    """What all methods share."""

    default_budget: ClassVar[float] = 120.0  # seconds

    bsdf: Bsdf = "roughconductor"
    """Which maps to recover: roughconductor (diffuse, specular) or principled (base colour, metallic)."""
    guess: GuessMethod = "robust"
    """How the guessed diffuse map is made: robust (ours), min (the paper's), mean-blur (Zhao 2020)."""
    budget: float | None = None
    """Stop after so many seconds. Unset: hierarchical and hybrid 120, direct 60, gan 300 or its preset's
    iterations."""
    iterations: int | None = None
    """Stop after this many iterations (with --budget: whichever comes first)."""
    seed: int = 0
    """Seed of every random choice."""
    fix: tuple[str, ...] = ()
    """Hold a map fixed: NAME=VALUE with a number, r,g,b, an image file, or normal=flat. Repeat it for
    several."""
    grey_specular: Switch = False
    """One grey specular level a texel instead of three channels."""

    def check(self) -> None:
        """Raise ConfigError for numbers out of range, and for words that are no choice."""
        for name, kind in get_type_hints(type(self)).items():
            if get_origin(kind) is Literal and getattr(self, name) not in get_args(kind):
                raise ConfigError(f"{name} of {get_args(kind)}", repr(getattr(self, name)),
                                  "choose one of these")
        check_seed(self.seed)
        stated_maps(self.fix, self.bsdf, self.grey_specular)
        if self.weights.get("photometric", 1.0) == 0 and self.weights.get("adversarial", 0.0) == 0:
            raise ConfigError("a fit that looks at the photos", "--photometric 0 and no adversarial weight",
                              "give one of them a weight > 0")
        for field in fields(self):
            value, name = getattr(self, field.name), field.name
            if isinstance(value, bool) or not isinstance(value, (int, float)) or name == "seed":
                continue
            least = "> 0" if name in POSITIVE else ">= 0"
            if not (value > 0 or value == 0 and name not in POSITIVE) or value > MOST.get(name, LARGEST):
                raise ConfigError(f"{name} {least} and <= {MOST.get(name, LARGEST):g}", str(value),
                                  "give such a number")

    def limited(self) -> FitConfig:
        """Itself with the method's default limit filled in where none was given."""
        return self if self.budget or self.iterations else replace(self, **self.default_limit)

    @property
    def falloff(self) -> Falloff:
        """The light that the method takes for granted."""
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
        """Whether the views stay as the capture has them, stated or not."""
        return False

    @property
    def refines_views(self) -> bool | None:
        """Whether each photo's view is refined; None: a stated one only where the photos do not follow the
        model.
        """
        return False

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted; None where the method has no such unknown."""
        return None


@dataclass(frozen=True)
class HierarchicalConfig(FitConfig):
    """The default method: every texel solved by itself, specular and roughness shared between texels that
    look alike.
    """

    materials: int = 64
    """Basis materials, told apart by their look, between which texels share specular and roughness."""
    likeness: float = 0.02
    """How alike texels must look to share: standard deviation, in the numbers of
    fit/hierarchical/appearance.py."""
    spread: float = 0.03
    """How far specular and roughness may be from those of look-alikes at 64 px, in photos that do not follow
    the model."""
    relief: float = 0.02
    """Slopes of the normals to expect at 64 px, in photos that do not follow the model."""
    own: float = 0.06
    """How far specular or metallic may leave its tied answer at full size, at first, in such photos; 0: only
    diffuse may."""
    tails: float = 2.0
    """Pixels farther from a highlight than so many lobe widths count less at 64 px, in such photos; 0 counts
    all alike."""
    independent: Switch = True
    """Whether specular and roughness are kept from following where the photos' highlights were, in such
    photos."""
    integrated: Switch = False
    """Whether look-alikes share what texels say with their own slopes and diffuse colours integrated out, not
    maximised."""
    noise: float | None = None
    """Of a phone's photos at full size, in display values: the higher, the less detail is believed. None:
    found by them."""
    neighbours: Switch = True
    """Whether texels try their neighbours' answers as starts."""
    exact: bool | None = None
    """Whether the photos follow the model, as a simulation's do. None: told by what a free fit leaves
    unexplained."""
    rivals: Switch = True
    """Whether exact photos are fitted from three starts, whose lobes are of very different width."""
    calibrate: bool | None = None
    """Estimate missing views, refine all, which exact photos lose by. None: refine stated ones of a phone's
    photos only."""
    flash_offset: Switch = True
    """Whether the sideways distance between lens and flash is fitted, one for all photos (calibrations claim
    0)."""

    @property
    def holds_views(self) -> bool:
        """Whether the views stay as the capture has them: asked for."""
        return self.calibrate is False

    @property
    def refines_views(self) -> bool | None:
        """Whether each photo's view is refined, as asked for."""
        return self.calibrate

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted, as asked for."""
        return self.flash_offset


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
    """Weight of the discriminator's verdict (the paper's adversarial loss); 0 leaves the discriminator
    out."""
    smooth: float = 0.01
    """Weight of the roughness of the specular and roughness maps (total variation)."""
    flat: float = 0.02
    """Weight of the tilt of the normals."""
    flash_offset: Switch = True
    """Whether the sideways distance between lens and flash is fitted, one for all photos (calibrations claim
    0)."""

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted, as asked for."""
        return self.flash_offset


@dataclass(frozen=True)
class DirectConfig(FitConfig):
    """The baseline: every texel on its own, from a robust start."""

    default_budget: ClassVar[float] = 60.0

    learning_rate: float = 0.05
    """Adam's step size at the start, in logits; it falls to 2 % along a cosine."""
    photometric: float = 1.0
    """Weight of the re-rendering error over all photos (|e| + 5 e^2 in display values)."""
    smooth: float = 0.01
    """Weight of the roughness of the specular and roughness maps (total variation)."""
    flat: float = 0.02
    """Weight of the tilt of the normals."""
