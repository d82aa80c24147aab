"""The stages of the fit: the present one, its rounds, and the noise assumed of its photos.

Photos of a simulation follow the model to the last digit, photos of a phone do not. What the first stage
leaves unexplained tells which kind they are, and that decides which stages come next.
"""

from enum import IntEnum

import torch
from torch import Tensor

from ... import color
from ...capture import Capture
from ...material.maps import SVBRDF
from ...render import Renderer
from ...views import Views
from .sensor_noise import STEPS


class Stage(IntEnum):
    """A stage of the fit."""

    ALONE = 0  # coarse; every texel explains its photos freely
    MULTI_START = 1  # the same at many roughnesses, and the lobes that texels share; exact photos only
    TOGETHER = 2  # coarse; texels are tied to those that look alike; photos of a phone only
    FINE = 3  # full size


# Real photos at full size: after a round in which a share below CALM of the texels moved by MOVED, one more
# round follows. After a round in which other starts saved a share below WORTH of the cost, they are not used.
MOVED, CALM, WORTH = 0.01, 0.05, 1e-3
ROUNDS = {Stage.ALONE: 12, Stage.MULTI_START: 10, Stage.TOGETHER: 12, Stage.FINE: 6}
LOBE_ROUNDS, ALIKE = 4, 2  # of FINE, if texels share lobes; in the first ALIKE of them, pixels count alike
ALONE_ROUNDS = 14  # of FINE, for exact photos whose texels share no lobes
# share of the run at which a stage ends at the latest
DEADLINE = {Stage.ALONE: 0.15, Stage.MULTI_START: 0.4, Stage.TOGETHER: 0.5}

# Structure that a free fit leaves when coarse (:func:`unexplained`): six known materials 0.0003 to 0.0009
# without noise and up to 0.004 with noise of 0.003 in linear radiance, twelve real captures 0.009 to 0.053.
EXACT = 0.006

# of a real photo's display values: sensor, alignment, light that is no point, lobes that are no GGX
NOISE = 0.03
LEAST_NOISE = 0.004  # of any photo: one step of 8 bits
UNTOLD = 1.5  # assumed noise, in multiples of the RMSE that a fit with so many unknowns leaves
# Factor of the noise a round. Noise starts at NOISE, so that no texel is caught early by a wrong highlight.
EASED = 0.75


