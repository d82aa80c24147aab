"""``gan``: the paper's method. A two-stream generator turns one photo into maps; their rendering under that photo's view
has to pass for the photo (adversarial loss) and the diffuse map has to look like the guessed one (diffuse loss).

What the paper leaves open, and what is done here: the encoder moves with the diffuse/specular decoder, once an iteration;
blends are made in linear light, and the same blend of the same views is rendered; the maps reported are those generated
from the first photo; of the first stage only the generator's weights are kept.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ... import color
from ...errors import ConfigError
from ...material.maps import SVBRDF
from ...system.profile import profiled, switch_at
from ...views import Views
from .. import losses
from ..checkpoint import load_module_state, load_optimizer_state, load_tensors, module_state, optimizer_state, part
from ..config import GanConfig
from ..method import Method, descend
from ..parameters import from_units, streams_of
from ..task import FitTask
from .networks import PatchDiscriminator, TwoStreamGenerator, seeded


class Gan(Method[GanConfig]):
    """Steps of the paper's training (III.F).

    Args:
        task: photos, guess, preset and weights.

    Raises:
        ConfigError: the pretrained checkpoint is of another size or kind.
    """

    def __init__(self, task: FitTask[GanConfig]) -> None:
        super().__init__(task)
        config, self.guess = task.config, task.guess
        self.random = torch.Generator().manual_seed(config.seed)
        with seeded(config.seed):
            streams = streams_of(config.bsdf, self.fixed, config.grey_specular)
            self.generator = TwoStreamGenerator(streams, config.width)
        self.learning_rate = config.learning_rate
        if config.pretrained:
            load_generator(self.generator, config, config.pretrained)
        first, second = config.stages
        self.first_share = 0.0 if config.pretrained else first / (first + second)
        self.stage = 1 if self.first_share > 0 else 2
        self._new_stage()

    def _new_stage(self) -> None:
        """A new discriminator and new optimisers; the generator's weights stay."""
        g = self.generator
        with seeded(self.config.seed + self.stage):
            self.discriminator = PatchDiscriminator(self.config.width)
        trained: dict[str, list[nn.Module | None]] = {
            "slow": [g.encoder, g.diffuse_specular], "fast": [g.normal_roughness], "judge": [self.discriminator]}
        parameters = {name: [p for module in modules if module is not None for p in module.parameters()]
                      for name, modules in trained.items()}
        self.optimizers = {name: torch.optim.Adam(some, lr=self.learning_rate, betas=(0.5, 0.999))
                           for name, some in parameters.items() if some}

    def step(self, progress: float) -> dict[str, float]:
        """One iteration: discriminator once, diffuse/specular and encoder once, normal/roughness several times."""
        if self.stage == 1 and progress >= self.first_share:
            self.stage = 2
            self._new_stage()
        photo, views, weights = self._draw_input()
        size = photo.shape[-1]
        with profiled("network"):
            code = self.generator.encode(photo)
            lower = self.generator.decode(1, code, size)
        logged: dict[str, float] = {}
        fast = [self.optimizers["fast"]] if "fast" in self.optimizers else []
        for substep in range(self.config.normal_roughness_steps if fast else 1):
            first = substep == 0
            if not first:
                code, lower = code.detach(), {k: v.detach() for k, v in lower.items()}
            with profiled("network"):
                units = self.generator.decode(0, code, size) | lower
                switch_at("network, backward", *units.values())
            with profiled("hand-over"):
                svbrdf = from_units(self.config.bsdf, units, self.fixed)
                switch_at("hand-over, backward", *svbrdf.maps.values())
            fake = self._picture(svbrdf, views, weights)
            with profiled("discriminator"):
                if first:
                    logged["discriminator"] = self.discriminator.learn(photo, fake.detach(), self.optimizers["judge"])
                adversarial = losses.adversarial(self.discriminator(fake))
                switch_at("discriminator, backward", adversarial)
            with profiled("losses"):
                total = adversarial
                if "diffuse" not in self.unused:
                    diffuse = losses.diffuse(svbrdf, self.guess)
                    logged["diffuse"] = float(diffuse.detach())
                    total = total + self.config.diffuse * diffuse
            with profiled("losses, backward"):
                gradient = descend(total, *fast, *([self.optimizers["slow"]] if first else []))
            logged |= {"adversarial": float(adversarial.detach()), "gradient": logged.get("gradient", 0.0) + gradient}
        return logged | {"stage": float(self.stage)}

    def _draw_input(self) -> tuple[Tensor, Views, Tensor]:
        """With equal chance one photo, or two blended with a random weight: display values, views, weights (III.F)."""
        count = 1 if self.stage == 1 else len(self.capture)
        order = torch.randperm(count, generator=self.random)
        coin, weight = torch.rand(2, generator=self.random).tolist()
        picked = order[:1] if coin < 0.5 or count == 1 else order[:2]
        weights = torch.tensor([1.0] if len(picked) == 1 else [weight, 1 - weight]).reshape(-1, 1, 1, 1)
        linear = color.decode(self.capture.photos[picked], self.capture.transfer)
        blend = (weights * linear).sum(dim=0)
        return color.encode(blend, self.capture.transfer).permute(2, 0, 1)[None], self.views.pick(picked), weights

    def _picture(self, svbrdf: SVBRDF, views: Views, weights: Tensor) -> Tensor:
        # Each view is clipped as its photo was before it is blended, so that input and rendering show the same physics.
        with profiled("renderer"):
            rendered = self.renderer.render(svbrdf, views)
            switch_at("renderer, backward", rendered)
        with profiled("losses"):
            blend = (weights * rendered.clamp(0, 1)).sum(dim=0)
            picture = color.to_display(blend, self.capture.transfer).permute(2, 0, 1)[None]
            switch_at("losses, backward", picture)
        return picture

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The maps generated from the first photo, and the views, which stay."""
        with torch.no_grad():
            units = self.generator(self.capture.photos[:1].permute(0, 3, 1, 2))
            return from_units(self.config.bsdf, units, self.fixed).map(Tensor.contiguous), self.views

    def cut_step(self) -> None:
        """Halve the step size of all optimisers."""
        self.learning_rate /= 2
        for optimizer in self.optimizers.values():
            optimizer.param_groups[0]["lr"] = self.learning_rate

    def state(self) -> dict[str, Tensor]:
        """Stage, step size, random numbers, and weights and averages of the networks."""
        state = {"random": self.random.get_state(), "stage": torch.tensor(self.stage),
                 "learning_rate": torch.tensor(self.learning_rate, dtype=torch.float64)}
        for name in ("generator", "discriminator"):
            state |= module_state(name, getattr(self, name))
        for name, optimizer in self.optimizers.items():
            state |= optimizer_state(name, optimizer)
        return state

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state."""
        self.stage = int(state["stage"])
        self.learning_rate = float(state["learning_rate"])
        self._new_stage()
        self.random.set_state(state["random"])
        for name in ("generator", "discriminator"):
            load_module_state(name, getattr(self, name), state)
        for name, optimizer in self.optimizers.items():
            load_optimizer_state(name, optimizer, state)


def load_generator(generator: TwoStreamGenerator, config: GanConfig, path: str) -> None:
    """Fill a generator from a checkpoint of ``mitsvbrdf pretrain`` or of a ``gan`` fit.

    Raises:
        ConfigError: no checkpoint, or one of another width or parameter set.
    """
    tensors, note = load_tensors(path)
    try:
        load_module_state("generator", generator, part(tensors, "method."))
    except RuntimeError:
        raise ConfigError(f"a generator of width {config.width} for {config.bsdf}",
                          f"another one in {path} (bsdf {note.get('bsdf')})",
                          "use the --width, --bsdf, --fix and --grey-specular it was pretrained with") from None
