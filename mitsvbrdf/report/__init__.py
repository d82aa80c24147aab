"""Every page of the package: of a fit, a capture, a comparison, a cross-check; and values in notebooks."""

import sys
from typing import Any

SHOWN_IN_NOTEBOOKS = {"SVBRDF": "material.maps", "Capture": "capture.capture", "Fit": "fit.result"}


def show_in_notebooks() -> None:
    """If IPython runs, let it show materials, captures and fits as pictures. This imports no module."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None:
        html = shell.display_formatter.formatters["text/html"]
        for name, module in SHOWN_IN_NOTEBOOKS.items():
            html.for_type_by_name(f"mitsvbrdf.{module}", name, _html)


def _html(value: Any) -> str:
    from .notebook import html_of
    return html_of(value)
