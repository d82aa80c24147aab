"""A fitted material with the record of its fit: one value, in memory or in a folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from .. import color
from ..errors import MapsError, MitsvbrdfError
from ..io import images
from ..io.json import error_text
from ..material.map_files import DETAIL, FORMER_DETAIL, MAP_FOLDERS, load_maps
from ..material.maps import SVBRDF
from ..render import Renderer, RendererName, make_renderer
from ..render.needs import Omitted
from ..views import Falloff, Views
from .config import FitConfig
from .fixed_maps import described
from .options import config_of
from .record import FILE, SCHEMA_VERSION, Fact, checked, missing, record_in

# fields that :meth:`Fit.but` changes in the record, too
_FACTS = "rerender_rmse", "calibrated_rmse", "renderer", "variant", "warnings", "stopped", "trace"
ALIKE = "with-look-alikes"  # folder of deviations that use look-alikes


class Thumbnail(NamedTuple):
    """What tells a photo from others."""

    side: int  # its pixels a side
    pixels: np.ndarray  # every k-th of them, P x P x 3 display values, P < 128; NaN if not measured
    means: np.ndarray  # the photo averaged to 4 x 4 x 3

    @staticmethod
    def of(photo: Tensor, measured: Tensor | None = None) -> Thumbnail:
        """Of a photo as stored, R x R x 3, and its mask, R x R."""
        few = np.s_[::max(1, len(photo) // 64), ::max(1, len(photo) // 64)]
        told = True if measured is None else measured[few][..., None].numpy()
        return Thumbnail(len(photo), np.where(told, images.display(photo[few].numpy()).clip(0, 1), np.nan),
                      images.averaged(photo.numpy(), 4))


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A fit, in memory or from its folder: the content of ``fit.json``, and arrays, read on first use."""

    record: dict = field(default_factory=dict)  # of fit.json (docs/formats.md); empty for maps without a fit
    path: Path = Path()  # its folder; the working folder for a fit in memory
    known: Mapping[str, Any] = field(default_factory=dict)  # name to value of attributes in memory

    def __post_init__(self) -> None:
        vars(self).update(self.known)  # cached properties look here first

    method = Fact[str | None](None)
    """Name of the method; None when unknown."""
    renderer = Fact[str]()
    """Name of the renderer."""
    variant = Fact[str | None](None)
    """Its Mitsuba variant, or None."""
    trace = Fact[list[dict]]()
    """One dict for each measurement: seconds, iteration, each loss, rerender_rmse."""
    stopped = Fact[str]()
    """Why it ended: settled, budget, iterations, interrupted or unstable (too many steps undone)."""
    rerender_rmse = Fact[float]()
    """Error of the re-rendered photos, in display values clipped to [0, 1]."""
    calibrated_rmse = Fact[float | None](None)
    """The same error in stated views plus flash offset; None if ``views`` are these or none is stated."""
    calibration = Fact[dict]({})
    """Origin and standard deviations of the views; see :func:`mitsvbrdf.fit.diagnose.views_record`."""
    detail_record = Fact[dict | None](None, "detail")
    """Settings, seconds and errors of the plausible detail, or None."""
    capture = Fact[str | None](None, "capture", "name")
    """Name of the folder of its photos; None when unknown."""
    transfer = Fact[color.Transfer | None](None, "capture", "transfer")
    """How its photos encode light; None when unknown."""
    falloff = Fact[Falloff]("inverse-square", "views", "falloff")
    """Falloff of its light; inverse-square when unknown."""

    def __repr__(self) -> str:
        return (f"Fit({self.method}, {self.svbrdf!r}, re-rendering RMSE {self.rerender_rmse:.4f}, "
                f"{self.stopped})" if self.record else "Fit()")

    @staticmethod
    def load(folder: str | Path) -> Fit:
        """A complete fit from its folder, the OUT of a fit. MapsError: the folder has no complete fit."""
        folder = Path(folder)
        if not (folder / FILE).is_file():
            raise MapsError("the OUT of `mitsvbrdf fit`", f"{folder}, which has no {FILE}", "check the path")
        fit = _read(folder)
        if wrong := missing(fit.record):
            raise MapsError(f"a {FILE} of schema version {SCHEMA_VERSION}", f"{folder / FILE}: {wrong}",
                            "fit again with this version")
        _ = fit.svbrdf  # maps that cannot be read are an error here
        return fit

    @staticmethod
    def of_maps(maps: str | Path) -> Fit:
        """The fit that maps come from; one with an empty record if there is no ``fit.json``.

        Args:
            maps: the folder of a fit, or the ``maps`` or ``detail`` folder inside it.

        Raises:
            MapsError: the ``fit.json`` cannot be understood.
        """
        folder = Path(os.path.abspath(maps))
        folder = folder.parent if folder.name in MAP_FOLDERS else folder
        return _read(folder) if (folder / FILE).is_file() else Fit(path=folder)

    def but(self, **changes: Any) -> Fit:
        """The same fit with other values of some attributes."""
        facts = {name: list(value) if isinstance(value, tuple) else value for name, value in changes.items()
                 if name in _FACTS}
        if "detail_record" in changes:
            facts["detail"] = changes["detail_record"]
        return Fit(self.record | facts, self.path, {**self.known, **changes})

    @cached_property
    def svbrdf(self) -> SVBRDF:
        """The material: the last (``hierarchical``, ``gan`` from solved maps), else that of lowest error."""
        return load_maps(self.path / "maps", self.record["bsdf"])

    @cached_property
    def detail(self) -> SVBRDF | None:
        """One plausible draw of what no photo shows, for pictures; None if it was not asked for."""
        folder = self.path / (DETAIL if (self.path / DETAIL).is_dir() else FORMER_DETAIL)
        return load_maps(folder, self.record["bsdf"]) if "detail" in self.record else None

    @cached_property
    def guess(self) -> Tensor:
        """The guessed diffuse map, R x R x 3 linear."""
        return self._image("guess/diffuse.exr")

    @cached_property
    def photos(self) -> Tensor:
        """The photos used, N x R x R x 3 in display values; of 8 bits if read from a folder."""
        return (self.known["shots"].photos if "shots" in self.known
                else torch.stack([*map(self.photo, self.seen)]))

    @cached_property
    def rerendered(self) -> Tensor:
        """Renderings of the photos used, linear radiance N x R x R x 3."""
        return torch.stack([*map(self.rerendering, range(len(self.names)))])

    def rerendering(self, row: int) -> Tensor:
        """One of :attr:`rerendered`, R x R x 3; a large one of a fit in memory is rendered at each call."""
        if "rerendered" in self.known:
            return self.rerendered[row]
        if "seen_by" in self.known:
            return self.known["seen_by"].render(self.svbrdf, self.views.pick([row]))[0]
        return self._image(f"rerendered/{self.names[row]}.exr")

    @cached_property
    def deviations(self) -> Mapping[str, Tensor]:
        """Deviations by own photos: map name to r x r x C, r <= 1024; from a folder R x R x 1 (RMS)."""
        return self._deviations("uncertainty")

    @cached_property
    def deviations_with_look_alikes(self) -> Mapping[str, Tensor]:
        """The same by own photos and look-alikes: the errors to expect; empty if texels share nothing."""
        return self._deviations(f"uncertainty/{ALIKE}")

    def _deviations(self, of: str) -> Mapping[str, Tensor]:
        return {name: self._image(f"{of}/{name}.exr")[..., :1] for name in self.record["confidence"]
                if (self.path / f"{of}/{name}.exr").is_file()}

    def _image(self, name: str) -> Tensor:
        return images.read_image(self.path / name, MapsError)

    @cached_property
    def config(self) -> FitConfig:
        """The method and its settings."""
        return config_of({"method": self.method, **self.record["config"]})

    def engine(self) -> Renderer | None:
        """The renderer of the fit; None for one that is not ours."""
        name: Any = self.renderer
        return make_renderer(name, self.variant or "llvm_ad_rgb") if name in get_args(RendererName) else None

    @property
    def fixed(self) -> list[str]:
        """Names of the maps that were not fitted."""
        return list(described(self.record["config"]["fix"]))

    @cached_property
    def omitted(self) -> tuple[Omitted, ...]:
        """What the scene or the method did not need."""
        return tuple(Omitted(each["what"], each["why"]) for each in self.record.get("omitted", ()))

    @property
    def used(self) -> tuple[tuple[str, str], ...]:
        """(what, how) of each network that was trained."""
        return tuple((each["what"], each["how"]) for each in self.record.get("used", ()))

    @cached_property
    def undone(self) -> tuple[dict, ...]:
        """``iteration`` and ``reason`` of each step that made something non-finite and was taken back."""
        return tuple(self.record["undone"])

    @cached_property
    def per_photo(self) -> list[float]:
        """The error of each photo."""
        return list(self.record["per_photo"].values())

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings, in sentences; see :mod:`mitsvbrdf.fit.warnings`."""
        return tuple(self.record["warnings"])

    @property
    def names(self) -> list[str]:
        """Names of the photos that it used."""
        return list(self.record["per_photo"])

    @cached_property
    def seen(self) -> tuple[int, ...]:
        """Numbers of the photos that it used."""
        return tuple(self.record["capture"]["photos"]) if self.record else ()

    @cached_property
    def views(self) -> Views:
        """The views as fitted; their lights contain the flash offset; see :attr:`known_views`."""
        return Views.of(*(self.record["views"][name] for name in ("camera", "light", "intensity", "size",
                                                                  "falloff")))

    @property
    def known_views(self) -> Views | None:
        """The views as fitted; None for maps that came without a fit."""
        return self.views if "views" in self.known or "views" in self.record else None

    @cached_property
    def flash_offset(self) -> tuple[float, float] | None:
        """How far (x, y), in patch sides, the fit moved the flash relative to the lens; None: not fitted."""
        found = self.record.get("flash_offset")
        return found and (float(found["x"]), float(found["y"]))

    @cached_property
    def estimated(self) -> bool:
        """Whether the views were estimated from the photos."""
        return self.calibration.get("estimated", False) is True

    @property
    def light_power_factor(self) -> float:
        """Factor on the light power, found from the maps; 1 if it was not changed."""
        return float(self.calibration.get("power_told") or 1.0)

    @property
    def side_metres(self) -> float | None:
        """Side of the patch in metres; None if no sheet of tags in the photos gave the unit of the views."""
        return self.views.size / 100 if self.calibration.get("from") == "sheet" else None

    @cached_property
    def small_photos(self) -> dict[int, Thumbnail]:
        """A dict: number to what tells a photo. Photos used; from a folder also predicted ones."""
        stems = [path.stem for path in (self.path / "photos").glob("*.png")] if self.record else ()
        numbers = self.seen if "shots" in self.known else [int(stem) for stem in stems if stem.isdecimal()
                                                           and stem == f"{int(stem):02d}"]
        return {number: Thumbnail.of(self.photo(number)) for number in numbers}

    def photo(self, number: int) -> Tensor:
        """The photo with this number, R x R x 3, as it is stored."""
        if "shots" in self.known:
            return self.known["shots"].stored[self.seen.index(number)]
        return self._image(f"photos/{number:02d}.png")

    def unchanged(self) -> bool:
        """Whether ``fit.json`` in its folder still equals the record."""
        return record_in(self.path) == self.record


def _read(folder: Path) -> Fit:
    try:
        fit = Fit(checked(record_in(folder)), folder)
        _ = fit.flash_offset, fit.views, fit.light_power_factor  # making them checks them
    except (OSError, ValueError, KeyError, TypeError, MitsvbrdfError) as reason:
        raise MapsError(f"a {FILE} of this package", f"{folder / FILE}: {error_text(reason)}",
                        "move it away to read the maps alone") from None
    return fit
