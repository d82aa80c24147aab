"""``mitsvbrdf batch``: many captures into one library."""

import contextlib
import io
import itertools
import os
import re
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from ..batch.asked import Asked, Stock, take_stock
from ..batch.captures import Entry, captures, told_with
from ..batch.library import PAGE, Library
from ..batch.results import FAILED, LOG, ResultStore
from ..batch.run import Batch
from ..batch.settings import BatchSettings
from ..batch.tasks import RayTasks, require_ray
from ..capture.align.sheet import Sheet
from ..errors import ConfigError
from ..fit.config import FitConfig
from ..fit.fixed_maps import absolute_files
from ..fit.options import FitOptions
from ..io.progress import progress_bar, say
from . import check_numbers
from .fit import Advanced, Settings, settings, with_flags
from .options import Strict

USUAL, USUAL_BATCH = FitOptions(), BatchSettings()
INTERRUPTED = 130
TOLD = 20  # failures that are printed, at most


def batch(names: Annotated[Positional[list[str]], arg(metavar="CAPTURE", name="captures", help=(
              "Captures, folders of captures, URLs, or list files. A line of a list file: a capture, then "
              "options for this capture only."), help_behavior_hint="(required)")],
          out: Annotated[str, arg(aliases=["-o"], metavar="LIBRARY", help=(
              "The library: a folder that all workers see, or a URL like s3://bucket/library."))],
          config: Settings, shared: OmitArgPrefixes[FitOptions] = USUAL,
          running: OmitArgPrefixes[BatchSettings] = USUAL_BATCH,
          method: Annotated[Literal["hierarchical", "hybrid", "gan", "direct"], arg(
              help="How to fit. `batch --method gan --help` shows the options of gan.")] = "hierarchical",
          pages: Annotated[Literal["all", "none"], arg(
              help="none: write only maps, uncertainty, fit.json and preview, a sixth of the size.")] = "all",
          tag: UseAppendAction[Annotated[tuple[str, ...], arg(
              help="Search words for these materials, separated by commas.")]] = (),
          sheet: Annotated[float | None, arg(metavar="CM", help=(
              "Measured size of the printed sheet of tags around the material in raw photos."))] = None,
          strict: Strict = False, advanced: Advanced = False) -> int:
    """Fit many captures into one library. After a crash, the same command continues the batch.

    `mitsvbrdf batch shots/ -o library` fits each capture in shots/. The options are those of `mitsvbrdf fit`.
    The same command continues an earlier batch: it checks and skips finished results, and fits captures that
    have changed. With --retry-failed it also fits captures that failed. Raw photos are first made into a
    capture. Ctrl-C waits for the running fits. A second Ctrl-C ends them.

    LIBRARY contains a folder for each material, the page index.html (you can open it while the batch runs),
    library.json for pandas, and failed/ with the reason and the log of each capture that failed. The exit
    code is 1 if a capture failed or could not be read. `batch` needs Ray: pip install 'mitsvbrdf[batch]'.
    """
    running.check()
    shared.check(config)
    require_ray()
    base = Asked(Entry(""), config, shared, pages == "all", _split(tag), sheet, strict)
    asked = [with_own_options(entry, base) for entry in captures(names)]
    for each in asked:
        check_asked(each)
    results = ResultStore(out)
    with results.claimed() as token:
        results.clear_work()
        library = Library(results)
        with progress_bar("reading captures") as report:
            stock = take_stock(asked, library, running.retry_failed, report)
        _say_stock(stock, results)
        interrupted = False
        if stock.work:
            tell = partial(say, out=sys.stdout)
            with RayTasks(running) as tasks:
                work = Batch(library, stock.work, running, token, tell)
                interrupted = work.run(tasks)
            results.clear_work()
            if work.trouble:
                say(f"stopped: {work.trouble}; the same command goes on")
        else:
            library.write()
        return _ended(library, stock, interrupted)


