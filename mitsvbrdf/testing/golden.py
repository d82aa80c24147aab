"""Golden files: results accepted once, kept beside the test, and compared with later results.

``tests/test_a.py`` keeps its golden files in ``tests/golden/test_a/NAME.exr``: float32, ZIP-compressed, one
EXR file for a picture, a stack of views or all maps of a material (as layers). Values are linear.
"""

import math
import re
import shlex
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import torch
from torch import Tensor

from .. import color
from ..errors import ConfigError, MapsError
from ..io import images
from ..material.maps import SVBRDF, TITLES, shown_map
from ..measure.metrics import flip as flip_error
from . import running
from .page import Figure, failure, left_behind, row

Layers = dict[str, Tensor]  # layer name to H x W x C; a lone picture has the name ""


def assert_matches_golden(result: Tensor | SVBRDF, name: str, *, rtol: float = 1e-4, atol: float = 1e-6,
                          flip: float = 1.0) -> None:
    """Fail unless a result matches the one that ``pytest --mitsvbrdf-update`` accepted.

    With that option a missing golden file is written and one that no longer matches is replaced; one that
    matches stays as it is. Without it no golden file is ever touched.

    Args:
        result: a linear picture H x W x 3, views N x H x W x 3, or a material.
        name: name of the golden file, without suffix: letters, digits, ``-``, ``_`` and ``.``, 100 at most.
            Use each name once in a test file.
        rtol: a value may be off by ``atol + rtol |golden value|``. The defaults suit float32 renderers on
            different machines; with ``math.inf``, only ``flip`` decides.
        atol: see ``rtol``; linear units.
        flip: largest mean FLIP error (:func:`mitsvbrdf.measure.metrics.flip`) of a view or map, as
            displayed.

    Raises:
        AssertionError: the result differs, has another shape, or is not finite; or no golden file exists. The
            message names the page, the new EXR file and the way to accept it.
        MapsError: a result of another kind, or a golden file that cannot be read.
        ConfigError: a bad name, a call outside a test, or tolerances that are negative, NaN, or no limit.
    """
    __tracebackhide__ = True
    if not (rtol >= 0 and atol >= 0 and flip >= 0 and (rtol + atol < math.inf or flip < 1)):
        raise ConfigError("tolerances from 0, with finite rtol and atol or a flip below 1",
                          f"rtol={rtol}, atol={atol}, flip={flip}", "else everything matches, or nothing")
    path, layers = _golden_path(name), _layers(result)
    if not all(torch.isfinite(layer).all() for layer in layers.values()):
        raise AssertionError(f"{name} has values that are not finite: it was neither compared nor written")
    golden = _read(path) if path.exists() else {}
    title, figures, notes = _compared(name, layers, golden, rtol, atol, flip)
    if title and running.now.update:
        _write(path, layers)
        running.now.written.append(path)
    if not title or running.now.update:
        return
    notes += [f"golden file: {path}",
              f"new result: {left_behind(f'-{name}.exr', lambda file: _write(file, layers))}",
              f"to accept it: pytest --mitsvbrdf-update {shlex.quote(running.now.test)}"]
    paired = golden if _shapes(layers) == _shapes(golden) else {}
    rows = [row(layer or "picture", value, paired.get(layer), partial(_shown, layer))
            for layer, value in layers.items()]
    raise failure(title, figures, rows, notes, f"-{name}.html")


def _golden_path(name: str) -> Path:
    file = running.now.file
    if file is None:
        raise ConfigError("a running test", "a call outside of one, or without the pytest plugin",
                          "install mitsvbrdf, or run pytest -p mitsvbrdf.testing.plugin")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", name):
        raise ConfigError("a name of letters, digits, '-', '_' and '.', 100 at most", repr(name),
                          "leave out other characters: it becomes a file name")
    return file.parent / "golden" / file.stem / f"{name}.exr"


def _layers(result: Tensor | SVBRDF) -> Layers:
    if isinstance(result, SVBRDF):
        return {name: value.detach().float() for name, value in result.maps.items()}
    result = torch.as_tensor(result).detach().float()
    if result.ndim not in (3, 4) or result.shape[-1] != 3 or not result.numel():
        raise MapsError("H x W x 3, N x H x W x 3, or an SVBRDF", f"shape {tuple(result.shape)}",
                        "give linear colours")
    return {"": result} if result.ndim == 3 else {f"view{k:03d}": view for k, view in enumerate(result)}


def _compared(name: str, layers: Layers, golden: Layers, rtol: float, atol: float, flip: float,
              ) -> tuple[str, list[Figure], list[str]]:
    """The title of the failure (empty: none), the figures, and notes."""
    if not golden:
        return f"{name} has no golden file yet", [], []
    if (new := _shapes(layers)) != (old := _shapes(golden)):
        return f"{name} has another shape than its golden file: {new} instead of {old}", [], []
    figures, notes = [], []
    for layer, value in layers.items():
        label = f"{layer}: " if layer else ""
        if rtol + atol < math.inf:
            off = (value.double() - golden[layer]).abs()
            excess = torch.where(off == 0, 0.0, off / (atol + rtol * golden[layer].double().abs()))
            figures.append(Figure(f"{label}largest difference, in tolerances", float(excess.max()), 1.0))
            if figures[-1].missed:
                worst = torch.unravel_index(excess.argmax(), excess.shape)
                notes.append(f"{label}{int((~(excess <= 1)).sum())} of {excess.numel()} values are off, "
                             f"worst at (row, column, channel) {tuple(map(int, worst))}: {value[worst]:.7g}, "
                             f"golden {golden[layer][worst]:.7g}")
        if flip < 1:
            look = flip_error(_shown(layer, value), _shown(layer, golden[layer]), "linear")
            figures.append(Figure(f"{label}mean FLIP error", float(look.mean()), flip))
    return f"{name} does not match its golden file" * any(f.missed for f in figures), figures, notes


def _shapes(layers: Layers) -> str:
    return ", ".join(f"{layer} {' x '.join(map(str, value.shape))}".strip()
                     for layer, value in sorted(layers.items()))


def _shown(layer: str, value: Tensor) -> Tensor:
    shown = shown_map(layer, value) if layer in TITLES else color.to_display(value)
    return shown.expand(*value.shape[:2], 3)


def _read(path: Path) -> Layers:
    layers: dict[str, dict[str, np.ndarray]] = {}
    try:
        for name, channel in OpenEXR.File(str(path), separate_channels=True).channels().items():
            layer, _, letter = name.rpartition(".")
            layers.setdefault(layer, {})[letter] = channel.pixels
        return {layer: torch.from_numpy(np.stack([parts[c] for c in ("RGB" if "R" in parts else "Y")],
                                                 axis=-1)) for layer, parts in layers.items()}
    except Exception as reason:  # OpenEXR raises plain RuntimeError and others; or a channel is missing
        raise MapsError("a golden EXR file", f"{path}: {reason!r}, channels {sorted(layers)}",
                        "fetch it anew, or delete it and accept a new one") from None


def _write(path: Path, layers: Layers) -> None:
    images.write_channels(path, {f"{layer}.{letter}".lstrip("."): value[..., k].numpy()
                                 for layer, value in layers.items()
                                 for k, letter in enumerate("RGB" if value.shape[-1] == 3 else "Y")})
