"""The stages of the fit: the present one, its rounds, and the assumed noise of the photos.

Simulated photos follow the model exactly, up to sensor noise; photos of a phone do not. The errors that the
first stage leaves show which kind the photos are. The kind decides the next stages.
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

    ALONE = 0  # coarse; every texel is fitted alone
    MULTI_START = 1  # coarse; fits at many roughnesses give lobes that texels share; exact photos only
    TOGETHER = 2  # coarse; texels are tied to those that look alike; real photos only
    FINE = 3  # full size


# Real photos at full size: if less than CALM (share) of the texels move more than MOVED in a round, the next
# round is the last. If other starts save less than WORTH (share) of the cost, no more are tried.
MOVED, CALM, WORTH = 0.01, 0.05, 1e-3
ROUNDS = {Stage.ALONE: 12, Stage.MULTI_START: 10, Stage.TOGETHER: 12, Stage.FINE: 6}
LOBE_ROUNDS, ALIKE = 4, 2  # rounds of FINE with shared lobes; the first few, with one noise for all pixels
ALONE_ROUNDS = 14  # rounds of FINE for exact photos whose texels share no lobes
# share of the run at which a stage ends at the latest
DEADLINE = {Stage.ALONE: 0.15, Stage.MULTI_START: 0.4, Stage.TOGETHER: 0.5}

# Structure of the errors of a coarse free fit (:func:`unexplained`); exact photos have less. Six materials:
# 0.0003 to 0.0009, up to 0.004 with noise of 0.003 in linear radiance. Twelve real captures: 0.009 to 0.053.
EXACT = 0.006

# Noise of real photos in display values: sensor, misalignment, a flash with an area, lobes unlike GGX
NOISE = 0.03
LEAST_NOISE = 0.004  # least assumed noise of any photo: one step of 8 bits
UNTOLD = 1.5  # assumed noise / RMSE of the fit: its many unknowns explain a part of the noise
# Factor of the assumed noise in each round. It starts high, at NOISE: texels can leave a wrong highlight.
EASED = 0.75


class Stages:
    """The state of the fit: the stage, the number of its rounds begun, and the noise of the present round.

    ``multi_start``: whether texels of exact photos are fitted at many roughnesses. ``stated``: whether the
    photos are exact; None: their errors decide.
    """

    def __init__(self, multi_start: bool, stated: bool | None = None) -> None:
        self.multi_start, self.stated = multi_start, stated
        self.stage, self.rounds = Stage.ALONE, 0
        self.noise = torch.tensor(NOISE)
        self.unexplained = torch.full((2,), torch.nan)  # errors after ALONE (:func:`unexplained`), once known
        self.detail = torch.tensor(NOISE)  # noise of real photos at full size; of exact ones, once measured
        self.sensor = torch.full((3, STEPS), torch.nan)  # brightness, noise measured last, least one measured
        self.hurried = False  # whether the present stage lacked time, or the one before it
        self.early = False  # whether any stage ended before it was finished
        self.last = ROUNDS[Stage.FINE]  # last round of FINE, for real photos
        self.others = True  # whether other starts are worth their time
        self.closing = False  # whether only the last steps are left
        self.matte = False  # whether the photos were found to need no specular lobe

    @property
    def known(self) -> bool:
        """Whether :attr:`unexplained` has values."""
        return not bool(self.unexplained[0].isnan())

    @property
    def measured(self) -> bool:
        """Whether the noise of exact photos has been measured (:meth:`measure`)."""
        return not bool(self.sensor.isnan().any())

    @property
    def told_by_brightness(self) -> bool:
        """Whether noise depends on brightness: not in FINE's first rounds (ALIKE), far from highlights."""
        return self.measured and (self.stage != Stage.FINE or self.rounds > ALIKE)

    @property
    def by_brightness(self) -> Tensor:
        """Brightness and the noise there, 2 x STEPS: as measured last; in the last steps, the least measured.

        High noise lets texels leave a wrong highlight. At the end, errors of a highlight that is only half
        reproduced must not count as noise.
        """
        return self.sensor[[0, 2 if self.closing else 1]]

    def measure(self, sensor: Tensor) -> None:
        """Set the noise of exact photos at each brightness (:mod:`.sensor_noise`)."""
        self.sensor = torch.stack([*sensor, sensor[1].fmin(self.sensor[2])])
        self.detail = self.noise = sensor[1].square().mean().sqrt()

    @property
    def exact(self) -> bool:
        """Whether the photos follow the model, as a simulation's do; False until that is known."""
        return self.known and (bool(self.unexplained[0] < EXACT) if self.stated is None else self.stated)

    @property
    def tied(self) -> bool:
        """Whether the photos are known to be real: look-alikes are tied, and freed again at full size."""
        return self.stage != Stage.ALONE and not self.exact

    @property
    def settled(self) -> bool:
        """Whether the last stage had all its rounds."""
        rounds = self.last if not self.exact else LOBE_ROUNDS if self.measured else ALONE_ROUNDS
        return self.stage == Stage.FINE and self.rounds >= rounds

    @property
    def finished(self) -> bool:
        """Whether the stage had all its rounds."""
        return self.rounds >= ROUNDS[self.stage]

    def over(self, progress: float, short: bool = False) -> bool:
        """Whether the stage ends before the next round, at the share ``progress`` of the run or if ``short``.

        ``short`` (time is too short for a round) counts only after two rounds, which show a round's duration.
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
        """Begin a stage; ``hurried``: time was too short for a step before it."""
        self.early |= not self.finished
        self.hurried = stage == Stage.FINE and (hurried or not self.finished)
        self.stage, self.rounds = stage, 0

    def moved(self, share: float) -> None:
        """Note the share of texels that moved by more than :data:`MOVED` in this round."""
        if self.stage == Stage.FINE and not self.exact and share < CALM:
            self.last = min(self.last, self.rounds + 1)

    def saved(self, share: float) -> None:
        """Note the share of the cost that other starts saved in this round."""
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
    """Structure and RMSE of the errors of usable pixels in display values: two numbers.

    Structure is the root of the mean product of the errors of neighbouring pixels: 0 for sensor noise or if
    no neighbours are usable, more for a wrong model. ``svbrdf`` and the photos have R x R texels.
    """
    with torch.no_grad():
        shown = color.to_display(renderer.render(svbrdf, views), capture.transfer)
    error = torch.where(capture.usable, shown - capture.photos, torch.nan)
    alike = (error[:, 1:] * error[:, :-1]).nanmean() + (error[:, :, 1:] * error[:, :, :-1]).nanmean()
    return torch.stack(((alike / 2).clamp_min(0), error.square().nanmean())).sqrt().nan_to_num()
