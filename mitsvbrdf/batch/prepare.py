"""From what was asked for to what is left to do: identities, what lies in the library already, and what has
changed.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from ..errors import OutputError
from ..io.files import open_regular, write_bytes, write_json
from .asked import Asked
from .entries import name_of_source
from .identity import identity, identity_of_unreadable, is_calibrated
from .manifest import FILE, Manifest
from .places.place import QUARANTINE, WORK, Place, clear_work
from .places.remote import is_capture
from .schedule import Work

LOG = "log.txt"  # of a capture that failed
LOCK, TOKEN = ".lock", ".token"  # what nodes are to see of a library, to be sure that it is the same

Report = Callable[[str, float], None]


def library_lock(home: Path) -> Callable[[], None]:
    """Hold a library for this process alone; returns what lets go of it.

    Raises:
        OutputError: another batch has it, or the folder is none of ours or cannot be written.
    """
    try:
        known = not home.is_dir() or (home / FILE).exists() or all(
            path.name == LOCK or path.name.startswith((TOKEN, f".{TOKEN}")) for path in home.iterdir())
        if not known or home.exists() and not home.is_dir():
            photos = home.is_dir() and is_capture(os.listdir(home))
            raise OutputError("a new folder or a library",
                              f"{home}, which {'holds photos' if photos else 'is neither'}",
                              "choose another place")
        home.mkdir(parents=True, exist_ok=True)
        _refuse_links(home)
        lock = open_regular(home / LOCK, os.O_RDWR | os.O_CREAT)
    except OSError as reason:
        raise OutputError(f"a place to write at {home}", reason.strerror or str(reason),
                          "check your rights, or choose another place") from None
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


def _refuse_links(home: Path) -> None:
    """Raise OutputError where something would be written through a link; results may be links, which are only
    read.
    """
    for path in (*home.iterdir(), *home.glob(f"{QUARANTINE}/*")):
        if path.is_symlink() and not (path.is_dir() and path.parent == home and path.name not in (WORK,
                                                                                                  QUARANTINE)):
            raise OutputError("a library without links in it", f"{path}, a link", "move it away")


class Registered(NamedTuple):
    """What of the captures that were named is not fitted by itself.

    Args:
        nameless: why a capture cannot even be entered, by source.
        same: source of the capture that has the same photos and options, by source.
    """

    nameless: dict[str, OutputError]
    same: dict[str, str]


def register(asked: Iterable[Asked], manifest: Manifest, report: Report) -> Registered:
    """Enter what is asked for into the manifest; a capture that cannot be read has failed.

    Args:
        asked: each capture with its options; the same twice counts once.
        manifest: of the library.
        report: told what is being read and the share done.
    """
    asked, materials, nameless, same = list(asked), dict[str, dict](), dict[str, OutputError](), dict[str,
                                                                                                      str]()
    unreadable: dict[str, str] = {}
    for number, each in enumerate(asked):
        source = each.entry.source
        report(os.path.basename(source), number / len(asked))
        try:
            material, reason = _material(each, manifest)
        except UnicodeEncodeError as error:  # which no manifest can hold
            nameless[source] = OutputError("a name in UTF-8", f"{source!r}: {error}", "rename it")
            continue
        known = material["identity"]
        if known in materials and materials[known]["source"] != source:
            same[source] = materials[known]["source"]
            continue
        materials[known] = material
        if reason:
            unreadable[known] = reason
    manifest.want(materials.values())
    manifest.refuse(unreadable)
    return Registered(nameless, same)


def _material(each: Asked, manifest: Manifest) -> tuple[dict, str]:
    """What the manifest keeps of a capture, and why it cannot be read, in words; empty where it can.

    Raises:
        UnicodeEncodeError: its name is not UTF-8.
    """
    source, reason, cost, limit = each.entry.source, "", 0.0, None
    source.encode()
    if each.sheet is not None and is_calibrated(source):  # nobody looks for a sheet there
        each = replace(each, sheet=None)
    try:
        known, cost, limit = identity(source, each.record, manifest.hash_of), each.cost, each.limit
    except OSError as error:
        known = identity_of_unreadable(source, each.record)
        reason = str(OutputError("a capture that can be read", f"{source}: {error}",
                                 "check your rights to it"))
    asked = each.record | {"folder": os.getcwd(), "limit": limit}
    return {"identity": known, "name": name_of_source(source), "source": source, "asked": asked,
            "own": each.words,
            "tags": list(each.tags), "cost": cost}, reason


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
        wrong = (place.damage(each["folder"], record, hashes=False) if record and whole
                 else "its record is missing")
        if not wrong and record:
            if each["state"] != "done":
                manifest.adopt(each["identity"], record)
                release(home, each["folder"])
                adopted += 1
        elif each["state"] == "done" or record is not None and each["state"] == "pending":
            damaged[each["folder"]] = wrong
            place.set_aside(each["folder"])
            manifest.again(each["identity"], wrong)
    for each in manifest.materials("failed"):
        if not each["attempts"]:  # it cannot be read, so nobody tries
            quarantine(home, each, each["state"], each["reason"])
        elif retry_failed:
            manifest.again(each["identity"], each["reason"])
    left = [Work(each["identity"], each["cost"]) for each in manifest.materials("pending")]
    return Standing(left, manifest.counts()["done"], adopted, damaged)


def quarantine(home: Path, material: sqlite3.Row, state: str, reason: str, log: str = "") -> None:
    """Keep why a capture failed, and what its fit printed where it printed anything.

    Args:
        home: folder of the quarantine.
        material: its row of the manifest.
        state: how its last attempt ended.
        reason: why, in words.
        log: what the fit printed.
    """
    release(home, material["folder"])
    if log.strip():
        write_bytes(home / QUARANTINE / material["folder"] / LOG, log.encode(errors="replace"))
    write_json(home / QUARANTINE / material["folder"] / "reason.json", {
        "name": material["name"], "source": material["source"], "state": state, "reason": reason,
        "attempts": material["attempts"]})


def release(home: Path, folder: str) -> None:
    """A capture that failed before is done: its reason is of no use any more."""
    shutil.rmtree(home / QUARANTINE / folder, ignore_errors=True)


def task_of(manifest: Manifest, work: Work, attempt: str, library: str) -> dict:
    """What a worker is told of a piece of work."""
    row = manifest.material(work.identity)
    asked = json.loads(row["asked"])
    return {"attempt": attempt, "name": row["name"], "identity": work.identity, "capture": row["source"],
            "library": library,
            "folder": asked.pop("folder"), "limit": asked.pop("limit", None), "options": asked}
