"""``mitsvbrdf batch``: many captures into one library."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from ..batch.asked import Asked
from ..batch.entries import Entry, Mistakes, entries
from ..batch.manifest import FILE, Manifest
from ..batch.places.address import check_address, download, home_of, is_url, place_of, upload
from ..batch.places.place import QUARANTINE, WORK, clear_work
from ..batch.prepare import LOG, Standing, library_lock, register, take_stock
from ..batch.progress import telling
from ..batch.run import Batch
from ..batch.schedule import Scheduler
from ..batch.settings import BatchSettings
from ..batch.workers.pool import RayPool, require_ray
from ..errors import ConfigError, MitsvbrdfError
from ..fit.config import FitConfig
from ..fit.options import FitOptions
from ..io.files import remove
from ..io.progress import progress_bar, say
from .fit import fit_command, with_flags
from .options import Strict

USUAL, USUAL_BATCH = FitOptions(), BatchSettings()
INTERRUPTED = 130


def batch(captures: Annotated[Positional[list[str]], arg(metavar="CAPTURE", help=(
              "Captures, folders of captures, patterns, URLs, or lists: text files with a capture and its "
              "own options a line; "
              "- is a list on standard input."), help_behavior_hint="(required)")],
          out: Annotated[str, arg(aliases=["-o"], metavar="LIBRARY", help="The library: a folder that all "
                                                                          "workers see, or a "
                                                                          "URL like s3://bucket/library.")],
          config: FitConfig, shared: OmitArgPrefixes[FitOptions] = USUAL,
          running: OmitArgPrefixes[BatchSettings] = USUAL_BATCH,
          method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"],
                            arg(help="How to fit; `batch --method gan --help` shows its own options.")] = "hierarchical",
          pages: Annotated[Literal["all", "none"],
                           arg(help="none: maps, uncertainty, fit.json and preview alone, in a sixth "
                                    "of the space.")] = "all",
          tag: UseAppendAction[Annotated[tuple[str, ...],
                                         arg(help="Words to find these materials by, commas between.")]] = (),
          sheet: Annotated[float | None, arg(metavar="CM", help="In raw photos a printed sheet of tags lies "
                                                                "around the "
                                                                "material: its measured size.")] = None,
          strict: Strict = False) -> int:
    """Fit many captures into one library, whatever dies on the way.

    `mitsvbrdf batch shots/ -o library` fits each capture in shots/; the options are those of `mitsvbrdf fit`.
    Run the same again and it goes on: what is done is checked and skipped, what has changed is done anew,
    what failed is tried again with --retry-failed. Raw photos become captures first. Ctrl-C waits for what
    runs; a second one does not.

    LIBRARY then holds a folder a material, index.html to look at, library.json for pandas, manifest.sqlite,
    and quarantine/ with the reason and the log of each capture that failed. The exit code is 1 where any
    failed. Needs Ray: pip install 'mitsvbrdf[batch]'.
    """
    running.check()
    shared.check(config)
    require_ray()
    asked = _asked(captures, Asked(Entry(""), config, shared, pages == "all", _split(tag), sheet, strict))
    with _opened(out) as (home, manifest):
        library = out if is_url(out) else os.path.realpath(out)
        place = place_of(library)
        with progress_bar("reading captures") as report:
            nameless, same = register(asked, manifest, report)
            stock = take_stock(manifest, place, home, running.retry_failed)
        for error in nameless.values():
            say(f"left out: {error}")
        for source, first in same.items():
            say(f"left out: {source} has the photos and options of {first}")
        _say_stock(stock, manifest, home)
        interrupted = False
        if stock.work:
            with telling(home.name) as tell, contextlib.closing(_pool(home, library, running)) as pool:
                work = Batch(home, library, place, manifest, Scheduler(stock.work, running.retries), tell,
                             _typed())
                interrupted = work.run(pool)
            if not interrupted:
                clear_work(home)
            if work.trouble:
                say(f"stopped: {work.trouble}; the same command goes on")
        return _ended(manifest, home, interrupted, len(nameless))


def _asked(captures: list[str], base: Asked) -> list[Asked]:
    """The captures and what is asked for of each; all mistakes are told at once."""
    mistakes, asked = Mistakes(), list[Asked]()
    for entry in entries(captures, mistakes):
        with mistakes.gathered(entry.where):
            asked.append(with_own_options(entry, base))
    mistakes.tell()
    return asked


def with_own_options(entry: Entry, base: Asked) -> Asked:
    """A capture with the options of its line beside those of the command line."""
    if not entry.own:
        return replace(base, entry=entry)
    import tyro

    def line(config: FitConfig, shared: OmitArgPrefixes[FitOptions] = base.options, method: str = "",
             pages: Literal["all", "none"] = "all" if base.pages else "none",
             tag: UseAppendAction[tuple[str, ...]] = (), sheet: float | None = base.sheet,
             strict: bool = base.strict) -> Asked:
        return Asked(entry, config, shared, pages == "all", (*base.tags, *_split(tag)), sheet, strict)

    words, said = with_flags(list(entry.own)), io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            asked = tyro.cli(fit_command(words, line, base.config), args=words, add_help=False,
                             config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit:
        raise ConfigError("options of `mitsvbrdf fit`, --tag, --pages or --sheet",
                          f"{shlex.join(entry.own)} ({_plain(said.getvalue())})", "mend the line") from None
    asked.options.check(asked.config)
    return asked


def _plain(box: str) -> str:
    """The sentence in tyro's box: what stands between its title and the next rule or empty line."""
    lines = [line.strip("│╭╮╰╯ ").strip("─-") for line in re.sub(r"\x1b\[[0-9;]*m", "", box).splitlines()]
    return " ".join(itertools.takewhile(bool, itertools.dropwhile(lambda line: not line, lines[1:])))


