"""The site of ``./run docs``: the Markdown pages of the repository, with help and docstrings filled in.

Pages are read where they lie, so a link works on the site and in the repository. ``docs/commands.md`` gets
the help of every command, ``docs/python.md`` the docstrings of the public names.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import re
import sys
import textwrap
from pathlib import Path
from typing import get_type_hints

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ["COLUMNS"] = str(WIDTH := 88)  # of help, in characters

import mitsvbrdf  # noqa: E402
from mitsvbrdf import cli  # noqa: E402

# The sidebar: by page, by caption, its pages in order, as Sphinx reads them.
CONTENTS = {
    "docs/index": {
        "Start": ["/docs/start-phone", "/docs/start-capture", "/docs/start-known",
                  "Tutorial </docs/tutorial>"],
        "How to": ["/docs/install", "/docs/capture", "/docs/relight", "/docs/export", "/docs/batch",
                   "/docs/testing"],
        "How good it is": ["/docs/limits", "/docs/faq", "/docs/evaluation"],
        "How it works": ["/docs/method", "/ARCHITECTURE"],
        "Reference": ["/docs/commands", "/docs/python", "/docs/formats", "/docs/conventions"],
        "Results": ["/docs/results/benchmark", "/docs/results/stability", "/docs/results/*"],
        "Project": ["All at a glance </README>", "/CONTRIBUTING", "/CHANGELOG", "/SECURITY"],
    },
}

project, author, copyright = "mitsvbrdf", "the mitsvbrdf developers", "the mitsvbrdf developers"
version = release = mitsvbrdf.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**"]
exclude_patterns = [*(path.name for path in ROOT.iterdir() if path.is_dir() and path.name != "docs"),
                    "docs/tutorial-out", "**/.ipynb_checkpoints"]
nitpicky = True
# torch, the standard library, and what is not public
nitpick_ignore_regex = [("py:.*", r"(?!mitsvbrdf\.\w+$).*")]
html_theme, html_title = "furo", f"mitsvbrdf {version}"
html_copy_source = html_show_sourcelink = html_use_index = False
highlight_language = "none"
smartquotes = False  # --option stays as it is typed
myst_heading_anchors = 4
nb_execution_mode = "off"
nb_ipywidgets_js: dict = {}  # the notebook has none, and pages load nothing from elsewhere
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring, napoleon_numpy_docstring = True, False


def contents(page: str) -> str:
    """The sidebar's part of a page, as toctrees."""
    text = ""
    for caption, entries in CONTENTS.get(page, {}).items():
        options = [":hidden:", ":glob:", *([f":caption: {caption}"] if caption else [])]
        text += "\n".join(["\n\n```{toctree}", *options, *entries, "```\n"])
    return text


def help_of(words: tuple[str, ...]) -> str:
    """The help of a command, as it prints it."""
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.suppress(SystemExit):
        cli.main([*words, "--help"])
    return "\n".join(line if line.startswith(" ") else textwrap.fill(line, WIDTH)
                     for line in printed.getvalue().splitlines())


def with_commands(text: str) -> str:
    """The page of commands, and below it the help of each."""
    fits = [("fit", "--method", name) for name in ("hybrid", "gan", "direct")]
    research = [("fit", "--advanced"), ("fit", "--advanced", "--method", "gan")]
    for words in [*((name,) for name in cli.COMMANDS), *fits, *research]:
        text += f"\n\n## {' '.join(words)}\n```text\n{help_of(words)}\n```"
    return text


def with_docstrings(text: str) -> str:
    """The page of public names, with their docstrings in place of each line of names."""
    def entry(name: str) -> str:
        if isinstance(getattr(mitsvbrdf, name), type):
            return f".. autoclass:: mitsvbrdf.{name}\n   :members:\n   :inherited-members: Exception"
        return f".. autofunction:: mitsvbrdf.{name}"

    def entries(line: re.Match) -> str:
        return "\n".join(["```{eval-rst}", *map(entry, re.findall(r"\w+", line[0])), "```"])

    return re.sub(r"^(?:`\w+` ?)+$", entries, text, flags=re.M)


def as_prose(app) -> None:
    """Docstrings are also help: a bar is no mark-up, and a colon in the meaning of a field ends no type."""
    fields: dict[str, list[str]] = {}

    def before(_app, what: str, name: str, _object: object, _options: object, lines: list[str]) -> None:
        lines[:] = [line if "``" in line else line.replace("|", r"\|") for line in lines]
        if what in ("attribute", "property"):
            fields[name] = list(lines)

    def after(_app, _what: str, name: str, _object: object, _options: object, lines: list[str]) -> None:
        lines[:] = fields.pop(name, lines)  # napoleon reads "type: meaning"

    app.connect("autodoc-process-docstring", before, priority=100)
    app.connect("autodoc-process-docstring", after, priority=900)


def without_marks(kind: type) -> None:
    """Remove the marks of the command line from the annotations that are shown."""
    for base in kind.__mro__:
        if base.__module__.startswith("mitsvbrdf"):
            types = get_type_hints(base)
            for it in filter(None, (base, vars(base).get("__init__"))):
                it.__annotations__ = {name: types.get(name, given)
                                      for name, given in inspect.get_annotations(it).items()}


def setup(app) -> None:
    """Fill the generated pages, and lead from the first address of the site to its first page."""
    fill = {"docs/commands": with_commands, "docs/python": with_docstrings}

    def read(_app, page: str, source: list[str]) -> None:
        source[0] = fill.get(page, str)(source[0]) + contents(page)

    def written(_app, _failed: Exception | None) -> None:
        refresh = f'<meta http-equiv="refresh" content="0; url={root_doc}.html">'
        Path(app.outdir, "index.html").write_text(
            f'<!doctype html><meta charset="utf-8"><title>{project}</title>{refresh}\n')

    for name in mitsvbrdf.__all__:
        if isinstance(it := getattr(mitsvbrdf, name), type):
            without_marks(it)
    as_prose(app)
    app.connect("source-read", read)
    app.connect("build-finished", written)
