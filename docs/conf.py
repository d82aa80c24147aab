"""The site, as ``./run docs`` builds it: the Markdown files of the repository, and beside them what the program says of itself.

Nothing is kept twice. Pages are read where they lie, so a link works here and where the repository is browsed. Help of the
commands and docstrings of the public names are put into ``docs/commands.md`` and ``docs/python.md`` as they are now.
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

# What the sidebar shows: by page, by caption, its pages in order, as Sphinx reads them. A page that is not there is left out,
# one that stands nowhere is an error; with * come all others of a folder.
CONTENTS = {
    "docs/index": {
        "Start": ["/docs/start-phone", "/docs/start-capture", "/docs/start-known", "Tutorial </docs/tutorial>",
                  "/docs/gallery"],
        "How to": ["/docs/install", "/docs/capture", "/docs/relight", "/docs/export", "/docs/batch", "/docs/batch-planning",
                   "/docs/testing"],
        "How good it is": ["/docs/limits", "/docs/faq", "/docs/evaluation", "/docs/results/README"],
        "How it works": ["/docs/method", "/docs/calibration", "/ARCHITECTURE"],
        "Reference": ["/docs/commands", "/docs/python", "/docs/formats", "/docs/conventions"],
        "Project": ["All at a glance </README>", "/CONTRIBUTING", "/CHANGELOG", "/SECURITY", "/docs/citation"],
    },
    "docs/results/README": {
        "": ["/docs/benchmark", "The same on Intel, 300 s, renderers </docs/results/benchmark-intel>",
             "/docs/stability", "/docs/stability-fits", "/docs/leave-out",
             "Each ingredient off </docs/results/ablation>",
             "/docs/results/coverage", "/docs/results/finish", "The same at 256 px </docs/results/finish-256/finish>",
             "/docs/results/gan", "The same: 300 s, 256 px </docs/results/gan-256>",
             "The same: captures </docs/results/gan-captures>", "The same: feature matching </docs/results/gan-features>",
             "The same: ingredients </docs/results/gan-ingredients>",
             "The same: adversarial loss </docs/results/gan-adversarial>",
             "The same: full schedule </docs/results/gan-schedule>",
             "/docs/results/generator-gradients", "/docs/results/clients", "/docs/results/*"],
    },
}

project, author, copyright = "mitsvbrdf", "the mitsvbrdf developers", "the mitsvbrdf developers"
version = release = mitsvbrdf.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**"]
exclude_patterns = [*(path.name for path in ROOT.iterdir() if path.is_dir() and path.name != "docs"), "docs/tutorial-out",
                    "**/.ipynb_checkpoints"]
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!mitsvbrdf\.\w+$).*")]  # torch, the standard library, and what is not public
html_theme, html_title = "furo", f"mitsvbrdf {version}"
html_copy_source = html_show_sourcelink = html_use_index = False
highlight_language = "none"
smartquotes = False  # --option stays as it is typed
myst_heading_anchors = 4
nb_execution_mode = "off"
nb_ipywidgets_js: dict = {}  # the notebook has none, and pages ask nobody for anything
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring, napoleon_numpy_docstring = True, False


def source_of(entry: str) -> str:
    """The page, or pattern of pages, of an entry of CONTENTS."""
    return entry.rpartition("<")[2].strip("/>")


def with_contents(text: str, page: str) -> str:
    """A page, and below it what the sidebar shows of its pages."""
    for caption, entries in CONTENTS.get(page, {}).items():
        there = [entry for entry in entries if any(ROOT.glob(f"{source_of(entry)}.*"))]
        options = [":hidden:", ":glob:", f":caption: {caption}"][:3 if caption else 2]
        text += "\n".join(["\n\n```{toctree}", *options, *there, "```\n"])
    return text


def with_commands(text: str) -> str:
    """The page of the commands, and below it the help of each as it prints it."""
    methods = [("fit", "--method", name) for name in ("hybrid", "gan", "direct")]
    for words in [*((name,) for name in cli.COMMANDS), *methods]:
        with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):
            cli.main([*words, "--help"])
        shown = "\n".join(line if line.startswith(" ") else textwrap.fill(line, WIDTH) for line in said.getvalue().splitlines())
        text += f"\n\n## {' '.join(words)}\n```text\n{shown}\n```"
    return text


def with_docstrings(text: str) -> str:
    """The page of the public names, each line that lists some followed by their docstrings."""
    def entry(name: str) -> str:
        if isinstance(getattr(mitsvbrdf, name), type):
            return f".. autoclass:: mitsvbrdf.{name}\n   :members:\n   :inherited-members: Exception"
        return f".. autofunction:: mitsvbrdf.{name}"

    def entries(line: re.Match) -> str:
        return "\n".join(["```{eval-rst}", *map(entry, re.findall(r"\w+", line[0])), "```"])

    return re.sub(r"^(?:`\w+` ?)+$", entries, text, flags=re.M)


def as_prose(app) -> None:
    """Docstrings are also help on a terminal: a bar is no mark-up, and a colon in what a field means ends no type."""
    fields: dict[str, list[str]] = {}

    def before(_app, what: str, name: str, _object: object, _options: object, lines: list[str]) -> None:
        lines[:] = [line if "``" in line else line.replace("|", r"\|") for line in lines]
        if what in ("attribute", "property"):
            fields[name] = list(lines)

    def after(_app, _what: str, name: str, _object: object, _options: object, lines: list[str]) -> None:
        lines[:] = fields.pop(name, lines)  # napoleon would take it for "type: meaning"

    app.connect("autodoc-process-docstring", before, priority=100)
    app.connect("autodoc-process-docstring", after, priority=900)


def without_marks(kind: type) -> None:
    """Take what annotations say to the command line out of the types that are shown."""
    for base in kind.__mro__:
        if base.__module__.startswith("mitsvbrdf"):
            types = get_type_hints(base)
            for it in filter(None, (base, vars(base).get("__init__"))):
                it.__annotations__ = {name: types.get(name, given) for name, given in inspect.get_annotations(it).items()}


def setup(app) -> None:
    """Fill the pages that show what the program says of itself, and send the site's first address to its first page."""
    fill = {"docs/commands": with_commands, "docs/python": with_docstrings}

    def read(_app, page: str, source: list[str]) -> None:
        source[0] = with_contents(fill.get(page, str)(source[0]), page)

    def written(_app, _failed: Exception | None) -> None:
        to_first = f'<meta charset="utf-8"><title>{project}</title><meta http-equiv="refresh" content="0; url={root_doc}.html">'
        Path(app.outdir, "index.html").write_text(f"<!doctype html>{to_first}\n")

    for name in mitsvbrdf.__all__:
        if isinstance(it := getattr(mitsvbrdf, name), type):
            without_marks(it)
    as_prose(app)
    app.connect("source-read", read)
    app.connect("build-finished", written)