def _split(tags: Sequence[str]) -> tuple[str, ...]:
    """Tags with commas between them as tags."""
    return tuple(dict.fromkeys(word for tag in tags for part in tag.split(",") if (word := part.strip())))


def _typed() -> str | None:
    """The command as it was typed; None where it was called otherwise."""
    return shlex.join(["mitsvbrdf", *sys.argv[1:]]) if sys.argv[1:2] == ["batch"] else None


@contextlib.contextmanager
def _opened(out: str) -> Iterator[tuple[Path, Manifest]]:
    """The folder of a library's manifest and page, and the manifest, for this process alone.

    A new library is taken away again where an error ended the command before anything was begun.
    """
    check_address(out)
    home = home_of(out)
    made = not home.exists()
    with contextlib.ExitStack() as last:
        last.callback(library_lock(home))
        download(home, out)
        new, begun = not (home / FILE).exists(), True
        try:
            with contextlib.closing(Manifest(home / FILE)) as manifest:
                try:
                    yield home, manifest
                except MitsvbrdfError:
                    begun = not new or any(each["attempts"] for each in manifest.materials(wanted=False))
                    raise
        finally:
            if begun:
                upload(home, out)
            else:
                _take_away(home, made)


def _take_away(home: Path, folder: bool) -> None:
    """Remove what is in a library's folder, all of which is ours, and where asked for the folder."""
    with contextlib.suppress(OSError):
        for path in home.iterdir():
            remove(path)
        if folder:
            home.rmdir()


def _pool(home: Path, library: str, settings: BatchSettings) -> RayPool:
    """Workers as the settings ask for them; a cluster has as many as it has room for."""
    here = settings.address is None
    workers = settings.local_workers() if here else settings.workers
    memory = settings.local_memory(workers) if here and workers else settings.memory
    (home / WORK).mkdir(exist_ok=True)
    return RayPool(library, address=settings.address, workers=workers, threads=settings.threads,
                   memory=memory, timeout=settings.timeout, dashboard=settings.dashboard,
                   log=home / WORK / "ray.log")


def _say_stock(stock: Standing, manifest: Manifest, home: Path) -> None:
    """What the library has already, and what is left."""
    for folder, wrong in stock.damaged.items():
        say(f"done anew: {folder} ({wrong}; what was there is kept as {folder}.damaged)")
    failed = manifest.materials("failed")
    tried = sum(row["attempts"] > 0 for row in failed)
    known = [f"{count} {what}" for count, what in (
        (stock.done, "done already"), (stock.adopted, "of these found finished"),
        (tried, "failed before (--retry-failed)"), (len(failed) - tried, "unreadable")) if count]
    say(f"{len(stock.work)} to fit into {home}" + (f"; {', '.join(known)}" if known else ""))


def _ended(manifest: Manifest, home: Path, interrupted: bool, nameless: int) -> int:
    """Say what came of it, and give the exit code."""
    counts = manifest.counts()
    left = counts["pending"] + counts["running"]
    for each in manifest.materials("failed")[:20]:
        log = home / QUARANTINE / each["folder"] / LOG
        say(f"failed: {each['name']} ({each['source']}): {each['reason']}"
            + (f"; its log: {log}" if log.exists() else ""))
    words = [f"{counts['done']} done"] + [f"{n} {what}" for n, what in (
        (counts["failed"], "failed"), (nameless, "left out"), (left, "left")) if n]
    say(f"{', '.join(words)}; {home}/index.html shows them" + ("; the same command goes on" if left else ""))
    if counts["failed"] or nameless:
        return 1
    return INTERRUPTED if interrupted and left else int(left > 0)
