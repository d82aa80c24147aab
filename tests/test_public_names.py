"""The names of the package are the same for a program that runs and for a type checker."""

import ast
import os
import subprocess
import sys
from importlib.resources import files

import pytest
from helpers import ROOT

import mitsvbrdf


def declared() -> dict[str, str]:
    """Name -> module of what a type checker sees: the re-exports of the stub."""
    tree = ast.parse(files("mitsvbrdf").joinpath("__init__.pyi").read_text())
    return {alias.asname: each.module for each in tree.body if isinstance(each, ast.ImportFrom)
            for alias in each.names}


def test_a_type_checker_sees_what_a_program_gets():
    assert declared() == mitsvbrdf._HOME
    assert files("mitsvbrdf").joinpath("py.typed").is_file()


def test_every_name_is_there():
    assert mitsvbrdf.__all__ == dir(mitsvbrdf) and all(hasattr(mitsvbrdf, name) for name in mitsvbrdf.__all__)


@pytest.mark.parametrize("stated, first, expected", [(None, "", "PASSIVE"), ("ACTIVE", "", "ACTIVE"),
                                                     (None, "torch", None)])
def test_the_first_use_lets_threads_wait_where_torch_is_yet_to_load(stated, first, expected):
    script = f"""if True:
        import os, sys
        sys.modules.update(dict.fromkeys({first.split()!r}, sys))  # stands for torch
        import mitsvbrdf
        print(os.environ.get("OMP_WAIT_POLICY"))
        mitsvbrdf.MitsvbrdfError
        print(os.environ.get("OMP_WAIT_POLICY"))
    """
    others = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    environment = others | {"PYTHONPATH": str(ROOT)} | ({"OMP_WAIT_POLICY": stated} if stated else {})
    found = subprocess.run([sys.executable, "-P", "-c", script], env=environment, capture_output=True,
                           text=True, check=True)
    assert found.stdout.split() == [str(stated), str(expected)]
