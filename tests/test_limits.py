"""What counts as too long, and that a budget that is broken is told."""

import limits
import pytest
from limits import BODY_LINES, FILE_LINES, over_budget, too_long


def function(lines: int, docstring: str = "") -> str:
    return "class A:\n    def method(self):\n" + docstring + "        pass\n" * lines


@pytest.mark.parametrize("text, breaches", [("#\n" * FILE_LINES, []),
    ("#\n" * (FILE_LINES + 1), [FILE_LINES + 1]), (function(BODY_LINES), []),
    (function(BODY_LINES + 1), [2]),
    (function(BODY_LINES, '        """One.\n\n        Two.\n        """\n'), []),
    (function(BODY_LINES + 1, '        """One."""\n'), [2]),
])
def test_lines_are_counted(text, breaches):
    assert [line for line, _ in too_long(text)] == breaches


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout that just meets its budgets."""
    monkeypatch.setattr(limits, "PACKAGE_LINES", 10)
    monkeypatch.setattr(limits, "PAGE_WORDS", 3)
    for name, text in {"mitsvbrdf/a.py": "#\n" * 6, "mitsvbrdf/b/c.py": "#\n" * 4, "tests/t.py": "#\n" * 9,
                       "docs/page.md": "three words here\n```sh\nmany words in code\n```\n",
                       "docs/results/page.md": "a page of results may be longer"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("name, more, told", [("mitsvbrdf/b/c.py", "#\n", "mitsvbrdf: 11 lines, budget 10"),
    ("tests/t.py", "#\n", "tests: 10 lines, budget 0.9 of the 10"),
    ("docs/page.md", "more", "docs/page.md: 4 words")])
def test_a_broken_budget_is_told(name, more, told, checkout):
    assert not list(over_budget(checkout))
    with (checkout / name).open("a") as file:
        file.write(more)
    (said,) = over_budget(checkout)
    assert told in said
