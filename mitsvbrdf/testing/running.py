"""The running test and the command line's options: set by the plugin, read by the assertions."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Running:
    """The running test, and the options of its suite."""

    test: str = "comparison"  # as pytest names it
    file: Path | None = None  # the file of the test; None outside pytest
    update: bool = False  # new results become golden files
    report: Path = Path(".mitsvbrdf-report")  # folder for the pages of failed comparisons
    written: list[Path] = field(default_factory=list)  # golden files made or replaced in this suite


now = Running()  # a default without a file, for runs without the plugin
