"""What a fit omits, and why: known from photos, renderer and settings, or decided while the fit runs."""

from ..render.needs import Omitted, scene_needs
from ..views import Views
from . import losses
from .config import HierarchicalConfig, HybridConfig
from .detail_config import DetailConfig
from .fixed_maps import described, unknown_but
from .gan_config import FEWEST, GanConfig
from .generator.highlight_discriminator import PATCH
from .hierarchical.omitted import decided_later, omitted_stages
from .posterior import step_of
from .task import FitTask

# Reasons, for methods that solve every texel by itself.
_NO_GENERATOR = ("each texel is solved by itself, which gives smaller errors of the maps at equal time: "
                 "docs/results/benchmark.md")
TOO_LITTLE = f"fewer than {FEWEST} photos, or than {PATCH} pixels a side: too few to hold some out"
_LOOKS = "texels are means over look classes of the photo"
_NO_DISCRIMINATOR = "there is no generator to teach: each pixel's error says what to change"


def omitted_by(task: FitTask, views: Views | None = None) -> list[Omitted]:
    """What a fit does not compute, by renderer, settings and photos, before its method decides on more.

    ``views``: the fitted ones; default: the capture's. A fitted flash offset can need the Fresnel curve.
    """
    config = task.config
    material = unknown_but(task.fixed, config.bsdf, task.capture.resolution, config.grey_specular)
    items = list(scene_needs(material, views or task.capture.views, task.renderer.name).omitted)
    items += [Omitted(f"gradient of {name}", why) for name, why in described(config.fix).items()]
    if (step := step_of(task.capture.resolution)) > 1:
        items.append(Omitted(f"the likelihood profile of more than one texel in {step} a side",
                             "other deviations are by curvature, times what the profiles nearby add"))
    if "diffuse" in task.fixed:
        items.append(Omitted("guessed diffuse map", "diffuse held fixed"))
    items += [Omitted(losses.NAMES[name], why) for name, why in task.unused.items()]
    if config.wants_flash_offset is not None and task.why_no_flash_offset:
        items.append(Omitted("flash offset", task.why_no_flash_offset))
    if not isinstance(config, (GanConfig, HybridConfig)):
        items += [Omitted("generator", _LOOKS if task.of_looks else _NO_GENERATOR),
                  Omitted("discriminator", _NO_DISCRIMINATOR)]
    elif not used(task):
        items += [Omitted(what, TOO_LITTLE) for what in ("generator", "discriminator")]
    elif "discriminator" not in dict(used(task)):
        items.append(Omitted("discriminator", "no loss asks for its verdict"))
    return items


def explained(task: FitTask) -> tuple[list[Omitted], list[Omitted]]:
    """Two lists: what a fit omits in any case; what it may omit, with the condition in ``why``."""
    if not isinstance(task.config, HierarchicalConfig) or task.of_looks:
        return omitted_by(task), []
    return omitted_by(task) + omitted_stages(task), decided_later(task)


def used(task: FitTask) -> list[tuple[str, str]]:
    """The networks that a fit trains, as (what, how): a generator and perhaps a discriminator, or none."""
    config, weights = task.config, task.config.weights
    if isinstance(config, HybridConfig):
        does = f"sees all photos; its maps are compared with each of them; width {config.width}"
        game = ""
    elif isinstance(config, GanConfig) and config.begins == "solved":
        if len(task.capture) < FEWEST or task.capture.resolution < PATCH:
            return []
        does = f"changes solved maps within what photos leave open; width {DetailConfig.width}"
        game = "; under novel lights"
    elif isinstance(config, GanConfig):
        sees = ("all photos" if config.generator != "two-stream"
                else "the first of the pictures its maps are compared with")
        does, game = f"sees {sees}; width {config.width}", f"; game {config.game}"
    else:
        return []
    verdicts = [f"{losses.NAMES[name]}, weight {weights[name]:g}" for name in ("adversarial", "features")
                if name in weights and name not in task.unused]
    judged = [("discriminator", f"{' and '.join(verdicts)}{game}")] if verdicts else []
    return [("generator", does), *judged]
