"""A benchmark in a few sentences, wins and losses alike: photos that nobody saw, the time to pass others,
maps, losses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from . import summary
from .published import BLIND
from .tables import at_time, count_of, judged, methods_of

SAID = (("Photos that no method saw", "left_out"), ("Maps of known materials", "mean"),
        ("Photos seen, of which the others fitted all nine", "seen"))
MAPS = ("diffuse", "specular", "roughness", "normal")


class Duel(NamedTuple):
    """The default method at its longest budget against one published method, where both have errors.

    Args:
        what: the error, in words.
        ours: the default's name and budget.
        who: the other's name.
        names: the materials or captures.
        mean: the default's error over them; ``theirs`` is the other's.
        worse: name -> both errors, where the default's is not lower.
        passed: the shortest budget whose mean is lower; None where there is none.
    """

    what: str
    ours: str
    who: str
    names: list[str]
    mean: float
    theirs: float
    worse: dict[str, tuple[float, float]]
    passed: summary.Point | None

    @property
    def won(self) -> str:
        """On how many the default is lower."""
        return f"lower than {self.who} on {len(self.names) - len(self.worse)} of {len(self.names)}"


def in_short(record: Mapping) -> list[str]:
    """What a reader wants first, as a section; empty where there is nothing to say."""
    protocols, lines = summary.for_readers(record), list[str]()
    duels = [duel for protocol in protocols for duel in _duels(protocol)]
    for title, wanted in SAID:
        lines += _told(title, [duel for error, duel in duels if error == wanted])
    lines += _lowest(protocols)
    lines += _worse(protocols, [duel for _, duel in duels])
    failed: dict[str, int] = {}
    for r in summary.failures(record["records"]):
        what = f"`{r['method']}` on {r['name']}, {r['budget']:g} s ({r['why']})"
        failed[what] = failed.get(what, 0) + 1
    if failed:
        lines.append(f"- **Fits that failed**, {sum(failed.values())}: "
                     + "; ".join(what + (f", {count} times" if count > 1 else "")
                                 for what, count in failed.items()) + ".")
    return ["## In short", "", *lines, ""] if lines else []


def _duels(protocol: Mapping) -> Iterator[tuple[str, Duel]]:
    """Error and duel, with all whose published errors are comparable: nobody saw the photos left out, both
    saw the others.
    """
    for kind, error, title, fits in judged(protocol, "methods"):
        default = methods_of(fits)[0]
        for who in summary.comparable(protocol["published"], kind, error):
            given = summary.with_published(protocol["published"], kind, summary.names(fits), who, error)
            found = {name: points[-1] for name in given if (points := summary.curves(fits, error,
                                                                                     [name]).get(default))}
            points = summary.curves(fits, error, list(found)).get(default)
            if not points:
                continue
            theirs = {name: protocol["published"][kind][name][who][error] for name in found}
            mean = sum(theirs.values()) / len(theirs)
            yield error, Duel(f"{title}, {count_of(kind, [r for r in fits if r['name'] in found])}",
                              _ours(default, points[-1]), who.removesuffix(BLIND), list(found),
                              points[-1].median, mean,
                              {n: (p.median, theirs[n]) for n, p in found.items() if p.median >= theirs[n]},
                              summary.first_below(points, mean))


def _ours(default: str, last: summary.Point) -> str:
    ended = f" (it ended after {last.seconds:.3g} s)" if last.ended else ""
    return f"`{default}` with a budget of {last.budget:g} s{ended}"


def _told(title: str, duels: Sequence[Duel]) -> list[str]:
    """One line for each group of duels over the same materials or captures."""
    lines, groups = list[str](), dict[tuple[str, ...], list[Duel]]()
    for duel in duels:
        groups.setdefault((duel.what, duel.ours, *duel.names), []).append(duel)
    for group in groups.values():
        first = group[0]
        lines.append(
            f"- **{title}.** {first.what}: {first.ours} has {first.mean:.4f}, "
            + ", ".join(f"{duel.who} {duel.theirs:.4f}" for duel in group) + ", as published. It is "
            + ", ".join(duel.won for duel in group) + ". It passes "
            + ", ".join(f"{duel.who} " + ("at no budget" if duel.passed is None else
                                        f"after {duel.passed.seconds:.3g} s ({duel.passed.wall:.3g} s on "
                                          "the wall)")
                        for duel in group) + ".")
    return lines


def _lowest(protocols: Sequence[Mapping]) -> list[str]:
    """Which of our methods is lowest at each budget, beside the default or, where that is the default, the
    next.
    """
    lines = []
    for kind, error, title, fits in (each for protocol in protocols for each in judged(protocol, "methods")):
        found, default = summary.curves(fits, error), methods_of(fits)[0]
        if len({default, *found}) < 2 or not found or error != next(iter(summary.ERRORS[kind])):
            continue
        lowest: dict[str, list[str]] = {}
        for budget in summary.budgets(fits):
            here = {name: p.median for name, points in found.items() if (p := at_time(points, budget))}
            order = sorted(here, key=lambda name: here[name])
            if order:
                other = default if order[0] != default else order[1] if len(order) > 1 else ""
                beside = (f", `{other}` {f'{here[other]:.4f}' if other in here else 'has none'}" if other
                          else "")
                lowest.setdefault(order[0], []).append(f"{budget:g} s ({here[order[0]]:.4f}{beside})")
        lines.append(f"- **Our methods.** {title}, {count_of(kind, fits)}, lowest: "
                     + "; ".join(f"`{name}` at {listed(at)}" for name, at in lowest.items()) + ".")
    return lines


def _worse(protocols: Sequence[Mapping], duels: Sequence[Duel]) -> list[str]:
    """Where the default is not lower than what was published and is comparable; of the maps each one."""
    parts = [f"{duel.what.replace('mean of ', '')}: than {duel.who} on " + _both(duel.worse) for duel in duels
             if duel.worse]
    for protocol in protocols:
        fits, given = summary.of(protocol["records"], "methods",
                                 "material"), protocol["published"].get("material", {})
        maps: dict[str, dict[str, tuple[float, float]]] = {}
        for who, name, error in ((w, n, e) for w in summary.comparable(protocol["published"], "material",
                                                                       "mean")
                                 for n in summary.names(fits) for e in MAPS if e in given.get(n, {}).get(w,
                                                                                                         {})):
            points = summary.curves(fits, error, [name]).get(methods_of(fits)[0])
            if points and points[-1].median >= given[name][who][error]:
                maps.setdefault(who, {})[f"{error} of {name}"] = points[-1].median, given[name][who][error]
        parts += [f"RMSE of a single map: than {who} in {_both(each)}" for who, each in maps.items()]
    return ["- **Where it is worse:**", *(f"    - {part}." for part in parts)] if parts else []


def _both(worse: Mapping[str, tuple[float, float]]) -> str:
    return ", ".join(f"{name} ({ours:.4f} against {theirs:.4f})" for name, (ours, theirs) in worse.items())


def listed(words: Sequence[str]) -> str:
    """Words with commas and an "and"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def plural(count: int, what: str) -> str:
    """How many of what."""
    return f"{count} {what}{'s' * (count != 1)}"
