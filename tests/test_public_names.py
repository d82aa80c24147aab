"""The names of the package are the same for a program that runs and for a type checker."""

from __future__ import annotations

import ast
import inspect
from importlib.resources import files

import mitsvbrdf


def declared() -> dict[str, str]:
    """Name -> module of what a type checker sees: the re-exports under TYPE_CHECKING."""
    tree = ast.parse(inspect.getsource(mitsvbrdf))
    imports = [each for node in tree.body if isinstance(node, ast.If) for each in node.body]
    return {alias.asname: each.module for each in imports for alias in each.names}


def test_a_type_checker_sees_what_a_program_gets():
    assert declared() == mitsvbrdf._HOME
    assert files("mitsvbrdf").joinpath("py.typed").is_file()


def test_every_name_is_there():
    assert mitsvbrdf.__all__ == dir(mitsvbrdf) and all(hasattr(mitsvbrdf, name) for name in mitsvbrdf.__all__)
