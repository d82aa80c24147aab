"""What a fit omits, and why: known from photos, renderer and settings, or decided while the fit runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..render.needs import Omitted, scene_needs
from ..views import Views
from . import losses
from .config import HierarchicalConfig, HybridConfig
from .fixed_maps import described, unknown_but
from .gan_config import GanConfig
from .task import FitTask

if TYPE_CHECKING:
    from .hierarchical.stages import Stages

# Of the methods that solve every texel by itself.
_NO_GENERATOR = "each texel is solved by itself, and at equal time that errs less in the maps: docs/benchmark.md"
_NO_DISCRIMINATOR = "there is no generator to teach: each pixel's error says what to change"
# Parts of ``hierarchical``.
TIED, MULTI_START, VIEWS, CROSS_VALIDATION = "tied stage", "multi-start", "view refinement", "cross-validation"
LOBE = "search for a specular lobe"
FOLLOW = "the photos follow the model"


def omitted_by(task: FitTask, views: Views | None = None) -> list[Omitted]:
    """What a fit does not compute, whatever its method decides later: the renderer's list and the method's.

    Args:
        task: photos, renderer and settings.
        views: as fitted. Default: as calibrated. A flash offset found later can need the Fresnel curve.
    """
    config = task.config
    material = unknown_but(task.fixed, config.bsdf, task.capture.resolution, config.grey_specular)
    items = list(scene_needs(material, views or task.capture.views, task.renderer.name).omitted)
    items += [Omitted(f"gradient of {name}", why) for name, why in described(config.fix).items()]
    if "diffuse" in task.fixed:
        items.append(Omitted("guessed diffuse map", "diffuse held fixed"))
    items += [Omitted(losses.NAMES[name], why) for name, why in task.unused.items()]
    if config.wants_flash_offset is not None and task.why_no_flash_offset:
        items.append(Omitted("flash offset", task.why_no_flash_offset))
    if not isinstance(config, (GanConfig, HybridConfig)):
        items += [Omitted("generator", _NO_GENERATOR), Omitted("discriminator", _NO_DISCRIMINATOR)]
    elif "discriminator" not in dict(used(task)):
        items.append(Omitted("discriminator", "no loss asks for its verdict"))
    return items


def known_before(task: FitTask) -> list[Omitted]:
    """What a fit omits whatever its photos show."""
    return omitted_by(task) + (omitted_stages(task) if isinstance(task.config, HierarchicalConfig) else [])


def decided_later(task: FitTask) -> list[Omitted]:
    """What a fit decides while it runs; ``why`` says when it omits it."""
    if not isinstance(task.config, HierarchicalConfig):
        return []
    from .hierarchical.specular_test import WEAK, may_be_omitted
    from .hierarchical.stages import EXACT

    exact, matte = task.config.exact, f"no block of texels needs a lobe, and one of {WEAK:g} would show"
    if exact is not None:
        if not exact or not may_be_omitted(task):
            return []
        starts = [Omitted(MULTI_START, "without a lobe")] if _may_start_anew(task) else []
        return [Omitted(LOBE, f"if {matte}"), *starts]
    below = f"a free fit at 64 px leaves errors whose structure is below {EXACT:g}: {FOLLOW}"
    found = [Omitted(TIED, f"if {below}")]
    if may_be_omitted(task):
        found.append(Omitted(LOBE, f"if {below}; {matte}"))
    if _may_start_anew(task):
        found.append(Omitted(MULTI_START, f"unless {below}" + (", and without a lobe" if len(found) > 1 else "")))
    if task.refined == "unless exact":
        found.append(Omitted(VIEWS, f"if {below}, and so do the stated views"))
    if _may_cross_validate(task):
        found.append(Omitted(CROSS_VALIDATION, f"if {below}, or where time is short"))
    return found


def omitted_stages(task: FitTask[HierarchicalConfig], stages: Stages | None = None,
                   short: bool = False) -> list[Omitted]:
    """What ``hierarchical`` omits, as far as it is known.

    Args:
        task: of the fit.
        stages: as it stands; None before the fit.
        short: whether the views were refined less often than they should be, for lack of time.
    """
    from .hierarchical.cross_validation import FEWEST
    from .hierarchical.specular_test import WEAK
    from .hierarchical.stages import EXACT

    config, exact, why = task.config, task.config.exact, "stated by --exact"
    if exact is None and stages and stages.known:
        exact, structure = stages.exact, float(stages.unexplained[0])
        why = f"a free fit leaves errors with a structure of {structure:.2g}, {'' if exact else 'not '}below {EXACT:g}"
    items, hurried = list[tuple[str, str]](), stages is not None and stages.hurried
    if exact:
        items.append((TIED, f"{FOLLOW}: {why}"))
    if stages is not None and stages.matte:
        items.append((LOBE, f"the material is matte: no block of texels needs a lobe, and one of {WEAK:g} "
                            "would show"))
        items.append((MULTI_START, "without a lobe there is one start"))
    elif not _may_start_anew(task):
        items.append((MULTI_START, "not asked for" if not config.multi_start else "roughness held fixed"))
    elif exact is False:
        items.append((MULTI_START, f"the photos do not follow the model: {why}"))
    elif exact and hurried:
        items.append((f"further {MULTI_START}", "the fits could not have ended within their share of the time"))
    if task.refined == "never":
        items.append((VIEWS, "the views are held" if config.holds_views else "the views are a stated default"))
    elif exact and task.refined == "unless exact":
        items.append((VIEWS, f"{FOLLOW} with the stated views: {why}"))
    if exact:
        items.append((CROSS_VALIDATION, f"{FOLLOW}: what a free fit leaves is their noise"))
    elif not _may_cross_validate(task):
        items.append((CROSS_VALIDATION, "stated by --noise" if config.noise is not None
                      else f"fewer than {FEWEST} photos"))
    elif hurried:
        items.append((CROSS_VALIDATION, "it could not have ended within its share of the time"))
    if short:
        items.append((f"further {VIEWS}", "it could not have ended within the budget"))
    return [Omitted(*item) for item in items]


def _may_cross_validate(task: FitTask[HierarchicalConfig]) -> bool:
    from .hierarchical.cross_validation import FEWEST

    return task.config.noise is None and len(task.capture) >= FEWEST


def _may_start_anew(task: FitTask[HierarchicalConfig]) -> bool:
    return task.config.multi_start and "roughness" not in task.fixed


def used(task: FitTask) -> list[tuple[str, str]]:
    """The networks that a fit trains, as (what, how): a generator and perhaps a discriminator, or none."""
    config = task.config
    if isinstance(config, HybridConfig):
        items = [("generator", "sees all photos; its maps are compared with each of them; width "
                               f"{config.width}")]
        verdicts = {"adversarial": config.adversarial}
    elif isinstance(config, GanConfig):
        sees = ("all photos" if config.generator != "two-stream"
                else "the first of the pictures its maps are compared with")
        items = [("generator", f"sees {sees}; width {config.width}")]
        verdicts = {"adversarial": config.adversarial, "features": config.features}
    else:
        return []
    weights = [f"{losses.NAMES[name]}, weight {weight:g}" for name, weight in verdicts.items()
               if name not in task.unused]
    if weights:
        game = f"; game {config.game}" if isinstance(config, GanConfig) else ""
        items.append(("discriminator", f"{' and '.join(weights)}{game}"))
    return items
