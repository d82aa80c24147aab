"""From a phone to maps: captures that were made without calibration, against the truth and against calibrated
ones.

Known materials are photographed by the simulated phone, with and without a sheet of tags; the capture made of
the photos is held against the truth, and so are the maps of its fit, beside those of a fit of the same photos
with the true views. Real captures lose their views; those found again are held against the ones given.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from .. import color
from ..calibrate.estimate import self_calibrated
from ..capture import Capture, read_capture, write_capture
from ..errors import MitsvbrdfError
from ..evaluate import evaluate_fit
from ..fit import HierarchicalConfig, fit_svbrdf
from ..fit.result import FitResult
from ..io.timing import timed
from ..material.made import make_material
from ..material.map_files import load_maps
from ..material.maps import SVBRDF
from ..measure.metrics import map_rmse
from ..render import Renderer
from ..synth.against_truth import compare_with_truth
from ..synth.phone import HandheldPhone
from ..synth.photos import write_handheld
from ..synth.truth import Truth, rig_of, true_capture, truth_maps
from ..views import Views, default_views
from .methods import settings_of
from .schema import USUAL_LEFT_OUT

SHEET_CM = 18.0
SAMPLE_SIDE = 1024  # texels of made materials over the whole sample
TAKING_SECONDS, MAKING_SECONDS = 60.0, 60.0  # seconds, before there is anything to go by


@dataclass(frozen=True)
class CaptureJob:
    """One known material with or without a sheet, or one real capture without its views.

    Args:
        kind: ``material`` or ``capture``.
        source: ``builtin:NAME``, or a folder of maps or of rectified photos.
        sheet: whether a sheet of tags lies around the material.
        phone: the phone of known materials; its sheet is set here.
        config: of the fits.
        resolution: side of photos and maps in the fits.
        renderer: of the fits.
        variant: of Mitsuba, which takes the photos.
    """

    kind: str
    source: str
    sheet: bool
    phone: HandheldPhone
    config: HierarchicalConfig
    resolution: int
    renderer: Renderer
    variant: str = "llvm_ad_rgb"

    @property
    def name(self) -> str:
        """Of the material or the capture."""
        return (self.source.removeprefix("builtin:") if self.source.startswith("builtin:")
                else Path(self.source).name)

    @property
    def key(self) -> dict:
        """What identifies the record."""
        return {"suite": "capture", "kind": self.kind, "name": self.name, "sheet": self.sheet}

    @property
    def settings(self) -> dict:
        """What else shapes the record."""
        return settings_of(self.config, __name__) | {"budget": self.config.budget, "seed": self.config.seed,
                                           "megapixels": self.phone.megapixels, "photos": self.phone.photos}

    @property
    def title(self) -> str:
        """For the progress line."""
        how = ("without views" if self.kind == "capture" else "with a sheet" if self.sheet
               else "without a sheet")
        return f"capture, {self.name}, {how}"

    @property
    def group(self) -> str:
        """Jobs whose guesses of run time are off by the same factor."""
        return f"capture {self.kind}"

    @property
    def cost(self) -> float:
        """A guess of its seconds."""
        fits = (2 if self.kind == "material" else 4) * (self.config.budget or 120.0)
        return fits + (TAKING_SECONDS + MAKING_SECONDS if self.kind == "material" else 0.0)

    def run(self, report: Callable[[float], object] = lambda share: None) -> dict:
        """The figures. What cannot be done is a result too: it has no errors, and says why."""
        try:
            if self.kind == "material":
                with tempfile.TemporaryDirectory() as folder:
                    seconds, errors = self._material(Path(folder), report)
            else:
                seconds, errors = self._capture(report)
        except MitsvbrdfError as reason:
            return {"seconds": {}, "errors": {}, "stopped": "failed", "why": str(reason)}
        return {"seconds": seconds, "errors": errors, "stopped": "done", "why": None}

    def _material(self, folder: Path, report: Callable[[float], object]) -> tuple[dict[str, float],
                                                                                  dict[str, float]]:
        from ..capture.photo import Photo, photos_in
        from ..capture.stages import capture_keys, make_capture
        from ..synth.traced import HandheldRenderer

        made = self.source.startswith("builtin:")
        maps = make_material(self.name, SAMPLE_SIDE) if made else load_maps(self.source)
        phone = replace(self.phone, sheet=SHEET_CM if self.sheet else None)
        _, taking = timed(write_handheld, maps, phone, partial(HandheldRenderer, variant=self.variant),
                          folder / "raw")
        report(0.2)
        photographed = make_capture([Photo.open(path) for path in photos_in(folder / "raw")], phone.sheet,
                                    phone.depth if self.sheet else 0.0, resolution=max(512, self.resolution))
        write_capture(photographed.capture, folder / "capture", capture_keys(photographed))
        seconds = {"taking": taking} | photographed.seconds
        report(0.3)
        truth = Truth.read(folder / "raw")
        errors = _flat(compare_with_truth(folder / "capture", truth))
        known = truth_maps(truth, rig_of(folder / "capture"), self.resolution)
        for number, (whose, shots) in enumerate((
                ("found", read_capture(folder / "capture", self.resolution)),
                ("true", true_capture(folder / "capture", truth, resolution=self.resolution)))):
            fit, seconds[f"fit, {whose} views"] = timed(self._fit, shots, self.config)
            fitted = fit.svbrdf.detach()
            errors |= {f"{whose} {name}": value for name, value in map_rmse(fitted, known).items()}
            errors[f"{whose} scaled diffuse"] = scaled_diffuse_rmse(fitted, known)
            report(0.65 + 0.35 * number)
        return seconds, errors | {"ratio": errors["found mean"] / errors["true mean"]}

    def _capture(self, report: Callable[[float], object]) -> tuple[dict[str, float], dict[str, float]]:
        given = read_capture(self.source, self.resolution)
        unknown = replace(default_views(len(given)), falloff=given.views.falloff)
        without = replace(given, views=unknown, calibration="none")
        (estimated, *_), taken = timed(self_calibrated, without)
        seconds = {"views estimated": taken}
        errors = {f"estimated {name}": value for name, value in recovered(estimated.views,
                                                                          given.views).items()}

        def fitted(shots: Capture, name: str, config: HierarchicalConfig) -> FitResult:
            result, seconds[f"fit, {name}"] = timed(self._fit, shots, config)
            report(len(seconds) / 5)
            return result

        with_views, alone = fitted(given, "views given", self.config), fitted(without, "without views",
                                                                              self.config)
        errors |= {f"fitted {name}": value for name, value in recovered(alone.views, given.views).items()}
        errors |= {"given photos": with_views.rerender_rmse, "found photos": alone.rerender_rmse,
                   "ratio": alone.rerender_rmse / with_views.rerender_rmse}
        seen, held = ([i for i in given.index if (i in USUAL_LEFT_OUT) == out] for out in (False, True))
        for name, calibrate in (("refined", True), ("held", False)) if seen and held else ():
            result = fitted(given.pick(seen), f"views {name}", replace(self.config, calibrate=calibrate))
            errors[f"{name} left out"] = evaluate_fit(result, given.pick(held))["rerender_rmse"]
        return seconds, errors

    def _fit(self, shots: Capture, config: HierarchicalConfig) -> FitResult:
        result = fit_svbrdf(shots, self.renderer, config)
        if result.stopped == "interrupted":
            raise KeyboardInterrupt
        return result


def recovered(found: Views, given: Views) -> dict[str, float]:
    """Cameras against those given, in patch sides, after the scale and the sideways shift of least squares.

    Returns:
        ``lateral``: median distance seen from above; ``depth``: median ratio of heights, less 1; ``scale``:
        given over found.
    """
    one, other = (views.in_patch_sides().camera.double().numpy().copy() for views in (found, given))
    for camera in (one, other):
        camera[:, :2] -= camera[:, :2].mean(axis=0)
    scale = float((one * other).sum() / (one**2).sum())
    lateral = np.linalg.norm(scale * one[:, :2] - other[:, :2], axis=1)
    return {"lateral": float(np.median(lateral)),
            "depth": float(np.median(np.abs(scale * one[:, 2] / other[:, 2] - 1))),
            "scale": scale}


def scaled_diffuse_rmse(svbrdf: SVBRDF, truth: SVBRDF) -> float:
    """RMSE of the diffuse map (:func:`mitsvbrdf.measure.metrics.map_rmse`) after the one factor that makes it
    least.
    """
    size = min(svbrdf.resolution, truth.resolution)
    found, known = (color.encode(m.as_roughconductor().resized(size)["diffuse"].double()) for m in (svbrdf,
                                                                                                    truth))
    factor = (found * known).sum() / found.square().sum().clamp_min(torch.finfo(torch.float64).tiny)
    return float((factor * found - known).square().mean().sqrt())


def _flat(compared: dict) -> dict[str, float]:
    """The numbers of :func:`compare_with_truth` that tables show."""
    cameras, rectification, lens, power = (compared[k] for k in ("cameras", "rectification", "lens", "power"))
    return {"cameras": cameras["rms"], "worst camera": cameras["worst"], "lights": compared["lights"]["rms"],
            "rectification": rectification["rms"], "mutual": rectification["mutual"], "focal": lens["focal"],
            "flash": float(np.linalg.norm(lens["flash"][:2])), "vignetting": lens["vignetting"],
            "power": power["ratio"],
            "photos": float(len(compared["photos"]["used"]))}


def capture_jobs(materials: list[str], captures: list[str], phone: HandheldPhone, config: HierarchicalConfig,
                 resolution: int, renderer: Renderer, variant: str) -> list[CaptureJob]:
    """Each material with and without a sheet, and each real capture."""
    rest = phone, config, resolution, renderer, variant
    return [CaptureJob("material", name, sheet, *rest) for name in materials for sheet in (True, False)] + [
        CaptureJob("capture", name, False, *rest) for name in captures]
