"""What a running fit shows of itself: one small file, replaced about once a second, that ``mitsvbrdf view``
reads.
"""

from __future__ import annotations

import contextlib
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..io.profile import profiled
from .checkpoint import save_tensors
from .methods import method_name
from .warnings import about_photos, about_steps

if TYPE_CHECKING:
    from .loop import Loop

SIDE = 256  # texels a side of the maps shown, at most
SECONDS = 1.0  # from one record to the next, at least
SHARE = 0.05  # of the time that records may take, at most


class LiveRecord:
    """The file a fit is watched through: maps as float16, and the note of :meth:`write`.

    It only looks at the fit: what is fitted has the same bits with and without it. A record that cannot be
    written is left out; a full disk shows in the checkpoint. The file stays when the fit ends; whoever gave
    its name takes it away.

    Args:
        path: the file (.safetensors) to replace.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.run = path, uuid.uuid4().hex
        self.due = 0.0
        self.about_photos: list[str] | None = None

    def offer(self, loop: Loop, losses: dict[str, float], stopped: str | None = None) -> None:
        """Write a record where the last one is long enough ago: :data:`SECONDS`, and so that all take
        :data:`SHARE`.

        Args:
            loop: the fit.
            losses: those of the latest step.
            stopped: why the fit ended; written at once then.
        """
        began = time.perf_counter()
        if began < self.due and not stopped:
            return
        with profiled("live record"), contextlib.suppress(OutputError):
            self.write(loop, losses, stopped)
        ended = time.perf_counter()
        self.due = ended + max(SECONDS, (ended - began) * (1 / SHARE - 1))

    def write(self, loop: Loop, losses: dict[str, float], stopped: str | None) -> None:
        """Replace the file, in one step.

        The maps are those of the latest measurement, or what a method shows in between; shrunk to
        :data:`SIDE`. The note holds ``run`` (of this record's fit and no other), ``method``, ``renderer``,
        ``capture``, ``bsdf``, ``resolution``, ``iteration``, ``seconds``, ``share`` (0 to 1), ``stopped``,
        ``latest_is_best``, ``trace``, ``latest`` (losses since the trace's last entry) and ``warnings`` so
        far.

        Raises:
            OutputError: it cannot be written.
        """
        method, capture = loop.method, loop.capture
        if self.about_photos is None:
            self.about_photos = [*capture.notes, *about_photos(capture)]
        svbrdf = method.preview() or loop.seen[1]
        svbrdf = svbrdf.resized(min(SIDE, svbrdf.resolution))
        save_tensors(self.path, {name: value.half() for name, value in svbrdf.maps.items()}, {
            "run": self.run, "method": method_name(method.config), "renderer": loop.renderer.name,
            "capture": capture.source.name if capture.source else None, "bsdf": svbrdf.bsdf,
            "resolution": capture.resolution, "iteration": loop.iteration, "seconds": round(loop.seconds, 3),
            "share": loop.progress, "stopped": stopped, "latest_is_best": loop.latest_is_best,
            "trace": loop.trace,
            "latest": {"seconds": round(loop.seconds, 3), "iteration": loop.iteration, **losses},
            "warnings": [*self.about_photos, *about_steps(loop.undone, loop.restarts)]})
