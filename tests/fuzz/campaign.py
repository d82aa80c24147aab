"""Many cases on warm processes, counted by group, with a file kept for each way in which one failed."""

import re
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue

from fuzz.case import Case, Result, run, smaller
from fuzz.groups import CALLS, GROUPS, drawn, options
from fuzz.warm import Warm


@dataclass
class Tally:
    """What came of the cases of a group."""

    tried: int = 0  # how many
    # by cause, the cases and the file of the first, as small as it could be made
    failed: dict[str, list[Path | None]] = field(default_factory=dict)
    seconds: float = 0.0  # the wall clock's
    cpu: float = 0.0  # seconds of it, of the commands alone
    peak: int = 0  # resident bytes beside the imports, of the hungriest

    @property
    def held(self) -> int:
        """How many broke no rule."""
        return self.tried - sum(map(len, self.failed.values()))

    def __str__(self) -> str:
        lines = [f"{self.tried} tried, {self.held} held, {self.seconds:.0f} s ({self.cpu:.0f} s of CPU), "
                 f"{self.peak / 2**20:.0f} MiB at most"]
        return "\n".join(lines + [f"    {len(files)} x {cause}: python -m fuzz "
                                  f"{next(filter(None, files), '')}"
                                  for cause, files in self.failed.items()])


class Campaign:
    """Warm processes that run ``entry`` (see :mod:`fuzz.warm`), and a folder for their cases; files of those
    that failed go to ``kept``.
    """

    def __init__(self, folder: Path, processes: int, kept: Path, entry: str = "fuzz.entry") -> None:
        self.folder, self.good, self.kept, self._count = folder, folder / "good", kept, processes
        self._idle: SimpleQueue[Warm] = SimpleQueue()
        for process in [Warm(entry, folder / f"home-{number}", number) for number in range(processes)]:
            self._idle.put(process)

    def make_good(self) -> None:
        """Make the files that cases spoil."""
        from fuzz.good import make

        make(self.good)

    def close(self) -> None:
        for _ in range(self._count):
            self._idle.get().close()

    def run(self, case: Case) -> Result:
        """One case."""
        warm = self._idle.get()
        try:
            return run(case, self.good, self._place(warm), warm)
        finally:
            self._idle.put(warm)

    def run_all(self, cases: Sequence[Case]) -> Tally:
        """Many, so many at a time as there are processes."""
        tally, begun = Tally(tried=len(cases)), time.monotonic()
        with ThreadPoolExecutor(self._count) as pool:
            for case, result in zip(cases, pool.map(self.run, cases)):
                tally.peak = max(tally.peak, result.answer["peak"])
                tally.cpu += result.answer["cpu"]
                if result.wrong:
                    files = tally.failed.setdefault(f"{case.arguments[0]}: {result.cause}", [])
                    files.append(None if files else self._keep(case))
        tally.seconds = time.monotonic() - begun
        return tally

    def group(self, name: str, number: int = 0) -> list[Case]:
        """The cases of a group that a number stands for."""
        count, strategy = GROUPS[name]
        return drawn(strategy(self._options()) if strategy is options else strategy(), count, number)

    def _keep(self, case: Case) -> Path:
        warm = self._idle.get()
        try:
            return smaller(case, self.good, self._place(warm), warm).keep(self.kept)
        finally:
            self._idle.put(warm)

    def _place(self, warm: Warm) -> Path:
        return self.folder / f"case-{warm.number}"

    def _options(self) -> dict[str, tuple[str, ...]]:
        """The options of each command, as its help lists them."""
        names: Iterable[str] = (call.split()[0] for call in CALLS)
        helps = {name: self.run(Case("help", (), (), (name, "--help"))).said for name in names}
        return {name: tuple(sorted(set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", text))))
                for name, text in helps.items()}
