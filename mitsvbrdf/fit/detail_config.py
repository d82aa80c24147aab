"""Settings of the plausible detail."""

from __future__ import annotations

from dataclasses import dataclass, fields

from ..errors import LARGEST, ConfigError
from ..kinds import check_fields
from .config import check_seed


@dataclass(frozen=True)
class DetailConfig:
    """Plausible detail: one random draw of what no photo shows. The maps of the fit stay the same."""

    steps: int = 80
    """Steps of generator and discriminator."""
    seed: int = 0
    """Seed of the draw: noise, weights, lights and patches."""
    width: int = 8
    """Channels of the generator's finest level."""
    discriminator_width: int = 32
    """Channels of the discriminator's first layer."""
    learning_rate: float = 5e-3
    """Adam's step size of the generator at the start; it falls along a cosine."""
    discriminator_rate: float = 1e-3
    """The same of the discriminator."""
    certain: float = 0.01
    """Texels of a map with at most this standard deviation stay the same."""
    reach: float = 4.0
    """Largest change of the others, as a multiple of their standard deviation above that."""
    lights: int = 4
    """Novel lights in one step, each beside a photo."""
    tries: int = 4
    """Places tried for a novel light; the place that looks most like the photo's is taken."""
    crop: float = 0.5
    """Side of the compared pictures, in patch sides."""
    seen: int = 3
    """Photos in one step whose re-rendering is held."""
    adversarial: float = 0.4
    """Weight of the discriminator's verdict."""
    patches: float = 80.0
    """Weight of the sliced Wasserstein distance of patches."""
    photometric: float = 10.0
    """Weight of the re-rendering error of photos seen."""
    diffuse: float = 1.0
    """Weight of the distance of the diffuse map to the solved one."""
    worst: float = 1.4
    """Largest re-rendering RMSE over that of the maps; a larger change is weakened to this."""

    def check(self) -> None:
        """Raise ConfigError for other kinds and numbers out of range."""
        check_fields(self)
        check_seed(self.seed)
        for field in fields(self):
            value = getattr(self, field.name)
            may_be_zero = field.name in ("seed", "certain", "adversarial", "patches", "photometric",
                                         "diffuse")
            if not 0 <= value <= LARGEST or (value == 0 and not may_be_zero):
                raise ConfigError(f"{field.name} {'>= 0' if may_be_zero else '> 0'}", str(value),
                                  "give such a number")
        if self.crop > 1:
            raise ConfigError("crop of at most 1 patch side", str(self.crop), "0.5 is half a side")
