"""What is photographed, what of it a fit is told, and how much the photos say."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import color
from ...capture import Capture, guess_diffuse
from ...fit import DirectConfig, FitTask
from ...fit.confidence import deviations
from ...fit.start import robust_start
from ...material.made import GOLD, make_material
from ...material.maps import SVBRDF
from ...measure.metrics import map_rmse, photo_rmse
from ...render import make_renderer
from ...synth import photograph
from ...verify.stability.conditioning import condition, jacobian
from ...views import Views, nine_view_grid


@dataclass(frozen=True)
class Scene:
    """A made material, nine photos of it, and what is wrong with either; the defaults are harmless.

    Args:
        material: its name.
        roughness: of all texels; None leaves the material's own.
        metal: whether it is gold without diffuse reflection.
        black: whether its diffuse map is 0.
        relief: by this factor its slopes are steeper.
        photos: how many of the nine there are, the first ones.
        spread: by this factor cameras stand further apart.
        clipped: share of the pixels that are burnt out.
        noise: standard deviation of the sensor's noise, linear.
        light: the power stated over the true one.
        off: how far the stated cameras are from the true ones, over their distance.
        same: whether all nine photos are the first one.
        grey: whether the photos are of one grey instead, which no material explains.
    """

    material: str
    roughness: float | None = None
    metal: bool = False
    black: bool = False
    relief: float = 1.0
    photos: int = 9
    spread: float = 1.0
    clipped: float = 0.0
    noise: float = 0.003
    light: float = 1.0
    off: float = 0.0
    same: bool = False
    grey: bool = False

    def truth(self, resolution: int) -> SVBRDF:
        """Its maps, R x R x C."""
        made = make_material(self.material, resolution)
        slopes = torch.tensor([self.relief, self.relief, 1.0])
        values: dict[str, Any] = {"diffuse": 0.0} if self.metal or self.black else {}
        values |= {"specular": torch.tensor(GOLD)} if self.metal else {}
        values |= {"roughness": self.roughness} if self.roughness is not None else {}
        maps = {name: torch.as_tensor(values[name]).expand_as(value).contiguous() if name in values else value
                for name, value in made.maps.items()}
        return SVBRDF(made.bsdf, {**maps, "normal": F.normalize(made["normal"] * slopes, dim=-1)})

    def views(self, truth: SVBRDF) -> Views:
        """Where cameras and lights were, and how bright the lights: so bright that the photos are clipped as
        much as stated.
        """
        grid = nine_view_grid()
        aside = torch.tensor([self.spread, self.spread, 1.0], dtype=torch.float64)
        views = Views.of(grid.camera * aside, intensity=grid.intensity).pick(range(self.photos))
        if not self.clipped:
            return views
        radiance = make_renderer("analytic").render(truth, views).amax(dim=-1)
        return replace(views, intensity=views.intensity / float(radiance.quantile(1 - self.clipped)))

    def told(self, views: Views) -> Views:
        """The views as a fit is told them."""
        rng = torch.Generator().manual_seed(0)
        away = F.normalize(torch.randn(views.camera.shape, generator=rng, dtype=torch.float64), dim=1)
        camera = views.camera + self.off * views.camera.norm(dim=1, keepdim=True) * away
        return replace(views, camera=camera, light=camera.clone(), intensity=views.intensity * self.light)


CONTROL = "nothing wrong"
CASES: dict[str, Scene] = {
    CONTROL: Scene("tiles"),
    "metal of roughness 0.05": Scene("tiles", metal=True, roughness=0.05),
    "black albedo": Scene("leather", black=True),
    "relief 3 times as deep": Scene("leather", relief=3.0),
    "30 % of the pixels clipped": Scene("inlay", clipped=0.3),
    "light stated 4x too weak": Scene("tiles", light=1 / 4),
    "light stated 4x too strong": Scene("tiles", light=4.0),
    "camera positions 5 % off": Scene("plates", off=0.05),
    "a single photo": Scene("inlay", photos=1),
    "nine identical photos": Scene("inlay", same=True),
    "constant grey photos": Scene("inlay", grey=True),
    "metal of roughness 0.05, deep relief, 30 % clipped": Scene("tiles", metal=True, roughness=0.05,
                                                                relief=3.0, clipped=0.3),
    "black albedo, light 4x too strong, cameras 5 % off": Scene("leather", black=True, light=4.0, off=0.05),
    "deep relief, light 4x too weak, cameras 5 % off": Scene("leather", relief=3.0, light=1 / 4, off=0.05),
    "a single photo, 30 % clipped, noise 0.03": Scene("inlay", photos=1, clipped=0.3, noise=0.03),
}

# One thing at a time from harmless to extreme: what changes -> its value in words -> the scene.
SERIES: dict[str, dict[str, Scene]] = {
    "number of photos": {str(n): Scene("inlay", photos=n) for n in (9, 5, 4, 3, 2, 1)},
    "spread of the cameras": {f"{s:g}": Scene("inlay", spread=s) for s in (1.5, 0.5, 0.2, 0.1, 0.03)},
    "roughness": {f"{r:g}": Scene("inlay", roughness=r) for r in (0.4, 0.3, 0.2, 0.1, 0.05)},
}


def digest() -> str:
    """Twelve digits that change with the scenes."""
    return hashlib.sha256(repr((CASES, SERIES)).encode()).hexdigest()[:12]


@dataclass(frozen=True, eq=False)
class StiffTask:
    """A scene as a fit is given it.

    Args:
        kind: ``case``, or ``series`` for a member of one.
        name: of the case; of the series and its member, with a colon between.
        scene: what is photographed.
        resolution: of maps and photos.
    """

    kind: str
    name: str
    scene: Scene
    resolution: int

    @property
    def key(self) -> dict:
        """What identifies it in a record."""
        return {"kind": self.kind, "name": self.name}

    @cached_property
    def truth(self) -> SVBRDF:
        """The material photographed."""
        return self.scene.truth(self.resolution)

    @cached_property
    def seen(self) -> Capture:
        """The photos that differ, with the views that they were taken from."""
        found = photograph(self.truth, self.scene.views(self.truth), make_renderer("analytic"),
                           self.scene.noise)
        return found.pick([0]) if self.scene.same else found

    @cached_property
    def photos(self) -> Capture:
        """What the fit is given."""
        told = self.scene.told(self.scene.views(self.truth))
        photos = self.seen.photos.repeat(len(told) // len(self.seen), 1, 1, 1)
        return Capture(torch.full_like(photos, 0.5) if self.scene.grey else photos, told)

    @cached_property
    def known(self) -> dict[str, Any]:
        """How stiff it is: figures for JSON, the same for every method.

        Returns:
            ``condition`` of the texels' Jacobians in what the photos show
            (:func:`mitsvbrdf.verify.stability.conditioning.condition`); ``attainable``: standard deviation of
            each map at the truth with the right views, of an estimate of each texel by itself
            (:mod:`mitsvbrdf.fit.confidence`), and ``photos``, what the truth misses the photos by; ``start``:
            the error of the maps that fits begin with. All three are empty where the photos are of no
            material.
        """
        if self.scene.grey:
            return {"condition": {}, "attainable": {}, "start": {}}
        views, truth = self.seen.views, self.truth
        slopes = jacobian(make_renderer("analytic64"), truth, views, color.to_display)
        with torch.no_grad():
            images = make_renderer("analytic").render(truth, views)
        spreads = deviations(truth, views, images, FitTask(self.seen, make_renderer("analytic"),
                                                           DirectConfig()))
        begun = robust_start(self.photos, guess_diffuse(self.photos), truth.bsdf)
        return {"condition": condition(slopes.detach()),
                "attainable": stated(spreads) | {"photos": photo_rmse(images, self.seen.photos)[0]},
                "start": map_rmse(begun, truth)}


def stated(spreads: Mapping[str, Tensor]) -> dict[str, float]:
    """Root mean square of the standard deviations of each map, as :func:`~mitsvbrdf.measure.metrics.map_rmse`
    would count such errors, and their ``mean``.

    Args:
        spreads: of :func:`mitsvbrdf.fit.confidence.deviations`.
    """
    squares = {name: float(value.double().square().mean()) for name, value in spreads.items()}
    if "normal" in squares:
        # of x and y alone; z has an error of second order, and counts as a third channel
        squares["normal"] *= 2 / 3
    found = {name: math.sqrt(value) for name, value in squares.items()}
    return found | {"mean": sum(found.values()) / len(found)}


def stiff_tasks(resolution: int) -> tuple[list[StiffTask], list[StiffTask]]:
    """All cases, and the members of all series."""
    return ([StiffTask("case", name, scene, resolution) for name, scene in CASES.items()],
            [StiffTask("series", f"{series}: {member}", scene, resolution)
             for series, members in SERIES.items() for member, scene in members.items()])
