"""docs/stability-fits.md, written from the record as a whole, its picture beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ...io import files
from ...report.charts import svg_file
from ..page import made_on, markdown, print_tables
from .fits import NEAR, SUITE
from .plots import convergence_figure
from .tables import convergence, each, fits_of, inputs, overview, usual_budget, warnings
from .verdict import FAILED, RULE, SILENT, far_off, verdict

PICTURE = "convergence"


def print_verdicts(record: Mapping) -> None:
    """The verdicts and the warnings, on the terminal."""
    print_tables([overview(record), warnings(record)])


def failures(record: Mapping) -> list[str]:
    """The fits that failed, and why, a line each."""
    return [f"{r['method']} on {r['name']}, seed {r['seed']}: {_why(r)}" for r in record["records"]
            if verdict(r) == FAILED]


def stiff_page_files(path: Path | None) -> list[Path]:
    """The page and the picture beside it; nothing for None."""
    return [path, path.with_name(f"{path.stem}-{PICTURE}.svg")] if path else []


def write_stiff_page(path: str | Path, record: Mapping) -> list[Path]:
    """Write the page and its picture.

    Args:
        path: the page, e.g. ``docs/stability-fits.md``.
        record: a :class:`mitsvbrdf.bench.records.Benchmark` of the suite ``stiff``.

    Returns:
        Every file that was written, the page first.

    Raises:
        OutputError: a file cannot be written.
    """
    page, picture = stiff_page_files(Path(path))
    drawing = convergence_figure(record)
    files.write_bytes(page, "\n".join(_lines(record, picture.name if drawing else None)).encode())
    if drawing is None:
        return [page]
    files.write_bytes(picture, svg_file(drawing))
    return [page, picture]


def _lines(record: Mapping, picture: str | None) -> Iterator[str]:
    yield "# Numerical stability of the fits"
    fits = [r for r in record["records"] if r["suite"] == SUITE]
    which = "quick" if record["settings"]["quick"] else "all"
    yield f"\nWritten by `mitsvbrdf stability --fits {which}`, nothing by hand. {made_on(record)} {_budgets(fits)}"
    if record["settings"]["quick"]:
        yield ("\n**A quick run**: one seed and short budgets, on a machine that may have done other work. "
               "Most fits end "
               "before they have converged, and times are rough; `--fits all` on a machine that does "
               "nothing else has more.")
    yield "\n## In short\n"
    yield from _in_short(fits)
    yield "\n## How it is judged\n"
    yield from _how()
    yield ""
    for table in (overview(record), warnings(record), inputs(record)):
        yield from markdown(table, "##")
    yield "## Case by case\n"
    yield ("Medians over the seeds, in brackets their range. *Over attainable*: error of the maps over what "
           "each texel by "
           "itself allows; methods that share between texels can be below 1. *Undone*: steps taken back and "
           "returns to an "
           "earlier state, of all seeds together.\n")
    for head, fits in fits_of(record, "case").items():
        yield from markdown(each(head, fits))
    yield "## Convergence and condition\n"
    yield ("One thing at a time goes from harmless to extreme, in photos of inlaid wood: fewer photos, "
           "cameras closer together "
           "(by a factor of their usual distances), one roughness for all texels. A rank below the number "
           "of unknowns is an "
           "infinite condition.\n")
    if picture:
        yield f"![Error of the maps and time to converge against condition]({picture})\n"
        yield "A fit that ends within a tenth of the error it starts with has hardly moved: 0 s, and no point in the picture.\n"
    for head, fits in fits_of(record, "series").items():
        yield from markdown(convergence(head, fits))
    yield "## How to reproduce\n"
    yield f"    {command(record)}\n"
    yield "Each fit is kept as soon as it is done: Ctrl-C loses one, and the same command goes on.\n"


def _budgets(fits: Sequence[Mapping]) -> str:
    """What time the fits had, in a sentence."""
    usual = usual_budget(fits)
    longer = dict.fromkeys(f"`{r['method']}` {r['budget']:g} s" for r in fits if r["budget"] != usual)
    return (f"A fit had {usual:g} s at most" + (f"; beside that {', '.join(longer)}, where the tables say so"
                                                if longer else "")
            + ". `direct` draws no random number, and has one seed.")


def _in_short(fits: Sequence[Mapping]) -> Iterator[str]:
    counts = Counter(map(verdict, fits))
    yield f"- {len(fits)} fits: {', '.join(f'{counts[word]} {word}' for word in RULE if counts[word])}."
    undone = sum(r["undone"] for r in fits)
    yield (f"- {undone} steps had to be taken back, and {sum(r['restarts'] for r in fits)} fits returned to "
           "an earlier state."
           if undone or any(r["restarts"] for r in fits)
           else "- No step had to be taken back in any of them.")
    for word, about in ((FAILED, _why), (SILENT, _how_far)):
        here: dict[tuple[str, str], list[Mapping]] = {}
        for r in fits:
            if verdict(r) == word:
                here.setdefault((r["method"], r["name"]), []).append(r)
        named = "; ".join(f"`{method}` on {name} ({about(same[0])})" for (method, name), same in here.items())
        yield f"- {word[0].upper()}{word[1:]}: {named or 'none'}."


def _why(r: Mapping) -> str:
    return r["why"] or f"photos met to {r['errors']['photos']:.3g}, by the start to {r['errors']['photos_start']:.3g}"


def _how_far(r: Mapping) -> str:
    return ", ".join(f"{name} {r['errors'][name]:.2f}" for name in far_off(r) if name in r["errors"])


def _how() -> Iterator[str]:
    yield "| verdict | when |\n|---|---|"
    for word, when in RULE.items():
        yield f"| {word} | {when} |"
    yield ("\n- **Errors** are RMSEs of the maps as everywhere in these pages (docs/conventions.md), the "
           "photos' in display "
           "values. *At the start*: before the first step.\n"
           "- **Attainable** is the standard deviation of an estimate of each texel by itself from these "
           "photos, with the "
           "right views and light, at the truth: the curvature of the photometric error, the photos' own "
           "noise, and a prior "
           "as wide as each number's range. *Photos, truth*: by how much the true maps miss the photos. "
           "Where a map is 0 "
           "the curve of gamma is flat, and the curvature says less than is known.\n"
           "- **Condition** is the largest by the smallest singular value of a texel's Jacobian, as in "
           "[stability.md](stability.md), median and worst texel; pixels that are burnt out have no slope.\n"
           "- **Stated** is the standard deviation that the fit itself gives, root mean square over texels, "
           "mean of the maps.\n"
           f"- **Within 10 %**: when the photos' error first was at most {NEAR:g} times the final one.\n"
           "- A warning counts by its words; one that comes for another reason counts as well.")


def command(record: Mapping) -> str:
    """The command that makes the record again."""
    s = record["settings"]
    methods = list(dict.fromkeys(r["method"] for r in record["records"]))
    return (f"mitsvbrdf stability --fits {'quick' if s['quick'] else 'all'} --renderer {s['renderer']} "
            "--resolution "
            f"{s['resolution']} --budget {usual_budget(record['records']):g} --methods {' '.join(methods)} "
            "--json stability-fits.json --md stability-fits.md")
