"""Settings of the plausible detail."""

from dataclasses import dataclass

from ..errors import ConfigError
from ..kinds import check_fields
from .config import check_numbers

POSITIVE = ("steps", "width", "discriminator_width", "learning_rate", "discriminator_rate", "reach",
            "lights", "tries", "crop", "seen", "worst")


@dataclass(frozen=True)
class DetailConfig:
    """Plausible detail: one random draw of what no photo shows. The maps of the fit stay the same."""

    steps: int = 80  # steps of generator and discriminator
    seed: int = 0  # seed of the draw: noise, weights, lights and patches
    width: int = 8  # channels of the generator's finest level
    discriminator_width: int = 32  # channels of the discriminator's first layer
    learning_rate: float = 5e-3  # Adam's step size of the generator at the start; it falls along a cosine
    discriminator_rate: float = 1e-3  # the same of the discriminator
    certain: float = 0.01  # texels with this standard deviation or less stay the same
    reach: float = 4.0  # largest change of other texels, in multiples of standard deviation minus ``certain``
    lights: int = 4  # novel lights in one step, each compared with a photo
    tries: int = 4  # places tried for a novel light; the one that looks most like the photo's place is used
    crop: float = 0.5  # side of the compared pictures, in patch sides
    seen: int = 3  # photos re-rendered in one step; their error is a loss
    adversarial: float = 0.4  # weight of the adversarial loss
    patches: float = 80.0  # weight of the sliced Wasserstein distance of patches
    photometric: float = 10.0  # weight of the error of the re-rendered photos
    diffuse: float = 1.0  # weight of the distance of the diffuse map to the solved one
    worst: float = 1.4  # largest re-rendering RMSE / that of the maps; a change that exceeds it is weakened

    def check(self) -> None:
        """Raise ConfigError for wrong types and numbers out of range."""
        check_fields(self)
        check_numbers(self, POSITIVE)
        if self.crop > 1:
            raise ConfigError("crop of at most 1 patch side", str(self.crop), "0.5 is half a side")
