"""Pairs of photos: matched features, their homographies, and the chain that leads to a common frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lens import Array
from .features import FEW_FEATURES, LEAST_INLIERS, MOST_FEATURES, Features, homography, match, wild
from .planar import Match

MOST_AGAIN = 8  # others that a photo left alone is compared with by all features
SIGMA = 0.5  # of a match, in pixels at which features were searched


@dataclass(frozen=True)
class Pair:
    """What two photos have in common.

    Args:
        matches: features that are alike, right or wrong.
        agree: which of them agree with ``warp``, K.
        warp: homography from pixels of ``a`` to pixels of ``b``; None where there is none to be trusted.
        wild: whether there is one that no camera could have made.
    """

    matches: Match
    agree: NDArray[np.bool_]
    warp: Array | None
    wild: bool = False

    @property
    def a(self) -> str:
        """Name of the first photo."""
        return self.matches.a

    @property
    def b(self) -> str:
        """Name of the second photo."""
        return self.matches.b

    @property
    def count(self) -> int:
        """How many matches agree; 0 without a homography."""
        return int(self.agree.sum()) if self.warp is not None else 0


def find_pairs(features: dict[str, Features], size: tuple[int, int],
               report: Callable[[float], object]) -> list[Pair]:
    """Each pair of photos by their strongest features; by all of them where photos are left alone so."""
    both = list(combinations(features, 2))
    # the time of 100 pairs is the limit
    few = int(np.clip(FEW_FEATURES * math.sqrt(100 / len(both)), 500, FEW_FEATURES))
    found = {}
    for n, (a, b) in enumerate(both):
        report(n / len(both))
        found[a, b] = _pair(features, a, b, size, few)
    linked = chained_pairs(features, list(found.values()))[1]
    again: dict[tuple[str, str], None] = {}
    for name in features:
        if name not in linked:
            own = sorted((p for p in found.values() if name in (p.a, p.b)), key=lambda p: -p.agree.sum())
            again |= {(p.a, p.b): None for p in own[:MOST_AGAIN] if p.warp is None}
    return list((found | {(a, b): _pair(features, a, b, size, MOST_FEATURES) for a, b in again}).values())


def _pair(features: dict[str, Features], a: str, b: str, size: tuple[int, int], most: int) -> Pair:
    index = match(features[a], features[b], most)
    pixel = features[a].pixel
    alike = Match(a, b, features[a].points[index[:, 0]], features[b].points[index[:, 1]], SIGMA * pixel)
    warp, agree = homography(alike.at_a, alike.at_b, pixel)
    if warp is not None and (wild(warp, size) or wild(np.asarray(np.linalg.inv(warp), np.float64), size)):
        return Pair(alike, agree, None, wild=True)
    return Pair(alike, agree, warp)


def chained_pairs(names: Collection[str], pairs: list[Pair]) -> tuple[str, dict[str, Array]]:
    """Homographies from the photo that has most in common with others, the hub, to each within reach.

    The maximum spanning tree over the number of agreeing matches (Prim 1957), in the largest group of
    connected photos.
    """
    links: dict[str, dict[str, tuple[int, Any]]] = {name: {} for name in names}
    for pair in pairs:
        if pair.warp is not None:
            links[pair.a][pair.b] = (pair.count, pair.warp)
            links[pair.b][pair.a] = (pair.count, np.linalg.inv(pair.warp))
    best: tuple[str, dict[str, Array]] = ("", {})
    for hub in sorted(names, key=lambda name: -sum(count for count, _ in links[name].values())):
        if hub in best[1]:
            continue
        warps = {hub: np.eye(3)}
        while reach := [(links[a][b][0], a, b) for a in warps for b in links[a] if b not in warps]:
            _, a, b = max(reach)
            warps[b] = links[a][b][1] @ warps[a]
        if len(warps) > len(best[1]):
            best = hub, warps
    return best


def apart(name: str, pairs: list[Pair]) -> str:
    """Why a photo could not be connected."""
    own = [p for p in pairs if name in (p.a, p.b)]
    most = max(own, key=lambda p: int(p.agree.sum()))
    other = most.b if most.a == name else most.a
    if any(p.wild for p in own):
        return ("its homography is wild (folded, or scaled very differently): another surface, or one that "
                "is not flat")
    if any(p.count for p in own):
        return f"it has something in common only with {other}, not with the larger group of photos"
    return (f"no agreement with any other photo: at most {int(most.agree.sum())} features agree with "
            f"{other}, {LEAST_INLIERS} needed; another material, too little overlap, or blurred")
