"""``gan``, the paper's method: a discriminator compares renderings of the generated maps with the photos.

The paper's presets and ours are the same code; each ingredient is a setting of
:class:`mitsvbrdf.fit.GanConfig`. The paper leaves some details open. Here the encoder is trained with the
diffuse/specular decoder, once an iteration. Photos are blended in linear light, and renderings of the same
views are blended in the same way. The reported maps are those generated from the first photo. The second
stage takes over only the generator's weights.
"""

import itertools

import torch
from torch import Tensor, nn

from ...errors import ConfigError
from ...material.maps import SVBRDF
from ...material.resample import enlarged
from ...views import Views
from .. import losses
from ..checkpoint import Held, load_parts, load_tensors, part
from ..gan_config import GanConfig, Phase
from ..method import Method, descend
from ..parameters import Streams, from_units, streams_of
from ..task import FitTask
from .conditioning import Conditioning, level, with_flash_at
from .networks import AllPhotosGenerator, PatchDiscriminator, TwoStreamGenerator, frozen, seeded
from .pictures import Pictures, PictureSource, seen_through


class Gan(Method[GanConfig]):
    """Training (paper, III.F). ConfigError: the pretrained checkpoint is of another size or kind."""

    def __init__(self, task: FitTask[GanConfig]) -> None:
        super().__init__(task)
        config = self.config
        self.task = task
        self.streams = streams_of(config.bsdf, self.fixed, config.grey_specular)
        self.start = None if config.begins == "untrained" else task.start()
        self.random = torch.Generator().manual_seed(config.seed)
        # features and maps that later substeps do not change
        self.resting: tuple[Tensor, dict[str, Tensor]] | None = None
        self.offset = torch.zeros(2, dtype=torch.float64, requires_grad=True)  # of the flash, in patch sides
        self.phases = config.phases(self.capture.resolution)
        self.whole = self._scale(Phase(1.0), {})  # the result is of this size
        self.generator = make_generator(config, self.streams, self.whole.condition.shape[1])
        self._begin(0, {})

    def _rate(self, name: str) -> float:
        return self.pace * (self.config.discriminator_rate if name == "judge" else self.config.learning_rate)

    def _scale(self, phase: Phase, carried: dict[str, Tensor]) -> Conditioning:
        capture = (self.capture if phase.photos is None
                   else self.capture.pick(self.capture.index[:phase.photos]))
        return Conditioning(self.task, capture, capture.resolution >> phase.halvings, self.streams,
                            self.start, carried)

    def _begin(self, phase: int, carried: dict[str, Tensor]) -> None:
        """Begin a phase with a new discriminator and new optimisers; the generator's weights stay."""
        config, g = self.config, self.generator
        self.phase, self.scale = phase, self._scale(self.phases[phase], carried)
        self.source = PictureSource(self.scale.capture, config.crop)
        with seeded(config.seed + 1 + phase):
            self.discriminator = PatchDiscriminator(config.width, 6 if config.paired else 3)
        trained: dict[str, list[nn.Module | None]] = {"slow": [g]}
        if isinstance(g, TwoStreamGenerator):
            trained = {"slow": [g.encoder, g.diffuse_specular], "fast": [g.normal_roughness]}
        groups: dict[str, list[Tensor]] = {
            name: [p for module in modules if module is not None for p in module.parameters()]
            for name, modules in (trained | {"judge": [self.discriminator]}).items()}
        if self.fits_offset:
            groups["flash"] = [self.offset]
        self.optimizers = {name: torch.optim.Adam(some, lr=self._rate(name), betas=(0.5, 0.999), fused=True)
                           for name, some in groups.items() if some}

    def step(self, progress: float) -> dict[str, float]:
        """One discriminator step, then one of the generator; its normal/roughness decoder may do several."""
        self._enter_phase(progress)
        for name, optimizer in self.optimizers.items():
            optimizer.param_groups[0]["lr"] = self._rate(name)
        logged: dict[str, float] = {}
        pictures = self.source.draw(self.config.pictures, self.random)
        for substep in range(self.config.normal_roughness_steps if "fast" in self.optimizers else 1):
            if substep < 2:
                self.resting = None  # the first substep moves the encoder
            self._substep(pictures, substep == 0, logged)
        return logged | {"phase": float(self.phase)}

    def _enter_phase(self, progress: float) -> None:
        """Begin the phase at ``progress``, never an earlier one: a resumed run may have a higher limit."""
        begins = list(itertools.accumulate((phase.share for phase in self.phases[:-1]), initial=0.0))
        present = max(number for number, begin in enumerate(begins) if progress >= begin)
        if present > self.phase:
            grown = self.phases[present].halvings != self.phases[self.phase].halvings
            change = self._change() if grown and self.config.begins != "untrained" else {}
            if change:
                self.generator.begin_change()
            self._begin(present, change)

    def _substep(self, pictures: Pictures, first: bool, logged: dict[str, float]) -> None:
        svbrdf, total = self._material(pictures, first), torch.zeros(())
        if not {"adversarial", "features"} <= set(self.unused):
            fake, told = self._rendered(svbrdf, pictures), self._told(pictures)
            if first:
                logged["discriminator"] = self.discriminator.learn(
                    pictures.shown, fake.detach(), self.optimizers["judge"], self.config.game, told)
            with frozen(self.discriminator):
                total, values = self._verdict(pictures.shown, fake, told)
            logged |= values
        if first:
            guess = self.scale.guess[pictures.window]
            own, values = self.summed({"diffuse": lambda: losses.diffuse(svbrdf, guess),
                "smooth": lambda: losses.total_variation(svbrdf, losses.edge_weights(guess), self.fixed)})
            total = total + own
            logged |= values
        if total.requires_grad:
            moved = [name for name in ("fast", "slow", "flash") if name in self.optimizers
                     and (first or name == "fast")]
            gradient = descend(total, *(self.optimizers[name] for name in moved))
            logged["gradient"] = logged.get("gradient", 0.0) + gradient

    def _material(self, pictures: Pictures, first: bool = True) -> SVBRDF:
        """The generated maps; in later substeps only normal and roughness have gradients."""
        change = self._out(pictures, first)
        fixed = {name: value[pictures.window] for name, value in self.scale.fixed.items()}
        return from_units(self.config.bsdf, self.scale.units(change, pictures.window), fixed)

    def _out(self, pictures: Pictures, first: bool = True) -> dict[str, Tensor]:
        """Output of the generator before Tanh, in the window of the pictures."""
        g, side = self.generator, pictures.shown.shape[-1]
        if isinstance(g, TwoStreamGenerator):
            if first or self.resting is None:
                with torch.set_grad_enabled(first and torch.is_grad_enabled()):
                    code = g.encode(pictures.shown[:1])
                    self.resting = code, g.decode(1, code, side)
            out = g.decode(0, self.resting[0], side) | self.resting[1]
        else:
            out = g(self.scale.condition[..., *pictures.window])
        return level(out) if self.fits_offset else out

    def _rendered(self, svbrdf: SVBRDF, pictures: Pictures) -> Tensor:
        views = seen_through(pictures.window, self._views(), self.scale.capture.resolution)
        rendered = self.renderer.render(svbrdf, views.pick(pictures.index))
        return pictures.of(rendered.float())  # the networks are float32, analytic64 is not

    def _told(self, pictures: Pictures) -> Tensor | None:
        """The photos, as a second input of the discriminator, in [-1, 1]; None if it has no second input."""
        return pictures.shown * 2 - 1 if self.config.paired else None

    def _verdict(self, shown: Tensor, fake: Tensor, told: Tensor | None) -> tuple[Tensor, dict[str, float]]:
        """Weighted sum and values of the generator's losses that use the discriminator."""
        seen = self.discriminator.activations(fake, told)
        with torch.no_grad():
            real = (self.discriminator.activations(shown, told)
                    if self.config.game == "relativistic" or "features" not in self.unused else seen)
        return self.summed({"adversarial": lambda: losses.adversarial(real[-1], seen[-1], self.config.game),
                            "features": lambda: losses.features(real[:-1], seen[:-1])})

    def _views(self) -> Views:
        return with_flash_at(self.views, self.offset) if self.fits_offset else self.views

    def estimate(self) -> tuple[SVBRDF, Views]:
        """The maps generated from the first photo or from all, at full size, and the fitted views."""
        with torch.no_grad():
            change = {name: enlarged(value, self.capture.resolution)
                      for name, value in self._change().items()}
            maps = from_units(self.config.bsdf, self.whole.units(change), self.fixed)
            return maps.map(Tensor.contiguous), self._views()

    def _change(self) -> dict[str, Tensor]:
        """The present change to the start, before Tanh, at the resolution of the phase."""
        with torch.no_grad():
            out = self._out(self.source.whole())
            return {name: value + self.scale.carried[name] if self.scale.carried else value
                    for name, value in out.items()}

    @property
    def parts(self) -> dict[str, Held]:
        """Random numbers, the flash offset, and the networks and optimisers of the phase."""
        return {"random": self.random, "offset": self.offset, "generator": self.generator,
                "discriminator": self.discriminator, **self.optimizers}

    def state(self) -> dict[str, Tensor]:
        """The state of the parts, the phase, and the change carried into the phase."""
        begun = {f"carried.{name}": value for name, value in self.scale.carried.items()}
        return super().state() | begun | {"phase": torch.tensor(self.phase)}

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Go on from a saved state, in its phase."""
        self._begin(int(state["phase"]), part(state, "carried."))
        super().load_state(state)


def make_generator(config: GanConfig, streams: Streams,
                   inputs: int) -> AllPhotosGenerator | TwoStreamGenerator:
    """A generator with the weights of its seed, or those of a checkpoint (``--pretrain`` or ``gan`` fit).

    ConfigError: no checkpoint, or one of another width or parameter set.
    """
    change = config.begins != "untrained"
    with seeded(config.seed):
        generator: AllPhotosGenerator | TwoStreamGenerator = (
            TwoStreamGenerator(streams, config.width, change) if config.generator == "two-stream" else
            AllPhotosGenerator(inputs, streams, config.width, change))
    if config.pretrained:
        tensors, note = load_tensors(config.pretrained)
        try:
            load_parts({"generator": generator}, part(tensors, "method."))
        except RuntimeError:
            raise ConfigError(f"a generator of width {config.width} for {config.bsdf}",
                              f"another one in {config.pretrained} (bsdf {note.get('bsdf')})",
                              "use the --width, --bsdf, --generator, --fix and --grey-specular it was "
                              "pretrained with") from None
    return generator
