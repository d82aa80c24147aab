"""Options of a fit beside the settings of its method: photos, how they are read, and the renderer."""

from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, Literal

from tyro.conf import arg

from ..calibrate.readings import Axes, Reading
from ..capture import Capture
from ..color import Transfer
from ..errors import ConfigError
from ..render import RendererName
from ..views import Falloff, photo_numbers
from .config import FitConfig
from .detail_config import DetailConfig
from .methods import METHODS, method_name

PREDICTED = 9  # most held-out photos on the page of a fit; `report --capture` shows all

# Settings of earlier fits, whose fit.json is still read: former names, and settings that are gone.
FORMER = {"own": "detail_spread", "tails": "highlight_reach", "likeness": "similarity",
          "independent": "remove_burn_in", "rivals": "multi_start"}
GONE = ("guessed_normal", "highlight_aware", "kl", "average", "fresh_pictures", "integrated",
        "marginalise", "precision")


@dataclass(frozen=True)
class FitOptions:
    """The options that every method has."""

    renderer: RendererName = "mitsuba"
    """Renderer of the images that are compared with photos. direct, hybrid and gan need its gradients."""
    resolution: int = 256
    """Side of the maps in texels; photos are area-averaged down to it."""
    views: Annotated[str | None, arg(metavar="0,1,2,...")] = None
    """Photos to use, by number. Default: all."""
    falloff: Literal["auto", "inverse-square", "none"] = "auto"
    """Light falloff. auto: inverse-square; none for the paper's presets of --method gan."""
    transfer: Literal["auto", Transfer] = "auto"
    """Encoding of photos. auto: as stated, else gamma2.2 (calibrated, no profile), linear (RAW) or srgb."""
    axes: Axes = "right-up"
    """Directions in the photos of the x and y axes of a calibration."""
    side: float | None = None
    """Side of the patch, in the unit of the calibration's positions. Default: as stated."""
    light_factor: float = 1.0
    """Factor on the stated light power: 0.0001 if the power uses centimetres and the positions use metres."""
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb"] = "llvm_ad_rgb"
    """Mitsuba variant."""
    detail: Literal["none", "gan"] = "none"
    """gan: also write OUT/detail, maps with invented detail where photos show too little. For pictures."""
    detail_steps: int = DetailConfig.steps
    """Steps of --detail gan. 80 take under a minute at 256 px."""

    def check(self, config: FitConfig) -> None:
        """Raise ConfigError for an option out of range or in conflict with the settings of the method."""
        config.check()
        (self.detail_config(config) or DetailConfig()).check()
        if self.resolution < 8:
            raise ConfigError("--resolution of 8 or more", str(self.resolution), "try 256")
        photo_numbers(self.views)
        _ = self.reading

    @property
    def reading(self) -> Reading:
        """How to read the numbers of the calibration."""
        return Reading(self.axes, self.side, self.light_factor)

    def light(self, config: FitConfig) -> Falloff:
        """The light falloff of ``--falloff``; if ``auto``, the one that the method assumes."""
        return config.falloff if self.falloff == "auto" else self.falloff

    def detail_config(self, config: FitConfig) -> DetailConfig | None:
        """Settings of the plausible detail; None if it is not asked for."""
        return DetailConfig(steps=self.detail_steps, seed=config.seed) if self.detail == "gan" else None

    def chosen(self, photos: Capture) -> tuple[Capture, Capture | None]:
        """Two captures: photos to fit; as stated, these and held-out ones that the page predicts, or None."""
        numbers = photo_numbers(self.views)
        shots = self.reading.of(photos if numbers is None else photos.pick(numbers))
        unused = [number for number in photos.index if number not in shots.index][:PREDICTED]
        return shots, photos.pick(sorted({*shots.index, *unused})) if unused else None

    def record(self, shots: Capture) -> dict:
        """The options as kept in ``fit.json``; the falloff is that of the photos' views."""
        kept = ("renderer", "resolution", "views", "transfer", "variant", "detail", "axes", "side",
                "light_factor")
        return {name: getattr(self, name) for name in kept} | {"falloff": shots.views.falloff}


def config_record(config: FitConfig) -> dict:
    """A dict for JSON: the method and its settings; :func:`config_of` turns it into settings again."""
    return {"method": method_name(config), **asdict(config)}


def config_of(record: dict) -> FitConfig:
    """The settings in a record of :func:`config_record`, which may use present or former names.

    ConfigError: a method or a setting of a later version.
    """
    settings: dict[str, Any] = {FORMER.get(name, name): tuple(value) if isinstance(value, list) else value
                                for name, value in record.items() if name not in ("method", *GONE)}
    if isinstance(settings.get("start"), bool):  # of earlier fits
        settings["start"] = "guess" if settings["start"] else "untrained"
    kind = METHODS.get(record["method"])
    later = settings.keys() - {each.name for each in fields(kind)} if kind else {str(record["method"])}
    if kind is None or later:
        raise ConfigError("settings that this version knows", ", ".join(sorted(later)), "update mitsvbrdf")
    return kind(**settings)
