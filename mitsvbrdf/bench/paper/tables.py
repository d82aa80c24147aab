"""The tables of ``docs/results/gan.md``: they print what the record and its summary hold."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from .. import summary
from ..summary import ERRORS, KINDS, Point
from ..tables import Table, ablation_tables, each_map, error_cell, with_best
from ..variants import FULL, NO_GAME, PAPERS_LOSSES
from .printed import GUESS
from .references import START, guess_by

MAPS = ("diffuse", "specular", "roughness", "normal")
COLUMNS = (*MAPS, "mean", GUESS)
HEADS = ["", *MAPS, "mean", "guessed diffuse", "seconds"]
SCHEDULE_ERRORS = {"material": {name: name for name in (*MAPS, "mean", "photos")},
                   "capture": {"seen": "photos seen", "left_out": "photos left out"}}

# What is ours, from the paper's method to the default: a name, and (suite, method) of its fits, the first
# that is there.
GAN = "`gan`"
TWO_STAGE = "`gan-two-stage`, the paper's preset"
OURS: dict[str, tuple[tuple[str, str], ...]] = {
    TWO_STAGE: (("methods", "gan-two-stage"),), f"{GAN}, {PAPERS_LOSSES}": (("gan", PAPERS_LOSSES),),
    GAN: (("methods", "gan"), ("gan", FULL)), "`hierarchical`": (("methods", "hierarchical"),)}


@dataclass(frozen=True)
class Row:
    """Errors of one method, with the seconds it took where they are known here."""

    label: str
    errors: Mapping[str, float]
    seconds: float | None = None


def printed_tables(record: Mapping) -> list[Table]:
    """Tables 1 and 2 of the paper."""
    tables = []
    for which, rows in record["published"].get("paper", {}).items():
        cells = [[who, *(_number(errors.get(name), 3) for name in (*MAPS, GUESS))]
                 for who, errors in rows.items()]
        tables.append(Table(f"As printed, {which}", ["", *MAPS, "guessed diffuse"], cells))
    return tables


def measured_tables(record: Mapping) -> list[Table]:
    """The same columns on known materials: the mean over all, then each that has published maps."""
    names = materials(record)
    published = [n for n in names if set(_references(record, "material").get(n, {})) - {START,
                                                                                        *_guesses(record, n)}]
    several = [("Mean of " + str(len(names)) + " known materials", names)] if len(names) > 1 else []
    tables = []
    for title, only in [*several, *((name, [name]) for name in (published if several else names))]:
        rows = list(_rows(record, only))
        cells = [[row.label, *(_number(row.errors.get(name)) for name in COLUMNS),
                  "" if row.seconds is None else f"{row.seconds:.3g}"] for row in rows]
        values = [[row.errors.get(name) for name in COLUMNS[:-1]] for row in rows]
        missing = [label for label in OURS if label not in {row.label for row in rows}]
        note = (f"Not run on {'all of these' if len(only) > 1 else 'it'}: {', '.join(missing)}." if missing
                else "")
        tables.append(Table(title, HEADS, with_best(cells, values), note))
    return tables


def materials(record: Mapping) -> list[str]:
    """The known materials that were fitted here, by any method of :data:`OURS`."""
    wanted = {each for choices in OURS.values() for each in choices}
    fits = [r for suite in summary.FIT_SUITES for r in summary.of(record["records"], suite, "material")]
    return summary.names(r for r in fits if (r["suite"], r["method"]) in wanted)


def _rows(record: Mapping, names: Sequence[str]) -> Iterator[Row]:
    """Published maps, the start and ours: medians over seeds of means over these materials, at the longest
    budget.
    """
    given = [_references(record, "material").get(name, {}) for name in names]
    whose = [who for who in given[0] if all(who in each for each in given) and who not in _guesses(record,
                                                                                                   names[0])]
    for who in sorted(whose, key=lambda who: who == START):
        errors = {e: statistics.fmean(each[who][e] for each in given) for e in (*MAPS, "mean")}
        yield Row("the start: the guess, one lobe for all texels, flat" if who == START
                  else f"{who}, published maps", errors, None)
    for label in OURS:
        fits = _fits(record, "material", label)
        points = {e: _last(fits, e, names) for e in (*MAPS, "mean")}
        if points["mean"] is not None:
            errors = {e: point.median for e, point in points.items() if point}
            guess = guess_by(fits[0]["config"].get("guess", ""))
            if all(guess in each for each in given):
                errors[GUESS] = statistics.fmean(each[guess]["diffuse"] for each in given)
            yield Row(label, errors, points["mean"].seconds)


def start_and_end(record: Mapping) -> Table | None:
    """How far ``gan`` brings each known material from where it starts."""
    fits, given, rows = _fits(record, "material", GAN), _references(record, "material"), []
    names = [name for name in summary.names(fits) if START in given.get(name, {})]
    for only in [*([name] for name in names), *([names] if len(names) > 1 else [])]:
        points = {e: _last(fits, e, only) for e in ("mean", *MAPS)}
        end = points["mean"]
        if end is not None:
            starts = {e: statistics.fmean(given[name][START][e] for name in only) for e in points}
            rows.append([only[0] if len(only) == 1 else f"mean of {len(only)}", f"{starts['mean']:.4f}",
                         error_cell(end),
                         f"{100 * (1 - end.median / starts['mean']):.0f} %",
                         *(f"{starts[e]:.4f} → {_number(p.median if p else None)}"
                           for e, p in list(points.items())[1:])])
    if not rows:
        return None
    return Table(f"{GAN} after {max(summary.budgets(fits)):g} s", ["", "start, mean", "end, mean", "below",
                                                                   *MAPS], rows,
                 "Mean: of the four maps. End: median over seeds, quartiles in brackets.")


def game_tables(record: Mapping) -> list[Table]:
    """With and without the adversarial loss at equal time, one by one."""
    tables = []
    for kind, errors in ERRORS.items():
        fits = [r for r in summary.of(record["records"], "gan", kind) if r["method"] in (FULL, NO_GAME)]
        for error, title in errors.items():
            rows, lower = [], 0
            for name in summary.names(fits):
                found = [_last([r for r in fits if r["method"] == method], error, [name]) for method in (FULL,
                                                                                                         NO_GAME)]
                if found[0] is not None and found[1] is not None:
                    lower += found[0].median < found[1].median
                    rows.append([name, error_cell(found[0]), error_cell(found[1]),
                                 f"{found[0].median - found[1].median:+.4f}"])
            if rows:
                tables.append(Table(f"{title}, {max(summary.budgets(fits)):g} s",
                                    ["", "with", "without", "difference"], rows,
                                    f"Lower with the adversarial loss on {lower} of {len(rows)}. "
                                    f"{_seeds(fits)}"))
    return tables


def ingredient_tables(record: Mapping) -> list[Table]:
    """Each variant of ``gan``: by budget, and map by map, over the fits that all variants have."""
    common = {**record, "records": [r for kind in ERRORS for r in _shared(summary.of(record["records"], "gan",
                                                                                     kind))]}
    maps = each_map(common, "gan")
    return [*ablation_tables(common, "gan"), *([maps] if maps else [])]


def _shared(fits: Sequence[Mapping]) -> list[Mapping]:
    """The fits of what every method was run on: the same materials or captures, budgets and seeds."""
    def what(r: Mapping) -> tuple:
        return r["name"], r["budget"], r["seed"]

    each = [{what(r) for r in fits if r["method"] == method} for method in {r["method"] for r in fits}]
    shared = set.intersection(*each) if each else set()
    return [r for r in fits if what(r) in shared]


def capture_tables(record: Mapping) -> list[Table]:
    """Photos seen and left out of real captures, ours beside what was published."""
    given, tables = _references(record, "capture"), []
    found = {label: _fits(record, "capture", label) for label in OURS}
    fits = [r for each in found.values() for r in each]
    labels, published = [label for label, each in found.items() if each], record["published"].get("capture",
                                                                                                  {})
    for error, title in ERRORS["capture"].items():
        whose = list(dict.fromkeys(who for n in summary.names(fits) for who, e in published.get(n, {}).items()
                                   if error in e))
        starts, rows, values = any(START in given.get(name, {}) for name in summary.names(fits)), [], []
        for name in summary.names(fits):
            points = [_last(found[label], error, [name]) for label in labels]
            start = given.get(name, {}).get(START, {}).get(error)
            beside = [published.get(name, {}).get(who, {}).get(error) for who in whose]
            rows.append([name, *([_number(start)] if starts else []), *(error_cell(p) for p in points),
                         *map(_number, beside)])
            values.append([p.median if p else None for p in points])
        if rows:
            heads = ["", *(["the start"] if starts else []), *labels, *(f"{who}, published" for who in whose)]
            middle = "; ".join(f"{label} {_number(_median([v[k] for v in values]), 4)}"
                               for k, label in enumerate(labels))
            tables.append(Table(title, heads, rows, f"Median of these: {middle}. {_seeds(fits)}"))
    return tables


def schedule_tables(record: Mapping) -> list[Table]:
    """Where the paper's schedule ends: the result, which explains its photos best, and the state after the
    last iteration.
    """
    given, tables = _references(record, "material"), []
    for kind, columns in SCHEDULE_ERRORS.items():
        rows, known = [], kind == "material"
        for r in schedules(record, kind):
            guess = given.get(r["name"], {}).get(guess_by(r["config"].get("guess", "")), {}).get("diffuse")
            for what, errors in (("result", r["errors"]), ("last", r["trace"][-1])):
                rows.append([f"{schedule_title(r)}, {what}", *(_number(errors.get(e)) for e in columns),
                             *([_number(guess)] if known else []), f"{r['seconds']:.0f}"])
        if rows:
            heads = [*columns.values(), *(["guessed diffuse"] if known else []), "seconds"]
            tables.append(Table(f"Errors at the end, {KINDS[kind]}s", ["", *heads], rows,
                                "Result: the state of the lowest re-rendering error, as every fit returns "
                                "it; last: after the "
                                "last iteration."))
    return tables


def schedules(record: Mapping, kind: str) -> list[Mapping]:
    """The long runs of known materials, or of real captures."""
    return [r for r in record["records"] if r["suite"] == "schedule" and r["kind"] == kind]


def schedule_title(r: Mapping) -> str:
    """What was run at what size."""
    config = r["config"]
    return f"`{r['method']}`, {r['name']}, {r['iterations']} iterations, {config['resolution']} px, width {config['width']}"


def step_tables(record: Mapping) -> list[Table]:
    """Seconds of an iteration by preset, now and in the earlier version, and what they go to."""
    found = [r for r in record["records"] if r["suite"] == "steps"]
    if not found:
        return []
    timed, parts = [], []
    names = list(dict.fromkeys(name for r in found for row in r["rows"] for name in row["parts"]))
    for r in found:
        title = f"`{r['preset']}`, {r['resolution']} px, width {r['width']}"
        timed.append([title, *(_spread(row["seconds"]) for row in r["rows"]), _spread(r["ratio"]),
                      ", ".join("bfloat16" if row["bfloat16"] else "float32" for row in r["rows"])])
        parts += [[f"{title}, {row['version']}",
                   *(f"{100 * row['parts'].get(name, 0):.0f} %" for name in names)]
                  for row in r["rows"]]
    return [Table("Seconds of an iteration", ["", "now", "earlier", "earlier / now", "networks in"], timed,
                  "Both versions take turns; median, quartiles in brackets. Earlier: float32, gradients of "
                  "the discriminator's "
                  "weights in every gradient step, and the diffuse loss in each of them."),
            Table("Shares of an iteration", ["", *names], parts)]


def _fits(record: Mapping, kind: str, label: str) -> list[Mapping]:
    """The fits that a name of :data:`OURS` stands for."""
    for suite, method in OURS[label]:
        found = [r for r in summary.of(record["records"], suite, kind) if r["method"] == method]
        if found:
            return found
    return []


def _last(fits: Sequence[Mapping], error: str, names: Sequence[str]) -> Point | None:
    """The point of the longest budget of one method, over these materials or captures."""
    points = next(iter(summary.curves(fits, error, names).values()), [])
    return points[-1] if points else None


def _references(record: Mapping, kind: str) -> dict[str, Mapping]:
    return {r["name"]: r["errors"] for r in record["records"] if r["suite"] == "references"
            and r["kind"] == kind}


def _guesses(record: Mapping, name: str) -> set[str]:
    return {who for who in _references(record, "material").get(name, {}) if who.startswith(guess_by(""))}


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def _number(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _spread(value: Mapping) -> str:
    return f"{value['median']:.3g} ({value['low']:.3g}–{value['high']:.3g})"


def _seeds(fits: Sequence[Mapping]) -> str:
    seeds = len({r["seed"] for r in fits})
    return f"Median of {seeds} seeds, quartiles in brackets." if seeds > 1 else "One seed."
