"""What is left to do of what is asked for: what lies in the library already is checked and skipped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from ..errors import OutputError
from .asked import Asked
from .captures import name_of
from .fitting import now
from .library import Library
from .records import Material


@dataclass
class Stock:
    """What a library has of what is asked for.

    Args:
        work: what is left to do.
        done: how many results were found whole.
        failed: how many failed before and are not tried again.
        unreadable: how many have photos, or a name, that cannot be read.
        notes: lines about what is omitted, or done anew.
    """

    work: list[Material] = field(default_factory=list)
    done: int = 0
    failed: int = 0
    unreadable: int = 0
    notes: list[str] = field(default_factory=list)


def take_stock(asked: Iterable[Asked], library: Library, retry_failed: bool,
               report: Callable[[str, float], None] = lambda *_: None) -> Stock:
    """Compare what is asked for with the folders of a library, which is this process's own.

    Args:
        asked: each capture with its options; the same twice counts once.
        library: what lies there; it learns what is asked for.
        retry_failed: whether what failed is tried again.
        report: told what is read and the share done.
    """
    stock, results, known, wanted = Stock(), library.results, library.materials, dict[str, Material]()
    for material in _materials(list(asked), report):
        if isinstance(material, OutputError):
            stock.unreadable += 1
            stock.notes.append(f"omitted: {material}")
        elif (twin := wanted.setdefault(material.folder, material)).source != material.source:
            stock.notes.append(f"omitted: {material.source} has the photos and options of {twin.source}")
    names, shown = set(results.names()), library.shown()
    for folder, material in wanted.items():
        before = known.get(folder)
        if folder in names:
            wrong = _wrong(library, before, material)
            if before and not wrong:
                stock.done += 1
                _restate(library, before, material, folder in shown)
                continue
            stock.notes.append(f"done anew: {folder} ({wrong}; it is kept as {folder}.damaged.*)")
            results.set_aside(folder)
        if before and before.state == "failed" and not retry_failed:
            stock.failed += 1
        else:
            library.wants(material)
            stock.work.append(material)
    return stock


def _materials(asked: list[Asked], report: Callable[[str, float], None]) -> Iterator[Material | OutputError]:
    """What a library keeps of each capture, or why it cannot be read."""
    with ThreadPoolExecutor() as pool:
        for number, (each, found) in enumerate(zip(asked, pool.map(_material, asked))):
            report(os.path.basename(each.entry.source), number / len(asked))
            yield found


def _material(asked: Asked) -> Material | OutputError:
    source = asked.entry.source
    try:
        source.encode()
        return Material(identity=asked.identity, name=name_of(source), source=source, asked=asked.record,
                        words=asked.words, tags=list(asked.tags), date=now(), base=os.getcwd(),
                        cost=asked.cost, limit=asked.limit)
    except (OSError, UnicodeEncodeError) as error:  # no record can state such a name
        return OutputError("a capture that can be read, with a name in UTF-8", f"{source!r}: {error}",
                           "check your rights to it, and its name")


def _wrong(library: Library, before: Material | None, material: Material) -> str:
    """What is wrong with the folder of a result, in words; empty where nothing is."""
    if before is None or before.state != "done" or before.identity != material.identity:
        return "its record is missing"
    return library.results.damage(before, hashes=False)


def _restate(library: Library, result: Material, material: Material, shown: bool) -> None:
    """Let a result say what is said of its capture now, and be the newest of it."""
    if (result.source, result.tags) != (material.source, material.tags) or not shown:
        result = result.but(source=material.source, tags=material.tags, date=now())
        library.results.restate(result)
    library.done(result)
