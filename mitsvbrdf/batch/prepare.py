"""From what was asked for to what is left to do: identities, what lies in the library already, and what has changed."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from ..capture.photo import SUFFIXES
from ..errors import OutputError
from ..fit.config import FitConfig, HierarchicalConfig
from ..fit.options import FitOptions, config_record
from ..system.files import write_bytes, write_json
from .entries import Entry, name_of_source
from .identity import capture_files, identity
from .manifest import Manifest
from .places.address import is_url
from .places.place import QUARANTINE, Place, clear_work
from .schedule import Work

TYPICAL_SECONDS = 35.0  # of the default fit: nine photos, 256 px, one thread
PHOTOS = 9  # of a capture whose files are not at hand
ENDLESS = 3600.0  # seconds, of a fit that ends after iterations
LOCK, TOKEN = ".lock", ".token"  # what nodes are to see of a library, to be sure that it is the same

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Asked:
    """A capture, and how it is to be fitted.

    Args:
        entry: the capture.
        config: method and settings.
        options: the others.
        pages: whether its page and pictures are written.
        tags: words to find it by.
        sheet: size in cm of the printed sheet in raw photos; None where there is none.
        strict: whether photos that are damaged are refused.
    """

    entry: Entry
    config: FitConfig
    options: FitOptions
    pages: bool
    tags: tuple[str, ...]
    sheet: float | None = None
    strict: bool = False

    @property
    def record(self) -> dict:
        """What a worker is told, and what the identity is made of."""
        return {"config": config_record(self.config), "options": asdict(self.options), "pages": self.pages,
                "sheet": self.sheet, **({"strict": True} if self.strict else {})}

    @property
    def cost(self) -> float:
        """A guess of its seconds, to begin with the largest."""
        limit = self.config.limited()
        if not isinstance(self.config, HierarchicalConfig):
            return limit.budget or ENDLESS
        photos = PHOTOS
        if not is_url(self.entry.source):
            photos = sum(path.suffix.lower() in SUFFIXES for path in capture_files(Path(self.entry.source)))
        return min(limit.budget or ENDLESS, TYPICAL_SECONDS * photos / PHOTOS * (self.options.resolution / 256) ** 2)


def library_lock(home: Path) -> Callable[[], None]:
    """Hold a library for this process alone; returns what lets go of it.

    Raises:
        OutputError: another batch has it, or the folder is none of ours or cannot be written.
    """
    from .manifest import FILE

    try:
        known = not home.is_dir() or (home / FILE).exists() or all(
            path.name == LOCK or path.name.startswith((TOKEN, f".{TOKEN}")) for path in home.iterdir())
        if not known or home.exists() and not home.is_dir():
            raise OutputError("a new folder or a library", f"{home}, which is neither", "choose another place")
        home.mkdir(parents=True, exist_ok=True)
        lock = (home / LOCK).open("w")
    except OSError as reason:
        raise OutputError(f"a place to write at {home}", reason.strerror or str(reason), "choose another place") from None
    import fcntl
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise OutputError("one batch at a time in a library", f"{home}, in use by another one",
                          "wait for it, or choose another library") from None
    if not (token := home / TOKEN).exists():
        write_bytes(token, secrets.token_hex(16).encode())
    return lock.close


class Registered(NamedTuple):
    """What of the captures that were named is not fitted by itself.

    Args:
        unreadable: why a capture cannot even be read, by source.
        same: source of the capture that has the same photos and options, by source.
    """

    unreadable: dict[str, OutputError]
    same: dict[str, str]


def register(asked: Iterable[Asked], manifest: Manifest, report: Report) -> Registered:
    """Enter what is asked for into the manifest.

    Args:
        asked: each capture with its options; the same twice counts once.
        manifest: of the library.
        report: told what is being read and the share done.
    """
    asked, materials, unreadable, same = list(asked), dict[str, dict](), dict[str, OutputError](), dict[str, str]()
    for number, each in enumerate(asked):
        report(os.path.basename(each.entry.source), number / len(asked))
        try:
            known = identity(each.entry.source, each.record, manifest.hash_of)
            if known in materials and materials[known]["source"] != each.entry.source:
                same[each.entry.source] = materials[known]["source"]
                continue
            materials[known] = {
                "identity": known, "name": name_of_source(each.entry.source), "source": each.entry.source,
                "asked": each.record | {"folder": os.getcwd()}, "own": " ".join(each.entry.own), "tags": list(each.tags),
                "cost": each.cost}
        except (OSError, UnicodeEncodeError) as reason:  # the second: a name that is not UTF-8, which no manifest can hold
            way_out = "check your rights to it" if isinstance(reason, OSError) else "rename it"
            unreadable[each.entry.source] = OutputError("a capture that can be read", f"{each.entry.source}: {reason}", way_out)
    manifest.want(materials.values())
    return Registered(unreadable, same)


@dataclass(frozen=True)
class Standing:
    """What a library has of what is wanted.

    Args:
        work: what is left to do.
        done: how many were found whole.
        adopted: how many of these an earlier batch finished without noting it.
        damaged: by folder, what was wrong with a result that is made anew.
    """

    work: list[Work]
    done: int
    adopted: int
    damaged: dict[str, str]


def take_stock(manifest: Manifest, place: Place, home: Path, retry_failed: bool) -> Standing:
    """Compare the manifest with the files, which are the truth, and say what is left to do.

    Args:
        manifest: of the library.
        place: where its results lie.
        home: folder of the manifest and of what is being made.
        retry_failed: whether what failed is tried again.
    """
    manifest.interrupted()
    clear_work(home)
    adopted, damaged = 0, {}
    for each in manifest.materials("done", "pending", "failed"):
        record = place.record(each["folder"])
        whole = record is not None and record.get("identity") == each["identity"]
        wrong = place.damage(each["folder"], record, hashes=False) if record and whole else "its record is missing"
        if not wrong and record:
            if each["state"] != "done":
                manifest.adopt(each["identity"], record)
                release(home, each["folder"])
                adopted += 1
        elif each["state"] == "done" or record is not None and each["state"] == "pending":
            damaged[each["folder"]] = wrong
            place.set_aside(each["folder"])
            manifest.again(each["identity"], wrong)
    if retry_failed:
        for each in manifest.materials("failed"):
            manifest.again(each["identity"], each["reason"])
    left = [Work(each["identity"], each["cost"]) for each in manifest.materials("pending")]
    return Standing(left, manifest.counts()["done"], adopted, damaged)


def quarantine(home: Path, folder: str, reason: dict, log: str) -> None:
    """Keep why a capture failed, and what its fit printed."""
    write_json(home / QUARANTINE / folder / "reason.json", reason)
    write_bytes(home / QUARANTINE / folder / "log.txt", log.encode(errors="replace"))


def release(home: Path, folder: str) -> None:
    """A capture that failed before is done: its reason is of no use any more."""
    shutil.rmtree(home / QUARANTINE / folder, ignore_errors=True)


def task_of(manifest: Manifest, work: Work, attempt: str, library: str) -> dict:
    """What a worker is told of a piece of work."""
    row = manifest.material(work.identity)
    asked = json.loads(row["asked"])
    return {"attempt": attempt, "name": row["name"], "identity": work.identity, "capture": row["source"], "library": library,
            "folder": asked.pop("folder"), "options": asked}
