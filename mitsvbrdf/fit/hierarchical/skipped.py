"""Which parts of the fit are skipped, as these photos do not need them: known before it, or decided by the
free stage.
"""

from __future__ import annotations

from ..config import HierarchicalConfig
from ..task import FitTask
from .left_out import FEWEST
from .matte import WEAK, may_be_left_out
from .stages import EXACT, Stages

TIED, RIVALS, VIEWS, IN_TURN = "tied stage", "rival starts", "view refinement", "photos left out in turn"
LOBE = "search for a specular lobe"
FOLLOW = "the photos follow the model"


def decided_later(task: FitTask[HierarchicalConfig]) -> list[tuple[str, str]]:
    """What the fit decides while it runs, as (what it may leave out, when).

    Args:
        task: of the fit.
    """
    exact = task.config.exact
    matte = f"no block of texels needs a lobe, and one of {WEAK:g} would show"
    if exact is not None:
        if not exact or not may_be_left_out(task):
            return []
        return [(LOBE, f"if {matte}"), *([(RIVALS, "without a lobe")] if _may_rival(task) else [])]
    below = f"a free fit at 64 px leaves errors whose structure is below {EXACT:g}: {FOLLOW}"
    lobe = [(LOBE, f"if {below}; {matte}")] if may_be_left_out(task) else []
    rivals = ([(RIVALS, f"unless {below}" + (", and without a lobe" if lobe else ""))] if _may_rival(task)
              else [])
    views = [(VIEWS, f"if {below}, and so do the stated views")] if task.refined == "unless exact" else []
    turns = [(IN_TURN, f"if {below}, or where time is short")] if _may_take_turns(task) else []
    return [(TIED, f"if {below}"), *lobe, *rivals, *views, *turns]


def left_out(task: FitTask[HierarchicalConfig], stages: Stages | None = None,
             short: bool = False) -> list[tuple[str, str]]:
    """What the fit leaves out, as (what, why), as far as it is known.

    Args:
        task: of the fit.
        stages: as it stands; None before the fit.
        short: whether the views were refined less often than they should be, for lack of time.
    """
    config, exact, why = task.config, task.config.exact, "stated by --exact"
    if exact is None and stages and stages.known:
        exact, structure = stages.exact, float(stages.unexplained[0])
        why = f"a free fit leaves errors with a structure of {structure:.2g}, {'' if exact else 'not '}below {EXACT:g}"
    items, matte = [], stages is not None and stages.matte
    if exact:
        items.append((TIED, f"{FOLLOW}: {why}"))
    if matte:
        items.append((LOBE, f"the material is matte: no block of texels needs a lobe, and one of {WEAK:g} "
                            "would show"))
        items.append((RIVALS, "without a lobe there is one start"))
    elif not _may_rival(task):
        items.append((RIVALS, "not asked for" if not config.rivals else "roughness held fixed"))
    elif exact is False:
        items.append((RIVALS, f"the photos do not follow the model: {why}"))
    elif exact and stages and stages.hurried:
        items.append((f"further {RIVALS}", "they could not have ended within their share of the time"))
    if task.refined == "never":
        items.append((VIEWS, "the views are held" if config.holds_views
                      else "the views are a stated default"))
    elif exact and task.refined == "unless exact":
        items.append((VIEWS, f"{FOLLOW} with the stated views: {why}"))
    if exact:
        items.append((IN_TURN, f"{FOLLOW}: what a free fit leaves is their noise"))
    elif not _may_take_turns(task):
        items.append((IN_TURN, "stated by --noise" if config.noise is not None else f"fewer than {FEWEST} "
                                                                                    "photos"))
    elif stages and stages.hurried:
        items.append((IN_TURN, "it could not have ended within its share of the time"))
    if short:
        items.append((f"further {VIEWS}", "it could not have ended within the budget"))
    return items


def _may_take_turns(task: FitTask[HierarchicalConfig]) -> bool:
    return task.config.noise is None and len(task.capture) >= FEWEST


def _may_rival(task: FitTask[HierarchicalConfig]) -> bool:
    return task.config.rivals and "roughness" not in task.fixed
