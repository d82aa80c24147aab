"""The options of each capture, the identity of its result (a hash), and the captures left to fit."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .. import __version__
from ..capture.photo import SUFFIXES
from ..errors import OutputError
from ..fit.config import FitConfig, HierarchicalConfig
from ..fit.methods import METHODS
from ..fit.options import FitOptions, config_record
from ..io import Report
from ..io.files import file_hash
from ..io.json import load
from .captures import Entry, is_calibrated, name_of
from .fitting import now
from .library import Library
from .records import Material
from .stores import Store, is_url

CALIBRATION_FILES = ("capture.json", "camera_pos.txt", "image_size.txt", "light_power.txt", "light_pos.txt")
PATIENCE = 3600.0  # seconds on top of the budgets: enough for a large capture on a machine ten times slower
BUDGETS = 3.0  # budgets a fit may take: it checks the clock only between steps, and the last may be long


@dataclass(frozen=True)
class Asked:
    """A capture, and how it is fitted."""

    entry: Entry  # the capture
    config: FitConfig  # method and settings
    options: FitOptions  # all other options of the fit
    pages: bool  # whether its page and pictures are written
    tags: tuple[str, ...]  # words for a search in the library
    sheet: float | None = None  # size in cm of the printed sheet in raw photos; None: no sheet
    strict: bool = False  # whether damaged photos are refused

    @property
    def record(self) -> dict:
        """The settings for a worker; the identity covers them. A calibrated capture has no sheet."""
        sheet = None if self.sheet is None or is_calibrated(self.entry.source) else self.sheet
        return {"config": config_record(self.config), "options": asdict(self.options), "pages": self.pages,
                "sheet": sheet, "strict": self.strict}

    @property
    def identity(self) -> str:
        """SHA-256, in hex, of photos, calibration, options, files named in the options, and version."""
        source = self.entry.source
        if is_url(source):
            contents: list[list] = Store(source).contents()
        else:
            files_of = capture_files(Path(source))
            contents = [[os.path.relpath(path, source), file_hash(path)] for path in files_of]
        named = [[name, file_hash(path)] for name in self.config.files
                 if (path := Path(self.entry.base, name)).is_file()]
        known = json.dumps([__version__, self.record, contents, named], sort_keys=True)
        return hashlib.sha256(known.encode()).hexdigest()

    @property
    def words(self) -> str:
        """The options that differ from the defaults, without tags: ``resolution=512, seed=3``."""
        preset: Any = {"preset": found} if (found := getattr(self.config, "preset", None)) else {}
        usual = Asked(self.entry, type(self.config)(**preset), FitOptions(), True, ()).record
        known = usual | usual["config"] | usual["options"] | {"method": next(iter(METHODS)), "preset": None}
        given = self.record["config"] | self.record["options"] | self.record
        return ", ".join(f"{name}={value}" for name, value in given.items()
                         if name not in ("config", "options") and value != known.get(name))

    @property
    def cost(self) -> float:
        """Guessed seconds; the longest fit starts first. Default method: 4 s a photo of 256 px."""
        budget, photos = self.config.limited(self.options.resolution).budget or PATIENCE, 9
        if not isinstance(self.config, HierarchicalConfig):
            return budget
        if not is_url(self.entry.source):
            photos = sum(path.suffix.lower() in SUFFIXES for path in capture_files(Path(self.entry.source)))
        return min(budget, 4.0 * photos * (self.options.resolution / 256) ** 2)

    @property
    def limit(self) -> float | None:
        """Seconds after which the fit counts as hanging; None if only iterations limit it."""
        budget = self.config.limited(self.options.resolution).budget
        return None if budget is None else PATIENCE + BUDGETS * budget


def capture_files(source: Path) -> list[Path]:
    """The files that a capture is read from: calibration and photos, sorted by path."""
    folder = source.parent if source.is_file() else source
    folders = {folder}
    stated = source if source.is_file() else folder / "capture.json"
    try:
        folders.add(folder / load(stated)["target_dir"])
    except (OSError, ValueError, KeyError, TypeError):
        pass  # no such file, or a wrong one, which the fit reports
    inside = [path for each in folders if each.is_dir() for path in each.iterdir() if path.is_file()
              and path.name[0] != "."]
    return sorted({path for path in inside if path == source or path.name in CALIBRATION_FILES
                   or path.suffix.lower() in SUFFIXES})


@dataclass
class Stock:
    """Which of the captures asked for have a result in a library, and which are left to fit."""

    work: list[Material] = field(default_factory=list)  # what is left to fit
    done: int = 0  # how many have a complete result
    failed: int = 0  # how many failed before and are not tried again
    unreadable: int = 0  # how many cannot be read, or have a path that is not UTF-8
    notes: list[str] = field(default_factory=list)  # lines about what is skipped or fitted again


def take_stock(asked: Iterable[Asked], library: Library, retry_failed: bool,
               report: Report = lambda text, share: None) -> Stock:
    """Compare the captures asked for with a library, which this process has locked; update the library.

    A capture that is named twice with the same options counts once, with the tags of both.
    """
    stock, results, known = Stock(), library.results, library.materials
    names, shown = set(results.names()), library.shown()
    wanted: dict[str, Material] = {}  # identity to material
    for material in _materials(list(asked), report):
        if isinstance(material, OutputError):
            stock.unreadable += 1
            stock.notes.append(f"passed over: {material}")
            continue
        twin = wanted.get(material.identity, material)
        if material.folder in names and twin.folder not in names:
            twin, material = material, twin
        wanted[twin.identity] = twin.but(tags=list(dict.fromkeys((*twin.tags, *material.tags))))
        if twin.source != material.source:
            stock.notes.append(f"passed over: {material.source} has the photos and options of {twin.source}")
    for material in wanted.values():
        folder, before = material.folder, known.get(material.folder)
        if folder in names:
            there = before
            if before and (before.state != "done" or before.identity != material.identity):
                there = None
            wrong = results.damage(there, hashes=False) if there else "its record is missing"
            if there and not wrong:
                stock.done += 1
                # the result gets the present source and tags of its capture, and the newest date
                if (there.source, there.tags) != (material.source, material.tags) or folder not in shown:
                    there = there.but(source=material.source, tags=material.tags, date=now())
                    results.restate(there)
                library.done(there)
                continue
            stock.notes.append(f"done anew: {folder} ({wrong}; it is kept as {folder}.damaged.*)")
            results.set_aside(folder)
        if before and before.state == "failed" and not retry_failed:
            stock.failed += 1
        else:
            library.materials[folder] = material
            stock.work.append(material)
    return stock


def _materials(asked: list[Asked], report: Report) -> Iterator[Material | OutputError]:
    """The record of each capture for a library, or the error if the capture cannot be read."""
    with ThreadPoolExecutor() as pool:
        for number, (each, found) in enumerate(zip(asked, pool.map(_material, asked))):
            report(os.path.basename(each.entry.source), number / len(asked))
            yield found


def _material(asked: Asked) -> Material | OutputError:
    source = asked.entry.source
    try:
        source.encode()
        return Material(identity=asked.identity, name=name_of(source), source=source, asked=asked.record,
                        words=asked.words, tags=list(asked.tags), date=now(),
                        base=asked.entry.base or os.getcwd(), cost=asked.cost, limit=asked.limit)
    except (OSError, UnicodeEncodeError) as error:  # a record cannot contain a name outside UTF-8
        return OutputError("a capture that can be read, with a name in UTF-8", f"{source!r}: {error}",
                           "check your rights to it, and its name")
