"""The parts that ``hierarchical`` omits for these photos: known before the fit, or after its first stage."""

from ...render.needs import Omitted
from ..config import HierarchicalConfig
from ..task import FitTask
from .cross_validation import FEWEST
from .specular_test import WEAK, may_be_omitted
from .stages import EXACT, Stages

TIED, MULTI_START = "tied stage", "multi-start"
VIEWS, CROSS_VALIDATION = "view refinement", "cross-validation"
LOBE = "search for a specular lobe"
FOLLOW = "the photos follow the model"
MATTE = f"no block of texels needs a lobe, and a lobe of specular {WEAK:g} would show"


def decided_later(task: FitTask[HierarchicalConfig]) -> list[Omitted]:
    """The parts that a fit may omit while it runs; ``why`` is the condition."""
    below = f"a free, coarse fit leaves errors whose structure is below {EXACT:g}: {FOLLOW}"
    stated, lobe, anew = task.config.exact, may_be_omitted(task), _may_start_anew(task)
    if stated is not None:
        told = [(lobe, LOBE, f"if {MATTE}"), (lobe and anew, MULTI_START, "without a lobe")] if stated else []
    else:
        told = [(True, TIED, f"if {below}"), (lobe, LOBE, f"if {below}; {MATTE}"),
                (anew, MULTI_START, f"unless {below}" + (", and without a lobe" if lobe else "")),
                (task.refined == "unless exact", VIEWS, f"if {below} with the stated views"),
                (_may_cross_validate(task), CROSS_VALIDATION, f"if {below}, or where time is short")]
    return [Omitted(what, why) for holds, what, why in told if holds]


def omitted_stages(task: FitTask[HierarchicalConfig], stages: Stages | None = None,
                   short: bool = False) -> list[Omitted]:
    """The parts that ``hierarchical`` omits, as far as this is known.

    Args:
        stages: the present state of the fit; None before the fit.
        short: whether a refinement of the views was omitted for lack of time.
    """
    config, exact, why = task.config, task.config.exact, "stated by --exact"
    if exact is None and stages and stages.known:
        exact, structure = stages.exact, float(stages.unexplained[0])
        below = "below" if exact else "not below"
        why = f"a free fit leaves errors with a structure of {structure:.3g}, {below} {EXACT:g}"
    items, hurried = list[tuple[str, str]](), stages is not None and stages.hurried
    if exact:
        items.append((TIED, f"{FOLLOW}: {why}"))
    if stages is not None and stages.matte:
        items.append((LOBE, f"the material is matte: {MATTE}"))
        items.append((MULTI_START, "without a lobe there is one start"))
    elif not _may_start_anew(task):
        items.append((MULTI_START, "not asked for" if not config.multi_start else "roughness held fixed"))
    elif exact is False:
        items.append((MULTI_START, f"the photos do not follow the model: {why}"))
    elif exact and hurried:
        items.append((f"further {MULTI_START}",
                      "the fits could not have ended within their share of the time"))
    if task.refined == "never":
        items.append((VIEWS, "the views are held" if config.holds_views
                      else "the views are a stated default"))
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
    return task.config.noise is None and len(task.capture) >= FEWEST


def _may_start_anew(task: FitTask[HierarchicalConfig]) -> bool:
    return task.config.multi_start and "roughness" not in task.fixed
