"""``mitsvbrdf pretrain-hybrid``: the learned start of ``hybrid``, trained on materials made by code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from .. import files
from ..errors import ConfigError
from ..fit.config import check_seed
from ..progress import progress_bar, say
from .options import Out, Overwrite


def pretrain_hybrid(out: Out, budget: Annotated[float, arg(help="Stop after this many seconds.")] = 600.0,
                    steps: Annotated[int | None, arg(help="Stop after this many steps, if that is sooner.")] = None,
                    seed: Annotated[int, arg(help="Of materials, photos and weights.")] = 0,
                    width: Annotated[int, arg(help="Channels of the generator's finest level.")] = 16,
                    overwrite: Overwrite = False) -> int:
    """Train a start for `fit --method hybrid` on random materials made by code; no picture is needed.

    OUT is a .safetensors file, for `fit --method hybrid --pretrained OUT`. Ctrl-C ends the training early and keeps what
    it has learned.
    """
    from ..fit.pretraining import pretrain_start

    if min(budget, width, 1 if steps is None else steps) <= 0:
        raise ConfigError("--budget, --steps and --width > 0", f"{budget}, {steps} and {width}",
                          "leave them out for the defaults")
    check_seed(seed)
    check_new_checkpoint(out, overwrite)
    with progress_bar("pretrain-hybrid") as report:
        pretrain_start(out, budget=budget, steps=steps, seed=seed, width=width, report=report)
    say(f"wrote {out}")
    return 0


def check_new_checkpoint(out: Path, overwrite: bool) -> None:
    """Raise ConfigError where a checkpoint cannot be written, before any work is done."""
    if out.is_dir() or out.exists() and not overwrite:
        raise ConfigError("a new checkpoint file", f"{out}, which exists", "add --overwrite, or choose another name")
    files.check_output(out)
