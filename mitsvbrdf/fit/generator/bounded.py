"""Solved maps that a generator may change: the less certain a texel's value, the further."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ...material.maps import SVBRDF, map_of, numbers_of
from ...material.resample import resized
from ...views import Views
from ..parameters import ROUGHNESS_RANGE

STEEPEST = 0.95  # largest length of (x, y) of a changed normal, unless that of the solved one is larger


@dataclass(frozen=True, eq=False)
class Bounded:
    """The solved maps, and the largest change of each value."""

    svbrdf: SVBRDF  # the solved maps, R x R
    views: Views  # as solved
    bounds: Mapping[str, Tensor]  # map name to the largest change of its numbers_of, R x R x C

    @staticmethod
    def of(svbrdf: SVBRDF, views: Views, deviations: Mapping[str, Tensor], reach: float,
           certain: float = 0.0) -> Bounded:
        """A bound is ``reach`` times the part of the standard deviation (r x r x C) above ``certain``."""
        return Bounded(svbrdf, views, {
            name: reach * (resized(spread, svbrdf.resolution) - certain).clamp_min(0)
            for name, spread in deviations.items()})

    def moved(self, change: Mapping[str, Tensor], share: float = 1.0) -> SVBRDF:
        """The solved maps plus a share of their change. Values with bound 0 stay exactly as solved.

        ``change``: map name to C x R x R; its Tanh times the bound is the change.
        """
        maps = dict(self.svbrdf.maps)
        for name, value in change.items():
            bound, numbers = share * self.bounds[name], numbers_of(name, maps[name])
            moved, free = numbers + bound * torch.tanh(value.permute(1, 2, 0)), bound > 0
            if name == "normal":
                solved, flat = (2 * x - 1 for x in (numbers, moved))
                longest = solved.norm(dim=-1, keepdim=True).clamp_min(STEEPEST)
                moved = (flat * (longest / flat.norm(dim=-1, keepdim=True).clamp_min(1e-6)).clamp_max(1)
                         + 1) / 2
                free = free.any(dim=-1, keepdim=True)
            elif name == "roughness":
                moved = torch.maximum(moved, numbers.clamp_max(ROUGHNESS_RANGE[0])).clamp_max(1)
            else:
                moved = moved.clamp(0, 1)
            maps[name] = torch.where(free, map_of(name, moved), maps[name])
        return SVBRDF(self.svbrdf.bsdf, maps)