def with_own_options(entry: Entry, base: Asked) -> Asked:
    """The options for one capture: those of its line in a list override those of the command line."""
    if not entry.own:
        return replace(base, entry=entry)
    import tyro

    def line(config: Settings, shared: OmitArgPrefixes[FitOptions] = base.options, method: str = "",
             pages: Literal["all", "none"] = "all" if base.pages else "none",
             tag: UseAppendAction[tuple[str, ...]] = (), sheet: float | None = base.sheet,
             strict: bool = base.strict) -> Asked:
        return Asked(entry, config, shared, pages == "all", (*base.tags, *_split(tag)), sheet, strict)

    words, said = with_flags(entry.own), io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            asked = tyro.cli(partial(line, config=settings(words, base.config)), args=words, add_help=False,
                             config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit:
        got = f"{shlex.join(entry.own)} ({_plain(said.getvalue())}; {entry.where})"
        raise ConfigError("options of `fit`, --tag, --pages or --sheet", got, "mend the line") from None
    with told_with(entry.where):
        asked.options.check(asked.config)
    return _from_list(asked, base.config)


def _from_list(asked: Asked, common: FitConfig) -> Asked:
    """The same options. If the line names files, relative files of the command become absolute paths."""
    config = asked.config
    before = common if isinstance(config, type(common)) else type(config)()
    if set(config.files) <= set(before.files):
        return replace(asked, entry=asked.entry._replace(base=""))
    changes: dict[str, Any] = {"fix": (*absolute_files(before.fix), *config.fix[len(before.fix):])}
    if (pretrained := getattr(before, "pretrained", None)) and pretrained in config.files:
        changes["pretrained"] = os.path.abspath(pretrained)
    return replace(asked, config=replace(config, **changes))


def check_asked(asked: Asked) -> None:
    """Raise ConfigError if a number is out of range, or if a file named in the settings is missing."""
    with told_with(asked.entry.where):
        check_numbers("", asked)
        if asked.sheet is not None:
            Sheet(asked.sheet)
        for file in asked.config.files:
            if not os.path.isfile(os.path.join(asked.entry.base, file)):
                raise ConfigError("a number or a file that is there", file, "check the path")


def _plain(box: str) -> str:
    """The message in an error box of tyro: the lines below its title, up to a rule or an empty line."""
    lines = [line.strip("│╭╮╰╯ ").strip("─-") for line in re.sub(r"\x1b\[[0-9;]*m", "", box).splitlines()]
    return " ".join(itertools.takewhile(bool, itertools.dropwhile(lambda line: not line, lines[1:])))


def _split(tags: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word for tag in tags for part in tag.split(",") if (word := part.strip())))


def _say_stock(stock: Stock, results: ResultStore) -> None:
    for note in stock.notes:
        say(note)
    known = [f"{count} {what}" for count, what in (
        (stock.done, "done already"), (stock.failed, "failed before (--retry-failed)")) if count]
    say(f"{len(stock.work)} to fit into {results.address}" + (f"; {', '.join(known)}" if known else ""))


def _ended(library: Library, stock: Stock, interrupted: bool) -> int:
    """Print how the batch ended. Return the exit code, which depends only on the captures of this command."""
    counts, home = library.counts(), library.results.address
    failed = [each for each in library.shown().values() if each.state == "failed"]
    for each in sorted(failed, key=lambda each: each.name)[:TOLD]:
        log = f"; its log: {home}/{FAILED}/{each.folder}/{LOG}" if each.log else ""
        say(f"failed: {each.name} ({each.source}): {each.reason}{log}")
    words = [f"{counts['done']} done"] + [f"{n} {what}" for n, what in (
        (counts["failed"], "failed"), (stock.unreadable, "passed over"), (counts["pending"], "left")) if n]
    more = "; the same command goes on" if counts["pending"] else ""
    say(f"{', '.join(words)}; {home}/{PAGE} shows them{more}")
    ended = Counter(library.materials[each.folder].state for each in stock.work)
    if interrupted and ended["pending"]:
        return INTERRUPTED
    return int(bool(ended["pending"] or ended["failed"] or stock.failed or stock.unreadable))
