"""Plausible detail: one random draw of what no photo shows, for pictures. The solved maps do not change.

If no photo shows a texel's highlight, its maps are expected values or the last ones of the solver. A
rendering under a new light then does not look like a photo. A small generator changes the solved maps, each
value within a bound from its standard deviation in the fit. The fit's renderer renders the changed maps
under novel lights (:mod:`.novel_lights`). Two criteria compare renderings with photos of other pieces of
the material under the same light (:mod:`.highlight_discriminator`): a relativistic discriminator, which
also sees the half vectors and the diffuse part, and the distance between projected patches. Two more losses
keep the renderings near the photos seen, and the diffuse map near the solved one.
"""

import time
from dataclasses import asdict, replace

import torch
from torch import Tensor
from torch.nn.utils import convert_conv2d_weight_memory_format

from ... import color
from ...capture import Capture
from ...io import Report
from ...io.entry import entry
from ...io.signals import stop_signals
from ...material.maps import SVBRDF, numbers_of
from ...measure.rerender import rerender
from ...render import Renderer
from ...views import Views, geometry
from .. import losses
from ..checkpoint import Held
from ..detail_config import DetailConfig
from ..method import Trained, cosine, descend
from ..parameters import STREAMS
from ..result import Fit
from .bounded import Bounded
from .highlight_discriminator import PATCH, HighlightDiscriminator, patch_distance
from .networks import AllPhotosGenerator, seeded
from .novel_lights import NovelLight, draw, novel_views

WHAT = ("detail/ is one plausible draw of what no photo shows, for pictures; maps/ holds the expected "
        "values, for validation, and is the same with and without it")
NOISE = 4  # channels of noise that the generator sees
VIEW_SCALE = 10.0  # scales 1 - z of half vectors (some hundredths) to the size of display values
SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0)  # of the generator's change, tried in this order


@entry(gradients=True)
def with_detail(result: Fit, capture: Capture, renderer: Renderer, config: DetailConfig | None = None,
                report: Report = lambda text, share: None) -> Fit:
    """A fit with plausible detail beside its unchanged maps. ``capture``: the photos of the fit.

    Returns a copy of the fit with ``detail`` and ``detail_record``. After Ctrl-C, or if :func:`why_not` gives
    a reason, returns the given fit itself. ConfigError: settings out of range.
    """
    config = config or DetailConfig()
    config.check()
    if why_not(result):
        return result
    began = time.perf_counter()
    bounded = Bounded.of(result.svbrdf, result.views, result.deviations, config.reach, config.certain)
    training = DetailTraining(bounded, capture.through(result.transfer), renderer, config)
    with stop_signals() as stopped:
        for step in range(config.steps):
            training.step(step / config.steps)
            report(f"step {step + 1}", (step + 1) / config.steps)
            if stopped:
                return result
    with torch.no_grad():
        share, detail, (_, total, each) = training.weakened(config.worst * result.rerender_rmse)
    return result.but(detail=detail, detail_record={
        "what": WHAT, "config": asdict(config), "steps": config.steps, "share": share,
        "seconds": round(time.perf_counter() - began, 3), "rerender_rmse": total,
        "per_photo": dict(zip(capture.names, each))})


def why_not(result: Fit) -> str | None:
    """The reason why a fit cannot have plausible detail; None if it can."""
    if result.stopped == "interrupted":
        return "the fit was interrupted"
    if not result.deviations:
        return "its bounds are deviations, which need Mitsuba"
    if result.svbrdf.resolution < PATCH:
        return f"the maps have fewer than {PATCH} texels a side: no patch can be compared"
    camera = result.views.in_patch_sides().camera[:, :2]
    still = (camera.amax(dim=0) - camera.amin(dim=0)).max() < 1e-3
    return ("the photos have one view: nothing says how the material looks under another"
            if still and not result.record.get("repeats", {}).get("stationary") else None)


