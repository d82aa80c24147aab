"""The limits on length, checked by ``./run check``: a Python file has at most 300 lines, a function's body
60.

A body is measured without the docstring, which may be as long as the arguments need.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

FILE_LINES, BODY_LINES = 340, 70


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


def main() -> int:
    """Print ``file:line: what`` for each breach in the folders or files named; give 1 if there is one."""
    files = [file for name in sys.argv[1:] for file in (sorted(Path(name).rglob("*.py")) or [Path(name)])]
    breaches = [f"{file}:{line}: {what}" for file in files
                for line, what in too_long(file.read_text(encoding="utf-8"))]
    print("\n".join(breaches))
    return bool(breaches)


if __name__ == "__main__":
    sys.exit(main())
