"""The tables of docs/stability-fits.md; they print what the record holds, medians over seeds with the range
in brackets.
"""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from ...fit.confidence import DETERMINED
from ...report.page import figure
from ...report.stability_page import condition_text
from ..tables import Table
from .fits import SUITE
from .verdict import far_off, faults, scene_of, verdict, warned

Fits = list[Mapping]


def fits_of(record: Mapping, kind: str) -> dict[str, Fits]:
    """Method and budget in words -> its fits of this kind; where a method has several budgets, apart."""
    here = [r for r in record["records"] if r["suite"] == SUITE and r["kind"] == kind]
    usual = usual_budget(here)
    found: dict[str, Fits] = {}
    for r in here:
        found.setdefault(r["method"] + ("" if r["budget"] == usual else f", {r['budget']:g} s"), []).append(r)
    return found


def usual_budget(fits: Sequence[Mapping]) -> float:
    """The seconds that most fits had; 0 where there is none."""
    budgets = Counter(r["budget"] for r in fits)
    return max(budgets, key=lambda budget: budgets[budget], default=0.0)


def by_name(fits: Iterable[Mapping]) -> dict[str, Fits]:
    """Case, or series and member -> its fits, one a seed."""
    found: dict[str, Fits] = {}
    for r in fits:
        found.setdefault(r["name"], []).append(r)
    return found


def overview(record: Mapping) -> Table:
    """The verdict on each case by each method."""
    columns = {head: by_name(fits) for head, fits in fits_of(record, "case").items()}
    names = dict.fromkeys(name for cases in columns.values() for name in cases)
    return Table("Verdicts", ["", *(f"`{head}`" for head in columns)],
                 [[name, *(_verdicts(cases.get(name, ())) for cases in columns.values())] for name in names])


def inputs(record: Mapping) -> Table:
    """How stiff each case is, and what is wrong with what a fit is given."""
    rows = []
    for name, (first, *_) in by_name(r for fits in fits_of(record, "case").values() for r in fits).items():
        wrong = ", ".join(fault.name for fault in faults(scene_of(first)))
        rows.append([name, condition_text({"condition": first["condition"] or None}),
                     _one(first["attainable"].get("mean")),
                     _one(first["start"].get("mean")), _one(first["attainable"].get("photos")), wrong or "–"])
    return Table("What was given", ["", "condition", "attainable", "start", "photos, truth",
                                    "a fit should warn of"], rows)


def each(head: str, fits: Fits) -> Table:
    """How the fits of one method ended, case by case."""
    heads = ["", "verdict", "maps", "over attainable", f"off by more than {DETERMINED:g}", "stated", "photos",
             "at the start",
             "within 10 %, s", "s", "steps", "undone", "warns of", "and not of"]
    rows = []
    for name, same in by_name(fits).items():
        good = [r for r in same if r["errors"]]
        said, unsaid = zip(*map(warned, same))
        far = dict.fromkeys(m for r in good for m in far_off(r) if m in r["errors"])
        rows.append([
            name, _verdicts(same), _spread(good, lambda r: r["errors"].get("mean")),
            _spread(good, _over_attainable, "x"),
            ", ".join(f"{m} {_one(statistics.median(r['errors'][m] for r in good))}" for m in far) or "–",
            _spread(good, lambda r: r["stated"].get("mean")), _spread(good, lambda r: r["errors"]["photos"]),
            _spread(good, lambda r: r["errors"]["photos_start"], short=True),
            _spread(good, lambda r: r["near"]["seconds"], "s", short=True),
            _spread(good, lambda r: r["seconds"], "s", short=True),
            _spread(good, lambda r: r["iterations"], "n", short=True),
            "–" if not good else str(sum(r["undone"] + r["restarts"] for r in good)), _counted(said),
            _counted(unsaid)])
    return Table(f"`{head}`", heads, rows)


def warnings(record: Mapping) -> Table:
    """Of the fits whose input has a fault, how many warn of it."""
    columns = fits_of(record, "case")
    found: dict[str, dict[str, list[bool]]] = {}
    for head, fits in columns.items():
        for r in fits:
            for right, names in zip((True, False), warned(r)):
                for name in names:
                    found.setdefault(name, {}).setdefault(head, []).append(right)
    rows = [[name, *(f"{sum(here[head])} of {len(here[head])}" if head in here else "–" for head in columns)]
            for name, here in found.items()]
    return Table("Warned of", ["", *(f"`{head}`" for head in columns)], rows)


def convergence(head: str, fits: Fits) -> Table:
    """Error and time of one method against the condition of each member of each series."""
    rows = []
    for name, (r, *_) in by_name(fits).items():
        known = [name, condition_text({"condition": r["condition"]}), _one(r["attainable"]["mean"])]
        near = r["near"] or {"seconds": None, "iterations": None}
        rows.append([*known, _one(r["errors"].get("mean")), _one(r["errors"].get("photos")),
                     "–" if r["why"] else f"{near['iterations']:g}",
                     "–" if r["why"] else f"{near['seconds']:.3g}",
                     f"{r['seconds']:.3g}", verdict(r)])
    heads = ["", "condition", "attainable", "maps", "photos", "steps within 10 %", "s", "s in all", "verdict"]
    return Table(f"`{head}`", heads, rows)


def _verdicts(fits: Sequence[Mapping]) -> str:
    counts = Counter(map(verdict, fits))
    if not counts:
        return "–"
    if len(counts) == 1:
        return next(iter(counts))
    return "; ".join(f"{word} ({n} of {len(fits)})" for word, n in counts.most_common())


def _counted(names: Iterable[Sequence[str]]) -> str:
    each_seed = list(names)
    counts = Counter(name for here in each_seed for name in here)
    return ", ".join(name if n == len(each_seed) else f"{name} ({n} of {len(each_seed)})"
                     for name, n in counts.items()) or "–"


def _over_attainable(r: Mapping) -> float | None:
    return r["errors"]["mean"] / r["attainable"]["mean"] if r["attainable"] else None


def _spread(fits: Sequence[Mapping], value: Callable[[Mapping], float | None], kind: str = "",
            short: bool = False) -> str:
    """The median over seeds and, where there are several and it is not to be ``short``, their range."""
    found = [number for r in fits if (number := value(r)) is not None]
    if not found:
        return "–"
    show = {"": _one, "x": lambda v: f"{v:.1f}", "s": lambda v: f"{v:.3g}", "n": lambda v: f"{v:.0f}"}[kind]
    middle = show(statistics.median(found))
    return middle if len(found) == 1 or short else f"{middle} ({show(min(found))} to {show(max(found))})"


def _one(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}" if value >= 0.01 else figure(value)
