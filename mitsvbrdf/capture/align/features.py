"""SIFT features of photos of a flat material, matched, and the homographies that most matches agree with.

Source: SIFT by Lowe 1999, 2004; RootSIFT by Arandjelovic and Zisserman 2012; MAGSAC++ by Barath et al. 2020.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from ..lens import Array
from ..photo import Photo
from .planar import Match

FEATURE_SIDE = 2048  # photos are searched for features at no more than this many pixels a side
MOST_FEATURES = 8000
FEW_FEATURES = 3000  # the strongest ones, compared first, as time grows with the square of their number
# of the weakest feature; with OpenCV's 0.04, flash photos of wood were placed 50 pixels wrong or rejected
CONTRAST = 0.01
RATIO = 0.8  # a match counts when its distance is below this share of the second best's (Lowe 2004)
REPROJECTION = 3.0  # a match with a larger error is an outlier; in pixels of the feature search
OTHER_PLACE = 12.0  # features of one photo count as different from this distance on, in pixels
MOST_AGAIN = 8  # an unconnected photo is compared again with at most this many, by all features
SIGMA = 0.5  # standard deviation of a match, in pixels of the feature search
LEAST_INLIERS = 15  # four matches always agree with a homography; up to 10 were seen to agree by chance


@dataclass(frozen=True)
class Features:
    """Features of a photo, the strongest first."""

    points: Array  # K x 2, pixels of the photo
    descriptors: NDArray[np.float32]  # K x 128 float32 of length 1 (RootSIFT)
    pixel: float  # side of a pixel of the feature search, in pixels of the photo

    def __len__(self) -> int:
        return len(self.points)


def find_features(photo: Photo, mirror: bool = False) -> Features:
    """Features of a photo or of its mirror image, found in the mean of red, green and blue."""
    pixels = photo.pixels(FEATURE_SIDE)
    grey = pixels.astype(np.float32).mean(axis=2) * (255 / np.iinfo(pixels.dtype).max)
    image = np.rint(grey[:, ::-1] if mirror else grey).astype(np.uint8)
    # without precise upscaling, points are off by 0.25 pixels
    sift = cv2.SIFT_create(MOST_FEATURES, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    found, descriptors = sift.detectAndCompute(image, None)
    if not found:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), 1.0)
    order = np.argsort([-p.response for p in found], kind="stable")
    times = max(1, round(photo.size[0] / image.shape[1]))
    # Pixel centres are whole numbers, so shrinking shifts points by half the difference of pixel sizes.
    points = (np.array([p.pt for p in found], dtype=np.float64) + 0.5) * times - 0.5
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return Features(points[order], root[order].astype(np.float32), float(times))


def match(a: Features, b: Features, most: int = MOST_FEATURES) -> NDArray[np.intp]:
    """Matches (M x 2: index in a, index in b) among the ``most`` strongest features of each photo: pairs that
    are each other's nearest, and clearly nearer than the second best (:data:`RATIO`).
    """
    if min(len(a), len(b)) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    ours, theirs = torch.from_numpy(a.descriptors[:most]), torch.from_numpy(b.descriptors[:most])
    likeness = ours @ theirs.T
    best, to = likeness.max(dim=1)
    likeness[torch.arange(len(best)), to] = -1.0
    second = likeness.max(dim=1).values
    # |x - y|^2 = 2 - 2 x . y for vectors of length 1
    rows = torch.nonzero(1 - best < RATIO**2 * (1 - second)).ravel()
    to = to[rows]
    rows, to = (index[(theirs[to] @ ours.T).argmax(dim=1) == rows] for index in (rows, to))
    return torch.stack((rows, to), dim=1).numpy()


def repeats(features: Features) -> float:
    """How much a pattern repeats: the share of a photo's most similar features that fit one homography.

    Patterns that repeat exactly have 0.26 to 0.33; tiles, inlays and bricks that vary have at most 0.05.
    """
    if len(features) <= LEAST_INLIERS:
        return 0.0
    points, ours = features.points[:FEW_FEATURES], torch.from_numpy(features.descriptors[:FEW_FEATURES])
    at = torch.from_numpy(points)
    likeness = (ours @ ours.T).masked_fill_(torch.cdist(at, at) < OTHER_PLACE * features.pixel, -1.0)
    nearest = likeness.argmax(dim=1).numpy()
    # each pair once, from left to right
    one = np.flatnonzero((nearest[nearest] == np.arange(len(nearest))) & (points[:, 0] < points[nearest, 0]))
    agree = homography(points[one], points[nearest[one]], features.pixel)[1]
    return float(agree.sum()) / max(1, len(one))


def homography(source: Array, aim: Array, pixel: float) -> tuple[Array | None, NDArray[np.bool_]]:
    """The homography (3 x 3) that most pairs of pixels agree with, None if too few do; and which do (K).

    ``pixel``: side of a pixel of the feature search, in the pixels of ``source`` and ``aim`` (K x 2 each).
    """
    if len(source) < LEAST_INLIERS:
        return None, np.zeros(len(source), dtype=bool)
    cv2.setRNGSeed(0)
    found, inliers = cv2.findHomography(source / pixel, aim / pixel, cv2.USAC_MAGSAC, REPROJECTION,
                                        maxIters=10000, confidence=0.9999)
    if found is None or inliers.sum() < LEAST_INLIERS or not np.isfinite(found).all():
        return None, np.zeros(len(source), dtype=bool) if inliers is None else inliers.ravel().astype(bool)
    scale = np.diag((pixel, pixel, 1.0))
    return scale @ found @ np.linalg.inv(scale), inliers.ravel().astype(bool)


def mapped(warp: Array, points: Array) -> Array:
    """Points (... x 2), mapped by a homography."""
    x = points @ warp[:, :2].T + warp[:, 2]
    return x[..., :2] / x[..., 2:]


def wild(warp: Array, size: tuple[int, int]) -> bool:
    """Whether a homography folds a photo, or scales or bends it more than a handheld camera does."""
    width, height = size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    depth = np.concatenate([corners, np.ones((4, 1))], axis=1) @ warp[2]
    if not (depth * depth[0] > 0).all():
        return True
    edges = np.roll(at := mapped(warp, corners), -1, axis=0) - at
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    area = 0.5 * turns[[0, 2]].sum() / (width * height)
    return not ((turns > 0).all() and 1 / 6 < area < 6 and turns.max() < 6 * turns.min())


def spread(points: Array, size: tuple[int, int], most: int) -> NDArray[np.intp]:
    """Indices of at most ``most`` of the points (K x 2), taken in turn from 8 x 8 parts of the photo."""
    cell = np.clip(points * 8 // np.asarray(size), 0, 7).astype(int) @ (1, 8)
    turn = np.zeros(len(points), dtype=int)
    for value in np.unique(cell):
        inside = np.flatnonzero(cell == value)
        turn[inside] = np.arange(len(inside))
    return np.argsort(turn, kind="stable")[:most]


@dataclass(frozen=True)
class Pair:
    """What two photos have in common."""

    matches: Match  # all matches of features, right or wrong
    agree: NDArray[np.bool_]  # whether each match agrees with the homography, K
    warp: Array | None  # homography from pixels of a to pixels of b; None: none can be trusted
    wild: bool = False  # whether no camera could have made the homography that was found

    @property
    def names(self) -> tuple[str, str]:
        """Names of the two photos."""
        return self.matches.a, self.matches.b

    @property
    def count(self) -> int:
        """How many matches agree; 0 without a homography."""
        return int(self.agree.sum()) if self.warp is not None else 0


def find_pairs(features: dict[str, Features], size: tuple[int, int],
               report: Callable[[float], object]) -> list[Pair]:
    """Match all pairs of photos by the strongest features, then unconnected photos again by all features."""
    both = list(combinations(features, 2))
    # so few that all pairs together take at most the time of 100 pairs
    few = int(np.clip(FEW_FEATURES * math.sqrt(100 / len(both)), 500, FEW_FEATURES))
    found = {}
    for n, (a, b) in enumerate(both):
        report(n / len(both))
        found[a, b] = _pair(features, a, b, size, few)
    linked = chained_pairs(features, list(found.values()))[1]
    again: dict[tuple[str, str], None] = {}
    for name in features:
        if name not in linked:
            own = sorted((p for p in found.values() if name in p.names), key=lambda p: -p.agree.sum())
            again |= {p.names: None for p in own[:MOST_AGAIN] if p.warp is None}
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
    """The hub (the photo with most agreeing matches), and a dict: photo to the homography from the hub to it.

    The homographies follow the maximum spanning tree over the number of agreeing matches (Prim 1957), in the
    largest group of connected photos.
    """
    links: dict[str, dict[str, tuple[int, Any]]] = {name: {} for name in names}
    for pair in pairs:
        if pair.warp is not None:
            a, b = pair.names
            links[a][b], links[b][a] = (pair.count, pair.warp), (pair.count, np.linalg.inv(pair.warp))
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
    own = [p for p in pairs if name in p.names]
    most = max(own, key=lambda p: int(p.agree.sum()))
    (other,) = {*most.names} - {name}
    if any(p.wild for p in own):
        return ("its homography is wild (folded, or scaled very differently): another surface, or one that "
                "is not flat")
    if any(p.count for p in own):
        return f"it has something in common only with {other}, not with the larger group of photos"
    return (f"no agreement with any other photo: at most {int(most.agree.sum())} features agree with "
            f"{other}, {LEAST_INLIERS} needed; another material, too little overlap, or blurred")
