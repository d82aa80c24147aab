"""Which code shapes which records of a benchmark, as digits that change with what it does, but not with the
words in it.

What all records share has digits of its own, which a file states once; a record's settings state those of
what its method, or its suite, has for itself. So a change of one method makes its records void and no others.
"""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Iterable, Iterator
from importlib.util import resolve_name
from pathlib import Path

from .. import fit
from ..fit.methods import METHODS

PACKAGE = Path(__file__).parents[1]
# Said or drawn, and how a running fit is watched: no figure, and no time that counts. `warnings` take a third
# of a second at 256 px, which is part of `wall`.
SAID = tuple(f"fit/{name}.py" for name in ("left_out", "live", "options", "result"))
# What methods and suites have for themselves: it counts where a record's own modules import it.
OWN = ("fit/hierarchical/*.py", "fit/generator/*.py", "fit/direct.py", "bench/peers_baseline.py",
       *(f"bench/{name}.py" for name in ("from_phone", "renderers", "start", "start_child")),
       *(f"bench/paper/{name}.py" for name in ("references", "schedule", "sheets", "steps")))
# What all records share, but for what is in the lists above.
SHARED = ("capture/**/*.py", "calibrate/*.py", "fit/*.py", "material/*.py", "measure/*.py", "render/*.py",
          "synth/*.py",
          "evaluate/*.py", "color.py", "views.py",
          *(f"system/{name}.py" for name in ("decode", "entry", "images", "layout", "timing")),
          *(f"bench/{name}.py" for name in ("behaviour", "jobs", "methods", "schema", "tasks")))


@functools.cache
def shared_code(more: tuple[str, ...] = (), package: Path = PACKAGE) -> str:
    """Twelve digits of what all records of a file share.

    Args:
        more: what shapes them besides, as :data:`SHARED` has it.
        package: the folder of the package.
    """
    return _digits(_there(SHARED, package) - _there((*OWN, *SAID), package) | _there(more, package), package)


@functools.cache
def own_code(*modules: str, package: Path = PACKAGE) -> str:
    """Twelve digits of some modules and of what they import of :data:`OWN`, in any number of steps.

    Args:
        modules: their whole names.
        package: the folder of the package.
    """
    return _digits(own_files(modules, package), package)


def method_module(name: str) -> str:
    """The whole name of the module of a method of ``fit``."""
    return resolve_name(METHODS[name].module, fit.__name__)


def own_files(modules: Iterable[str], package: Path = PACKAGE) -> set[Path]:
    """The files of :func:`own_code`."""
    todo = [package.joinpath(*name.split(".")[1:]).with_suffix(".py") for name in modules]
    apart, found = _there(OWN, package), set[Path]()
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo += apart.intersection(imported(path, package))
    return found


def imported(path: Path, package: Path = PACKAGE) -> Iterator[Path]:
    """The files of the package that a file of it imports, inside functions too."""
    parts = path.relative_to(package.parent).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            home = package.parent.joinpath(*parts[:len(parts) - node.level + 1],
                                           *(node.module or "").split("."))
            for place in (home, *(home / alias.name for alias in node.names)):
                yield from filter(Path.is_file, (place.with_suffix(".py"), place / "__init__.py"))


def syntax_of(source: str) -> str:
    """What a source does, as text: its syntax tree without docstrings, whether of modules, classes, functions
    or fields.
    """
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not (  # type: ignore[attr-defined]
                isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
                and isinstance(each.value.value, str))]
    return ast.dump(tree)


def _there(patterns: Iterable[str], package: Path) -> set[Path]:
    return {path for pattern in patterns for path in package.glob(pattern)}


def _digits(paths: Iterable[Path], package: Path) -> str:
    """Of the syntax trees: comments, docstrings and the layout of lines do not count."""
    digest = hashlib.sha256()
    for name, path in sorted((path.relative_to(package).as_posix(), path) for path in paths):
        digest.update(name.encode() + syntax_of(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:12]
