"""The sizes of the stages: the photos, the solver and the look-alikes at each size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial

import torch
from torch import Tensor

from ...capture import Capture
from ...color import Transfer
from ...material.resample import area_averaged, sampled
from ...views import STRIP
from ..config import HierarchicalConfig
from .sharing import appearance_of, basis_materials, membership
from .solver import TexelSolver
from .stages import Stage

COARSE = 64  # texels a side of the first stages; up to 127 if every k-th pixel is taken


@dataclass(frozen=True, eq=False)
class Scale:
    """The photos and the solver that a stage works with.

    Args:
        capture: the photos, N x R x R.
        guess: guessed diffuse map, R x R x 3.
        basis: appearance of the basis materials (clusters of similar texels), K x 5.
        width: standard deviation of appearance within which texels share.
        free: whether texels may leave the values of their look-alikes.
    """

    capture: Capture
    guess: Tensor
    solver: TexelSolver
    basis: Tensor
    width: float
    free: bool = False

    @property
    def texels(self) -> int:
        """The number of texels."""
        return self.capture.resolution**2

    @cached_property
    def look(self) -> Tensor:
        """Appearance of the texels (:func:`.appearance_of`), M x 5."""
        return appearance_of(self.capture, self.guess)

    @cached_property
    def member(self) -> Tensor:
        """Shares of the basis materials in each texel, M x K."""
        return torch.cat(list(self.members()()))

    def members(self, kept: bool = False) -> Callable[[], Iterable[Tensor]]:
        """A function that gives :attr:`member` in parts, computed at each call unless ``kept`` in memory."""
        if kept:
            return partial(self.member.split, STRIP)
        look = appearance_of(self.capture, self.guess)
        return lambda: (membership(part, self.basis, self.width) for part in look.split(STRIP))

    def add_basis(self, planes: Tensor, values: Tensor) -> None:
        """Add to ``planes`` of the texels, S x M, the ``values`` of their basis materials, S x K."""
        for here, part in zip(planes.split(STRIP, dim=1), self.members()()):
            here += values @ part.T


class Scales:
    """Photos at full size, and two kinds of coarse ones: every k-th pixel, and area averages.

    Photos, guessed diffuse map and maps held fixed come at full size.
    """

    def __init__(self, capture: Capture, guess: Tensor, fixed: Mapping[str, Tensor],
                 config: HierarchicalConfig, variant: str) -> None:
        self.guess, self.fixed, self.config, self.variant = guess, fixed, config, variant
        sampled, averaged = (make(min(COARSE, capture.resolution))
                             for make in (capture.sampled, capture.averaged))
        # Photos no larger than COARSE have one memory layout in every stage: rounding of sums depends on it.
        full = averaged if averaged.resolution == capture.resolution else capture
        self.captures = {Stage.ALONE: sampled, Stage.MULTI_START: sampled, Stage.TOGETHER: averaged,
                         Stage.FINE: full}
        self.solvers: dict[int, TexelSolver] = {}
        guess = area_averaged(guess, averaged.resolution)
        self.basis = basis_materials(appearance_of(averaged, guess), config.materials, config.seed)

    def of(self, stage: Stage, free: bool = False) -> Scale:
        """The scale of this stage, with texels that are free or not."""
        capture = self.captures[stage]
        guess = area_averaged(self.guess, capture.resolution)
        return Scale(capture, guess, self.solver(capture.resolution), self.basis, self.config.similarity,
                     free)

    def see_through(self, transfer: Transfer) -> None:
        """Give the photos another transfer function."""
        self.captures = {stage: capture.but(transfer=transfer) for stage, capture in self.captures.items()}

    def holding(self, **maps: Tensor) -> Scales:
        """The same photos with further maps held fixed, at full size."""
        other = copy(self)
        other.fixed, other.solvers = {**self.fixed, **maps}, {}
        return other

    @staticmethod
    def sampled(planes: Tensor) -> Tensor:
        """Planes of full size, ... x R x R, at the texels of the first stages' sampled photos."""
        return sampled(planes, min(COARSE, planes.shape[-1]))

    def solver(self, side: int) -> TexelSolver:
        """The solver of ``side`` x ``side`` texels, made once."""
        if side not in self.solvers:
            fixed = {name: area_averaged(value, side) for name, value in self.fixed.items()}
            grey = self.config.grey_specular and "specular" not in fixed
            self.solvers[side] = TexelSolver(self.config.bsdf, fixed, grey, self.variant)
        return self.solvers[side]
