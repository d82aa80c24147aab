"""``mitsvbrdf library``: what a batch made, to list, check, export and tidy up."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..batch.library.rows import open_library, rows, write_library
from ..batch.library.where import matcher
from ..batch.manifest import FILE, Manifest
from ..batch.places.address import download, home_of, is_url, local_capture, place_of, title_of, upload
from ..batch.places.place import QUARANTINE
from ..batch.prepare import library_lock, release
from ..errors import ConfigError, MitsvbrdfError, OutputError
from ..export import check_options
from ..io.progress import console, progress_bar, say, several
from .options import folder_inside

COLUMNS = {"error": "{:.4f}", "left_out_error": "{:.4f}", "burn_in": "{:.2f}", "seconds": "{:.1f}",
           "attempts": "{}"}

WIDE = 32  # letters of a name that the list has room for beside its numbers, in a terminal of 80


def library(folder: Annotated[Positional[str],
                              arg(metavar="LIBRARY", help="What a batch made: a folder or a URL.")],
            where: Annotated[str, arg(metavar="EXPRESSION", help="Only materials like these: \"error<0.05 "
                                                                 "tag:wood\"; all "
                                                                 "words are in docs/batch.md.")] = "",
            verify: Annotated[bool, arg(
                help="Count the hashes of all files anew, and say which have changed.")] = False,
            export: Annotated[str, arg(metavar="FORMAT,...", help="Export each of them into OUT/NAME; "
                                                                  "formats as of `mitsvbrdf "
                                                                  "export --to`.")] = "",
            out: Annotated[Path | None, arg(aliases=["-o"], help="Where exports go.")] = None,
            prune: Annotated[bool, arg(help="Delete results that a newer one of the same capture took the "
                                            "place of, and what "
                                            "was damaged and set aside.")] = False,
            dry_run: Annotated[bool, arg(help="With --prune: only say what it would delete.")] = False,
            as_json: Annotated[bool, arg(name="json", help="Print rows as JSON, one a line.")] = False,
            overwrite: Annotated[bool, arg(help="Replace exports that are there already.")] = False) -> int:
    """Look through a library of materials: list, check, export or tidy up what `mitsvbrdf batch` made.

    `mitsvbrdf library LIBRARY --where "error>0.05"` lists the materials whose photos are met worst; the page
    LIBRARY/index.html shows them and understands the same words. The exit code of --verify is 1 where a file
    has changed.
    """
    if bool(export) != (out is not None):
        raise ConfigError("--export FORMAT with -o FOLDER", "one of them", "give both, or neither")
    if dry_run and not prune:
        raise ConfigError("--prune beside --dry-run", "no --prune", "add it")
    formats = [part.strip() for part in export.split(",")]
    if export:
        check_options(formats)
    fits = matcher(where)
    home = home_of(folder)
    if prune:
        return _prune(folder, home, dry_run)
    if is_url(folder):
        _bring(folder, home)
    with contextlib.closing(open_library(home)) as manifest:
        chosen = [row for row in rows(manifest) if fits(row)]
        if verify:
            return _verify(folder, manifest, {row["folder"] for row in chosen if row["state"] == "done"})
        if out:
            return _export(folder, chosen, ",".join(formats), out, overwrite)
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
    table.add_column("material", overflow="fold",
                     min_width=min(WIDE, max(len(_called(row)) for row in chosen)))
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


def _verify(library: str, manifest: Manifest, folders: set[str]) -> int:
    """Count hashes anew; the exit code says whether all are as they were."""
    place, wrong = place_of(library), {}
    with progress_bar("counting hashes") as report:
        for number, folder in enumerate(sorted(folders)):
            report(folder, number / len(folders))
            record = place.record(folder)
            if damage := place.damage(folder, record, hashes=True) if record else "its record is missing":
                wrong[folder] = damage
    for folder, damage in wrong.items():
        say(f"changed: {folder}: {damage}")
    if wrong:
        say("to mend these, delete their folders and run the same batch again: it makes them anew")
    say(f"unchanged: {len(folders) - len(wrong)} of {several(len(folders), 'result')}")
    return int(bool(wrong))


def _export(library: str, chosen: Sequence[dict], formats: str, out: Path, overwrite: bool) -> int:
    """Export each material that is done into a folder of its own; one that cannot be is said, and the rest
    goes on.
    """
    from .export import export as export_one

    wrong = 0
    done = [row for row in chosen if row["state"] == "done"]
    for row in done:
        try:
            with local_capture(f"{library.rstrip('/')}/{row['folder']}") as result:
                export_one(str(result), formats, out=folder_inside(out, row["folder"]), overwrite=overwrite)
        except MitsvbrdfError as error:
            wrong += 1
            say(f"not exported: {row['folder']}: {error}")
    say(f"exported {len(done) - wrong} of {len(done)} to {out}")
    return int(bool(wrong))


def _bring(library: str, home: Path) -> None:
    """The manifest of a library behind a URL, as it is there; a batch of this machine that is at work has a
    newer one.
    """
    try:
        unlock = library_lock(home)
    except OutputError:
        return
    try:
        download(home, library)
    finally:
        unlock()


def _prune(library: str, home: Path, dry_run: bool) -> int:
    """Delete what is wanted no more."""
    with contextlib.ExitStack() as last:
        if not is_url(library):
            open_library(home).close()  # before the lock, which would make the folder
        last.callback(library_lock(home))
        download(home, library)
        open_library(home).close()
        if not dry_run:
            last.callback(upload, home, library)
        manifest = last.enter_context(contextlib.closing(Manifest(home / FILE)))
        place, deleted = place_of(library), "would delete" if dry_run else "deleted"
        old = [row for row in manifest.materials(wanted=False) if not row["wanted"]]
        gone = [(row["folder"], "a newer result took its place") for row in old if row["state"] == "done"]
        gone += [(folder, "damaged, and made anew") for folder in place.aside()]
        quarantined = [row["folder"] for row in old if row["state"] == "failed"]
        for folder, why in (*gone, *((f"{QUARANTINE}/{folder}", "its capture has changed")
                                     for folder in quarantined)):
            say(f"{deleted}: {folder} ({why})")
        if not dry_run:
            for folder, _ in gone:
                place.remove(folder)
            for folder in quarantined:
                release(home, folder)
            for row in old:
                manifest.forget(row["identity"])
            write_library(home, manifest, title_of(library))
    say(f"{deleted} {several(len(gone), 'result')}, and the reasons of {several(len(quarantined), 'failure')}")
    return 0
