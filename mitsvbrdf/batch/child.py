"""The process that fits: one capture after the other, with Mitsuba, renderers and kernels kept warm.

A :class:`~.workers.guard.Guard` talks to it over two pipes and watches it; what it prints goes to the guard's
log.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import MitsvbrdfError, strict
from .workers.guard import die_with_parent

if TYPE_CHECKING:
    from ..render import Renderer

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


def serve(perform: Callable[[dict], dict], read: int, write: int) -> None:
    """Answer tasks until the pipe ends.

    Args:
        perform: does a task and returns its row.
        read, write: file descriptors of the pipes.
    """
    with os.fdopen(read) as tasks, os.fdopen(write, "w") as answers:
        print(json.dumps({"ready": True}), file=answers, flush=True)
        for line in tasks:
            print(json.dumps(_answer(perform, json.loads(line)["task"])), file=answers, flush=True)


def _answer(perform: Callable[[dict], dict], task: dict) -> dict:
    try:
        return {"state": "done", "reason": "", "row": perform(task)}
    except MitsvbrdfError as reason:
        full = isinstance(reason.__context__, OSError) and reason.__context__.errno in NO_SPACE
        return {"state": "full" if full else "failed", "reason": str(reason), "row": None}
    except OSError as reason:
        traceback.print_exc()
        return {"state": "full" if reason.errno in NO_SPACE else "failed", "reason": str(reason), "row": None}
    except Exception as reason:
        traceback.print_exc()
        return {"state": "failed", "reason": f"{type(reason).__name__}: {reason}", "row": None}


def fit_into_library(task: dict) -> dict:
    """Fit one capture, and let its result appear in the library.

    Args:
        task: ``attempt``, ``name``, ``identity``, ``capture``, ``library``, ``folder`` where paths start, and
            ``options``: what was asked for, as ``Asked.record`` has it.

    Returns:
        The row of the material: error, left_out_error, burn_in, warnings and so on.
    """
    from .places.address import local_capture, place_of

    with contextlib.suppress(OSError):  # paths in the options start there
        os.chdir(task["folder"])
    place = place_of(task["library"])
    folder = f"{task['name']}-{task['identity'][:8]}"
    started = time.perf_counter()
    staging = place.staging(task["attempt"])
    try:
        with local_capture(task["capture"]) as capture, strict(task["options"].get("strict", False)):
            row = fit_capture(capture, staging, task["options"])
        row |= {"seconds": round(time.perf_counter() - started, 3)}
        _write_record(staging, task, row)
        place.publish(staging, folder)
    finally:  # what failed takes no space
        shutil.rmtree(staging, ignore_errors=True)
    return row


def fit_capture(capture: Path, out: Path, asked: dict) -> dict:
    """Fit a capture and write the result, its page where wanted, and its preview.

    Args:
        capture: folder or JSON file.
        out: the folder to write into.
        asked: ``config``, ``options``, ``pages`` and ``sheet``.

    Returns:
        Its row without seconds.
    """
    from ..capture import read_capture
    from ..fit import fit_svbrdf
    from ..fit.generator.detail import with_detail
    from ..fit.options import FitOptions, config_of
    from ..report.folder import write_fit_files
    from .library.rows import row_of
    from .preview import write_preview
    from .raw import rectified

    config, options = config_of(asked["config"]), FitOptions(**asked["options"])
    transfer = None if options.transfer == "auto" else options.transfer
    made = rectified(capture, out / "capture", asked["sheet"], transfer)
    photos = read_capture(made, options.resolution, transfer=transfer if made == capture else None,
                          falloff=options.light(config))
    photos = replace(photos, source=capture)  # what it is called
    shots, shown = options.chosen(photos)
    engine = _renderer(options.renderer, options.variant)
    result = fit_svbrdf(shots, engine, config)
    if settings := options.detail_config(config):
        result = with_detail(result, shots, engine, settings)
    write_fit_files(result, shots, out, options.record(shots), shown, pages=asked["pages"])
    write_preview(out / "preview.jpg", result.detail or result.svbrdf)
    return row_of(out, shown, engine)


@cache
def _renderer(name: str, variant: str) -> Renderer:
    from ..render import make_renderer

    return make_renderer(name, variant)


def _write_record(staging: Path, task: dict, row: dict) -> None:
    """Say in the result itself what it is, for whoever finds it."""
    from ..io.files import file_hash, write_json
    from .places.place import RECORD

    files = {str(path.relative_to(staging)): {"bytes": path.stat().st_size, "sha256": file_hash(path)}
             for path in sorted(staging.rglob("*")) if path.is_file()}
    write_json(staging / RECORD, {"identity": task["identity"], "name": task["name"],
                                  "attempt": task["attempt"],
                                  "source": task["capture"], "asked": task["options"], "row": row,
                                  "files": files})


def use_threads() -> None:
    """Use as many threads as the guard said, in torch and in Dr.Jit."""
    if threads := int(os.environ.get("MITSVBRDF_THREADS", "0")):
        import drjit
        import torch

        torch.set_num_threads(threads)
        drjit.set_thread_count(threads)


def main(perform: Callable[[dict], dict] = fit_into_library) -> None:
    """Run as a guard's child: the last two arguments are the pipes."""
    die_with_parent()
    # SIGTERM then kills: a fit would end early, and half a fit count
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from ..errors import plain_warnings
    from ..render import make_renderer

    make_renderer("mitsuba")  # so that the first task does not wait for it
    use_threads()
    with plain_warnings():
        serve(perform, int(sys.argv[-2]), int(sys.argv[-1]))


if __name__ == "__main__":
    main()