class DetailTraining(Trained):
    """Steps of the training. The solved maps are the start; they may change within their bounds."""

    def __init__(self, bounded: Bounded, capture: Capture, renderer: Renderer, config: DetailConfig) -> None:
        self.capture, self.renderer, self.config, self.bounded = capture, renderer, config, bounded
        self.solved, self.views = bounded.svbrdf, bounded.views
        size = capture.resolution
        self.side = max(min(size, 2 * PATCH), round(config.crop * size))
        self.random = torch.Generator().manual_seed(config.seed)
        bounds = bounded.bounds
        condition = [2 * numbers_of(name, self.solved[name]) - 1 for name in bounds] + list(bounds.values())
        streams = tuple({name: bounds[name].shape[-1] for name in stream if name in bounds}
                        for stream in STREAMS[self.solved.bsdf])
        with seeded(config.seed):
            condition.append(torch.randn(size, size, NOISE))
            inputs = torch.cat(condition, dim=-1).permute(2, 0, 1)[None]
            self.condition = inputs.contiguous(memory_format=torch.channels_last)
            generator = AllPhotosGenerator(self.condition.shape[1], (streams[0], streams[1]), config.width)
            self.discriminator = HighlightDiscriminator(8, config.discriminator_width)
        self.generator = convert_conv2d_weight_memory_format(generator, torch.channels_last)
        self.optimizer = torch.optim.Adam(self.generator.parameters(), betas=(0.5, 0.99))
        self.adversary = torch.optim.Adam(self.discriminator.parameters(), betas=(0.5, 0.99))
        self.albedo = color.encode(self.solved.as_roughconductor()["diffuse"])
        self.matte = matte(self.solved)
        self.half = geometry(self.views, size)[1]
        self.matte_photos = self._shown(self.matte, self.views)

    def weakened(self, worst: float) -> tuple[float, SVBRDF, tuple[Tensor, float, list[float]]]:
        """The largest of SHARES with RMSE up to ``worst`` (else 0), its maps, :func:`rerender` of these."""
        for share in SHARES:
            detail = self.material(share).map(Tensor.contiguous)
            met = rerender(self.renderer, detail, self.views, self.capture)
            if met[1] <= worst:
                break
        return share, detail.check(), met

    def material(self, share: float = 1.0) -> SVBRDF:
        """The solved maps plus a share of the present change. Values with bound 0 stay exactly as solved."""
        return self.bounded.moved(self.change(), share)

    def change(self) -> dict[str, Tensor]:
        """Present output of the generator: map name to C x R x R. Its Tanh times the bound is the change."""
        return self.generator(self.condition)

    def step(self, progress: float) -> dict[str, float]:
        """One step of both networks; returns the losses before it. ``progress``: 0 to 1, share of the run."""
        config = self.config
        self.optimizer.param_groups[0]["lr"] = self.pace * config.learning_rate * cosine(progress)
        self.adversary.param_groups[0]["lr"] = self.pace * config.discriminator_rate * cosine(progress)
        lights = [draw(self.views, self.albedo, self.side, config.tries, self.random)
                  for _ in range(config.lights)]
        moved = novel_views(self.views, lights, self.capture.resolution)
        seen = torch.randperm(len(self.capture), generator=self.random)[:config.seen]
        svbrdf = self.material()
        rendered = self.renderer.render(svbrdf, joined(moved, self.views.pick(seen)))
        new, known = rendered[:len(lights)], rendered[len(lights):]

        fake = torch.stack([light.under_it(image, self.side) for light, image in zip(
            lights, color.to_display(new, self.capture.transfer))])
        real = self._in_photos(lights, self.capture.photos)
        if (measured := self.capture.measured) is not None:  # masked pixels have no error
            known = torch.where(measured[seen][..., None], known, self.capture.linear[seen])
            fake = torch.where(self._in_photos(lights, measured)[..., None], fake, real)
        half = self._in_photos(lights, self.half)
        lean = half[..., :2].norm(dim=-1, keepdim=True)
        angles = torch.cat((VIEW_SCALE * (1 - half[..., 2:]), lean), dim=-1)
        matte = self._shown(self.matte, moved)
        under = torch.stack([light.under_it(image, self.side) for light, image in zip(lights, matte)])
        shown = _input(fake, under, angles)
        photo = _input(real, self._in_photos(lights, self.matte_photos), angles)
        loss = losses.discriminator(self.discriminator(photo), self.discriminator(shown.detach()),
                                    "relativistic")
        logged = {"discriminator": float(loss.detach()) + descend(loss, self.adversary)}
        with torch.no_grad():
            verdict = self.discriminator(photo)
        terms = {"adversarial": losses.adversarial(verdict, self.discriminator(shown), "relativistic"),
                 "patches": patch_distance(fake, real, lean[..., 0], self.random),
                 "photometric": losses.photometric(known, self.capture.photos[seen], self.capture.transfer),
                 "diffuse": losses.diffuse(svbrdf, self.solved.as_roughconductor()["diffuse"])}
        total = losses.weighted(terms, {name: getattr(config, name) for name in terms})
        logged |= {name: float(value.detach()) for name, value in terms.items()}
        return logged | {"gradient": descend(total, self.optimizer)}

    @property
    def parts(self) -> dict[str, Held]:
        """Random numbers, the networks, and their optimisers."""
        return {"random": self.random, "generator": self.generator, "slow": self.optimizer,
                "judge": self.discriminator, "fast": self.adversary}

    def _in_photos(self, lights: list[NovelLight], pictures: Tensor) -> Tensor:
        return torch.stack([light.in_photo(pictures[light.photo], self.side) for light in lights])

    def _shown(self, svbrdf: SVBRDF, views: Views) -> Tensor:
        with torch.no_grad():
            return color.to_display(self.renderer.render(svbrdf, views), self.capture.transfer)


def matte(svbrdf: SVBRDF) -> SVBRDF:
    """The material without its highlights: diffuse map and normals stay, specular is 0."""
    maps = dict(svbrdf.as_roughconductor().maps)
    return SVBRDF("roughconductor", maps | {"specular": torch.zeros_like(maps["specular"])})


def joined(first: Views, second: Views) -> Views:
    """Two sets of views of one patch, joined in this order."""
    return replace(first, camera=torch.cat((first.camera, second.camera)),
                   light=torch.cat((first.light, second.light)),
                   intensity=torch.cat((first.intensity, second.intensity)))


def _input(picture: Tensor, matte: Tensor, angles: Tensor) -> Tensor:
    """Input of the discriminator, N x 8 x H x W: picture and diffuse part in [-1, 1], half vectors."""
    return torch.cat((2 * picture - 1, 2 * matte - 1, angles), dim=-1).permute(0, 3, 1, 2)
