"""How far camera and flash stood from their places in the stated views."""

from dataclasses import replace

import torch
from torch import Tensor

from ...calibrate.refine import CHANGE, ITERATIONS, PRIORS, UNKNOWNS, Priors, moved, refine_views
from ...capture import Capture
from ...material.maps import SVBRDF
from ...render import Renderer
from ...views import Views
from ..task import Refined
from .stages import Stage

# Rounds of a stage after which the flash moves to level the patch; the share of this move that is made.
LEVELLED, DAMPED = {Stage.ALONE: (5, 7, 9)}, 0.65
# rounds after which the views are refined; of FINE the last but one
REFINED = {Stage.ALONE: (12,), Stage.TOGETHER: (3, 5, 7, 9)}
TILTED = 0.03  # standard deviation of apparent flash moves that come from a tilted patch, in patch sides
# Unknowns of stated views whose usual error is learned from the photos (empirical Bayes).
LEARNED = [UNKNOWNS.index("camera_z"), UNKNOWNS.index("log_exposure")]
WIDEST = 10.0  # largest learned error, in multiples of the usual error of such a calibration
FEW_STEPS = 10  # of a refinement, if views are always refined: they move far, and again in later rounds


class ViewCorrections:
    """Changes of the views, N x 7 (:data:`mitsvbrdf.calibrate.refine.CHANGE`), and their standard deviations.

    Args:
        capture: photos with the views to change, at full size.
        refined: when the views may move: ``never``; ``always`` (estimated from photos, or ``--calibrate``);
            ``unless exact`` (stated views: photos that follow the model confirm them).
        fits_offset: whether a flash offset that all photos share may change, too.
    """

    STATE = "change", "deviation", "flash_deviation", "off", "skipped"

    def __init__(self, capture: Capture, refined: Refined, fits_offset: bool) -> None:
        self.stated, self.refined, self.fits_offset = capture.views, refined, fits_offset
        self.steps = FEW_STEPS if refined == "always" else ITERATIONS
        self.work = self.steps * 2 * CHANGE.size  # most renderings of all views in a refinement: two a slope
        priors = PRIORS[capture.calibration]
        self.usual = priors if fits_offset else replace(priors, common_flash=(0.0, 0.0))
        self.off = torch.tensor([priors.camera[2], priors.exposure], dtype=torch.float64)
        self.change = torch.zeros(len(capture), CHANGE.size, dtype=torch.float64)
        self.deviation, self.flash_deviation = torch.zeros_like(self.change), self.change.new_zeros(2)
        self.skipped = torch.zeros(())  # 1 if a refinement was omitted for lack of time

    @property
    def priors(self) -> Priors:
        """The usual errors of the views; those of camera height and exposure as learned from the photos."""
        height, exposure = self.off.tolist()
        return replace(self.usual, camera=(*self.usual.camera[:2], height), exposure=exposure)

    def applied(self, views: Views) -> Views:
        """Views with the changes found so far."""
        return moved(views, self.change)

    def may_move(self, tied: bool) -> bool:
        """Whether the views may be refined now; ``tied``: the photos are known to be real."""
        return self.refined == "always" or self.refined == "unless exact" and tied

    def begun(self, in_time: bool) -> bool:
        """Whether a refinement is begun; one that cannot end in time is omitted and noted."""
        self.skipped = self.skipped if in_time else torch.ones(())
        return in_time

    def leave(self, stage: Stage, rounds: int, tied: bool) -> None:
        """Note in ``skipped`` if a stage that ends after ``rounds`` rounds missed some of its refinements."""
        self.begun(not self.may_move(tied) or rounds >= max(REFINED.get(stage, (0,))))

    def level(self, slope: Tensor) -> None:
        """Move the flash of all photos by one offset, which replaces a mean slope removed from the normals.

        With a camera at height z, normals of slope s move highlights by s z, as flat normals do with a flash
        2 s z beside the camera. A refinement with frozen maps cannot find this offset: the diffuse map has
        adapted to the present flash.

        Args:
            slope: mean slopes of the normals, two float64 numbers.
        """
        flash = self.change[:, CHANGE["flash"]][:, :2]  # x and y; it shares the memory of ``change``
        common = flash[0]
        said = common - 2 * self.stated.in_patch_sides().camera[:, 2].mean() * slope
        variance = torch.tensor(self.usual.common_flash).double().square()
        flash += DAMPED * (variance / (variance + TILTED**2) * said - common)

    def refine(self, svbrdf: SVBRDF, capture: Capture, renderer: Renderer | None = None) -> None:
        """Refine the views for the present maps. Start at ``change``; at 0 if ``refined`` is ``always``."""
        start = None if self.refined == "always" else self.change
        found = refine_views(svbrdf, capture.views, capture, self.priors, self.steps, start, renderer)
        self.change, self.deviation = found.change, found.deviation
        self.flash_deviation = found.common_covariance.diagonal().sqrt()
        if self.refined == "unless exact":
            usual = torch.tensor([self.usual.camera[2], self.usual.exposure], dtype=torch.float64)
            seen = (found.change.square() + found.deviation.square()).mean(dim=0).sqrt()[LEARNED]
            self.off = torch.minimum(torch.maximum(seen, usual), WIDEST * usual)

    @property
    def deviations(self) -> tuple[Tensor | None, Tensor | None]:
        """Standard deviations of the changes, N x 7, and of the flash offset, 2; None if not refined."""
        if not self.deviation.any():
            return None, None
        return self.deviation, self.flash_deviation if self.fits_offset else None

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        return {name: getattr(self, name).clone() for name in self.STATE}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        for name in self.STATE:
            setattr(self, name, state[name].clone())
