"""What competes: every method of ``fit`` with its settings, and one fit of any of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import get_args, get_type_hints

from torch import Tensor

from ..capture import Capture
from ..errors import ConfigError
from ..evaluate import as_fitted
from ..evaluate.placement import predict
from ..fit import FitConfig, FitTask, fit_svbrdf
from ..fit.loop import Loop
from ..fit.methods import METHODS, method_name
from ..io.timing import timed
from ..material.maps import SVBRDF
from ..render import Renderer
from .code import method_module, own_code
from .peers_baseline import PeersBaseline, PeersConfig

Report = Callable[[dict, float], None]  # told an entry of the trace and the share done
Predict = Callable[[Capture], tuple[Tensor, float]]


@dataclass(frozen=True)
class Fitted:
    """What a fit ended in.

    Args:
        svbrdf: the material of the lowest re-rendering error.
        rmse: that error, over the photos used.
        predict: what it predicts for the photos of a capture of the same material, N x R x R x 3 linear, and
            the RMSE over them in display values.
        seconds: of the loop, by its own clock.
        wall: seconds with the preparation before and the reckoning after it.
        iterations: steps made.
        stopped: why it ended.
    """

    svbrdf: SVBRDF
    rmse: float
    predict: Predict
    seconds: float
    wall: float
    iterations: int
    stopped: str


def method_table() -> dict[str, FitConfig]:
    """Name -> settings: the methods of ``fit``, with one more entry for each further preset, and the
    baseline.
    """
    table: dict[str, FitConfig] = {}
    for name, (config, *_) in METHODS.items():
        table[name] = default = config()
        presets = (get_args(get_type_hints(config)["preset"])
                   if any(f.name == "preset" for f in fields(config)) else ())
        table |= {f"{name}-{preset.removeprefix('paper-')}": config(preset=preset)  # type: ignore[call-arg]
                  for preset in presets if preset != getattr(default, "preset", None)}
    return table | {"peers-baseline": PeersConfig()}


def settings_of(config: FitConfig, *modules: str) -> dict:
    """The class, the guess, and the settings that are not the class's own, as JSON has them; each fit sets
    budget and seed.

    ``code``: the digits of what the method, and ``modules`` where they are given, have for themselves.
    """
    method = (PeersBaseline.__module__ if isinstance(config, PeersConfig)
              else method_module(method_name(config)))
    own = asdict(type(config)())
    plain = {name: list(value) if isinstance(value, tuple) else value
             for name, value in asdict(config).items() if value != own[name] or name == "guess"}
    return ({"class": type(config).__name__, "code": own_code(method, *modules)}
            | {k: v for k, v in plain.items() if k not in ("budget", "seed")})


def as_lit(capture: Capture, config: FitConfig) -> Capture:
    """The capture with the light that the method takes for granted: the paper's falls off with nothing."""
    return replace(capture, views=replace(capture.views, falloff=config.falloff))


def fit(capture: Capture, renderer: Renderer, config: FitConfig, report: Report | None = None) -> Fitted:
    """One fit of any method of the table.

    Raises:
        KeyboardInterrupt: Ctrl-C ended it.
        MitsvbrdfError: it cannot be done: no step of it stays finite, or its budget ends before the first.
    """
    lit = as_lit(capture, config)
    if isinstance(config, PeersConfig):
        found, wall = timed(_fit_of_peers, lit, renderer, config, report)
    else:
        found, wall = timed(_fit_of_ours, lit, renderer, config, report)
    if found.stopped == "interrupted":
        raise KeyboardInterrupt
    if found.iterations == 0:  # the budget counts what comes before the first step too
        raise ConfigError("a fit of one step or more", f"none in {wall:.2g} s", "give a longer budget")
    return replace(found, wall=wall)


def _fit_of_ours(capture: Capture, renderer: Renderer, config: FitConfig, report: Report | None) -> Fitted:
    result = fit_svbrdf(capture, renderer, config, report=report)

    def predicted(shots: Capture) -> tuple[Tensor, float]:
        return predict(result.svbrdf, *as_fitted(result, as_lit(shots, config)))[:2]

    return _ended(result.svbrdf, result.rerender_rmse, predicted, result.trace, result.stopped)


def _fit_of_peers(capture: Capture, renderer: Renderer, config: PeersConfig, report: Report | None) -> Fitted:
    config.check()
    loop = Loop(PeersBaseline(FitTask(capture, renderer, config)), capture, renderer, config, report=report)
    stopped = loop.run()
    assert loop.best is not None
    rmse, svbrdf, _ = loop.best

    def predicted(shots: Capture) -> tuple[Tensor, float]:
        return predict(svbrdf, as_lit(shots, config), renderer, None)[:2]

    return _ended(svbrdf, rmse, predicted, loop.trace, stopped)


def _ended(svbrdf: SVBRDF, rmse: float, predicted: Predict, trace: Sequence[Mapping], stopped: str) -> Fitted:
    """A fit by the last line of its trace; its wall-clock time is the caller's to measure."""
    last = trace[-1]
    return Fitted(svbrdf.detach(), rmse, predicted, last["seconds"], math.nan, last["iteration"], stopped)
