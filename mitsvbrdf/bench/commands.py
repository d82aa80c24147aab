"""The commands that make the records of a benchmark again, one for each suite."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Mapping, Sequence

from . import summary
from .behaviour import record_draws
from .schema import USUAL_LEFT_OUT
from .variants import FULL, ablations


def commands(record: Mapping) -> list[str]:
    """Lines to type; the suites in the order in which they stand here."""
    made = []
    for suite, options in {"renderers": _renderers, "methods": _fits, "start": _start, "ablation": _fits,
                           "gan": _fits,
                           "capture": _capture, "schedule": _schedule, "steps": _steps,
                           "sheets": _sheets}.items():
        here = [r for r in record["records"] if r["suite"] == suite]
        quick = " --quick" if record["settings"]["quick"] else ""
        made += [f"mitsvbrdf bench --suite {suite}{quick} "
                 f"{options(record['settings'], alike)}{_left_out(alike)}"
                 for alike in _alike(here)]
    return made


def _alike(here: Sequence[Mapping]) -> list[list[Mapping]]:
    """The records of a suite that one command makes.

    Those of long runs are apart by size, width and iterations, fits by the photos left out and, of each
    method, by the budgets that had the same seeds.
    """
    groups: dict[tuple, list[Mapping]] = {}
    usual = next(iter(summary.ways_to_leave_out(here)), ())
    together = _together([r for r in here if r["suite"] in summary.FIT_SUITES])
    for r in here:
        own: tuple = ((r["config"]["resolution"], r["config"]["width"], r["iterations"])
                      if r["suite"] == "schedule" else ())
        if r["suite"] in summary.FIT_SUITES:
            own = together[_series(r), r["budget"]]
        groups.setdefault((*own, tuple(r.get("left_out", usual))), []).append(r)
    return list(groups.values())


def _series(r: Mapping) -> tuple:
    """What the fits of a method are of."""
    return r["method"], r["kind"], tuple(r.get("left_out", ()))


def _together(fits: Sequence[Mapping]) -> dict[tuple, tuple]:
    """Series and budget -> its seeds, of a method that draws none those of the others, and all budgets that
    had the same.
    """
    own, drawn = defaultdict(set), defaultdict(set)
    for r in summary.with_repeats(fits):
        own[_series(r), r["budget"]].add(r["seed"])
        if record_draws(r):
            drawn[_series(r)[1:], r["budget"]].add(r["seed"])
    draws = {_series(r) for r in fits if record_draws(r)}
    seeds = {(series, budget): tuple(sorted(drawn[series[1:], budget] if series not in draws else found)
                                     or sorted(found))
             for (series, budget), found in own.items()}
    budgets = defaultdict(list)
    for (series, budget), found in seeds.items():
        budgets[series, found].append(budget)
    return {(series, budget): (found, tuple(sorted(budgets[series, found]))) for (series,
                                                                                  budget), found in seeds.items()}


def _renderers(settings: Mapping, here: Sequence[Mapping]) -> str:
    return f"--repeats {here[0]['config']['repeats']}"


def _steps(settings: Mapping, here: Sequence[Mapping]) -> str:
    return f"--repeats {here[0]['config']['repeats']} --resolution {settings['resolution']} --views {settings['views']}"


def _fits(settings: Mapping, here: Sequence[Mapping]) -> str:
    suite, methods = here[0]["suite"], list(dict.fromkeys(r["method"] for r in here))
    picked = f" --methods {','.join(methods)}" if suite == "methods" else ""
    if suite != "methods" and set(methods) != {FULL, *ablations()[suite].variants}:
        picked = f" --variants {shlex.quote(','.join(name for name in methods if name != FULL))}"
    times = summary.budgets(summary.with_repeats(here))
    return (f"{_named(here)}{picked} --budgets {','.join(f'{b:g}' for b in times)} {_seeds(here)} "
            f"--resolution {settings['resolution']} --views {settings['views']}")


def _capture(settings: Mapping, here: Sequence[Mapping]) -> str:
    config = here[0]["config"]
    return (f"{_named(here)} --budgets {config['budget']:g} --seeds {config['seed']} --megapixels "
            f"{config['megapixels']:g} "
            f"--resolution {settings['resolution']}")


def _schedule(settings: Mapping, here: Sequence[Mapping]) -> str:
    config = here[0]["config"]
    methods = ",".join(dict.fromkeys(r["method"] for r in here))
    return (f"{_named(here)} --methods {methods} --iterations {here[0]['iterations']} --schedule-size "
            f"{config['resolution']} "
            f"--schedule-width {config['width']} {_seeds(here)} --resolution {settings['resolution']} "
            f"--views {settings['views']}")


def _sheets(settings: Mapping, here: Sequence[Mapping]) -> str:
    config = here[0]["config"]
    return (f"{_named(here)} --methods {','.join(config['methods'])} --budgets {config['budget']:g} --seeds "
            f"{config['seed']} "
            f"--resolution {settings['resolution']} --views {settings['views']}")


def _start(settings: Mapping, here: Sequence[Mapping]) -> str:
    config = here[0]["config"]
    return (f"{_named(here)} --methods {','.join(dict.fromkeys(r['method'] for r in here))} --budgets "
            f"{config['budget']:g} "
            f"--repeats {config['repeats']} --resolution {config['resolution']}")


def _left_out(here: Sequence[Mapping]) -> str:
    """The photos left out, where they are not the usual ones."""
    numbers = next((r["left_out"] for r in here if "left_out" in r), USUAL_LEFT_OUT)
    return "" if tuple(numbers) == USUAL_LEFT_OUT else f" --left-out {','.join(map(str, numbers))}"


def _named(here: Sequence[Mapping]) -> str:
    """The materials and captures of these records, as options."""
    return " ".join(f"--{kind}s {','.join(summary.names(r for r in here if r['kind'] == kind)) or 'none'}"
                    for kind in summary.KINDS)


def _seeds(here: Sequence[Mapping]) -> str:
    return f"--seeds {','.join(map(str, sorted({r['seed'] for r in here})))}"
