"""The type Capture: rectified photos of one patch, their views, and how their colours were converted."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import torch
from torch import Tensor

from .. import color
from ..color import Transfer
from ..errors import CaptureError, ConfigError, warn_of
from ..io.colour_profile import Profile
from ..kinds import check_fields, kinds_checked
from ..material.resample import area_averaged, sampled
from ..views import Views, whole_numbers


@dataclass(frozen=True)
class Converted:
    """Photos converted from one profile to sRGB: their number, and the share of pixels outside of sRGB."""

    photos: int
    outside: float


def converted(stated: Mapping[str, Profile | None], outside: Mapping[str, float]) -> dict[str, Converted]:
    """A dict, profile name to conversion, of the photos in ``outside`` (photo name to share outside of sRGB).

    InputWarning: a profile that cannot be used.
    """
    names: dict[Profile, list[str]] = {}
    for name in outside:
        if profile := stated.get(name):
            names.setdefault(profile, []).append(name)
    for profile, those in names.items():
        if profile.reason:
            more = f" and {len(those) - 1} more photos" if those[1:] else ""
            warn_of(f"{those[0]}{more}: {profile.name} cannot be used ({profile.reason}); the values are "
                    "taken as sRGB; export the photos as sRGB")
    alike: dict[str, list[float]] = {}  # profiles of one name may differ, for example in their date
    for profile, those in names.items():
        if not profile.reason:
            alike.setdefault(profile.name, []).extend(outside[name] for name in those)
    return {name: Converted(len(shares), sum(shares) / len(shares)) for name, shares in alike.items()}


def notes_of(colours: Mapping[str, Converted]) -> list[str]:
    """One note for each profile."""
    return [f"{found.photos} photo{'s' * (found.photos > 1)} of colour profile {name}: converted to sRGB; "
            f"{found.outside:.2%} of the pixels lie outside of sRGB and were moved to its edge"
            for name, found in colours.items()]


def used_transfer(transfer: Transfer, profiles: Collection[str]) -> tuple[Transfer, list[str]]:
    """The transfer function to use, and notes. Values converted from a profile are sRGB, never linear."""
    if transfer != "linear" or not profiles:
        return transfer, []
    return "srgb", [f"transfer srgb is used, not linear: the photos state the profile {', '.join(profiles)}, "
                    "by which they were converted; remove it to have their values as they are"]


LEAST_SIDE = 8  # pixels
MOST_HELD = 500_000_000  # pixels of all photos of a capture together, after shrinking: 6 GB
KEPT = torch.uint8, torch.uint16  # photos of these types are kept as stored; others become float32
SINGLE = 32  # pixels a side that are kept, not averaged, when a photo is shrunk

# source of the views: the maker of the capture, a sheet of tags, features that raw photos share, or none
Calibration = Literal["given", "sheet", "photos", "none"]


class _Photos:
    """A descriptor: each access converts the stored photos to float32 display values."""

    def __get__(self, capture: Capture | None, _: type | None = None) -> Tensor:
        if capture is None:
            raise AttributeError("photos have no default")
        return color.shown(capture.stored)

    def __set__(self, capture: Capture, photos: Tensor) -> None:
        vars(capture)["photos"] = _checked(photos)


@dataclass(frozen=True)
class Capture:
    """Photos rectified to one frontal view: pixel (i, j) of each is the same point of the material.

    Args:
        photos: N x R x R x 3, display values in [0, 1], row 0 at the top: float32, or 8 or 16 bits as stored.
            Integers are kept (:attr:`stored`), and each access converts them to float32.
        views: the N views.
        transfer: how display values encode linear radiance.
        index: the number of each photo in the capture it was read from (0-based), e.g. (0, 1, 2, 3, 5, 6, 8).
        calibration: where the views come from; ``none``: the default geometry, or views estimated from it.
        source: the folder that the capture came from.
        notes: what a user should know about how it was read (rejected photos, default geometry, ...).
        colours: conversions to sRGB: a dict, name of a colour profile to its conversion.
        measured: N x R x R, False where a photo is filled in (masked, or beyond its edge); None: all True.
        carries: resolution of the detail in the photos before they were shrunk, pixels a side
            (:mod:`.sharpness`); None: not measured.
        single: N x P x P x 3, single pixels of the photos before they were shrunk (:func:`single_pixels`);
            None: they were not shrunk.

    Raises:
        CaptureError: photos of a wrong shape or with impossible values; views or an ``index`` that do not
            match the photos; views that fail :meth:`Views.check`; ``measured`` that is no mask.
        ConfigError: an unknown transfer function or calibration.
    """

    photos: Tensor
    views: Views
    transfer: color.Transfer = "gamma2.2"
    index: tuple[int, ...] = ()
    calibration: Calibration = "given"
    source: Path | None = None
    notes: tuple[str, ...] = ()
    colours: Mapping[str, Converted] = field(default_factory=dict)
    measured: Tensor | None = None
    carries: int | None = None
    single: Tensor | None = None

    def __post_init__(self) -> None:
        check_fields(self, "views", "transfer", "calibration", "source", "measured")
        color.parts(self.transfer)
        if self.calibration not in get_args(Calibration):
            raise ConfigError(f"a calibration of {get_args(Calibration)}", repr(self.calibration),
                              "choose one of these")
        self.views.check()
        parts = {name: getattr(self.views, name) for name in ("camera", "light", "intensity")}
        if any(part.requires_grad for part in parts.values()):
            object.__setattr__(self, "views", replace(
                self.views, **{name: part.detach() for name, part in parts.items()}))
        if len(self) != len(self.views):
            raise CaptureError(f"a view for each of {len(self)} photos",
                               f"{len(self.views)} views", "give one row of calibration a photo")
        index = whole_numbers(self.index) or list(range(len(self)))
        if len(index) != len(self) or len(set(index)) < len(index) or min(index) < 0:
            raise CaptureError(f"a number of its own for each of {len(self)} photos", str(index),
                               "omit the index")
        object.__setattr__(self, "index", tuple(index))
        shape, told = self.stored.shape[:3], self.measured
        if told is not None and (told.dtype != torch.bool or told.shape != shape):
            raise CaptureError(f"measured of {tuple(shape)}, bool", f"{tuple(told.shape)}, {told.dtype}",
                               "give True where a pixel is one of the photo")

    def __len__(self) -> int:
        return self.stored.shape[0]

    def __repr__(self) -> str:
        name = self.name or "without a folder"
        return f"Capture({name}, photos {', '.join(self.names)}, {self.resolution} px, {self.transfer})"

    @property
    def name(self) -> str:
        """Name of the source folder; empty without one."""
        return os.path.basename(os.path.abspath(self.source)) if self.source else ""

    @property
    def calibrated(self) -> bool:
        """Whether anything is known of the views."""
        return self.calibration != "none"

    @property
    def resolution(self) -> int:
        """Pixels along a side of the square photos."""
        return self.stored.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """Two-digit names of the photos: "00", "01", ..."""
        return tuple(f"{i:02d}" for i in self.index)

    @property
    def linear(self) -> Tensor:
        """The photos as linear radiance, N x R x R x 3 (clipped highlights stay at 1)."""
        return color.decode(self.photos, self.transfer)

    @property
    def stored(self) -> Tensor:
        """The photos as they are kept, N x R x R x 3: float32, or 8 or 16 bits (:func:`color.shown`)."""
        return cast(Tensor, vars(self)["photos"])

    def photo(self, row: int) -> Tensor:
        """One photo, R x R x 3 display values."""
        return color.shown(self.stored[row])

    def but(self, **changes: Any) -> Capture:
        """The same capture with other values of some fields; photos are kept as they are."""
        return replace(self, **{"photos": self.stored, **changes})

    def through(self, transfer: color.Transfer | None) -> Capture:
        """The capture with a fit's ``transfer`` (response and curve), if both have the same response."""
        if transfer in (None, self.transfer) or color.parts(transfer)[0] != color.parts(self.transfer)[0]:
            return self
        return self.but(transfer=transfer)

    @property
    def usable(self) -> Tensor:
        """Where the value of a photo is known, N x R x R x 3: measured and not clipped."""
        below = torch.stack([self.photo(row) < color.CLIPPED for row in range(len(self))])
        return below if self.measured is None else below & self.measured[..., None]

    def measured_at(self, resolution: int) -> Tensor | None:
        """:attr:`measured` at another size: True where all averaged pixels are measured."""
        hidden = None if self.measured is None else (~self.measured[..., None]).float()
        return None if hidden is None else area_averaged(hidden, resolution)[..., 0] == 0

    @kinds_checked
    def averaged(self, resolution: int) -> Capture:
        """The photos at another size, by area averages of display values."""
        if resolution < 1:
            raise ConfigError("a resolution of 1 or more", str(resolution), "choose a larger one")
        photos = [area_averaged(self.photo(row), resolution) for row in range(len(self))]
        return replace(self, photos=torch.stack(photos), measured=self.measured_at(resolution),
                       single=self.single_at(resolution))

    def single_at(self, resolution: int) -> Tensor | None:
        """The :attr:`single` pixels of the capture once it is shrunk to this size."""
        if self.single is not None or resolution == self.resolution:
            return self.single
        return torch.stack([single_pixels(photo, resolution) for photo in self.stored])

    def of_single(self) -> Capture | None:
        """The capture with :attr:`single` pixels as photos; None if photos were not shrunk, or are masked."""
        shrunk = self.single is not None and self.measured is None
        return self.but(photos=self.single, single=None, carries=None) if shrunk else None

    @kinds_checked
    def sampled(self, resolution: int) -> Capture:
        """Every k-th pixel of photos; k is the largest that leaves ``resolution`` pixels a side or more."""
        if resolution < 1:
            raise ConfigError("a resolution of 1 or more", str(resolution), "choose a larger one")
        photos = color.shown(sampled(self.stored.movedim(-1, 1), resolution))
        return replace(self, photos=photos.movedim(1, -1).contiguous(),
                       measured=None if self.measured is None else sampled(self.measured, resolution))

    def pick(self, index: Sequence[int]) -> Capture:
        """Photos with these numbers (:attr:`index`), in order. CaptureError: none, unknown or repeated."""
        index = whole_numbers(index)
        missing = [i for i in index if i not in self.index]
        if missing or not index:
            raise CaptureError(f"photos among {list(self.index)}", f"{missing or 'none'}", "check --views")
        if len(set(index)) < len(index):
            raise CaptureError("each photo once", f"photos {list(index)}", "take the repeated number out")
        rows = [self.index.index(i) for i in index]
        pixels = {"photos": self.stored, "measured": self.measured, "single": self.single}
        return self.but(views=self.views.pick(rows), index=tuple(index), **{
            name: None if kept is None else kept[rows] for name, kept in pixels.items()})


