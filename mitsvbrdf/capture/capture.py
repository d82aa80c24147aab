"""The capture value type: rectified photos of one patch with their views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from torch import Tensor

from .. import color
from ..errors import CaptureError
from ..material.resample import area_averaged, sampled
from ..pages.notebook import SHOWN, count_words, html_of, point_words, uri_of
from ..views import Views

LEAST_SIDE = 8  # pixels

KNOWN = {"given": "as calibrated", "sheet": "from a sheet of tags", "photos": "from features that the photos share",
         "none": "of no calibration"}

# Where the views of a capture come from: its maker, a marker sheet, the features that raw photos share, or nowhere.
Calibration = Literal["given", "sheet", "photos", "none"]


@dataclass(frozen=True)
class Capture:
    """Photos rectified to one frontal view: pixel (i, j) of each is the same point of the material.

    Args:
        photos: N x R x R x 3 float32, display values in [0, 1] as stored, row 0 at the top.
        views: the N views.
        transfer: how display values encode linear radiance.
        index: the number of each photo in the capture it was read from (0-based), e.g. (0, 1, 2, 3, 5, 6, 8).
        calibration: where the views come from; of ``none`` they are the stated default geometry.
        source: the folder it came from.
        notes: what a user should know about how it was read (photos left out, default geometry, ...).
    """

    photos: Tensor
    views: Views
    transfer: color.Transfer = "gamma2.2"
    index: tuple[int, ...] = ()
    calibration: Calibration = "given"
    source: Path | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.photos.shape[0] != len(self.views):
            raise CaptureError(f"a view for each of {self.photos.shape[0]} photos", f"{len(self.views)} views",
                               "give one row of calibration a photo")
        if not self.index:
            object.__setattr__(self, "index", tuple(range(len(self.views))))

    def __len__(self) -> int:
        return self.photos.shape[0]

    def __repr__(self) -> str:
        name = self.source.name if self.source else "without a folder"
        return f"Capture({name}, photos {', '.join(self.names)}, {self.resolution} px, {self.transfer})"

    @property
    def calibrated(self) -> bool:
        """Whether anything is known of the views."""
        return self.calibration != "none"

    @property
    def resolution(self) -> int:
        """Pixels along a side of the square photos."""
        return self.photos.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """Two-digit names of the photos: "00", "01", ..."""
        return tuple(f"{i:02d}" for i in self.index)

    @property
    def linear(self) -> Tensor:
        """The photos as linear radiance, N x R x R x 3 (clipped highlights stay at 1)."""
        return color.decode(self.photos, self.transfer)

    def averaged(self, resolution: int) -> Capture:
        """The photos at another size, by area averages of display values."""
        return replace(self, photos=area_averaged(self.photos, resolution).contiguous())

    def sampled(self, resolution: int) -> Capture:
        """Every k-th pixel of the photos, the middle one, for the greatest k that leaves at least ``resolution`` a side."""
        return replace(self, photos=sampled(self.photos.movedim(-1, 1), resolution).movedim(1, -1).contiguous())

    def pick(self, index: Sequence[int]) -> Capture:
        """The photos with these numbers (as in :attr:`index`), in this order.

        Raises:
            CaptureError: a number that is not there, or none at all.
        """
        missing = [i for i in index if i not in self.index]
        if missing or not index:
            raise CaptureError(f"photo numbers out of {list(self.index)}", f"{missing or 'none'}", "check --views")
        if len(set(index)) < len(index):
            raise CaptureError("each photo once", f"photos {list(index)}", "take the repeated number out")
        rows = [self.index.index(i) for i in index]
        return replace(self, photos=self.photos[rows], views=self.views.pick(rows), index=tuple(index))

    def _repr_html_(self) -> str:
        """The photos as small pictures with their positions, for notebooks."""
        return capture_html(self)


def capture_html(capture: Capture) -> str:
    """The photos with the positions of camera and light in patch sides, at most nine, as an HTML fragment."""
    sides, photos = capture.views.in_patch_sides(), []
    for name, photo, view in zip(capture.names, capture.photos[:SHOWN], sides):
        light = "light the same" if view.light == view.camera else f"light {point_words(view.light)}"
        photos.append((f"{name} · camera {point_words(view.camera)}, {light}", uri_of(photo)))
    height, width = capture.photos.shape[1:3]
    facts = [f"transfer {capture.transfer}, falloff {capture.views.falloff}; positions in patch sides, "
             f"{KNOWN[capture.calibration]}"]
    name = capture.source.name if capture.source else "without a folder"
    title = f"Capture · {name} · {count_words(len(capture))}, {width} × {height} px"
    return html_of(title, [("", photos)], facts, capture.notes)
