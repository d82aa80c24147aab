"""Small captures on disk."""

from __future__ import annotations

from pathlib import Path

from helpers import photos_of
from mitsvbrdf.capture import write_capture
from mitsvbrdf.material.made import make_material

SIDE = 16


def write_captures(folder: Path, count: int) -> list[Path]:
    """Captures of made materials, named shot-0 and so on."""
    written = [folder / f"shot-{k}" for k in range(count)]
    for k, path in enumerate(written):
        write_capture(photos_of(make_material("inlay", SIDE, seed=k), noise=0.003), path)
    return written
