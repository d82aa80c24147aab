"""``mitsvbrdf view``: a page that follows a fit while it runs, and shows its report when it has ended."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..system.progress import say


def view(out: Positional[Annotated[Path, arg(metavar="OUT", help="The folder that `mitsvbrdf fit -o OUT` writes to; it need "
                                                                 "not be there yet.")]],
         port: Annotated[int | None, arg(help="Left out: 8350, or any free one where that is taken.")] = None,
         open_page: Annotated[bool, arg(name="open", help="Open the page in the browser.")] = False) -> int:
    """Follow a fit in the browser: maps, curves and progress while it runs, then its report; Ctrl-C ends the page.

    Start it before, while or after `mitsvbrdf fit` runs, in another terminal: it only reads, and a fit neither waits for it nor
    changes with it. A fit that starts anew in OUT is followed again. Only this machine can reach the address; from another one,
    `ssh -L 8350:localhost:8350 HOST` brings it along.
    """
    from ..report.live import Watch, make_server

    watch = Watch(out)
    with make_server(watch, port) as server:
        try:
            say(f"following {watch.out} at {server.url} (this machine only); Ctrl-C ends it")
            if watch.state()["phase"] == "waiting":
                say("no fit there yet; the page waits for one")
            if open_page and not webbrowser.open(server.url):
                say("no browser to open; type the address into one")
            server.serve_forever(poll_interval=0.2)
        except KeyboardInterrupt:
            say("\nended; the fit, if one runs, goes on")
    return 0
