"""Fit one capture in a warm worker of Ray, and put the result into the library."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from .. import __version__
from ..errors import MitsvbrdfError, noted, plain_warnings, strict
from .captures import TOKEN, local_capture, rectified
from .records import Material, Row
from .results import NO_SPACE, WORK, ResultStore

if TYPE_CHECKING:
    from ..fit import Fit
    from ..render import Renderer

GIB = 1 << 30
LOG_CHARACTERS = 20_000  # the last ones of a fit's output, kept if the fit fails
LOOK_SECONDS = 0.2  # between two checks of the memory in use
HELD = "killed when it held"  # what a worker prints before it kills itself

SIDE = 192  # pixels a side of a preview, at most
QUALITY = 85


def fit_task(task: dict) -> Iterator[dict]:
    """Fit one capture; a task of Ray.

    Once the worker is warm, it yields its ``host``, its ``version``, and the ``token`` that it reads in the
    library. Then it yields the outcome: ``state`` (done, failed, or full if no space is left), ``reason``,
    and ``log``, the end of the fit's output. A worker with another version, or with another library at this
    address, does not fit. :meth:`.run.Batch._hand_out` makes ``task``.
    """
    results = ResultStore(task["library"])
    _warm(task["threads"])
    try:
        token = results.store.read(TOKEN).decode()
    except (OSError, MitsvbrdfError):
        token = ""
    yield {"host": socket.gethostname(), "version": __version__, "token": token}
    if (token, __version__) != (task["token"], task["version"]):
        return
    material = msgspec.convert(task["material"], Material)
    with _printed(results, task["attempt"]) as log, _memory_limit(task["memory"]), plain_warnings():
        found = _outcome(results, material, task["attempt"])
        _flush()
        text = log.read_text(errors="replace")[-LOG_CHARACTERS:]
    yield found | {"log": text}


def _outcome(results: ResultStore, material: Material, attempt: str) -> dict:
    """Fit into the library; return ``state`` (done, failed or full) and ``reason``, the error or empty."""
    started = time.perf_counter()
    try:
        with contextlib.suppress(OSError):  # paths in the options start there
            os.chdir(material.base)
        with (results.building(attempt) as made, local_capture(material.source) as capture,
              strict(material.asked.get("strict", False))):
            row = fit_capture(capture, made, material.asked)
            row = msgspec.structs.replace(row, seconds=round(time.perf_counter() - started, 3))
            results.publish(made, material.but(date=now(), host=socket.gethostname(), row=row))
        return {"state": "done", "reason": ""}
    except MitsvbrdfError as reason:
        full = isinstance(cause := reason.__context__, OSError) and cause.errno in NO_SPACE
        return {"state": "full" if full else "failed", "reason": str(reason)}
    except Exception as reason:
        with contextlib.suppress(OSError):  # the log may be on a full disk
            traceback.print_exc()
        full = isinstance(reason, OSError) and reason.errno in NO_SPACE
        return {"state": "full" if full else "failed", "reason": f"{type(reason).__name__}: {reason}"}


def fit_capture(capture: Path, out: Path, asked: dict) -> Row:
    """Fit a capture with settings as in ``Asked.record``; write the result; return its row of the list."""
    from ..capture import read_capture
    from ..fit import fit_svbrdf
    from ..fit.generator.detail import with_detail
    from ..fit.options import FitOptions, config_of
    from ..report.folder import write_fit_files

    config, options = config_of(asked["config"]), FitOptions(**asked["options"])
    transfer = None if options.transfer == "auto" else options.transfer
    with noted() as faults:
        made = rectified(capture, out / "capture", asked["sheet"], transfer, options.resolution)
        photos = read_capture(made, options.resolution, transfer=transfer if made == capture else None,
                              falloff=options.light(config))
    photos = photos.but(source=photos.source if made == capture else capture,  # the name comes from it
                        notes=tuple(dict.fromkeys((*faults, *photos.notes))))
    shots, shown = options.chosen(photos)
    engine = _renderer(options.renderer, options.variant)
    result = fit_svbrdf(shots, engine, config)
    if settings := options.detail_config(config):
        result = with_detail(result, shots, engine, settings)
    write_fit_files(result, shots, out, options.record(shots), shown, pages=asked["pages"])
    write_preview(out / "preview.jpg", result)
    return _row(out, faults)


def _row(folder: Path, faults: list[str]) -> Row:
    """The row of a fit in the list of materials. Its warnings begin with ``faults``, those of its photos."""
    from ..fit.record import record_in
    from ..io.json import load

    record, page = record_in(folder), folder / "report.json"
    burn_in = [value for name, value in record["burn_in"].items() if name in ("specular", "roughness")]
    return Row(error=record["rerender_rmse"], burn_in=max(burn_in, default=None),
               warnings=[*dict.fromkeys(faults), *record["warnings"]],
               held_out_error=load(page)["held_out_rmse"] if page.is_file() else None,
               photos=len(record["capture"]["photos"]))


def write_preview(path: Path, fit: Fit) -> None:
    """Write a JPEG of the fitted material in the view of the first photo."""
    import cv2
    import torch

    from .. import color
    from ..io.files import write_bytes
    from ..render import make_renderer
    from ..report.pictures import encoded

    material, transfer = fit.detail or fit.svbrdf, fit.transfer
    assert transfer is not None  # a fit to photos has it
    with torch.no_grad():
        radiance = make_renderer("analytic").render(material.resized(min(SIDE, material.resolution)),
                                                    fit.views.pick([0]))[0]
    write_bytes(path, encoded(color.to_display(radiance, transfer), "jpeg", cv2.IMWRITE_JPEG_QUALITY,
                              QUALITY))


def now() -> str:
    """The time in the format of a library: UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@cache
