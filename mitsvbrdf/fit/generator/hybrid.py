"""``hybrid``: a generator that sees all photos, trained through the renderer against all of them.

The generator idea, the adversarial and the diffuse loss are the paper's; the photometric loss over all
calibrated views, the conditioning on all photos and the priors are ours. Untrained weights are the prior: a
convolutional network fits what repeats and what has structure before it fits noise (Ulyanov et al. 2018, deep
image prior).
"""

from typing import Any

import torch
from torch import Tensor
from torch.nn.utils import convert_conv2d_weight_memory_format

from ... import color
from ...material.maps import SVBRDF
from ...views import Views
from .. import losses
from ..checkpoint import Held
from ..config import HybridConfig
from ..method import Method, cosine, descend
from ..parameters import streams_of, to_raw, to_svbrdf
from ..task import FitTask
from .conditioning import condition_of, level, with_flash_at
from .networks import AllPhotosGenerator, PatchDiscriminator, seeded

PATCH = 128  # side in pixels of the crops that the discriminator compares


class Hybrid(Method[HybridConfig]):
    """Steps of the hybrid method. Gradients pass through the renderer to maps and flash offset."""

    def __init__(self, task: FitTask[HybridConfig]) -> None:
        super().__init__(task)
        capture, guess, config = task.capture, task.guess, task.config
        self.guess = guess
        self.random = torch.Generator().manual_seed(config.seed)
        streams = streams_of(config.bsdf, self.fixed, config.grey_specular)
        self.start = to_raw(task.start(), streams)
        self.edges = losses.edge_weights(guess)
        self.condition = condition_of(capture, guess).contiguous(memory_format=torch.channels_last)
        with seeded(config.seed):
            generator = AllPhotosGenerator(self.condition.shape[1], streams, config.width)
        self.generator = convert_conv2d_weight_memory_format(generator, torch.channels_last)
        self.offset = torch.zeros(2, dtype=torch.float64, requires_grad=True)  # patch sides
        groups: list[dict[str, Any]] = [{"params": list(self.generator.parameters()),
                                         "peak": config.learning_rate}]
        if self.fits_offset:
            groups.append({"params": [self.offset], "peak": 0.5 * config.learning_rate})
        self.optimizer = torch.optim.Adam(groups)
        if "adversarial" not in self.unused:
            with seeded(config.seed + 1):
                self.discriminator = PatchDiscriminator(max(8, config.width))
            self.adversary = torch.optim.Adam(self.discriminator.parameters(), lr=2e-4, betas=(0.5, 0.999))

    def step(self, progress: float) -> dict[str, float]:
        """One Adam step on all photos; the discriminator learns from one random patch of one photo."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.pace * group["peak"] * cosine(progress)
        svbrdf, views = self._material(), self._views()
        rendered = self.compared(self.renderer.render(svbrdf, views))
        logged: dict[str, float] = {}

        def adversarial() -> Tensor:
            real, fake = self._patches(rendered)
            logged["discriminator"] = self.discriminator.learn(real, fake.detach(), self.adversary)
            return losses.adversarial(real, self.discriminator.activations(fake)[-1])

        total, values = self.summed({
            "photometric": lambda: losses.photometric(rendered, self.capture.photos, self.capture.transfer),
            "diffuse": lambda: losses.diffuse(svbrdf, self.guess),
            "smooth": lambda: losses.total_variation(svbrdf, self.edges, self.fixed),
            "flat": lambda: losses.tilt(svbrdf), "adversarial": adversarial})
        return values | logged | {"gradient": descend(total, self.optimizer)}

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The present maps of the generator, and the views with the fitted flash offset."""
        with torch.no_grad():
            return self._material().map(Tensor.contiguous), self._views()

    def _material(self) -> SVBRDF:
        change = level(self.generator(self.condition))
        return to_svbrdf(self.config.bsdf, {name: self.start[name] + change[name] for name in self.start},
                         self.fixed)

    def _views(self) -> Views:
        return with_flash_at(self.views, self.offset) if self.fits_offset else self.views

    def _patches(self, rendered: Tensor) -> tuple[Tensor, Tensor]:
        side = min(PATCH, self.capture.resolution)
        photo, top, left = (int(torch.randint(high, (1,), generator=self.random)) for high in (
            len(self.capture), self.capture.resolution - side + 1, self.capture.resolution - side + 1))
        cut = (slice(photo, photo + 1), slice(top, top + side), slice(left, left + side))
        fake = color.to_display(rendered[cut].float(), self.capture.transfer)  # the networks are float32
        return self.capture.photos[cut].permute(0, 3, 1, 2), fake.permute(0, 3, 1, 2)

    @property
    def parts(self) -> dict[str, Held]:
        """The networks, their optimisers, the flash offset, and random numbers."""
        plays: dict[str, Held] = {} if "adversarial" in self.unused else {
            "discriminator": self.discriminator, "judge": self.adversary}
        return {"generator": self.generator, "optimizer": self.optimizer, "offset": self.offset,
                "random": self.random, **plays}