class Stages:
    """Where the fit stands: the stage, the number of its rounds begun, and the noise of the present round.

    Exact photos may have a ``multi_start``: their texels are explained at many roughnesses. ``stated`` says
    whether the photos are exact; None: their errors decide.
    """

    def __init__(self, multi_start: bool, stated: bool | None = None) -> None:
        self.multi_start, self.stated = multi_start, stated
        self.stage, self.rounds = Stage.ALONE, 0
        self.noise = torch.tensor(NOISE)
        self.unexplained = torch.full((2,), torch.nan)  # what ALONE left (:func:`unexplained`), once known
        self.detail = torch.tensor(NOISE)  # noise of photos of a phone at full size
        self.sensor = torch.full((3, STEPS), torch.nan)  # brightness, noise as seen last, the least ever seen
        self.hurried = False  # whether the present stage lacked time, or the one before it
        self.early = False  # whether any stage ended before it was finished
        self.last = ROUNDS[Stage.FINE]  # last round of FINE, for real photos
        self.others = True  # whether other starts are worth their time
        self.closing = False  # whether only the last steps are left
        self.matte = False  # whether the photos were found to need no specular lobe

    @property
    def known(self) -> bool:
        """Whether :attr:`unexplained` tells which kind of photos these are."""
        return not bool(self.unexplained[0].isnan())

    @property
    def measured(self) -> bool:
        """Whether :meth:`measure` was told the noise of exact photos."""
        return not bool(self.sensor.isnan().any())

    @property
    def told_by_brightness(self) -> bool:
        """Whether pixels count by the noise of their brightness: not while starts are far from highlights."""
        return self.measured and (self.stage != Stage.FINE or self.rounds > ALIKE)

    @property
    def by_brightness(self) -> Tensor:
        """Brightness, and the noise there: as seen last, or in the very last steps the least ever seen.

        Texels caught by a wrong highlight leave it while noise is high. In the end, a highlight that is only
        half reproduced must not count as noisy.
        """
        return self.sensor[[0, 2 if self.closing else 1]]

    def measure(self, sensor: Tensor) -> None:
        """Learn the noise of exact photos by brightness (:mod:`.sensor_noise`)."""
        self.sensor = torch.stack([*sensor, sensor[1].fmin(self.sensor[2])])
        self.detail = self.noise = sensor[1].square().mean().sqrt()

    @property
    def exact(self) -> bool:
        """Whether the photos follow the model, as a simulation's do; False until that is known."""
        return self.known and (bool(self.unexplained[0] < EXACT) if self.stated is None else self.stated)

    @property
    def tied(self) -> bool:
        """Whether texels are tied to their look-alikes: real photos, once they are known to be real."""
        return self.stage != Stage.ALONE and not self.exact

    @property
    def settled(self) -> bool:
        """Whether another round would change little."""
        rounds = self.last if not self.exact else LOBE_ROUNDS if self.measured else ALONE_ROUNDS
        return self.stage == Stage.FINE and self.rounds >= rounds

    @property
    def finished(self) -> bool:
        """Whether the stage had all its rounds."""
        return self.rounds >= ROUNDS[self.stage]

    def over(self, progress: float, short: bool = False) -> bool:
        """Whether the stage ends before the next round, at this share of the run or with too little time.

        What a round takes is not known before the second one.
        """
        late = self.rounds > 1 and short or self.rounds > 0 and progress >= DEADLINE.get(self.stage, 2.0)
        return self.stage != Stage.FINE and (late or self.finished)

    def next(self, in_time: bool = True) -> Stage:
        """The stage after this one; after ALONE, :attr:`unexplained` must be known.

        Args:
            in_time: whether a search at many roughnesses can end in time.
        """
        if self.stage == Stage.ALONE and not self.exact:
            return Stage.TOGETHER
        return Stage.MULTI_START if self.may_search and in_time else Stage.FINE

    @property
    def may_search(self) -> bool:
        """Whether a search at many roughnesses comes next, if it can end in time."""
        return self.stage == Stage.ALONE and self.multi_start and self.exact and not self.matte

    def enter(self, stage: Stage, hurried: bool = False) -> None:
        """Begin a stage, in a hurry or not."""
        self.early |= not self.finished
        self.hurried = stage == Stage.FINE and (hurried or not self.finished)
        self.stage, self.rounds = stage, 0

    def moved(self, share: float) -> None:
        """Learn which share of the texels moved by :data:`MOVED` in this round."""
        if self.stage == Stage.FINE and not self.exact and share < CALM:
            self.last = min(self.last, self.rounds + 1)

    def saved(self, share: float) -> None:
        """Learn which share of the cost other starts saved in this round."""
        if self.stage == Stage.FINE and not self.exact and share < WORTH:
            self.others = False

    def begin_round(self) -> None:
        """Count another round, and set its noise."""
        self.noise = torch.tensor(self._next_noise())
        self.rounds += 1

    def _next_noise(self) -> float:
        stage, done = self.stage, self.rounds
        if self.measured:
            return float(self.detail)
        if stage == Stage.ALONE:
            return max(LEAST_NOISE, NOISE * EASED**done)
        if self.exact:
            return max(LEAST_NOISE, UNTOLD * float(self.unexplained[1]), NOISE * EASED**(2 * done + 2))
        return float(self.detail) if stage == Stage.FINE else NOISE

    def state(self) -> dict[str, Tensor]:
        """Everything :meth:`load_state` needs."""
        return {"stage": torch.tensor([self.stage, self.rounds, self.hurried, self.last, self.others,
                                       self.early]),
                "matte": torch.tensor(self.matte), "noise": self.noise.clone(), "detail": self.detail.clone(),
                "unexplained": self.unexplained.nan_to_num(-1.0), "sensor": self.sensor.nan_to_num(-1.0)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        stage, self.rounds, hurried, self.last, *others = state["stage"].tolist()
        self.stage, self.hurried, self.matte = Stage(stage), bool(hurried), bool(state["matte"])
        self.others, self.early = map(bool, others)
        self.noise, self.detail = state["noise"].clone(), state["detail"].clone()
        self.unexplained, self.sensor = (torch.where(state[name] < 0, torch.nan, state[name])
                                         for name in ("unexplained", "sensor"))


def unexplained(svbrdf: SVBRDF, views: Views, capture: Capture, renderer: Renderer) -> Tensor:
    """Structure and RMSE of the errors in display values of usable pixels: two numbers.

    Structure is the root of the mean product of neighbouring errors: sensor noise has none, a wrong model
    has. The material found has R x R texels, and so have the photos. 0: no pixels are usable neighbours.
    """
    with torch.no_grad():
        shown = color.to_display(renderer.render(svbrdf, views), capture.transfer)
    error = torch.where(capture.usable, shown - capture.photos, torch.nan)
    alike = (error[:, 1:] * error[:, :-1]).nanmean() + (error[:, :, 1:] * error[:, :, :-1]).nanmean()
    return torch.stack(((alike / 2).clamp_min(0), error.square().nanmean())).sqrt().nan_to_num()
