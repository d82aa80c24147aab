"""Sheets like the paper's figures 4 to 6: input photo, maps with the guessed diffuse map, rendering; a row
for each method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from ...capture import Capture
from ...capture.guess import guess_diffuse
from ...color import to_display
from ...evaluate import evaluate_maps
from ...fit import FitConfig
from ...material.maps import SVBRDF, TITLES, shown_map
from ...render import Renderer
from ...report.canvas import HEADER_HEIGHT, LABEL_HEIGHT, PICTURE_GAP, SHEET_MARGIN, Canvas, square_side
from ...report.colours import SHEET_QUIET, SHEET_TEXT
from ..code import own_code
from ..methods import as_lit, fit, settings_of
from ..tasks import KnownMaterial, novel_views
from .references import peers

COLUMNS = ("Input", ", ".join(TITLES[name] for name in ("diffuse", "specular", "roughness", "normal")),
           "Guessed diffuse",
           "Rendering", "Lit from the side")
MOST_BYTES = 400_000
QUALITIES = (90, 84, 76, 66, 50)  # of the JPEG: the first that is small enough
MAPS = ("diffuse", "specular", "roughness", "normal")
SHOWN_VIEW, SIDE_LIGHT = 0, 0  # numbers of the photo and of the light from the side that are shown


@dataclass(frozen=True)
class SheetRow:
    """One method of a sheet.

    Args:
        label: its name, and what else is to be said.
        svbrdf: its maps.
        guess: its guessed diffuse map, R x R x 3 linear, where it has one.
        errors: RMSE of each map, where it is not the truth itself.
    """

    label: str
    svbrdf: SVBRDF
    guess: Tensor | None = None
    errors: Mapping[str, float] | None = None


@dataclass(frozen=True)
class SheetJob:
    """The sheet of one known material: the truth, a fit of each method, and published maps.

    Args:
        methods: name -> settings.
        task: the material.
        budget: seconds of each fit.
        seed: of each fit.
        renderer: carries the gradients.
        folder: where the picture goes.
    """

    methods: Mapping[str, FitConfig]
    task: KnownMaterial
    budget: float
    seed: int
    renderer: Renderer
    folder: Path

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "sheets", "kind": self.task.kind, "name": self.task.name}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return {"budget": self.budget, "seed": self.seed, "code": own_code(__name__),
                "methods": {n: settings_of(c) for n, c in self.methods.items()}}

    @property
    def title(self) -> str:
        """For the progress line."""
        return f"sheet of {self.task.name}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return "sheets"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        return (self.budget + 5) * len(self.methods)

    @property
    def path(self) -> Path:
        """The picture."""
        return self.folder / f"gan-{self.task.name}.jpg"

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The picture's file, and the errors written on it: whose -> map -> RMSE, and ``seconds``."""
        rows, found = [SheetRow("Truth", self.task.truth)], {}
        for number, (name, config) in enumerate(self.methods.items()):
            config = replace(config, budget=self.budget, seed=self.seed)
            fitted = fit(self.task.photos, self.renderer, config)
            errors = {e: v for e, v in self.task.errors(fitted).items() if e in MAPS}
            guess = guess_diffuse(as_lit(self.task.photos, config), config.guess)
            rows.append(SheetRow(f"{name}, {fitted.seconds:.0f} s", fitted.svbrdf, guess, errors))
            found[name] = errors | {"seconds": fitted.seconds}
            report((number + 1) / len(self.methods))
        for who, maps in peers(self.task).items():
            assert self.task.folder is not None
            errors = {e: v for e, v in evaluate_maps(maps, self.task.folder).items() if e in MAPS}
            rows.append(SheetRow(f"{who}, published maps", maps, None, errors))
            found[who] = errors
        write_comparison(self.path, self.task.name, self.task.photos, rows, self.renderer)
        return {"file": self.path.name, "errors": found}


def write_comparison(path: Path, title: str, photos: Capture, rows: Sequence[SheetRow],
                     renderer: Renderer) -> None:
    """One JPEG of at most :data:`MOST_BYTES`, 1680 pixels wide, a row for each method.

    Args:
        path: the file to write or replace.
        title: the heading.
        photos: what was fitted.
        rows: the truth and the methods.
        renderer: draws the two renderings of each row.

    Raises:
        OutputError: the file cannot be written.
    """
    side = square_side(len(COLUMNS), 10_000)
    sheet = Canvas(HEADER_HEIGHT + LABEL_HEIGHT + len(rows) * (LABEL_HEIGHT + side + PICTURE_GAP) + 10)
    sheet.text(SHEET_MARGIN, 52, title, 22, SHEET_TEXT, weight="bold")
    left = [SHEET_MARGIN + k * (side + PICTURE_GAP) for k in range(len(COLUMNS))]
    for x, head in zip(left, COLUMNS):
        sheet.text(x, HEADER_HEIGHT + 8, head, 11, SHEET_QUIET)
    for number, row in enumerate(rows):
        y = HEADER_HEIGHT + LABEL_HEIGHT + number * (LABEL_HEIGHT + side + PICTURE_GAP) + LABEL_HEIGHT
        sheet.text(left[0], y - 9, row.label, 11, SHEET_TEXT)
        if row.errors:
            sheet.text(left[1], y - 9, "RMSE " + ", ".join(f"{row.errors[name]:.4f}" for name in MAPS), 10,
                       SHEET_TEXT)
        sheet.image(left[0], y, side, photos.photos[SHOWN_VIEW])
        _maps(sheet, left[1], y, side, row.svbrdf)
        if row.guess is not None:
            sheet.image(left[2], y, side, shown_map("diffuse", row.guess))
        for x, picture in zip(left[3:], _renderings(row.svbrdf, photos, renderer)):
            sheet.image(x, y, side, picture)
    sheet.write_jpeg(path, QUALITIES, MOST_BYTES)


def _maps(sheet: Canvas, x: int, y: int, side: int, svbrdf: SVBRDF) -> None:
    """Diffuse, specular, roughness and normal, two by two."""
    small = (side - PICTURE_GAP) // 2
    for k, name in enumerate(MAPS):
        down, across = divmod(k, 2)
        sheet.image(x + across * (small + PICTURE_GAP), y + down * (small + PICTURE_GAP), small,
                    shown_map(name, svbrdf[name]))


def _renderings(svbrdf: SVBRDF, photos: Capture, renderer: Renderer) -> list[Tensor]:
    """The shown photo's view again, and one lit from the side: display values R x R x 3, encoded as the
    photos are.
    """
    material = svbrdf.resized(min(photos.resolution, svbrdf.resolution))
    with torch.no_grad():
        return [to_display(renderer.render(material, views.pick([number]))[0], photos.transfer)
                for views, number in ((photos.views, SHOWN_VIEW), (novel_views(photos.views), SIDE_LIGHT))]
