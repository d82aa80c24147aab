"""Self-contained HTML pages: one file that opens from disk, in light and dark, with no network request.

A page computes nothing: it gets numbers that are in a JSON file, and pictures made from tensors. Its template
is beside the module that fills it; ``report/base.html`` has the style that all pages share.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from ..io import files

if TYPE_CHECKING:
    import jinja2


def write_page(path: str | Path, template: str, **context: object) -> None:
    """Render a template (which extends ``report/base.html``) into one file, renamed from a temporary one.

    The template is named by its path inside the package, such as ``report/report.html``. Text of the context
    is escaped.
    """
    files.write_bytes(Path(path), page_text(template, **context).encode())


def page_text(template: str, **context: object) -> str:
    """The text of a page; arguments as :func:`write_page`. Characters outside UTF-8 become ``?``."""
    return _environment().get_template(template).render(context).encode(errors="replace").decode()


@functools.cache
def _environment() -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(loader=jinja2.PackageLoader("mitsvbrdf", ""), autoescape=True,
                                     undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"figure": figure, "seconds": seconds}
    return environment


def figure(value: float | None) -> str:
    """A number as people read it: 3.2e-07, 0.0123, 12.3, 1230; a dash for None."""
    if value is None:
        return "–"
    return f"{value:.1e}" if value and not 1e-3 <= abs(value) < 1e4 else f"{float(f'{value:.3g}'):g}"


def seconds(value: float) -> str:
    """Seconds as people read them: 31 ms, 2.4 s."""
    return f"{figure(value * 1e3)} ms" if value < 1 else f"{figure(value)} s"
