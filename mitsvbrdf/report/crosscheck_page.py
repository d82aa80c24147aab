"""The page of a cross-check."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from ..verify.crosscheck import omitted
from .page import figure, write_page
from .pictures import error_picture, png_uri

# Error maps of all configurations share these ends of their log scale, so that they can be compared by eye.
LEAST_SHOWN, MOST_SHOWN = 1e-8, 1e-4


def write_crosscheck_page(path: str | Path, record: dict,
                          error_maps: Mapping[tuple[str, str, str], Tensor]) -> None:
    """One self-contained HTML file: figures, error maps, worst texels.

    The record and the error maps (R x R, by material, BSDF and renderer) are those of one call of
    :func:`mitsvbrdf.verify.crosscheck.crosscheck`.
    """
    maps = {key: png_uri(error_picture(error, MOST_SHOWN, LEAST_SHOWN)) for key, error in error_maps.items()}
    ramp = torch.logspace(-8, -4, 256, dtype=torch.float64).expand(16, 256)
    converted = {bsdf: how for material in record["materials"].values()
                 for bsdf, how in material["converted"].items()}
    materials = {name: [c for c in record["configurations"] if c["material"] == name]
                 for name in record["materials"]}
    write_page(path, "report/crosscheck.html", title="Renderers against float64", record=record,
               materials=materials, error_maps=maps,
               ramp=png_uri(error_picture(ramp, MOST_SHOWN, LEAST_SHOWN)),
               darkest=LEAST_SHOWN, brightest=MOST_SHOWN, omitted=omitted(record),
               converted=converted, cosine=_cosine, digits=_digits)


def _digits(value: float | None) -> str:
    """A float32 with all its digits, for values that differ in the last ones."""
    return figure(None) if value is None else f"{value:.9g}"


def _cosine(value: float | None) -> str:
    """A cosine close to 1, as its difference from 1: 1 - 2.3e-13."""
    return figure(None) if value is None else f"1 − {figure(max(1 - value, 0.0))}"
