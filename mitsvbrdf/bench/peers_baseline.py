"""The field's own baseline, to be beaten: every texel by Adam alone, from a constant material, on the squared
error.

As in ``svbrdf-diff-renderer`` (Guo 2023, ``optim_perpixel`` from "const", 1000 steps): diffuse, specular and
roughness are kept gamma-encoded on a scale from -1 to 1, normals by x and y; renderings are cut to [0, 1]
before they are encoded, so a clipped highlight has no gradient; neither prior nor falling step size. Two
things are ours: the renderer, that of the other methods, and that values which leave their range are put back
onto its end after each step, where theirs become NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .. import color
from ..errors import ConfigError
from ..fit.checkpoint import load_optimizer_state, optimizer_state
from ..fit.config import FitConfig
from ..fit.fixed_maps import LEAST_ROUGHNESS
from ..fit.method import Method, descend
from ..fit.task import FitTask
from ..material.maps import SVBRDF
from ..views import Views

START = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.2}  # gamma-encoded
TEXTURE_CHANNELS = {"diffuse": 3, "specular": 3, "roughness": 1, "normal": 2}
LEAST_RENDERED = 1e-6  # what renderings are cut to from below
# renderers take no roughness of 0
LEAST_ROUGHNESS_UNIT = 2 * float(color.encode(torch.tensor(LEAST_ROUGHNESS))) - 1


@dataclass(frozen=True)
class PeersConfig(FitConfig):
    """The settings of the peers' baseline."""

    iterations: int | None = 1000
    """Steps."""
    learning_rate: float = 0.01
    """Adam's step size, on values from -1 to 1."""

    def check(self) -> None:
        """Raise ConfigError where the peers' baseline cannot do what is asked."""
        super().check()
        if self.bsdf != "roughconductor" or self.fix:
            raise ConfigError("diffuse, specular, roughness and normal to fit",
                              f"{self.bsdf} with {list(self.fix)} fixed",
                              "the peers' baseline knows nothing else")


class PeersBaseline(Method):
    """Steps of the peers' baseline."""

    def __init__(self, task: FitTask[PeersConfig]) -> None:
        super().__init__(task)
        size = task.capture.resolution
        self.textures = {name: torch.full((size, size, channels), 2 * START[name] - 1 if name in START
                                          else 0.0)
                         .requires_grad_() for name, channels in TEXTURE_CHANNELS.items()}
        self.optimizer = torch.optim.Adam(list(self.textures.values()), lr=task.config.learning_rate)

    def step(self, progress: float) -> dict[str, float]:
        """One Adam step on all photos; ``progress`` does not matter."""
        rendered = self.renderer.render(self._material(), self.views).clamp(LEAST_RENDERED, 1)
        loss = (color.encode(rendered, self.capture.transfer) - self.capture.photos).square().mean()
        gradient = descend(loss, self.optimizer)
        with torch.no_grad():
            for name, texture in self.textures.items():
                texture.clamp_(LEAST_ROUGHNESS_UNIT if name == "roughness" else -1, 1)
        return {"l2": float(loss.detach()), "gradient": gradient}

    def _material(self) -> SVBRDF:
        maps = {name: color.decode((texture + 1) / 2) for name, texture in self.textures.items()
                if name in START}
        across = self.textures["normal"]
        up = (1 - across.square().sum(dim=-1, keepdim=True).clamp_max(1 - 1e-6)).sqrt()
        normal = torch.nn.functional.normalize(torch.cat((across, up), dim=-1), dim=-1)
        return SVBRDF("roughconductor", maps | {"normal": normal})

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The maps as they are now, and the views as they were given."""
        with torch.no_grad():
            return self._material().map(Tensor.contiguous), self.views

    def cut_step(self) -> None:
        """Halve Adam's step."""
        self.optimizer.param_groups[0]["lr"] /= 2

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint keeps."""
        rate = torch.tensor(self.optimizer.param_groups[0]["lr"], dtype=torch.float64)
        return {f"texture.{name}": t.detach().clone()
                for name, t in self.textures.items()} | {"rate": rate} | optimizer_state(
            "optimizer", self.optimizer)

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from :meth:`state`."""
        with torch.no_grad():
            for name, texture in self.textures.items():
                texture.copy_(state[f"texture.{name}"])
        load_optimizer_state("optimizer", self.optimizer, state)
        self.optimizer.param_groups[0]["lr"] = float(state["rate"])
