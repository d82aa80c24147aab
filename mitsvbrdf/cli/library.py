"""``mitsvbrdf library``: what a batch made, to list, check, export and tidy up."""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..batch.library import Library, matches
from ..batch.records import Failure, Result
from ..batch.results import FAILED, ResultStore
from ..errors import ConfigError, MapsError, MitsvbrdfError
from ..export import check_options
from ..io.progress import console, progress_bar, say, several
from .options import folder_inside

COLUMNS = {"error": "{:.4f}", "held_out_error": "{:.4f}", "burn_in": "{:.2f}", "seconds": "{:.1f}",
           "attempts": "{}"}
WIDE = 32  # letters of a name that the list has room for beside its numbers, in a terminal of 80


def library(
    folder: Annotated[
        Positional[str], arg(metavar="LIBRARY", help=("What a batch made: a folder or a URL."))
    ],
    search: Annotated[
        str,
        arg(
            metavar="TEXT",
            help=("Only materials with this text in name, tags, source, method, host, options or reason."),
        ),
    ] = "",
    state: Annotated[
        Literal["all", "done", "failed", "pending"], arg(help="Only materials in this state.")
    ] = "all",
    verify: Annotated[bool, arg(help="Hash all files again, and say which have changed.")] = False,
    export: Annotated[
        str,
        arg(
            metavar="FORMAT,...",
            help=("Export each of them into OUT/NAME; formats as of `mitsvbrdf export --to`."),
        ),
    ] = "",
    out: Annotated[Path | None, arg(aliases=["-o"], help="Where exports go.")] = None,
    prune: Annotated[
        bool,
        arg(
            help=(
                "Delete results that a newer one of the same capture took the place of, and what was damaged "
                "and set aside."
            )
        ),
    ] = False,
    dry_run: Annotated[bool, arg(help="With --prune: only say what it would delete.")] = False,
    as_json: Annotated[bool, arg(name="json", help="Print rows as JSON, one a line.")] = False,
    overwrite: Annotated[bool, arg(help="Replace exports that are there already.")] = False,
) -> int:
    """Look through a library of materials: list, check, export or tidy up what `mitsvbrdf batch` made.

    `mitsvbrdf library LIBRARY --search wood --state done` lists some of them. The page LIBRARY/index.html
    shows them all, and LIBRARY/library.json is for pandas. The exit code of --verify is 1 where a file has
    changed.
    """
    if bool(export) != (out is not None):
        raise ConfigError("--export FORMAT with -o FOLDER", "one of them", "give both, or neither")
    if dry_run and not prune:
        raise ConfigError("--prune beside --dry-run", "no --prune", "add it")
    formats = [part.strip() for part in export.split(",")]
    if export:
        check_options(formats)
    results = ResultStore(folder)
    if not results.is_library():
        raise MapsError("the LIBRARY of a batch", f"{folder}, which is none", "`mitsvbrdf batch` makes one")
    if prune:
        return _prune(results, dry_run)
    materials = Library(results)
    chosen = [row for row in materials.rows() if matches(row, search, () if state == "all" else (state,))]
    done = [row for row in chosen if row["state"] == "done"]
    if verify:
        return _verify(materials, [row["folder"] for row in done])
    if out:
        return _export(results, done, ",".join(formats), out, overwrite)
    if as_json:
        for row in chosen:
            say(json.dumps(row))
    else:
        _print(chosen)
    return 0


def _print(chosen: Sequence[dict]) -> None:
    from rich.console import Console
    from rich.table import Table

    if not chosen:
        say("no material matches")
        return
    table = Table(title=several(len(chosen), "material"), title_justify="left", box=None, header_style="bold")
    longest = max(len(_called(row)) for row in chosen)
    table.add_column("material", overflow="fold", min_width=min(WIDE, longest))
    table.add_column("state", no_wrap=True)
    for heading in (*(name.replace("_", " ") for name in COLUMNS), "warnings"):
        table.add_column(heading, justify="right")
    for row in chosen:
        numbers = ["" if row[name] is None else text.format(row[name]) for name, text in COLUMNS.items()]
        table.add_row(_called(row), row["state"], *numbers, str(len(row["warnings"]) or ""))
    with contextlib.suppress(BrokenPipeError):
        (console if console.is_terminal else Console(width=1000)).print(table)  # a pipe has no width
    for row in chosen:
        if row["state"] == "failed":
            say(f"failed: {_called(row)}: {row['reason']}")


def _called(row: dict) -> str:
    """The name of a material with the beginning of its identity."""
    return row["folder"].rpartition("/")[2]


def _verify(materials: Library, folders: Sequence[str]) -> int:
    """Hash files again; the exit code says whether all are as they were."""
    wrong: dict[str, str] = {}
    with progress_bar("hashing") as report:
        for number, folder in enumerate(folders):
            report(folder, number / len(folders))
            result = materials.materials[folder]
            if isinstance(result, Result) and (damage := materials.results.damage(result, hashes=True)):
                wrong[folder] = damage
    for folder, damage in wrong.items():
        say(f"changed: {folder}: {damage}")
    if wrong:
        say("to mend these, delete their folders and run the same batch again: it makes them anew")
    say(f"unchanged: {len(folders) - len(wrong)} of {several(len(folders), 'result')}")
    return int(bool(wrong))


def _export(results: ResultStore, done: Sequence[dict], formats: str, out: Path, overwrite: bool) -> int:
    """Export each material into a folder of its own; where one fails that is told, and the rest goes on."""
    from .export import export as export_one

    wrong = 0
    for row in done:
        try:
            with _local(results, row["folder"]) as result:
                export_one(str(result), formats, out=folder_inside(out, row["folder"]), overwrite=overwrite)
        except MitsvbrdfError as error:
            wrong += 1
            say(f"not exported: {row['folder']}: {error}")
    say(f"exported {len(done) - wrong} of {len(done)} to {out}")
    return int(bool(wrong))


@contextlib.contextmanager
def _local(results: ResultStore, folder: str) -> Iterator[Path]:
    """A result as a folder of this machine."""
    if results.store.folder:
        yield results.store.folder / folder
        return
    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-result-") as copy:
        results.store.fetch(folder, Path(copy) / folder)
        yield Path(copy) / folder


def _prune(results: ResultStore, dry_run: bool) -> int:
    """Delete what is wanted no more."""
    with results.claimed():
        materials, deleted = Library(results), "would delete" if dry_run else "deleted"
        shown = materials.shown()
        old = [each for folder, each in materials.materials.items() if folder not in shown]
        done = [each.folder for each in old if isinstance(each, Result)]
        aside, failed = results.aside(), [each.folder for each in old if isinstance(each, Failure)]
        for folder, why in (*((folder, "a newer result took its place") for folder in done),
                            *((folder, "damaged, and made anew") for folder in aside),
                            *((f"{FAILED}/{folder}", "its capture has changed") for folder in failed)):
            say(f"{deleted}: {folder} ({why})")
        if not dry_run:
            for folder in (*done, *aside):
                results.remove(folder)
            for folder in failed:
                results.settle(folder)
            for folder in (*done, *failed):
                del materials.materials[folder]
            materials.write()
    gone = several(len(done) + len(aside), "result")
    say(f"{deleted} {gone}, and the reasons of {several(len(failed), 'failure')}")
    return 0
