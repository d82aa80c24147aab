"""What leaving out a part of a fit saves and costs, by the records of its pairs of fits, and whether the part
is needed.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence

from ...io.timing import spread
from .fits import SUITE
from .parts import FOLLOWING, MATTE, OTHERS, parts

KINDS = (*FOLLOWING, *OTHERS)
SHOWN = {"mean": "maps", "novel_light": "new light", "left_out": "left out", "photos": "seen", "seen": "seen"}
# what decides: photos seen are explained better by whatever burns in
UNSEEN = ("maps", "new light", "left out")
FLOOR = 0.001  # of errors that are compared: a quarter of a step of 8 bits, below which none shows
NEEDED, NOT_NEEDED, NO_TIME_SAVED = "needed", "not needed", "no time saved"
# from which ratio on of seconds (median) and of errors (worst) a part counts as saved and as needed
SAVES, COSTS = 1.05, 1.02


def items(record: Mapping) -> list[dict]:
    """What leaving out each part saves and costs on scenes of each kind.

    Args:
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.

    Returns:
        Of each part and kind ``part``, ``of`` (a method), ``kind``, ``put_in``, ``scenes`` (how many),
        ``ratio`` (median and quartiles, over scenes and turns, of the seconds with it over those without),
        ``errors`` (by name ``median`` and ``worst`` of the errors without it over those with it) and
        ``verdict``; in the order of the parts, whichever was done first.
    """
    names = [part.name for part in parts()]
    order = {name: number for number, name in enumerate(names)}
    first = {(part.of, part.what): names.index(part.name) for part in reversed(parts())}

    # a part that was once put in, or left out, stays in its place
    def place(r: Mapping) -> tuple[int, int, int]:
        return first.get((r["of"], r["part"]), len(order)), order.get(r["method"],
                                                                      len(order)), KINDS.index(r["kind"])

    groups: dict[tuple[str, str], list[Mapping]] = {}
    for r in sorted(_pairs(record), key=place):
        groups.setdefault((r["method"], r["kind"]), []).append(r)
    return [_item(kind, pairs) for (_, kind), pairs in groups.items()]


def _pairs(record: Mapping) -> list[Mapping]:
    return [r for r in record["records"] if r["suite"] == SUITE]


def _item(kind: str, pairs: Sequence[Mapping]) -> dict:
    ratio = spread([full / lean for r in pairs for full, lean in zip(r["seconds"]["with"],
                                                                     r["seconds"]["without"])])
    ratios: dict[str, list[float]] = {}
    for r in pairs:
        for name, shown in SHOWN.items():
            # the roughness of a black lobe shows nowhere
            if name in r["errors"]["with"] and (kind, shown) != (MATTE, "maps"):
                full, lean = (max(r["errors"][side][name], FLOOR) for side in ("with", "without"))
                ratios.setdefault(shown, []).append(lean / full)
    errors = {name: {"median": statistics.median(each), "worst": max(each)} for name, each in ratios.items()}
    return {name: pairs[0][name] for name in ("part", "of", "put_in")} | {
        "kind": kind, "scenes": len(pairs), "ratio": ratio, "errors": errors,
        "verdict": verdict(ratio["median"], errors)}


def verdict(ratio: float, errors: Mapping[str, Mapping[str, float]]) -> str:
    """``needed`` where leaving it out costs errors; else ``not needed``, or ``no time saved`` where it saves
    less than 5 %.
    """
    worst = max((errors[name]["worst"] for name in UNSEEN if name in errors), default=1.0)
    if worst > COSTS:
        return NEEDED
    return NOT_NEEDED if ratio >= SAVES else NO_TIME_SAVED


def default_fits(record: Mapping) -> list[dict]:
    """Of each scene ``name``, ``kind``, ``photos``, and of the default fit the ``seconds`` of all its runs,
    median and quartiles, and ``spent``, the median seconds of each part of its work.
    """
    groups: dict[tuple[str, str], list[Mapping]] = {}
    for r in sorted(_pairs(record), key=lambda r: (KINDS.index(r["kind"]), r["name"])):
        if r["of"] == "hierarchical":
            groups.setdefault((r["name"], r["kind"]), []).append(r)
    found = []
    for (name, kind), pairs in groups.items():
        runs = [seconds for r in pairs for seconds in r["seconds"]["without" if r["put_in"] else "with"]]
        work = dict.fromkeys(name for r in pairs for name in r["spent"])
        found.append({"name": name, "kind": kind, "photos": pairs[0]["photos"], "seconds": spread(runs),
                      "spent": {each: statistics.median(r["spent"].get(each, 0.0) for r in pairs)
                                for each in work}})
    return found
