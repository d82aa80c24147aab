"""A case: good files, what is done to them, a command, and the rules that must hold whatever was done."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from fuzz.changes import apply
from fuzz.warm import Warm

SECONDS = 60.0  # a command on files of a few pixels that takes longer waits for something that never comes
LASTING = 10.0  # what an option makes long is ended by Ctrl-C, which must work as well
GRACE = 60.0  # seconds that this may take: a result that is being written is finished first
MEMORY = 1.5 * 2**30  # resident bytes beside the imports
# The exit code 1 is an answer of these, and of no other command.
ANSWER_1 = ("batch", "library", "crosscheck", "stability", "bench", "doctor")
KNOWN = Path(__file__).with_name("cases")  # each broke a rule once


@dataclass(frozen=True)
class Case:
    """One call of the command line."""

    group: str  # what is wrong in it
    parts: tuple[str, ...]  # the good files, folders that lie in in/
    changes: tuple[Mapping, ...]  # what is done to them, in order; see fuzz.changes
    arguments: tuple[str, ...]  # of the command, called in the folder work
    out: str = "work/out"  # the only file or folder that the command may change
    lasting: bool = False  # whether an option may make it take long; it is interrupted then

    @classmethod
    def read(cls, path: Path) -> Case:
        """A case that was kept."""
        kept = json.loads(path.read_text())
        return cls(**{name: tuple(value) if isinstance(value, list) else value
                      for name, value in kept.items()})

    @property
    def outputs(self) -> set[str]:
        """``out``, and the record that a `bench` goes on with."""
        words = self.arguments
        records = [word for option, word in zip(words, words[1:]) if option == "--json"]
        return {self.out, *(os.path.normpath(f"work/{word}") for word in records if words[0] == "bench")}

    def keep(self, folder: Path) -> Path:
        """Write it to a file whose name tells it from others; give the file."""
        text = json.dumps(asdict(self), indent=1)
        path = folder / f"{self.group}-{hashlib.sha256(text.encode()).hexdigest()[:8]}.json"
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
        return path


@dataclass(frozen=True)
class Result:
    """What came of a case."""

    wrong: list[str]  # the rules it broke, in words; empty where they hold
    said: str  # what the command printed
    answer: dict = field(default_factory=dict)  # of Warm.run

    @property
    def cause(self) -> str:
        """What cases that fail alike have in common: where the package raised, or the rule without its
        numbers.
        """
        places = re.findall(r'File "[^"]*/(mitsvbrdf/[^"]+)", line (\d+)', self.said)
        if "a traceback" in self.wrong and places:
            kinds = re.findall(r"^[A-Za-z_][\w.]*(?=:|$)", self.said, re.MULTILINE)
            return f"{places[-1][0]}:{places[-1][1]} {kinds[-1] if kinds else ''}"
        return "; ".join(dict.fromkeys(re.sub(r"(?<=OUT: ).* ", "", re.sub(r"[\d.]+", "N", words))
                                       for words in self.wrong))


def run(case: Case, good: Path, folder: Path, warm: Warm) -> Result:
    """Make the files of a case, of the ``good`` ones, in a new folder that is taken away afterwards; run its
    command, and judge.
    """
    box, said = folder / "box", folder / "said"
    try:
        for part in case.parts:
            shutil.copytree(good / part, box / "in" / part, symlinks=True)
        for record in (box / "in").glob("*/relight.json"):
            record.write_text(record.read_text().replace("@@", str(box)))
        for name in ("work", "tmp", "outside/folder", "in"):
            (box / name).mkdir(parents=True, exist_ok=True)
        for name in ("secret.txt", "folder/keep.txt", "folder/diffuse.exr"):
            (box / "outside" / name).write_text("of somebody else\n")
        for change in case.changes:
            apply(box, change)
        before = snapshot(box, case.outputs)
        arguments = [word.replace("@@", str(box)) for word in case.arguments]
        answer = warm.run(arguments, box / "work", said, box / "tmp", LASTING if case.lasting else SECONDS,
                          GRACE)
        text = said.read_text(errors="replace") if said.exists() else ""
        return Result(broken(case, answer, text, before, snapshot(box, case.outputs)), text, answer)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def broken(case: Case, answer: Mapping, said: str, before: Mapping, after: Mapping) -> list[str]:
    """The rules that did not hold, in words."""
    wrong, code, signals = [], answer["code"], answer["signals"]
    allowed = {0, 2, 130} | ({1} if case.arguments[:1] and case.arguments[0] in ANSWER_1 else set())
    if "Traceback (most recent call last)" in said:
        wrong.append("a traceback")
    if "SIGKILL" in signals:
        wrong.append("no end after Ctrl-C")
    elif signals and not case.lasting:
        wrong.append("no end by itself")
    elif code not in allowed:
        wrong.append(f"ended by signal {-code}" if code < 0 else f"exit code {code}")
    elif code == 2 and not said.strip():
        wrong.append("exit code 2 without a word")
    if answer["peak"] > MEMORY:
        wrong.append(f"{answer['peak'] / 2**30:.1f} GiB of memory")
    wrong += [f"outside of OUT: {name} {how}" for name, how in differences(before, after)]
    return wrong


def differences(before: Mapping, after: Mapping) -> list[tuple[str, str]]:
    """Names that two snapshots do not share, each with what happened."""
    return [(name, "made" if name not in before else "removed" if name not in after else "changed")
            for name in sorted({*before, *after}) if before.get(name) != after.get(name)]


def snapshot(folder: Path, outputs: Collection[str]) -> dict[str, tuple]:
    """All that lies in a folder but for these: kind and mode, of files also place on the disk, time,
    content, target.
    """
    found = {}
    for where, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(where, name)
            inside = str(path.relative_to(folder))
            if inside in outputs:
                continue
            about = path.lstat()
            content: tuple = ()
            if stat.S_ISREG(about.st_mode):
                content = about.st_ino, about.st_mtime_ns, hashlib.sha256(path.read_bytes()).hexdigest()
            elif stat.S_ISLNK(about.st_mode):
                content = (os.readlink(path),)
            found[inside] = about.st_mode, *content
        folders[:] = [name for name in folders if str(Path(where, name).relative_to(folder)) not in outputs]
    return found


def smaller(case: Case, good: Path, folder: Path, warm: Warm) -> Case:
    """The same case without changes that its failure does not need."""
    cause = run(case, good, folder, warm).cause
    for change in case.changes:
        fewer = replace(case, changes=tuple(each for each in case.changes if each is not change))
        if fewer.changes and run(fewer, good, folder, warm).cause == cause:
            case = fewer
    return case
