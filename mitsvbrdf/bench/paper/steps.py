"""Seconds of an iteration of ``gan``, by preset, beside those of an earlier version of it, and the parts of
both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from ...capture import Capture
from ...fit import FitTask, GanConfig, losses
from ...fit.generator.gan import Gan
from ...fit.generator.pictures import Pictures
from ...fit.method import descend
from ...io.profile import STEP, profiled, profiling, switch_at
from ...io.timing import in_turns, spread, timed
from ...material.made import make_material
from ...render import Renderer
from ...synth import photograph
from ...views import nine_view_grid
from ..code import own_code
from ..methods import as_lit

STEPPED_MATERIAL = "inlay"
NOW, EARLIER = "now", "earlier"
LATE = 0.9  # share of the run that is timed: the last phase, at full size
SECONDS_A_STEP = 2e-4  # a texel at width 64: a guess, only to say how long it will take


class EarlierGan(Gan):
    """The same training as an earlier version computed it, to be timed beside the present one.

    Every gradient step computes the gradients of the discriminator's weights, which nobody asks for, the
    diffuse loss, which moves nothing but the diffuse/specular decoder, and the output of networks that did
    not move since; in float32.
    """

    def _substep(self, pictures: Pictures, first: bool, logged: dict[str, float]) -> None:
        config, self.resting = self.config, None
        svbrdf = self._material(pictures, first)
        fake, told = self._rendered(svbrdf, pictures), self._told(pictures)
        if first:
            with profiled("discriminator"), self._networks():
                logged["discriminator"] = self.discriminator.learn(
                    pictures.shown, fake.detach(), self.optimizers["judge"], config.game, told)
        with profiled("discriminator"):
            total = losses.weighted(self._verdict(pictures.shown, fake, told), config.weights)
            switch_at("discriminator, backward", total)
        with profiled("losses"):
            guess = self.scale.guess_in(pictures.window)
            terms = {"diffuse": losses.diffuse(svbrdf, guess)}
            if "smooth" not in self.unused:
                terms["smooth"] = losses.total_variation(svbrdf, losses.edge_weights(guess), self.fixed)
            logged |= {name: float(value.detach()) for name, value in terms.items()}
            total = total + losses.weighted(terms, config.weights)
        moved = [name for name in ("fast", "slow", "flash") if name in self.optimizers
                 and (first or name == "fast")]
        with profiled("losses, backward"):
            descend(total, *(self.optimizers[name] for name in moved))


@dataclass(frozen=True)
class StepJob:
    """One preset.

    Args:
        config: its settings; float32 in the earlier version, whatever they say.
        resolution: of the photos.
        renderer: carries the gradients.
        repeats: timed turns.
    """

    config: GanConfig
    resolution: int
    renderer: Renderer
    repeats: int = 5

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "steps", "preset": self.config.preset, "resolution": self.resolution,
                "width": self.config.width}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return {"repeats": self.repeats, "precision": self.config.precision, "code": own_code(__name__)}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"iterations of {self.config.preset}, {self.resolution} px, width {self.config.width}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return f"steps {self.config.preset}"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        each = SECONDS_A_STEP * self.resolution**2 * (self.config.width / 64) ** 2 * self.config.pictures
        return 3 + 2 * (2 * self.repeats + 1) * each

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures: ``rows`` of both versions, which take turns, and the ``ratio`` of their seconds turn
        by turn.
        """
        material = make_material(STEPPED_MATERIAL, self.resolution)
        photos = as_lit(photograph(material, nine_view_grid(), self.renderer), self.config)
        versions = {NOW: _method(Gan, photos, self.renderer, self.config),
                    EARLIER: _method(EarlierGan, photos, self.renderer,
                                     replace(self.config, precision="float32"))}
        turns = in_turns({name: partial(_seconds, method) for name, method in versions.items()}, self.repeats,
                         report=lambda share: report(0.5 * share))
        rows = []
        for number, (name, method) in enumerate(versions.items()):
            rows.append({"version": name, "bfloat16": method.bfloat16, "seconds": spread(turns[name]),
                         "parts": parts_of(method, self.repeats)})
            report(0.5 + 0.25 * (number + 1))
        return {"rows": rows, "ratio": spread([before / now for now, before in zip(turns[NOW],
                                                                                   turns[EARLIER])])}


def _method(kind: type[Gan], photos: Capture, renderer: Renderer, config: GanConfig) -> Gan:
    config.check()
    return kind(FitTask(photos, renderer, config))


def _seconds(method: Gan) -> float:
    return timed(method.step, LATE)[1]


def parts_of(method: Gan, steps: int) -> dict[str, float]:
    """The share of each part of an iteration, as ``fit --profile`` names them, over some iterations of a warm
    method.
    """
    with profiling() as profile:
        for _ in range(steps):
            with profiled(STEP):
                method.step(LATE)
        return {name: part["share"] for name, part in profile.summary()["parts"].items()}
