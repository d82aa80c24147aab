"""The limits on length, checked by ``./run check``.

    python limits.py mitsvbrdf tests      files and functions in these folders, then the checkout's budgets

A Python file has at most 300 lines, a function's body 60; a body is measured without the docstring, which may
be as long as the arguments need. Lines of 110 columns are ruff's to check. A feature that would break a
budget names what it displaces.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

FILE_LINES, BODY_LINES = 300, 60
PACKAGE_LINES, TESTS_SHARE = 29_741, 0.9  # Python lines of mitsvbrdf, and of tests relative to these
PAGE_WORDS = 1_500  # of a page for users, docs/*.md


def too_long(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the words of each breach in the text of one file."""
    lines = len(text.splitlines())
    if lines > FILE_LINES:
        yield FILE_LINES + 1, f"file has {lines} lines, limit {FILE_LINES}"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            after = node.body[0].end_lineno if ast.get_docstring(node) else node.body[0].lineno - 1
            lines = node.body[-1].end_lineno - after
            if lines > BODY_LINES:
                yield node.lineno, f"body of {node.name} has {lines} lines, limit {BODY_LINES}"


def over_budget(root: Path) -> Iterator[str]:
    """Yield the words of each budget that a checkout breaks."""
    package, tests = (sum(len(file.read_text(encoding="utf-8").splitlines()) for file in
                          (root / name).rglob("*.py")) for name in ("mitsvbrdf", "tests"))
    if package > PACKAGE_LINES:
        yield f"mitsvbrdf: {package} lines, budget {PACKAGE_LINES}"
    if tests > TESTS_SHARE * package:
        yield f"tests: {tests} lines, budget {TESTS_SHARE:g} of the {package} of mitsvbrdf"
    for page in sorted((root / "docs").glob("*.md")):
        # code is not read
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        if (words := len(text.split())) > PAGE_WORDS:
            yield f"{page.relative_to(root)}: {words} words, budget {PAGE_WORDS}"


def main() -> int:
    """Print ``file:line: what`` for each breach in the folders or files named, and budgets; give 1 if there
    is one.
    """
    files = [file for name in sys.argv[1:] for file in (sorted(Path(name).rglob("*.py")) or [Path(name)])]
    breaches = [f"{file}:{line}: {what}" for file in files
                for line, what in too_long(file.read_text(encoding="utf-8"))]
    breaches += over_budget(Path(__file__).parents[1])
    print("\n".join(breaches))
    return bool(breaches)


if __name__ == "__main__":
    sys.exit(main())
