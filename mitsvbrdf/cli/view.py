"""``mitsvbrdf view``: a page that follows a fit or a batch while it runs, and shows what came of it when it
has ended.
"""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..batch.library.site import LibrarySite, is_library
from ..io.progress import say
from ..report.live import Answer, FitSite, make_server


def view(out: Positional[Annotated[Path,
                                   arg(help="The folder that `mitsvbrdf fit -o OUT` or `mitsvbrdf batch -o "
                                            "OUT` writes "
                                            "to; it need not be there yet.", metavar="OUT")]],
         port: Annotated[int | None, arg(help="Left out: 8350, or any free one where that is taken.")] = None,
         open_page: Annotated[bool, arg(name="open", help="Open the page in the browser.")] = False) -> int:
    """Follow a fit or a batch in the browser while it runs, then see its report or its library; Ctrl-C ends
    the page.

    Start it before, while or after `mitsvbrdf fit` or `mitsvbrdf batch` runs, in another terminal: it only
    reads, and they neither wait for it nor change with it. A fit that starts anew in OUT is followed again.
    Only this machine can reach the address; from another one, `ssh -L 8350:localhost:8350 HOST` brings it
    along.
    """
    site = _Followed(out)
    with make_server(site, port) as server:
        try:
            say(f"following {site.library.root} at {server.url} (this machine only); Ctrl-C ends it")
            if site.waits:
                say("nothing there yet; the page waits for a fit or a batch")
            if open_page and not webbrowser.open(server.url):
                say("no browser to open; type the address into one")
            server.serve_forever(poll_interval=0.2)
        except KeyboardInterrupt:
            say("\nended; what runs goes on")
    return 0


class _Followed:
    """The site of a library once there is one in the folder, until then that of a fit."""

    def __init__(self, out: Path) -> None:
        self.library = LibrarySite(out)
        self.fit = None if is_library(out) else FitSite(out)

    @property
    def waits(self) -> bool:
        """Whether neither is there."""
        return self.fit is not None and self.fit.watch.state()["phase"] == "waiting"

    def answer(self, path: str) -> Answer | None:
        """That of what is there now."""
        if self.fit is not None and not is_library(self.library.root):
            return self.fit.answer(path)
        if path == "/state.json":  # the page of a fit asks, and loads that of the library
            return Answer(b"null", "application/json")
        return self.library.answer(path)
