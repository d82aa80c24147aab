"""Pages of results: each is made from its JSON by the script beside it, which uses public names alone."""

import ast
import importlib.util
import json
import re
import sys
from dataclasses import fields

import pytest
from helpers import ROOT

import mitsvbrdf
from mitsvbrdf.bench.plot import svg

FOLDER = ROOT / "docs/results"
SCRIPTS = sorted(FOLDER.glob("*.py"))
USABLE = "mitsvbrdf.bench.", "mitsvbrdf.render.needs"  # the latter is a parameter of make_renderer
OTHERS = {"pandas", "numpy", "matplotlib", "torch", "flip_evaluator"}
each_script = pytest.mark.parametrize("script", SCRIPTS, ids=[path.stem for path in SCRIPTS])


def loaded(script):
    spec = importlib.util.spec_from_file_location(f"results_{script.stem.replace('-', '_')}", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@each_script
def test_a_script_imports_public_names_alone(script):
    for node in ast.walk(ast.parse(script.read_text())):
        modules = ([alias.name for alias in node.names] if isinstance(node, ast.Import)
                   else [node.module] if isinstance(node, ast.ImportFrom) else [])
        for module in modules:
            root = module.split(".")[0]
            assert root in OTHERS | {"mitsvbrdf"} or root in sys.stdlib_module_names, module
            if root == "mitsvbrdf" and isinstance(node, ast.ImportFrom):
                names = {alias.name for alias in node.names}
                assert names <= set(mitsvbrdf.__all__) or module.startswith(USABLE)
                assert not any(name.startswith("_") for name in names)


@each_script
def test_a_page_is_what_its_record_makes(script):
    record = json.loads(script.with_suffix(".json").read_text())
    assert loaded(script).page(record) == script.with_suffix(".md").read_text(), f"python {script}"


@pytest.mark.slow
@each_script
def test_a_picture_is_what_its_record_makes(script):
    def drawn(picture: bytes) -> bytes:  # digests of numbers name clip paths; the CPU decides last bits
        return re.sub(rb"\bp[0-9a-f]{10}\b", b"clip", picture)

    found = svg(loaded(script).figure(json.loads(script.with_suffix(".json").read_text())))
    assert drawn(found) == drawn(script.with_suffix(".svg").read_bytes())


def test_there_are_at_most_ten_pages_and_nothing_beside_them():
    pages = {path.stem for path in FOLDER.glob("*.md")}
    assert len(pages) <= 10 and pages == {path.stem for path in SCRIPTS} | {"lab-notes"}
    shown = "".join(path.read_text() for path in FOLDER.glob("*.md"))
    for path in FOLDER.iterdir():
        assert path.stem in pages or path.name in shown or path.name == "__pycache__", path


@pytest.mark.parametrize("name, variants, config", [
    ("omitted", "VARIANTS", "HierarchicalConfig"), ("omitted", "HYBRID", "HybridConfig"),
    ("gan", "VARIANTS", "GanConfig")])
def test_every_variant_can_be_measured(name, variants, config):
    kind = getattr(mitsvbrdf, config)
    for changes in getattr(loaded(FOLDER / f"{name}.py"), variants).values():
        assert set(changes) <= {field.name for field in fields(kind)}
        kind(**changes).check()
