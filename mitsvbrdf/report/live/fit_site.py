"""The addresses of a fit: its page, its state, its maps, and the two files that people look at once it has
ended.
"""

from __future__ import annotations

import json
import secrets
from pathlib import Path

from ...io.files import open_regular
from ..page import page_text
from .server import HTML, LIVE_POLICY, REPORT_POLICY, Answer
from .watch import REPORT_FILE, SHEET_FILE, Watch


class FitSite:
    """The page of a fit that runs, has run, or will run.

    Args:
        out: the folder that it writes to; see :class:`Watch`.
    """

    def __init__(self, out: Path) -> None:
        self.watch = Watch(out)

    def answer(self, path: str) -> Answer | None:
        """The page, its state, a map, or one of the two files of a finished fit."""
        if path == "/":
            nonce = secrets.token_urlsafe(16)
            page = page_text("report/live/live.html", title=self.watch.out.name or "mitsvbrdf", nonce=nonce)
            return Answer(page.encode(), HTML, LIVE_POLICY.format(nonce=nonce))
        if path == "/state.json":
            return Answer(json.dumps(self.watch.state(), allow_nan=False).encode(), "application/json",
                          again=True)
        if path == f"/{REPORT_FILE}":
            return self._file(REPORT_FILE, HTML, REPORT_POLICY)
        if path == f"/{SHEET_FILE}":
            return self._file(SHEET_FILE, "image/png")
        name = path.removeprefix("/maps/").removesuffix(".png")
        picture = self.watch.picture(name) if path == f"/maps/{name}.png" else None
        return None if picture is None else Answer(picture, "image/png")

    def _file(self, name: str, kind: str, policy: str = "") -> Answer | None:
        try:
            with open_regular(self.watch.out / name) as file:
                return Answer(file.read(), kind, policy)
        except OSError:
            return None
