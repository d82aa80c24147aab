"""The live page of a fit: one static file beside the result that is being made, rewritten while the fit runs.

It opens from disk. A script reloads the page every two seconds while ``live.svg`` is beside it. When
``live.svg`` is gone, the script opens the report of the finished fit.
"""

import os
import time
from pathlib import Path
from urllib.parse import quote

from ..fit.live import LiveState
from ..io import files
from ..material.maps import CHANNELS, TITLES, shown_map
from .curves import error_and_losses
from .page import write_page
from .pictures import picture_uri

PAGE, MARK = "live.html", "live.svg"
ENDED = {"settled": "settled: going on would change little", "budget": "out of seconds",
         "iterations": "all iterations done", "interrupted": "interrupted by Ctrl-C",
         "unstable": "too many steps had to be undone"}


class LivePage:
    """A page about a running fit: each call with a state writes ``live.html`` into ``folder``, where the
    result is being made. The result will appear in ``out``.
    """

    def __init__(self, folder: Path, out: Path) -> None:
        self.path = folder / PAGE
        self.out = quote(Path(os.path.relpath(os.path.realpath(out), os.path.realpath(folder))).as_posix())
        self.name = out.name
        files.write_bytes(folder / MARK, b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>')
        self(None)

    def __call__(self, fit: LiveState | None) -> None:
        """Rewrite the page, in one step. ``fit`` None: nothing is known yet."""
        best = fit and min(fit.trace, key=lambda row: row["rerender_rmse"], default=None)
        svbrdf = fit and fit.svbrdf
        maps = [(TITLES[name], picture_uri(shown_map(name, svbrdf[name]).nan_to_num()))
                for name in CHANNELS[svbrdf.bsdf]] if svbrdf else []
        names = fit and " · ".join(filter(None, (fit.capture, fit.method)))
        write_page(self.path, "report/live.html", title=names or self.name, fit=fit, best=best, maps=maps,
                   curves=error_and_losses(fit.trace) if fit else [], out=self.out, name=self.name, mark=MARK,
                   ended=fit and fit.stopped and ENDED.get(fit.stopped, fit.stopped),
                   written=time.time(), clock=time.strftime("%H:%M:%S"))

    def end(self) -> None:
        """Remove the page: the report replaces it."""
        for name in (PAGE, MARK):
            self.path.with_name(name).unlink(missing_ok=True)
