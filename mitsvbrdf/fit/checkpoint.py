"""Checkpoints: a fit's running state as named tensors in a safetensors file, which runs no code when loaded."""

from __future__ import annotations

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ..errors import ConfigError
from ..system.files import beside, to_disk


def save_tensors(path: Path, tensors: dict[str, Tensor], note: dict) -> None:
    """A safetensors file: plain tensors, and a note as JSON text. Loading it runs no code."""
    with beside(path) as temporary:
        try:
            save_file({k: v.detach().contiguous().clone() for k, v in tensors.items()}, temporary,
                      metadata={"mitsvbrdf": json.dumps(note)})
        except SafetensorError as reason:
            raise OSError(str(reason)) from None
        to_disk(temporary)  # it takes the place of one that can be resumed from


def load_tensors(path: Path | str) -> tuple[dict[str, Tensor], dict]:
    """What :func:`save_tensors` wrote.

    Raises:
        ConfigError: no such file, or not a checkpoint of this package.
    """
    try:
        with safe_open(str(path), "pt") as file:
            note = json.loads(file.metadata()["mitsvbrdf"])
            return {key: file.get_tensor(key) for key in file.keys()}, note
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as reason:
        raise ConfigError("a checkpoint of mitsvbrdf (.safetensors)", f"{path}: {reason}", "check the path") from None


def part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose name begins with a prefix, named without it."""
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}


def optimizer_state(name: str, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """A copy of an optimiser's running averages, as named tensors."""
    return {f"{name}.{i}.{key}": value.clone() for i, entry in optimizer.state_dict()["state"].items()
            for key, value in entry.items()}


def load_optimizer_state(name: str, optimizer: torch.optim.Optimizer, state: dict[str, Tensor]) -> None:
    """The inverse of :func:`optimizer_state`; step sizes stay as they are."""
    entries: dict[int, dict[str, Tensor]] = {}
    for key, value in part(state, f"{name}.").items():
        index, field = key.split(".", 1)
        entries.setdefault(int(index), {})[field] = value.clone()
    optimizer.load_state_dict({"state": entries, "param_groups": optimizer.state_dict()["param_groups"]})


def module_state(name: str, module: torch.nn.Module) -> dict[str, Tensor]:
    """A copy of a network's weights, as named tensors."""
    return {f"{name}.{key}": value.detach().clone() for key, value in module.state_dict().items()}


def load_module_state(name: str, module: torch.nn.Module, state: dict[str, Tensor]) -> None:
    """The inverse of :func:`module_state`."""
    module.load_state_dict(part(state, f"{name}."))
