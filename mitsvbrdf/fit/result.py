"""What every fit ends in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from torch import Tensor

from ..material.maps import SVBRDF
from ..views import Views
from .config import FitConfig
from .methods import method_name


@dataclass(frozen=True)
class FitResult:
    """A fitted material and how it came about.

    Args:
        svbrdf: the recovered material: the state with the lowest re-rendering error over the photos used; of
            ``hierarchical`` the last.
        views: the views it was fitted with (the flash offset found is in ``light``; ``hierarchical`` refines
            all of each view).
        guess: guessed diffuse map, R x R x 3 linear.
        rerendered: linear radiance N x R x R x 3 of the photos used.
        rerender_rmse: over these photos, in display values clipped to [0, 1].
        per_photo: the same for each photo.
        calibrated_rmse: the same with the stated views and ``flash_offset`` instead; None where these are
            ``views``, or no views were stated.
        trace: one dict a measurement: seconds, iteration, each loss, rerender_rmse.
        config: the settings.
        renderer: the name of the renderer; ``variant`` its Mitsuba variant or None.
        omitted: (what, why) of each thing the scene or the method did not need.
        used: (what, how) of each network that was trained.
        stopped: why the fit ended: "settled", "budget", "iterations", "interrupted" or "unstable" (too many
            steps undone).
        undone: ``iteration`` and ``reason`` of each step that made something non-finite and was taken back.
        restarts: the same of each return to the state of the lowest loss, from which the fit had diverged.
        deviations: standard deviation of each fitted map, by name, r x r x C with r <= 64, in the numbers in
            which map errors are counted; see :mod:`mitsvbrdf.fit.confidence`.
        warnings: in sentences; see :mod:`mitsvbrdf.fit.warnings`.
        flash_offset: by how much (x, y) the fit moved the flash beside the lens, in the unit of the views, or
            None.
        calibration: what is known of the views and how surely; see
            :func:`mitsvbrdf.fit.view_record.views_record`.
        detail: one plausible draw of what no photo shows, for pictures; None without
            :func:`mitsvbrdf.fit.generator.detail.with_detail`.
        detail_record: settings, seconds and losses of that, and what it is, or None.
        profile: where the time of the steps went, where :func:`mitsvbrdf.io.profile.profiling` was on,
            else None.
    """

    svbrdf: SVBRDF
    views: Views
    guess: Tensor
    rerendered: Tensor
    rerender_rmse: float
    per_photo: list[float]
    trace: list[dict]
    config: FitConfig
    renderer: str
    variant: str | None
    omitted: tuple[tuple[str, str], ...]
    stopped: str
    undone: tuple[dict, ...] = ()
    restarts: tuple[dict, ...] = ()
    deviations: Mapping[str, Tensor] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    flash_offset: tuple[float, float] | None = None
    profile: dict | None = None
    calibration: dict = field(default_factory=dict)
    used: tuple[tuple[str, str], ...] = ()
    detail: SVBRDF | None = None
    detail_record: dict | None = None
    calibrated_rmse: float | None = None

    def __repr__(self) -> str:
        return (f"FitResult({method_name(self.config)}, {self.svbrdf!r}, re-rendering RMSE "
                f"{self.rerender_rmse:.4f}, "
                f"{self.stopped})")