def _warm(threads: int) -> None:
    """Load what every fit needs, and set the number of threads; once in each worker."""
    import drjit
    import torch

    _renderer("mitsuba", "llvm_ad_rgb")
    # A fit that catches a signal ends early, and half a fit would count as done
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    torch.set_num_threads(threads)
    drjit.set_thread_count(threads)


@cache
def _renderer(name: str, variant: str) -> Renderer:
    from ..render import make_renderer

    return make_renderer(name, variant)  # type: ignore[arg-type]


@contextlib.contextmanager
def _printed(results: ResultStore, attempt: str) -> Iterator[Path]:
    """Send all output of the block to a file; yield its path. In a local library it survives a crash."""
    with tempfile.TemporaryDirectory(prefix="mitsvbrdf-log-") as folder:
        path = log_path(results, attempt) or Path(folder) / "log"
        path.parent.mkdir(parents=True, exist_ok=True)
        before = [os.dup(number) for number in (1, 2)]
        with path.open("wb") as log:
            for number in (1, 2):
                os.dup2(log.fileno(), number)
        faulthandler.enable(2)  # a crash prints its traceback
        try:
            yield path
        finally:
            _flush()
            for number, other in zip((1, 2), before):
                os.dup2(other, number)
                os.close(other)
            path.unlink(missing_ok=True)


def _flush() -> None:
    """Flush the output. If the disk is full, a part of the log is lost, but the fit does not fail."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()


def log_path(results: ResultStore, attempt: str) -> Path | None:
    """The log file of an attempt; None in an object store, where the output of a dying worker is lost."""
    return Path(results.store.path(f"{WORK}/{attempt}.log")) if results.store.folder else None


@contextlib.contextmanager
def _memory_limit(gib: float | None) -> Iterator[None]:
    """Inside the block, this process kills itself if it uses more memory than ``gib`` GiB; None: no limit."""
    done = threading.Event()

    def watch() -> None:
        while not done.wait(LOOK_SECONDS):
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            if gib and (used := pages * os.sysconf("SC_PAGE_SIZE") / GIB) > gib:
                os.write(2, f"{HELD} {used:.2f} GiB, the limit is {gib:g} GiB\n".encode())
                os.kill(os.getpid(), signal.SIGKILL)

    if gib and Path("/proc/self/statm").exists():
        threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        done.set()
