"""One table: median and spread over seeds, of every method at every budget."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from ..report.page import figure

# The errors compared for each kind of task: their names in records, and in titles.
ERRORS = {"material": {"mean": "maps", "novel_light": "images under new light"},
          "capture": {"held_out": "held-out photos", "seen": "photos seen"}}
KINDS = {"material": "known materials", "capture": "real captures"}
BY_ITSELF = ("iterations", "settled")  # reasons why a fit ends before its budget


class Judged(NamedTuple):
    """Fits that are compared by one error."""

    title: str
    error: str
    records: list[Mapping[str, Any]]


def judged(records: Iterable[Mapping[str, Any]]) -> Iterator[Judged]:
    """Group the records that can be compared: same kind of task, same held-out photos, same error."""
    groups: dict[tuple, list[Mapping]] = {}
    for record in records:
        groups.setdefault((record["kind"], tuple(record.get("held_out", ()))), []).append(record)
    for (kind, held_out), group in groups.items():
        without = f" without photos {' and '.join(map(str, held_out))}" if held_out else ""
        for error, what in ERRORS[kind].items():
            # tasks without this error, such as captures without views, are not in this table
            having = {r["name"] for r in group if error in r["errors"]}
            some = [r for r in group if r["name"] in having or not r["errors"]]
            if any(error in record["errors"] for record in some):
                count = len({record["name"] for record in some})
                yield Judged(f"RMSE of {what}: mean of {count} {KINDS[kind]}{without}", error, some)


def summary(records: Iterable[Mapping[str, Any]], error: str) -> pd.DataFrame:
    """The error of every method at every budget; ``error`` is a name in the ``errors`` of the records.

    The error of a method with one seed and budget is its mean over tasks. A seed that lacks a task, or failed
    at one, does not count. Index: method (in the order of the records) and budget. Columns: ``median``,
    ``low`` and ``high`` (quartiles) over ``seeds`` seeds; medians of ``seconds`` (of the loop) and ``wall``;
    ``ended``: whether all fits ended by themselves.
    """
    records = list(records)
    tasks = len({record["name"] for record in records})
    rows = pd.DataFrame(
        [{"method": r["method"], "budget": r["budget"], "seed": r["seed"], "error": r["errors"].get(error),
          "seconds": r["seconds"], "wall": r["wall"], "ended": r["stopped"] in BY_ITSELF} for r in records],
    ).dropna(subset=["error"])
    by_seed = rows.groupby(["method", "budget", "seed"], sort=False).agg(
        error=("error", "mean"), tasks=("error", "size"), seconds=("seconds", "mean"), wall=("wall", "mean"),
        ended=("ended", "all"))
    found = by_seed[by_seed["tasks"] == tasks].groupby(["method", "budget"], sort=False).agg(
        median=("error", "median"), low=("error", lambda e: e.quantile(0.25)),
        high=("error", lambda e: e.quantile(0.75)), seeds=("error", "size"), seconds=("seconds", "median"),
        wall=("wall", "median"), ended=("ended", "all"))
    order = list(dict.fromkeys(record["method"] for record in records))
    return found.sort_index(key=lambda level: level.map(order.index) if level.name == "method" else level)


def table(group: Judged) -> pd.DataFrame:
    """Cells of text: a row for each method, a column for each budget, the best of each budget in bold."""
    found = summary(group.records, group.error)
    budgets = sorted({record["budget"] for record in group.records})
    best = {budget: found.xs(budget, level="budget")["median"].min() for budget in budgets
            if budget in found.index.get_level_values("budget")}
    rows = {}
    for method in dict.fromkeys(record["method"] for record in group.records):
        rows[f"`{method}`"] = [
            _cell(found.loc[method, budget], best[budget], found.loc[method]["seeds"].max())
            if (method, budget) in found.index else _absent(group.records, method, budget)
            for budget in budgets]
    return pd.DataFrame.from_dict(rows, orient="index", columns=[f"{budget:g} s" for budget in budgets])


def markdown(groups: Sequence[Judged]) -> str:
    """The tables of all groups as Markdown, with a note below each."""
    return "\n".join(f"## {group.title}\n\n{as_markdown(table(group))}\n\n{note(group)}\n"
                     for group in groups)


def note(group: Judged) -> str:
    """The text below a table: how many seeds, and which methods ended by themselves."""
    found = summary(group.records, group.error)
    seeds = found["seeds"].max()
    ended = found[found["ended"]].groupby("method", sort=False)["seconds"].agg(["min", "max"])
    ends = "; ".join(f"`{method}` after {' to '.join(dict.fromkeys(figure(s) for s in span))} s"
                     for method, *span in ended.itertuples())
    return ((f"Median of {seeds} seeds (quartiles)." if seeds > 1 else "One seed.")
            + (f" † ended by itself: {ends}." if ends else ""))


def as_markdown(cells: pd.DataFrame) -> str:
    """A table of text as Markdown. All columns but the index are right-aligned."""
    rows = [["", *cells.columns], ["---", *["---:"] * len(cells.columns)],
            *([name, *row] for name, row in zip(cells.index, cells.itertuples(index=False)))]
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in rows)


def _cell(found: pd.Series, best: float, seeds: int) -> str:
    spread = f" ({found['low']:.4f}–{found['high']:.4f})" if found["seeds"] > 1 else ""
    fewer = f" ({found['seeds']} of {seeds} seeds)" if found["seeds"] < seeds else ""
    text = f"{found['median']:.4f}{spread}{fewer}{' †' if found['ended'] else ''}"
    return f"**{text}**" if found["median"] == best else text


def _absent(records: Iterable[Mapping[str, Any]], method: str, budget: float) -> str:
    here = [r for r in records if r["method"] == method and r["budget"] == budget]
    failed = sorted({r["name"] for r in here if r["stopped"] == "failed"})
    return f"fails on {', '.join(failed)}" if failed else "incomplete" if here else "not run"
