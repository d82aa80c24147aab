"""Fixed maps, which are not fitted: ``--fix NAME=VALUE`` checked, and made into tensors."""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from ..errors import ConfigError
from ..material.map_set import LEAST_ROUGHNESS, read_file
from ..material.maps import CHANNELS, SVBRDF, Bsdf, flat


def stated_maps(fix: Sequence[str], bsdf: Bsdf, grey_specular: bool = False) -> dict[str, str]:
    """The values of ``--fix``, map name -> value, checked; files are not read.

    Each item is ``NAME=VALUE``. A value is ``flat`` (normal), a number, numbers ``r,g,b``, or an image file.

    Raises:
        ConfigError: unknown map, number out of range, map twice, or nothing (or no grey specular) to fit.
    """
    stated: dict[str, str] = {}
    for item in fix:
        name, sign, value = str(item).partition("=")
        if name not in CHANNELS[bsdf] or not sign:
            raise ConfigError(f"--fix NAME=VALUE with a map of {list(CHANNELS[bsdf])}", repr(item),
                              "e.g. --fix normal=flat --fix roughness=0.5")
        if name in stated:
            raise ConfigError(f"--fix {name}=... once", f"{stated[name]!r} and {value!r}",
                              "take one of them out")
        _check_value(name, value, CHANNELS[bsdf][name])
        stated[name] = value
    if len(stated) == len(CHANNELS[bsdf]):
        raise ConfigError("at least one map to fit", "all of them fixed",
                          "take one --fix out, or use `mitsvbrdf evaluate`")
    if grey_specular and ("specular" not in CHANNELS[bsdf] or "specular" in stated):
        raise ConfigError("--grey-specular with a specular map to fit",
                          f"{bsdf} with {list(stated) or 'nothing'} fixed", "take one of the options out")
    return stated


def fixed_maps(fix: Sequence[str], bsdf: Bsdf, resolution: int) -> dict[str, Tensor]:
    """The fixed maps, name -> R x R x C, float32, linear. A constant takes no memory: its strides are 0.

    Files are read like those of a folder of maps, and resized to R (area averages down, bilinear up).

    Raises:
        ConfigError: see :func:`stated_maps`; a missing file; roughness to fit, but specular fixed at 0.
        MapsError: a file that is no such map.
    """
    fixed = {name: _tensor(name, value, bsdf, resolution) for name, value in stated_maps(fix, bsdf).items()}
    if "roughness" not in fixed and "specular" in fixed and not fixed["specular"].any():
        raise ConfigError("roughness held fixed too", "specular held at 0, without which no photo shows "
                                                      "roughness", "add --fix roughness=1")
    return fixed


def unknown_but(fixed: Mapping[str, Tensor], bsdf: Bsdf, resolution: int, grey_specular: bool) -> SVBRDF:
    """A material with the fixed maps; all other maps are 1 and require a gradient."""
    def unknown(name: str, channels: int) -> Tensor:
        own = 1 if grey_specular and name == "specular" else channels
        return torch.ones(own, requires_grad=True).expand(resolution, resolution, channels)

    return SVBRDF(bsdf, {n: fixed[n] if n in fixed else unknown(n, channels)
                         for n, channels in CHANNELS[bsdf].items()})


def named_files(fix: Sequence[str]) -> list[str]:
    """The image files named in ``--fix``."""
    values = [item.partition("=")[2] for item in fix]
    return [value for value in values if value != "flat" and _numbers(value) is None]


def absolute_files(fix: Sequence[str]) -> tuple[str, ...]:
    """The items of ``--fix``, with the absolute path of each file."""
    there = {item: f"{item.partition('=')[0]}={os.path.abspath(item.partition('=')[2])}" for item in fix
             if named_files([item])}
    return tuple(there.get(item, item) for item in fix)


def described(fix: Sequence[str]) -> dict[str, str]:
    """Map name -> "held at VALUE", for lists of what a fit omits."""
    return {name: f"held at {value}" for name, _, value in (item.partition("=") for item in fix)}


def _numbers(value: str) -> list[float] | None:
    """The numbers of ``0.5`` or ``r,g,b``; None for the name of a file."""
    try:
        return [float(part) for part in value.split(",")]
    except ValueError:
        return None


def _check_value(name: str, value: str, channels: int) -> None:
    numbers = _numbers(value)
    if name == "normal":
        if numbers is not None:
            raise ConfigError("normal=flat or normal=FILE", f"normal={value}",
                              "flat is a normal that points up everywhere")
    elif value == "flat":
        raise ConfigError(f"a number or a file for {name}", "flat, which only a normal can be",
                          f"e.g. --fix {name}=0.5")
    elif numbers is not None:
        least = LEAST_ROUGHNESS if name == "roughness" else 0.0
        if len(numbers) not in {1, channels}:
            raise ConfigError(f"{'1 number' if channels == 1 else f'1 or {channels} numbers'} for {name}",
                              value, "separate by commas")
        if not all(math.isfinite(x) and least <= x <= 1 for x in numbers):
            raise ConfigError(f"{name} from {least:.2g} to 1", value, "values are linear")


def _tensor(name: str, value: str, bsdf: Bsdf, resolution: int) -> Tensor:
    channels, numbers = CHANNELS[bsdf][name], [0.0, 0.0, 1.0] if value == "flat" else _numbers(value)
    if numbers is not None:
        return torch.tensor(numbers).expand(resolution, resolution, channels)
    if not os.path.isfile(value):  # False for a name that is too long; Path.is_file raises
        raise ConfigError(f"a number or an image file for {name}", f"{value!r}, which is neither",
                          "check the path")
    image = read_file(Path(value), name, channels)
    # Checked and resized inside a material, like any other map.
    others: Mapping[str, Tensor] = flat(image.shape[0], bsdf).maps
    return SVBRDF(bsdf, dict(others) | {name: image}).check().resized(resolution)[name].contiguous()
