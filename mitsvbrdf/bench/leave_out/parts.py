"""The parts of a fit that are left out, each with the settings that take it away, and the kinds of photos it
is tried on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ...capture import Capture
from ...fit import FitConfig, GanConfig, HierarchicalConfig, HybridConfig
from ...fit.hierarchical import matte, skipped
from ...fit.hierarchical.moved_views import REFINED
from ...fit.hierarchical.stages import ROUNDS, Stage
from ...fit.methods import method_name

EXACT, MATTE, NOISY, OFF, REAL = "exact", "exact, matte", "exact, noisy", "cameras off", "real photos"
FOLLOWING, OTHERS = (EXACT, MATTE, NOISY), (OFF, REAL)  # what the model does and does not explain
TRAINED = EXACT, REAL  # on which networks are trained: they make no difference between kinds
UNLIMITED = 3600.0  # seconds: a fit ends by itself
STEPS = 150  # of the methods that train networks


@dataclass(frozen=True)
class Part:
    """A part of a fit.

    Args:
        what: its name; where ``fit`` may leave it out by itself, the name that ``fit.json`` gives it.
        config: settings of the fit that has it, or of the one without where the program leaves it out by
            itself.
        other: the settings that take it away, or put it in.
        put_in: whether ``other`` puts it in.
        kinds: of scenes.
        says: further names by which ``fit --explain`` says that it is left out.
        photos: what takes it away from the photos, instead of settings.
        table: of the method, as of rounds by stage, and what changes in it instead of settings.
    """

    what: str
    config: FitConfig
    other: FitConfig
    put_in: bool = False
    kinds: Sequence[str] = (*FOLLOWING, *OTHERS)
    says: tuple[str, ...] = ()
    photos: Callable[[Capture], Capture] | None = None
    table: tuple[dict, Mapping] | None = None

    @property
    def of(self) -> str:
        """The method that it is a part of."""
        return method_name(self.config)

    @property
    def name(self) -> str:
        """Of the fits that it is measured by: no two parts share it."""
        return f"{self.of} {'with' if self.put_in else 'without'} {self.what}"


def parts() -> list[Part]:
    """What is left out, in the order of the table. What the program leaves out by itself is put in on made
    photos alone.
    """
    usual = HierarchicalConfig(budget=UNLIMITED)
    hybrid, gan = HybridConfig(iterations=STEPS), GanConfig(iterations=STEPS)
    first = partial(replace, usual)
    return [
        Part(skipped.TIED, usual, first(exact=False), True, FOLLOWING),
        Part(skipped.RIVALS, usual, first(exact=True), True, (OFF,)),
        Part(skipped.RIVALS, usual, first(rivals=False), kinds=(EXACT, NOISY)),
        Part(skipped.VIEWS, usual, first(calibrate=True), True, FOLLOWING),
        Part(skipped.VIEWS, usual, first(calibrate=False), kinds=OTHERS),
        Part("flash offset", usual, first(flash_offset=False), kinds=OTHERS),
        Part(skipped.IN_TURN, usual, first(noise=0.03), kinds=OTHERS),
        Part("other starts of texels", usual, first(neighbours=False)),
        Part("look-alikes", usual, first(materials=1)),
        Part("freedom at full size", usual, first(own=0.0), kinds=OTHERS),
        Part("weights of pixels", usual, first(tails=0.0), kinds=OTHERS),
        Part("removal of burn-in", usual, first(independent=False), kinds=OTHERS),
        Part("view refinement at full size", usual, usual, kinds=OTHERS, table=(REFINED, {Stage.FINE: ()})),
        Part("view refinements but one", usual, usual, kinds=OTHERS,
             table=(REFINED, {Stage.TOGETHER: (3,), Stage.FINE: ()})),
        Part("second half of the rounds at full size", usual, usual, kinds=FOLLOWING,
             table=(ROUNDS, {Stage.FINE: 7})),
        Part(skipped.LOBE, usual, usual, True, (MATTE,), table=(matte.LOBE, {"roughconductor": ()})),
        Part("every other photo", usual, usual, photos=lambda shots: shots.pick(shots.index[::2])),
        Part("generator", usual, hybrid, True, (EXACT,)),
        Part("discriminator", hybrid, replace(hybrid, adversarial=0.0), kinds=TRAINED,
             says=("adversarial loss",)),
        Part("diffuse loss", hybrid, replace(hybrid, diffuse=0.0), kinds=TRAINED),
        Part("smoothness of specular and roughness", hybrid, replace(hybrid, smooth=0.0), kinds=TRAINED),
        Part("price on tilted normals", hybrid, replace(hybrid, flat=0.0), kinds=TRAINED),
        Part("photometric loss", hybrid, replace(hybrid, photometric=0.0), kinds=TRAINED),
        Part("feature matching", gan, replace(gan, features=0.0), kinds=TRAINED),
        Part("discriminator", gan, replace(gan, adversarial=0.0, features=0.0), kinds=TRAINED),
    ]
