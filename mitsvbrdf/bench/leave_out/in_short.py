"""What a reader wants first of docs/leave-out.md, in sentences made of its records and verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ...report.page import figure
from .renders import SUITE as RENDERS
from .verdict import NEEDED, NOT_NEEDED, UNSEEN, items

MOST = 4  # of a scene, those that save most
SECONDS, ERRORS = "Seconds with it over those without", "Error without it over error with it"


def in_short(record: Mapping) -> list[str]:
    """One sentence a line.

    Args:
        record: a :class:`mitsvbrdf.bench.records.Benchmark`.
    """
    return [*_of_scenes([r for r in record["records"] if r["suite"] == RENDERS]), *_of_fits(items(record))]


def _of_scenes(renders: Sequence[Mapping]) -> Iterable[str]:
    # with float64: the same picture was asked for
    compared = [r for r in renders if r["full_error"] is not None]
    if compared:
        saved = {r["name"]: r["seconds"]["full"]["median"] / r["seconds"]["lean"]["median"] for r in compared}
        best = sorted(saved, key=saved.__getitem__, reverse=True)[:MOST]
        yield (f"**Of a scene.** Leaving out what it does not need changes pictures by at most "
               f"{figure(max(r['worst'] for r in compared))} of their values. {SECONDS}: "
               + ", ".join(f"{name} {saved[name]:.2g}" for name in best) + ".")


def _of_fits(found: Sequence[Mapping]) -> Iterable[str]:
    itself, kept = ([item for item in found if item["put_in"] == put_in] for put_in in (True, False))
    needed = _named(kept, NEEDED)
    idle = {name: each for name, each in _named(kept, NOT_NEEDED).items() if name not in needed}
    for named, shown, words in (
            (_named(itself, NOT_NEEDED), _seconds,
             "**Left out of fits by the program itself**, where photos show that they do not need it. "
             f"{SECONDS}"),
            (_named(itself, NEEDED), _errors, "**Left out by the program itself, though it would help.** "
                                              f"{ERRORS}"),
            (needed, _errors, f"**Needed.** {ERRORS}"),
            (idle, _seconds, "**Kept, though none of these photos needs it**, as no test of photos tells "
                             f"so. {SECONDS}")):
        if named:
            yield f"{words}: {'; '.join(map(shown, named, named.values()))}."


def _named(found: Iterable[Mapping], verdict: str) -> dict[str, list[Mapping]]:
    """The items of a verdict by the part they are of, and its method where that is not the default."""
    named: dict[str, list[Mapping]] = {}
    for item in found:
        if item["verdict"] == verdict:
            method = "" if item["of"] == "hierarchical" else f" of `{item['of']}`"
            named.setdefault(item["part"] + method, []).append(item)
    return named


def _seconds(name: str, each: Sequence[Mapping]) -> str:
    low, high = (f"{end(item['ratio']['median'] for item in each):.2g}" for end in (min, max))
    return f"{name} {low}" if low == high else f"{name} {low} to {high}"


def _errors(name: str, each: Sequence[Mapping]) -> str:
    worst = [max((item["errors"][error]["worst"], error) for error in UNSEEN if error in item["errors"])
             for item in each]
    return f"{name}: " + ", ".join(f"{error} {ratio:.2f} ({item['kind']})" for item, (ratio,
                                                                                      error) in zip(each, worst))
