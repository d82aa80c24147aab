"""The input of a fit, prepared once for all methods: guess, fixed maps, and which views may change."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Literal, TypeVar

import torch
from torch import Tensor

from ..calibrate.estimate import EstimatedViews, self_calibrated, why_not
from ..calibrate.readings import doubts
from ..capture import Capture, guess_diffuse
from ..capture.rectify import filled
from ..errors import ConfigError
from ..material.maps import SVBRDF
from ..render import Renderer
from . import losses
from .config import FitConfig, HierarchicalConfig
from .fixed_maps import fixed_maps
from .gan_config import GanConfig
from .repeats import Repeats, repeats
from .start import robust_start

Config = TypeVar("Config", bound=FitConfig)
Refined = Literal["never", "unless exact", "always"]


@dataclass(frozen=True, eq=False)
class FitTask(Generic[Config]):
    """A capture to fit with a method's settings. Values derived from the two are computed on first use."""

    capture: Capture  # photos and views
    renderer: Renderer  # of the images compared with photos; gives gradients
    config: Config  # which method, and its settings
    own_guess: Tensor | None = None  # guessed diffuse map, R x R x 3 linear; None: from the photos
    estimated: EstimatedViews | None = None  # from the photos; None: the views are stated or a default
    light_doubted: bool = False  # whether photos contradict the stated light power

    @cached_property
    def fixed(self) -> Mapping[str, Tensor]:
        """The maps that are not fitted: name to R x R x C."""
        return fixed_maps(self.config.fix, self.config.bsdf, self.capture.resolution)

    @cached_property
    def guess(self) -> Tensor:
        """The guessed diffuse map, R x R x 3 linear; or the diffuse map itself if it is fixed."""
        if self.own_guess is not None:
            return self.own_guess
        return (self.fixed["diffuse"].contiguous() if "diffuse" in self.fixed
                else guess_diffuse(self.capture, self.config.guess))

    def start(self) -> SVBRDF:
        """The robust start (:func:`robust_start`), with maps that are held fixed."""
        return robust_start(self.capture, self.guess, self.config.bsdf, self.fixed)

    @cached_property
    def unused(self) -> dict[str, str]:
        """The method's losses that are not computed: name to reason."""
        return losses.unused(self.config.weights, self.config.bsdf, self.fixed)

    @cached_property
    def repeats(self) -> Repeats | None:
        """Whether one photo shows a material that repeats itself; None if this is not tested.

        It is tested for `hierarchical` and `gan` from solved maps, if all maps of roughconductor are fitted
        to one photo without a mask. ConfigError: --stationary in another case.
        """
        config, asked = self.config, None
        if isinstance(config, HierarchicalConfig):
            asked = config.stationary
        elif not isinstance(config, GanConfig) or config.begins != "solved":
            return None
        whole = len(self.capture) == 1 < self.capture.resolution and self.capture.measured is None
        if whole and config.bsdf == "roughconductor" and not (config.fix or config.grey_specular):
            return repeats(self.capture, asked)
        if asked:
            raise ConfigError("one whole photo and all maps of roughconductor to fit, beside --stationary",
                              "several or masked photos, or fewer maps", "leave --stationary out")
        return None

    @property
    def of_looks(self) -> bool:
        """Whether the capture is one photo of a material that repeats itself."""
        return self.repeats is not None and self.repeats.stationary

    @cached_property
    def views_known(self) -> bool:
        """Whether the views are stated, or can be estimated from the photos."""
        return self.capture.calibrated or why_not(self.capture) is None

    @cached_property
    def why_no_flash_offset(self) -> str | None:
        """Why the sideways distance between lens and flash is not fitted; None if it is fitted."""
        config = self.config
        if not config.wants_flash_offset:
            return "not asked for"
        if not self.capture.calibrated and (config.holds_views or not self.views_known):
            return "the views are a stated default, not a calibration"
        if config.holds_views:
            return "the views are held"
        if self.of_looks:
            return "one photo does not tell it from the tilt of all its texels"
        return ("mitsuba-scene has no gradient to the lights" if self.renderer.name == "mitsuba-scene"
                else None)

    @property
    def refined(self) -> Refined:
        """When the method refines camera, flash and exposure of each photo."""
        if self.config.holds_views or self.config.refines_views is False or not self.views_known:
            return "never"
        return ("always" if self.config.refines_views or self.capture.calibration in ("photos", "none")
                else "unless exact")

    @property
    def light_power_unknown(self) -> bool:
        """Whether to find the light power from the maps: it was estimated, or views come from features."""
        return (self.estimated is not None
                or self.capture.calibration == "photos" and not self.config.holds_views)


def fit_task(capture: Capture, renderer: Renderer, config: Config) -> FitTask[Config]:
    """The task of a fit. Views are estimated if the capture has none and the settings do not hold them.

    Masked pixels are replaced by the mean of the photos that show them, because networks do not see the mask.
    """
    if (measured := capture.measured) is not None:
        shown = torch.where(measured[..., None], capture.photos, torch.nan)
        capture = capture.but(photos=filled(list(shown.numpy()), warn=False)[0])
    capture, estimated = (capture, None) if config.holds_views else self_calibrated(capture)
    if found := doubts(capture):
        capture = capture.but(notes=(*capture.notes, *found.said))
    return FitTask(capture, renderer, config, estimated=estimated, light_doubted=bool(found and found.light))