def check_held(photos: int, side: int, source: Path) -> None:
    """Raise ConfigError if ``photos`` photos, ``side`` pixels a side, have too many pixels together."""
    if (held := photos * side**2) > MOST_HELD:
        raise ConfigError(f"photos of at most {MOST_HELD / 1e6:.0f} megapixels together",
                           f"{held / 1e6:.0f} in {source}", "read them at a lower resolution")


def single_pixels(picture: Any, resolution: int) -> Any:
    """Pixels at the centres (to half a pixel) of P x P equal squares of a square picture: P x P x 3."""
    count = min(SINGLE, resolution)
    at = [(2 * k + 1) * len(picture) // (2 * count) for k in range(count)]
    return picture[at][:, at]


Capture.photos = _Photos()  # type: ignore[assignment,misc]


def _checked(photos: Tensor) -> Tensor:
    """Photos as float32, or as stored in 8 or 16 bits. CaptureError: a wrong type, shape or value."""
    if not isinstance(photos, Tensor) or not (photos.is_floating_point() or photos.dtype in KEPT):
        raise CaptureError("photos as a float tensor", repr(getattr(photos, "dtype", type(photos).__name__)),
                           "give display values in [0, 1]: 8 bits divided by 255")
    if photos.ndim != 4 or photos.shape[1] != photos.shape[2] or photos.shape[3] != 3 or not photos.numel():
        raise CaptureError("photos of N x R x R x 3", f"shape {tuple(photos.shape)}",
                           "rectify them to squares of one size")
    if not photos.is_floating_point():
        return photos
    least, most = photos.aminmax()
    if not (least >= 0 and most < float("inf")):  # NaN fails this test, too
        raise CaptureError("photos of display values >= 0, finite", f"values from {least:g} to {most:g}",
                           "check how they were read or developed")
    if most > 1 and (mean := float(photos.mean())) > 2:
        raise CaptureError("photos of display values, where white is 1", f"a mean of {mean:.3g}",
                           "divide values of 8 bits by 255")
    return photos.detach().float()
