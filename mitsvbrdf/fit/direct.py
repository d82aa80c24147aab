"""``direct``, the baseline: each texel optimised on its own through the renderer, from a robust start."""

from __future__ import annotations

import torch
from torch import Tensor

from ..capture import Capture
from ..material.maps import SVBRDF
from ..render import Renderer
from ..system.profile import profiled, switch_at
from ..views import Views
from . import losses
from .checkpoint import load_optimizer_state, optimizer_state
from .config import DirectConfig
from .fixed_maps import fixed_maps
from .method import cosine, descend
from .parameters import streams_of, to_raw, to_svbrdf
from .start import robust_start


class Direct:
    """Steps of per-texel optimisation with Adam; see :class:`mitsvbrdf.fit.method.Method`."""

    def __init__(self, capture: Capture, renderer: Renderer, guess: Tensor, config: DirectConfig) -> None:
        self.capture, self.renderer, self.config = capture, renderer, config
        self.views = capture.views
        self.held = fixed_maps(config.fix, config.bsdf, capture.resolution)
        self.unused = losses.unused(config, self.held)
        streams = streams_of(config.bsdf, self.held, config.grey_specular)
        start = robust_start(capture, guess, config.bsdf, self.held)
        self.raw = {k: v.requires_grad_() for k, v in to_raw(start, streams).items()}
        self.edges = losses.edge_weights(guess)
        self.peak = config.learning_rate
        self.optimizer = torch.optim.Adam(list(self.raw.values()), lr=self.peak)

    def step(self, progress: float) -> dict[str, float]:
        """One Adam step on all photos."""
        self.optimizer.param_groups[0]["lr"] = self.peak * cosine(progress)
        with profiled("hand-over"):
            svbrdf = to_svbrdf(self.config.bsdf, self.raw, self.held)
            switch_at("hand-over, backward", *svbrdf.maps.values())
        with profiled("renderer"):
            rendered = self.renderer.render(svbrdf, self.views)
            switch_at("renderer, backward", rendered)
        with profiled("losses"):
            terms = {"photometric": losses.photometric(rendered, self.capture.photos, self.capture.transfer)}
            if "smooth" not in self.unused:
                terms["smooth"] = losses.total_variation(svbrdf, self.edges, self.held)
            if "flat" not in self.unused:
                terms["flat"] = losses.tilt(svbrdf)
            total = sum(getattr(self.config, name) * value for name, value in terms.items())
        with profiled("losses, backward"):
            gradient = descend(total, self.optimizer)
        return {name: float(value.detach()) for name, value in terms.items()} | {"gradient": gradient}

    def estimate(self) -> tuple[SVBRDF, Views]:
        with torch.no_grad():
            return to_svbrdf(self.config.bsdf, self.raw, self.held).map(Tensor.contiguous), self.views

    def cut_step(self) -> None:
        self.peak /= 2

    def state(self) -> dict[str, Tensor]:
        return {f"raw.{k}": v.detach().clone() for k, v in self.raw.items()} | optimizer_state("optimizer", self.optimizer) | {
            "peak": torch.tensor(self.peak, dtype=torch.float64)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        with torch.no_grad():
            for name, value in self.raw.items():
                value.copy_(state[f"raw.{name}"])
        load_optimizer_state("optimizer", self.optimizer, state)
        self.peak = float(state["peak"])
