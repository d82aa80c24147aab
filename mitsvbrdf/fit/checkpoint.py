"""Checkpoints: a fit's running state as named tensors in a safetensors file, which runs no code when loaded.

A checksum of tensors and note reveals a damaged file; the format itself has no checksum.
"""

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from .. import color
from ..capture import Capture
from ..errors import ConfigError
from ..io.files import atomic_write, to_disk
from ..render import Renderer
from .config import FitConfig

KINDS = {torch.float32: "F32", torch.float64: "F64", torch.float16: "F16", torch.bfloat16: "BF16",
         torch.int64: "I64", torch.int32: "I32", torch.int16: "I16", torch.uint8: "U8", torch.bool: "BOOL"}
MOST_NAMED = 4  # differences from the resumed run that are listed by name
BANDED = 64  # rows of a tensor that are hashed together
Held = Tensor | torch.Generator | torch.optim.Optimizer | torch.nn.Module
Part = Held | Mapping[str, Tensor]  # of a running state


def save_tensors(path: Path, tensors: dict[str, Tensor], note: dict) -> None:
    """Write a safetensors file: plain tensors, and a note as JSON text. Loading it runs no code.

    It is written tensor by tensor: the format's own library would copy all tensors in memory.
    """
    names = sorted(tensors, key=lambda name: (-tensors[name].element_size(), name))  # aligns each tensor
    text, end = json.dumps(note), 0
    about: dict[str, dict] = {"__metadata__": {"mitsvbrdf": text, "sha256": _checksum(tensors, text)}}
    for name in names:
        value, begin = tensors[name], end
        end += value.numel() * value.element_size()
        about[name] = {"dtype": KINDS[value.dtype], "shape": list(value.shape), "data_offsets": [begin, end]}
    header = json.dumps(about).encode()
    header += b" " * (-len(header) % 8)
    with atomic_write(path) as temporary:
        with open(temporary, "wb") as file:
            file.write(struct.pack("<Q", len(header)) + header)
            for name in names:
                file.write(_bytes(tensors[name]))
        to_disk(temporary)  # before it replaces the last good checkpoint


def _bytes(value: Tensor) -> memoryview:
    return value.detach().contiguous().reshape(-1).view(torch.uint8).numpy().data


def load_tensors(path: Path | str) -> tuple[dict[str, Tensor], dict]:
    """Tensors and note from a file of :func:`save_tensors`. ConfigError: another or a damaged file."""
    try:
        if not Path(path).is_file():  # to open a pipe would block
            raise ValueError("no such file")
        with safe_open(str(path), "pt") as file:
            about = file.metadata() or {}
            text, stated = about.get("mitsvbrdf", ""), about.get("sha256")
            tensors = {key: file.get_tensor(key) for key in file.keys() if stated}
        if _checksum(tensors, text) != stated:
            raise ValueError("damaged, or written by another program")
        note = json.loads(text)
        if not isinstance(note, dict):
            raise ValueError("its note is no object")
        return tensors, note
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError) as reason:
        raise ConfigError("a whole checkpoint of mitsvbrdf (.safetensors)", f"{path}: {reason}",
                          "check the path; a damaged checkpoint cannot be resumed") from None


def _checksum(tensors: dict[str, Tensor], text: str) -> str:
    """SHA-256, in hex, of names, types, shapes and bytes of tensors, and of the note."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        value = tensors[name]
        digest.update(f"{name} {value.dtype} {list(value.shape)}".encode())
        digest.update(_bytes(value))
    return digest.hexdigest()


def part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names begin with a prefix; the prefix is removed from their names."""
    return {key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)}


def state_of(parts: Mapping[str, Part]) -> dict[str, Tensor]:
    """Copies of all tensors, weights, running averages and random states; names begin with the part's."""
    state = {}
    for name, each in parts.items():
        if isinstance(each, Tensor):
            state[name] = each
        elif isinstance(each, torch.Generator):
            state[name] = each.get_state()
        elif isinstance(each, torch.optim.Optimizer):
            state |= {f"{name}.{i}.{key}": value for i, entry in each.state_dict()["state"].items()
                      for key, value in entry.items()}
        else:
            held = each.state_dict() if isinstance(each, torch.nn.Module) else each
            state |= {f"{name}.{key}": value for key, value in held.items()}
    return {name: value.detach().clone() for name, value in state.items()}


def load_parts(parts: Mapping[str, Held], state: dict[str, Tensor]) -> None:
    """Load a state of :func:`state_of` into the parts; step sizes stay as they are.

    LookupError, RuntimeError, TypeError, ValueError: the state belongs to other parts.
    """
    for name, each in parts.items():
        if isinstance(each, Tensor):
            with torch.no_grad():
                each.copy_(state[name])
        elif isinstance(each, torch.Generator):
            each.set_state(state[name])
        elif isinstance(each, torch.nn.Module):
            each.load_state_dict(part(state, f"{name}."))
        else:
            _load_optimizer(name, each, state)


def _load_optimizer(name: str, optimizer: torch.optim.Optimizer, state: dict[str, Tensor]) -> None:
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    entries: dict[int, dict[str, Tensor]] = {}
    for key, value in part(state, f"{name}.").items():
        index, field = key.split(".", 1)
        if value.shape != (() if field == "step" else parameters[int(index)].shape):
            raise ValueError(f"{name}.{key} of shape {tuple(value.shape)}")
        entries.setdefault(int(index), {})[field] = value.clone()
    if any({"step", "exp_avg", "exp_avg_sq"} - entry.keys() for entry in entries.values()):
        raise ValueError(f"averages of {name} are missing")
    optimizer.load_state_dict({"state": entries, "param_groups": optimizer.state_dict()["param_groups"]})


def fingerprints(config: FitConfig, capture: Capture, renderer: Renderer,
                 fixed: Mapping[str, Tensor]) -> dict[str, str]:
    """A fingerprint of each thing that determines a fit, except its limits: a dict, name to text.

    The fingerprint of a fixed map comes from its values: its file may change later.
    """
    views = capture.views
    parts = {f"--{name.replace('_', '-')}": repr(value) for name, value in asdict(config).items()
             if name not in ("iterations", "budget", "fix")}
    parts |= {f"--fix {name}": digest(value) for name, value in sorted(fixed.items())}
    parts |= {"--renderer": renderer.name, "--variant": renderer.variant or "",
              "--transfer": capture.transfer, "--falloff": views.falloff,
              "size of the patch": repr(views.size)}
    for row, name in enumerate(capture.names):
        parts[f"photo {name}"] = digest(capture.stored[row], *(
            [] if capture.measured is None else [capture.measured[row]]))
        parts[f"view of photo {name}"] = digest(views.camera[row], views.light[row], views.intensity[row])
    return parts


def digest(*tensors: Tensor) -> str:
    """SHA-256 of the values of tensors; pixels of 8 or 16 bits count as their display values."""
    found = hashlib.sha256()
    for tensor in tensors:
        for rows in tensor.split(BANDED) if tensor.dim() else [tensor]:
            value = rows if rows.dtype == torch.bool else color.shown(rows)
            found.update(value.contiguous().numpy().data)
    return found.hexdigest()


def differing(before: object, now: Mapping[str, str]) -> list[str]:
    """Names of the fingerprints that differ; after :data:`MOST_NAMED` of them, the number of the rest."""
    if not isinstance(before, dict):
        return ["an earlier version kept no list of them"]
    names = [name for name in dict.fromkeys([*now, *before]) if before.get(name) != now.get(name)]
    return names if len(names) <= MOST_NAMED else [*names[:MOST_NAMED], f"{len(names) - MOST_NAMED} more"]
