"""``direct``, the baseline: each texel optimised on its own through the renderer, from a robust start."""

import torch
from torch import Tensor

from ..material.maps import SVBRDF
from ..views import Views
from . import losses
from .checkpoint import Held
from .config import DirectConfig
from .method import Method, cosine, descend
from .parameters import streams_of, to_raw, to_svbrdf
from .task import FitTask


class Direct(Method[DirectConfig]):
    """Steps of per-texel optimisation with Adam."""

    def __init__(self, task: FitTask[DirectConfig]) -> None:
        super().__init__(task)
        streams = streams_of(self.config.bsdf, self.fixed, self.config.grey_specular)
        self.raw = {k: v.requires_grad_() for k, v in to_raw(task.start(), streams).items()}
        self.edges = losses.edge_weights(task.guess)
        self.optimizer = torch.optim.Adam(list(self.raw.values()), lr=self.config.learning_rate)

    def step(self, progress: float) -> dict[str, float]:
        """One Adam step on all photos."""
        self.optimizer.param_groups[0]["lr"] = self.pace * self.config.learning_rate * cosine(progress)
        svbrdf = to_svbrdf(self.config.bsdf, self.raw, self.fixed)
        rendered = self.compared(self.renderer.render(svbrdf, self.views))
        total, logged = self.summed({
            "photometric": lambda: losses.photometric(rendered, self.capture.photos, self.capture.transfer),
            "smooth": lambda: losses.total_variation(svbrdf, self.edges, self.fixed),
            "flat": lambda: losses.tilt(svbrdf)})
        return logged | {"gradient": descend(total, self.optimizer)}

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present maps, and the views, which never change."""
        with torch.no_grad():
            return to_svbrdf(self.config.bsdf, self.raw, self.fixed).map(Tensor.contiguous), self.views

    @property
    def parts(self) -> dict[str, Held]:
        """The raw maps and Adam's averages."""
        return {"optimizer": self.optimizer, **{f"raw.{name}": value for name, value in self.raw.items()}}
