"""What counts as too long."""

from __future__ import annotations

import pytest
from limits import BODY_LINES, FILE_LINES, too_long


def function(lines: int, docstring: str = "") -> str:
    return "class A:\n    def method(self):\n" + docstring + "        pass\n" * lines


@pytest.mark.parametrize("text, breaches", [
    ("#\n" * FILE_LINES, []),
    ("#\n" * (FILE_LINES + 1), [FILE_LINES + 1]),
    (function(BODY_LINES), []),
    (function(BODY_LINES + 1), [2]),
    (function(BODY_LINES, '        """One.\n\n        Two.\n        """\n'), []),
    (function(BODY_LINES + 1, '        """One."""\n'), [2]),
])
def test_lines_are_counted(text, breaches):
    assert [line for line, _ in too_long(text)] == breaches
