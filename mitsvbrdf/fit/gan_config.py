"""Settings of ``gan``: the paper's presets, ours, and a setting for each difference between them."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, get_args

from ..capture.guess import GuessMethod
from ..errors import ConfigError
from ..kinds import check_fields
from ..views import Falloff
from . import losses
from .config import FitConfig, Switch
from .detail_config import DetailConfig
from .losses import Game

Preset = Literal["minutes", "paper-one-stage", "paper-two-stage"]
GeneratorKind = Literal["all-photos", "two-stream"]
Start = Literal["solved", "guess", "untrained"]

# The paper's method (III.C to III.F); the paper states no weight of the diffuse loss.
_PAPER: dict[str, Any] = {
    "guess": "min", "grey_specular": True, "generator": "two-stream", "start": "untrained", "width": 64,
    "learning_rate": 2e-5, "normal_roughness_steps": 5, "pictures": 1, "discriminator_rate": 2e-5,
    "game": "bce", "paired": False, "grow": False, "adversarial": 1.0, "features": 0.0, "diffuse": 10.0,
    "smooth": 0.0, "flash_offset": False}
_MINUTES: dict[str, Any] = {
    "guess": "robust", "grey_specular": False, "generator": "all-photos", "start": None, "width": 16,
    "learning_rate": 2e-3, "normal_roughness_steps": 1, "pictures": 6, "discriminator_rate": 1e-3,
    "game": "relativistic", "paired": True, "grow": True, "adversarial": 1.0, "features": 10.0,
    "diffuse": 5.0, "smooth": 1.0, "flash_offset": True}
PRESETS: dict[str, dict[str, Any]] = {
    "minutes": _MINUTES, "paper-one-stage": _PAPER, "paper-two-stage": _PAPER}
# Settings of the game (adversarial training) from solved maps; the others belong to that from the guess.
OF_SOLVED = "guess", "grey_specular", "start", "flash_offset"
# The paper's iterations: two stages (on one picture, then on the target photos), or one (target photos).
FIRST_STAGE, SECOND_STAGE, ONE_STAGE = 10_000, 15_000, 20_000
FEWEST = 4  # least number of photos for a game from solved maps, which holds patches out

# Side of the coarsest phase in texels. With fewer, the discriminator has few patches and only memorises the
# photos. At 128 px, four known materials, equal time: mean map RMSE .069 with a coarsest phase of 64 px, .076
# with 32 px; the start has .085.
SMALLEST = 64
AS_PRESET: Any = None  # not given: GanConfig takes the value of its preset


class Phase(NamedTuple):
    """A part of the training, with a new discriminator and optimisers; the generator keeps its weights."""

    share: float  # of the whole run, 0 to 1
    photos: int | None = None  # only this many photos are used, the first ones; None: all
    halvings: int = 0  # how often the resolution is halved


@dataclass(frozen=True)
class GanConfig(FitConfig):
    """A generator against a discriminator: adversarial and diffuse loss (III.D, III.F).

    A setting that is not given has the preset's value.
    """

    default_budget: ClassVar[float] = 300.0

    preset: Preset = "minutes"
    """minutes: ours. paper-one-stage: 20,000 iterations. paper-two-stage: 10,000 (one picture) + 15,000."""
    pretrained: str | None = None
    """Checkpoint of `--pretrain` from which the paper's second stage starts."""
    guess: GuessMethod = AS_PRESET
    """How the guessed diffuse map is made: robust (ours), min (the paper's), mean-blur (Zhao 2020)."""
    grey_specular: Switch = AS_PRESET
    """Fit one grey specular value per texel (the paper's) instead of three channels."""
    generator: GeneratorKind = AS_PRESET
    """Input of the generator. all-photos (ours): all photos. two-stream (the paper's): one photo."""
    start: Start | None = AS_PRESET
    """solved (default): hierarchical's maps. guess (default with e.g. --width). untrained: the paper's."""
    width: int = AS_PRESET
    """Channels of the first convolution of both networks."""
    learning_rate: float = AS_PRESET
    """Adam's step size of the generator."""
    normal_roughness_steps: int = AS_PRESET
    """Gradient steps of the normal/roughness decoder per step of the diffuse/specular decoder (III.F)."""
    pictures: int = AS_PRESET
    """Number of photos, or blends of two photos, compared in one step."""
    crop: int = 0
    """Side of random training crops in texels (stationary mode of Zhao 2020). 0: whole photos."""
    discriminator_rate: float = AS_PRESET
    """Adam's step size of the discriminator."""
    game: Game = AS_PRESET
    """Adversarial loss: bce (the paper's), hinge, or relativistic (photo against rendering of its view)."""
    paired: Switch = AS_PRESET
    """Give the discriminator the photo as a second input, beside the picture that it classifies."""
    grow: Switch = AS_PRESET
    """Train at a quarter and at half of the resolution first."""
    adversarial: float = AS_PRESET
    """Weight of the adversarial loss."""
    features: float = AS_PRESET
    """Weight of feature matching: distance of discriminator activations between rendering and photo."""
    diffuse: float = AS_PRESET
    """Weight of the diffuse loss: distance of the diffuse map to the guess (the paper states no weight)."""
    smooth: float = AS_PRESET
    """Weight of the total variation of the specular and roughness maps."""
    flash_offset: Switch = AS_PRESET
    """Fit one sideways distance between lens and flash for all photos. The paper's presets have none."""

    def __post_init__(self) -> None:
        check_fields(self, "fix", "preset")
        if self.preset not in get_args(Preset):
            raise ConfigError(f"a preset of {get_args(Preset)}", repr(self.preset), "choose one of these")
        for name, value in PRESETS[self.preset].items():
            if getattr(self, name) is AS_PRESET:
                object.__setattr__(self, name, value)
        fixed = any(item.startswith("specular=") for item in self.fix)
        if self.of_paper and (self.bsdf == "principled" or fixed):
            object.__setattr__(self, "grey_specular", False)  # no specular map is fitted

    @property
    def files(self) -> list[str]:
        """The files named in the settings."""
        return super().files + ([self.pretrained] if self.pretrained else [])

    @property
    def begins(self) -> Start:
        """Start of the generator. Default: ``guess`` if a setting of its game is given, else ``solved``."""
        return self.start or ("guess" if self._of_guess else "solved")

    @property
    def _of_guess(self) -> list[str]:
        """Names of the given settings that only the game from the guess has."""
        usual = PRESETS[self.preset] | {"crop": 0}
        return [name for name, value in usual.items()
                if name not in OF_SOLVED and getattr(self, name) not in (AS_PRESET, value)]

    def check(self) -> None:
        """Raise ConfigError for numbers out of range, and for settings that do not go together."""
        super().check()
        if self.start == "solved" and (self.of_paper or self._of_guess):
            option = (self._of_guess or ["preset"])[0].replace("_", "-")
            raise ConfigError(f"--start guess or untrained beside --{option}", "--start solved",
                              "a game from solved maps has no such setting: leave one of them out")
        if self.of_paper and all(
                getattr(self, name) == value for name, value in _MINUTES.items() if name != "start"):
            raise ConfigError("a preset with its own settings", f"{self.preset} with those of minutes",
                              "make GanConfig(preset=...) anew instead of replace(...)")
        if not any(self.weights.values()):
            raise ConfigError("a fit with a loss", "all weights 0",
                              "give --adversarial or --diffuse a weight > 0")
        if self._one_picture_first and (self.generator != "two-stream" or self.grow):
            raise ConfigError("--generator two-stream, --no-grow in a preset that begins with one picture",
                              f"generator {self.generator}, {'growing' if self.grow else 'not growing'}",
                              "give --generator two-stream and --no-grow, or a --pretrained first stage")
        if self.of_paper and self.flash_offset:
            raise ConfigError("--flash-offset beside --preset minutes", self.preset, "leave it out")
        if self.pretrained and self.preset != "paper-two-stage":
            raise ConfigError("--preset paper-two-stage beside a pretrained checkpoint",
                              f"--preset {self.preset}", "add --preset paper-two-stage")
        if self.normal_roughness_steps > 1 and self.generator != "two-stream":
            raise ConfigError("--generator two-stream with several steps of one decoder",
                              f"--generator {self.generator}", "leave --normal-roughness-steps at 1")
        if 0 < self.crop < 16:
            raise ConfigError("crop of 16 texels or more, or 0", str(self.crop), "0 trains on whole pictures")

    @property
    def _one_picture_first(self) -> bool:
        return self.preset == "paper-two-stage" and not self.pretrained

    @property
    def of_paper(self) -> bool:
        """Whether the preset is one of the paper's."""
        return self.preset != "minutes"

    @property
    def weights(self) -> dict[str, float]:
        """The weight of each loss; those of :class:`DetailConfig` if the game begins at solved maps."""
        own = DetailConfig() if self.begins == "solved" else self
        return {name: getattr(own, name) for name in losses.NAMES if hasattr(own, name)}

    @property
    def holds_views(self) -> bool:
        """Whether the views stay those of the capture: yes in the paper's presets."""
        return self.of_paper

    @property
    def wants_flash_offset(self) -> bool | None:
        """Whether the flash offset is to be fitted; None in the paper's presets, which have no offset."""
        return None if self.of_paper else self.flash_offset

    @property
    def falloff(self) -> Falloff:
        """The light falloff; ``none`` in the paper: its light does not weaken with distance."""
        return "none" if self.of_paper else "inverse-square"

    @property
    def default_limit(self) -> dict:
        """Seconds for our preset; iterations for the paper's, without the first stage if it is pretrained."""
        if not self.of_paper:
            return super().default_limit
        first = FIRST_STAGE if self._one_picture_first else 0
        return {"iterations": first + (ONE_STAGE if self.preset == "paper-one-stage" else SECOND_STAGE)}

    def phases(self, resolution: int) -> list[Phase]:
        """The phases of the training for maps of this side: the paper's stages, or growing resolutions."""
        if self._one_picture_first:
            both = FIRST_STAGE + SECOND_STAGE
            return [Phase(FIRST_STAGE / both, photos=1), Phase(SECOND_STAGE / both)]
        shares = {2: 0.2, 1: 0.3, 0: 0.5} if self.grow else {0: 1.0}
        kept = {halvings: share for halvings, share in shares.items() if not halvings
                or resolution >> halvings >= SMALLEST}
        return [Phase(share / sum(kept.values()), halvings=halvings) for halvings, share in kept.items()]
