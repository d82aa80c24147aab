"""``mitsvbrdf batch``: many captures into one library."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from ..batch.entries import Entry, entries
from ..batch.manifest import FILE, Manifest
from ..batch.places.address import check_address, download, home_of, is_url, place_of, upload
from ..batch.places.place import WORK, clear_work
from ..batch.prepare import Asked, Standing, library_lock, register, take_stock
from ..batch.progress import telling
from ..batch.run import Batch
from ..batch.schedule import Scheduler
from ..batch.settings import BatchSettings
from ..batch.workers.pool import RayPool, require_ray
from ..errors import ConfigError
from ..fit.config import FitConfig
from ..fit.options import FitOptions
from ..system.progress import progress_bar, say
from .fit import fit_command, with_flags
from .options import Strict

USUAL, USUAL_BATCH = FitOptions(), BatchSettings()
INTERRUPTED = 130


def batch(captures: Annotated[Positional[list[str]], arg(metavar="CAPTURE", help=(
              "Captures, folders of captures, patterns, URLs, or lists: text files with a capture and its own options a line; "
              "- is a list on standard input."))],
          out: Annotated[str, arg(aliases=["-o"], metavar="LIBRARY", help="The library: a folder that all workers see, or a "
                                                                          "URL like s3://bucket/library.")],
          config: FitConfig, shared: OmitArgPrefixes[FitOptions] = USUAL,
          running: OmitArgPrefixes[BatchSettings] = USUAL_BATCH,
          method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"],
                            arg(help="How to fit; `batch --method gan --help` shows its own options.")] = "hierarchical",
          pages: Annotated[Literal["all", "none"], arg(help="none: maps, uncertainty, fit.json and preview alone, in a sixth "
                                                            "of the space.")] = "all",
          tag: UseAppendAction[Annotated[tuple[str, ...], arg(help="A word to find these materials by; repeatable.")]] = (),
          sheet: Annotated[float | None, arg(metavar="CM", help="In raw photos a printed sheet of tags lies around the "
                                                                "material: its measured size.")] = None,
          strict: Strict = False) -> int:
    """Fit many captures into one library, whatever dies on the way.

    `mitsvbrdf batch shots/ -o library` fits each capture in shots/; the options are those of `mitsvbrdf fit`. Run the same
    again and it goes on: what is done is checked and skipped, what has changed is done anew, what failed is tried again with
    --retry-failed. Raw photos become captures first. Ctrl-C waits for what runs; a second one does not.

    LIBRARY then holds a folder a material, index.html to look at (`mitsvbrdf view LIBRARY` while the batch runs), library.json
    for pandas, manifest.sqlite, and quarantine/ with the reason and the log of each capture that failed. The exit code is 1
    where any failed. Needs Ray: pip install 'mitsvbrdf[batch]'.
    """
    running.check()
    shared.check(config)
    require_ray()
    base = Asked(Entry(""), config, shared, pages == "all", tag, sheet, strict)
    asked = [_with_own_options(entry, base) for entry in entries(captures)]
    for each in asked:
        each.options.check(each.config)
    with _opened(out) as (home, manifest):
        library = out if is_url(out) else os.path.realpath(out)
        place = place_of(library)
        with progress_bar("captures") as report:
            unreadable, same = register(asked, manifest, report)
            stock = take_stock(manifest, place, home, running.retry_failed)
        for error in unreadable.values():
            say(f"left out: {error}")
        for source, first in same.items():
            say(f"left out: {source} has the photos and options of {first}")
        _say_stock(stock, manifest, home)
        interrupted = False
        if stock.work:
            with telling(home.name) as tell, contextlib.closing(_pool(home, library, running, asked)) as pool:
                work = Batch(home, library, place, manifest, Scheduler(stock.work, running.retries), tell)
                interrupted = work.run(pool)
            if not interrupted:
                clear_work(home)
            if work.trouble:
                say(f"stopped: {work.trouble}; the same command goes on")
        return _ended(manifest, home, interrupted, len(unreadable))


def _with_own_options(entry: Entry, base: Asked) -> Asked:
    """A capture with the options of its line beside those of the command line."""
    if not entry.own:
        return replace(base, entry=entry)
    import tyro

    def line(config: FitConfig, shared: OmitArgPrefixes[FitOptions] = base.options, method: str = "",
             pages: Literal["all", "none"] = "all" if base.pages else "none",
             tag: UseAppendAction[tuple[str, ...]] = (), sheet: float | None = base.sheet) -> Asked:
        return Asked(entry, config, shared, pages == "all", (*base.tags, *tag), sheet, base.strict)

    words = with_flags(list(entry.own))
    try:
        return tyro.cli(fit_command(words, line, base.config), args=words, prog=f"options in {entry.where}",
                        config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit:
        raise ConfigError("options of `mitsvbrdf fit`, or --tag", f"{' '.join(entry.own)} ({entry.where})",
                          "mend the line") from None


@contextlib.contextmanager
def _opened(out: str) -> Iterator[tuple[Path, Manifest]]:
    """The folder of a library's manifest and page, and the manifest, for this process alone."""
    check_address(out)
    home = home_of(out)
    with contextlib.ExitStack() as last:
        last.callback(library_lock(home))
        download(home, out)
        last.callback(upload, home, out)
        yield home, last.enter_context(contextlib.closing(Manifest(home / FILE)))


def _pool(home: Path, library: str, settings: BatchSettings, asked: list[Asked]) -> RayPool:
    """Workers as the settings ask for them; a cluster has as many as it has room for."""
    here = settings.address is None
    workers = settings.local_workers() if here else settings.workers
    memory = settings.local_memory(workers) if here and workers else settings.memory
    (home / WORK).mkdir(exist_ok=True)
    return RayPool(library, address=settings.address, workers=workers, threads=settings.threads, memory=memory,
                   timeout=settings.limit([each.config for each in asked]), dashboard=settings.dashboard,
                   log=home / WORK / "ray.log")


def _say_stock(stock: Standing, manifest: Manifest, home: Path) -> None:
    """What the library has already, and what is left."""
    for folder, wrong in stock.damaged.items():
        say(f"done anew: {folder} ({wrong}; what was there is kept as {folder}.damaged)")
    failed = manifest.counts()["failed"]
    known = [f"{stock.done} done already"] * bool(stock.done) + [f"{failed} failed before (--retry-failed)"] * bool(failed)
    if stock.adopted:
        known.append(f"{stock.adopted} of these were found finished")
    say(f"{len(stock.work)} to fit into {home}" + (f"; {', '.join(known)}" if known else ""))


def _ended(manifest: Manifest, home: Path, interrupted: bool, unreadable: int) -> int:
    """Say what came of it, and give the exit code."""
    counts = manifest.counts()
    left = counts["pending"] + counts["running"]
    for each in manifest.materials("failed")[:20]:
        say(f"failed: {each['name']} ({each['source']}): {each['reason']}; log in {home}/quarantine/{each['folder']}")
    words = [f"{counts['done']} done"] + [f"{n} {what}" for n, what in (
        (counts["failed"], "failed"), (unreadable, "unreadable"), (left, "left")) if n]
    say(f"{', '.join(words)}; {home}/index.html shows them" + ("; the same command goes on" if left else ""))
    if counts["failed"] or unreadable:
        return 1
    return INTERRUPTED if interrupted and left else int(left > 0)

