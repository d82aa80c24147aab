"""What a fit is asked for beside the settings of its method: which photos, how they are read, and what
renders.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from tyro.conf import arg

from ..capture import Capture
from ..errors import ConfigError
from ..render import RendererName
from ..views import Falloff, photo_numbers
from .config import FitConfig
from .finish_config import FinishConfig
from .methods import METHODS, method_name

PREDICTED = 9  # photos left out of a fit that its page shows at once; `report --capture` shows all


@dataclass(frozen=True)
class FitOptions:
    """The options that every method has."""

    renderer: RendererName = "mitsuba"
    """What renders the maps and carries the gradients."""
    resolution: int = 256
    """Side of the maps in texels; photos are area-averaged down to it."""
    views: Annotated[str | None, arg(metavar="0,1,2,...")] = None
    """Which photos to use, by number; left out: all."""
    falloff: Literal["auto", "inverse-square", "none"] = "auto"
    """Light falloff; none is the paper's light. auto: inverse-square, but none for the paper's presets of
    --method gan."""
    transfer: Literal["auto", "gamma2.2", "srgb", "linear"] = "auto"
    """How photos encode light; auto: as the capture states, else gamma2.2 for calibrated captures and srgb
    for plain photos."""
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb"] = "llvm_ad_rgb"
    """Mitsuba variant."""
    finish: Literal["none", "gan"] = "none"
    """gan: OUT/look beside OUT/maps, one plausible draw of what no photo saw, for pictures; the maps stay the
    same."""
    finish_steps: int = FinishConfig.steps
    """Steps of the finish; 80 take under a minute at 256 px."""

    def check(self, config: FitConfig) -> None:
        """Raise ConfigError for options out of range, or that do not fit the method's settings."""
        config.check()
        (self.finishing(config) or FinishConfig()).check()
        if self.resolution < 8:
            raise ConfigError("--resolution of 8 or more", str(self.resolution), "try 256")
        photo_numbers(self.views)

    def light(self, config: FitConfig) -> Falloff:
        """How light falls off: as asked for, else as the method takes for granted."""
        return config.falloff if self.falloff == "auto" else self.falloff

    def finishing(self, config: FitConfig) -> FinishConfig | None:
        """Settings of the finish; None where none is asked for."""
        return FinishConfig(steps=self.finish_steps, seed=config.seed) if self.finish == "gan" else None

    def chosen(self, photos: Capture) -> tuple[Capture, Capture | None]:
        """The photos to fit; and these with some that are left out, for the page to predict, or None where
        all are fitted.
        """
        numbers = photo_numbers(self.views)
        shots = photos if numbers is None else photos.pick(numbers)
        unused = [number for number in photos.index if number not in shots.index][:PREDICTED]
        return shots, photos.pick(sorted({*shots.index, *unused})) if unused else None

    def record(self, shots: Capture) -> dict:
        """What ``fit.json`` keeps of them; the falloff is that of the photos' views."""
        kept = ("renderer", "resolution", "views", "transfer", "variant", "finish")
        return {name: getattr(self, name) for name in kept} | {"falloff": shots.views.falloff}


def config_record(config: FitConfig) -> dict:
    """A method and its settings as JSON can hold them; :func:`config_of` makes them settings again."""
    return {"method": method_name(config), **asdict(config)}


def config_of(record: dict) -> FitConfig:
    """The settings that a record of :func:`config_record` holds."""
    settings: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value
                                for name, value in record.items() if name != "method"}
    return METHODS[record["method"]].config(**settings)
