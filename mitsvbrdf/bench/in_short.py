"""A benchmark in a few sentences: where the default method is lowest and where it is not, wins and losses alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from . import summary
from .tables import at_time, count_of, judged


def in_short(record: Mapping) -> list[str]:
    """Where the default method is lowest and where it is not, and against what was published: wins and losses alike."""
    lines, apart = list[str](), summary.views(record)
    for kind, error, title, fits in (each for view in apart for each in judged(view, "methods")):
        found, times = summary.curves(fits, error), summary.budgets(fits)
        default = fits[0]["method"]
        if len({default, *found}) < 2 or not found:
            continue
        lowest: dict[str, list[str]] = {}
        for budget in times:
            here = {name: p.median for name, points in found.items() if (p := at_time(points, budget))}
            if here:
                best = min(here, key=lambda name: here[name])
                own = f"{here[default]:.4f}" if default in here else "has none"
                beside = "" if best == default else f" ({here[best]:.4f}, `{default}` {own})"
                lowest.setdefault(best, []).append(f"{budget:g} s{beside}")
        lines.append(f"- {title}, {count_of(kind, fits)}, lowest: "
                     + "; ".join(f"`{name}` at {listed(at)}" for name, at in lowest.items()) + ".")
    for view in apart:
        for kind, error, title, fits in judged(view, "methods"):
            for who in summary.beside(view["published"], kind):
                lines += _beside_published(view, kind, error, title, fits, who)
    failed = summary.failures(record["records"])
    if failed:
        lines.append(f"- {len(failed)} fits failed: " + "; ".join(
            f"`{r['method']}` on {r['name']}, {r['budget']:g} s, seed {r['seed']} ({r['why']})" for r in failed) + ".")
    return ["## In short", "", *lines, ""] if lines else []


def _beside_published(record: Mapping, kind: str, error: str, title: str, fits: Sequence[Mapping], who: str) -> list[str]:
    default = next(r["method"] for r in fits)
    only = summary.with_published(record["published"], kind, summary.names(fits), who, error)
    longest = max(summary.budgets(fits))
    won: list[str] = []
    lost: list[str] = []
    for name in only:
        point = at_time(summary.curves(fits, error, [name]).get(default, []), longest)
        given = record["published"][kind][name][who][error]
        if point:
            (won if point.median < given else lost).append(name)
    if not won and not lost:
        return []
    text = f"lower on {len(won)} of {len(won) + len(lost)}" + (f" ({', '.join(won)})" if won else "")
    text += f", not on {', '.join(lost)}" if lost else ""
    saw = ", which saw them," if (kind, error, who) == ("capture", "left_out", "MaterialGAN") else ""
    return [f"- {title}, `{default}` after {longest:g} s against {who}{saw} as published: {text}."]


def listed(words: Sequence[str]) -> str:
    """Words with commas and an "and"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def plural(count: int, what: str) -> str:
    """How many of what."""
    return f"{count} {what}{'s' * (count != 1)}"
