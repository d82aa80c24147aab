"""``mitsvbrdf library``: list or check the results of a batch."""

import json
from collections.abc import Sequence
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..batch.library import Library, matches
from ..batch.results import RECORD, ResultStore
from ..errors import MapsError
from ..io.progress import progress_bar, say, several

NUMBERS = ["error", "held_out_error", "burn_in", "seconds"]


def library(
    folder: Annotated[Positional[str], arg(metavar="LIBRARY", help="Library of a batch: a folder or a URL.")],
    search: Annotated[str, arg(metavar="TEXT", help=(
        "Only materials with this text in name, tags, source, method, host, options or reason."))] = "",
    state: Annotated[Literal["all", "done", "failed", "replaced"], arg(
        help="Only materials in this state. replaced: results that newer results have replaced.")] = "all",
    verify: Annotated[bool, arg(help="Hash all files again, and print which results changed.")] = False,
    as_json: Annotated[bool, arg(name="json", help="Print rows as JSON, one a line.")] = False,
) -> int:
    """Look through a library of materials: list or check what `mitsvbrdf batch` made.

    `mitsvbrdf library LIBRARY --search wood --state done` lists some of them. The page LIBRARY/index.html
    shows them all, and LIBRARY/library.json is for pandas. With --verify the exit code is 1 if a file has
    changed.
    """
    results = ResultStore(folder)
    if not results.is_library():
        raise MapsError("the LIBRARY of a batch", f"{folder}, which is none", "`mitsvbrdf batch` makes one")
    materials, replaced = Library(results), state == "replaced"
    chosen = [row for row in materials.rows(replaced)
              if matches(row, search) and state in ("all", "replaced", row["state"])]
    if verify:
        unread = [] if replaced or state == "failed" else [
            name for name in results.names() if search.lower() in name.lower()
            and (name not in materials.materials or materials.materials[name].state != "done")]
        return _verify(materials, [row["folder"] for row in chosen if row["state"] == "done"], unread)
    if as_json:
        for row in chosen:
            say(json.dumps(row))
    else:
        _print(chosen)
    return 0


def _print(chosen: Sequence[dict]) -> None:
    import pandas

    if not chosen:
        say("no material matches")
        return
    columns = ["material", "state", *NUMBERS]
    table = pandas.DataFrame(chosen, columns=columns).astype(dict.fromkeys(NUMBERS, float))
    table["material"] = [_called(row) for row in chosen]
    say(several(len(chosen), "material"))
    say(table.to_string(index=False, na_rep="", float_format="{:.4f}".format))
    for row in chosen:
        if row["state"] == "failed":
            say(f"failed: {_called(row)}: {row['reason']}")


def _called(row: dict) -> str:
    return row["folder"].rpartition("/")[2]


def _verify(materials: Library, folders: Sequence[str], unread: Sequence[str]) -> int:
    """Hash files again, print changes. Return 1 if any. ``unread``: folders without a readable record."""
    wrong = dict.fromkeys(unread, f"{RECORD} is missing or damaged, or a batch has yet to write it")
    with progress_bar("hashing") as report:
        for number, folder in enumerate(folders):
            report(folder, number / len(folders))
            if damage := materials.results.damage(materials.materials[folder], hashes=True):
                wrong[folder] = damage
    for folder, damage in wrong.items():
        say(f"changed: {folder}: {damage}")
    if wrong:
        say("to mend these, delete their folders while no batch runs, then run the same batch again")
    every = len(folders) + len(unread)
    say(f"unchanged: {every - len(wrong)} of {several(every, 'result')}")
    return int(bool(wrong))

