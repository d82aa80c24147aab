"""What is left to do of what is asked for: what lies in the library already is checked and skipped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import msgspec

from ..errors import OutputError
from .asked import Asked
from .captures import name_of
from .fitting import now
from .library import Library
from .records import Failure, Material, Pending, Result


@dataclass(frozen=True)
class Stock:
    """What a library has of what is asked for.

    Args:
        work: what is left to do.
        done: how many results were found whole.
        failed: how many failed before and are not tried again.
        unreadable: how many have photos that cannot be read.
        damaged: by folder, what is wrong with a result that is made anew.
        same: by source, the source of the capture that has the same photos and options.
        nameless: why a capture cannot even be named in a library.
    """

    work: list[Pending] = field(default_factory=list)
    done: int = 0
    failed: int = 0
    unreadable: int = 0
    damaged: dict[str, str] = field(default_factory=dict)
    same: dict[str, str] = field(default_factory=dict)
    nameless: list[OutputError] = field(default_factory=list)


def take_stock(asked: Iterable[Asked], library: Library, retry_failed: bool,
               report: Callable[[str, float], None] = lambda *_: None) -> Stock:
    """Compare what is asked for with the folders of a library, which is this process's own.

    Captures that an earlier command asked for and left unfinished are part of it.

    Args:
        asked: each capture with its options; the same twice counts once.
        library: what lies there; it learns what is asked for.
        retry_failed: whether what failed is tried again.
        report: told what is read and the share done.
    """
    results, known, unreadable = library.results, library.materials, dict[str, str]()
    nameless, same, wanted = list[OutputError](), dict[str, str](), dict[str, Pending]()
    for material, reason in _materials(list(asked), nameless, report):
        twin = wanted.setdefault(material.folder, material)
        if twin.source != material.source:
            same[material.source] = twin.source
        elif reason:
            unreadable[material.folder] = reason
    keys = {library.key(each): each.folder for each in wanted.values()}
    for folder, left in list(known.items()):
        if isinstance(left, Pending) and folder not in wanted:
            if library.key(left) in keys:  # its photos are others now
                results.settle(folder)
                del known[folder]
            else:
                wanted[folder] = left
    work, counts, damaged = list[Pending](), {"done": 0, "failed": 0}, dict[str, str]()
    names, shown = set(results.names()), library.shown()
    for folder, material in wanted.items():
        before = known.get(folder)
        if folder in names:
            wrong = _wrong(library, before, material)
            if isinstance(before, Result) and not wrong:
                counts["done"] += 1
                _restate(library, before, material, folder in shown)
                continue
            damaged[folder] = wrong
            results.set_aside(folder)
        if folder in unreadable:
            library.failed(Failure(**material.stated(), state="unreadable", reason=unreadable[folder]))
        elif isinstance(before, Failure) and not retry_failed:
            counts["failed"] += 1
        else:
            library.wants(material)
            work.append(material)
    return Stock(work, counts["done"], counts["failed"], len(unreadable), damaged, same, nameless)


def _materials(asked: list[Asked], nameless: list[OutputError],
               report: Callable[[str, float], None]) -> Iterator[tuple[Pending, str]]:
    """What a library keeps of each capture, and why that cannot be read, in words; empty where it can."""
    with ThreadPoolExecutor() as pool:
        for number, (each, found) in enumerate(zip(asked, pool.map(_material, asked))):
            report(os.path.basename(each.entry.source), number / len(asked))
            if isinstance(found, OutputError):
                nameless.append(found)
            else:
                yield found


def _material(asked: Asked) -> tuple[Pending, str] | OutputError:
    source, reason, cost, limit = asked.entry.source, "", 0.0, None
    try:
        source.encode()
    except UnicodeEncodeError as error:  # no record can state it
        return OutputError("a name in UTF-8", f"{source!r}: {error}", "rename it")
    try:
        asked = asked.settled()
        known, cost, limit = asked.identity, asked.cost, asked.limit
    except OSError as error:
        known = asked.identity_of_unreadable
        reason = str(OutputError("a capture that can be read", f"{source}: {error}",
                                 "check your rights to it"))
    return Pending(identity=known, name=name_of(source), source=source, asked=asked.record, words=asked.words,
                   tags=list(asked.tags), date=now(), base=os.getcwd(), cost=cost, limit=limit), reason


def _wrong(library: Library, before: Material | None, material: Pending) -> str:
    """What is wrong with the folder of a result, in words; empty where nothing is."""
    if not isinstance(before, Result) or before.identity != material.identity:
        return "its record is missing"
    return library.results.damage(before, hashes=False)


def _restate(library: Library, result: Result, material: Pending, shown: bool) -> None:
    """Let a result say what is said of its capture now, and be the newest of it."""
    said = {name: getattr(material, name) for name in ("source", "tags")}
    if said != {name: getattr(result, name) for name in said} or not shown:
        result = msgspec.structs.replace(result, **said, date=now())
        library.results.restate(result)
    library.done(result)
