"""What each fork runs: the command line, with the two ends replaced that a test cannot wait for.

Where a command would start workers of Ray it fails with an error of ours. ``view`` answers each address once
and ends as with Ctrl-C.
"""

from __future__ import annotations

import contextlib
import importlib
import pkgutil

ADDRESSES = ("/", "/state.json", "/report.html", "/sheet.png", "/maps/diffuse.png",
             "/maps/../../outside/secret.txt",
             "/library.js", "/index.html", "/wood-00000000/preview.jpg", "/wood-00000000/report.html")


def warm() -> None:
    """Import all that commands import."""
    import torch

    import mitsvbrdf

    for module in pkgutil.walk_packages(mitsvbrdf.__path__, "mitsvbrdf."):
        if module.name not in ("mitsvbrdf.__main__", "mitsvbrdf.testing.plugin"):
            importlib.import_module(module.name)
    importlib.import_module("OpenEXR")
    importlib.import_module("PIL.Image").init()
    # loads a compiler, which makes a folder for itself
    torch.optim.Adam([torch.zeros(1, requires_grad=True)]).step()
    _cut()


def main() -> int:
    """The command of ``sys.argv``."""
    from mitsvbrdf.__main__ import main as run

    return run()


def _cut() -> None:
    from mitsvbrdf.batch.workers.pool import RayPool
    from mitsvbrdf.cli import view
    from mitsvbrdf.errors import BackendError

    def no_workers(*_: object, **__: object) -> None:
        raise BackendError("workers", "none, in a test", "run it without")

    class Asked:
        url = "http://127.0.0.1:1/"

        def __init__(self, site: view._Followed, port: int | None) -> None:
            self.site = site

        def serve_forever(self, poll_interval: float) -> None:
            for address in ADDRESSES:
                self.site.answer(address)
            raise KeyboardInterrupt

    RayPool.__init__ = no_workers  # type: ignore[assignment,method-assign]
    view.make_server = lambda site, port: contextlib.nullcontext(Asked(site,
                                                                       port))  # type: ignore[assignment,return-value]
