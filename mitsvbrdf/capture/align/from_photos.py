"""Lens and poses of raw photos of a flat material, from the features that the photos share.

In two photos that overlap, features agree with one homography. A tree of the best homographies connects all
photos, and bundle adjustment finds lens and poses (:mod:`.planar`). Photos that cannot be used are listed
with the reason.

Source: the paper, III.C, for aligned photos. Each step names its own source.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...errors import CaptureError
from ...io import Report
from ..lens import Array, Lens, Pose, expected_lens, unsure_note
from ..photo import Photo
from ..rig import LEAST_PHOTOS, Rig, check_enough
from ..turned import in_place, one_place
from .features import (
    LEAST_INLIERS,
    REPROJECTION,
    SIGMA,
    Pair,
    apart,
    chained_pairs,
    find_features,
    find_pairs,
    mapped,
    repeats,
    spread,
)
from .patch import CENTRED, centred_square, choose_patch, framed, outline, turned, upright
from .planar import Match, adjust, starts

# standard deviation, as a share, of the focal length in EXIF: its 35 mm equivalent is in whole millimetres
FOCAL_SHARE = 0.02
FOCAL_SHARE_ASSUMED = 0.15  # the same, if FIELD_OF_VIEW gives the focal length
REPEATING = 0.15  # a pattern counts as repeating if :func:`repeats` is larger
# standard deviation, as a share, of the fitted focal length that is worth a note: just below EXIF's
UNSURE = 0.018
MOST_MATCHES = 4000  # in a bundle adjustment
CHAINED = 10 * REPROJECTION  # a pair with a larger error under the tree of homographies is omitted at first
AGREEING = 0.4  # share of a photo's matches with others that must agree with its pose
NEEDED = ("that show the same part of a flat material",
          "take nine from somewhat different places, sharp, with much overlap; where a material has no marks "
          "to go by, lay a printed sheet around it (`mitsvbrdf sheet`)")


def rig_from_photos(photos: Sequence[Photo], reference: Literal["best", "first"] = "best",
                    report: Report = lambda text, share: None) -> Rig:
    """Lens and poses of overlapping photos of a flat material.

    World: the material is at z = 0. The patch has side 1: 0.95 of the largest square that all photos show,
    upright in the reference photo. Lengths are as exact as the focal length: to about 2 % with EXIF.

    Args:
        photos: three or more, of one size.
        reference: ``best`` (the photo taken most nearly from straight above) or ``first`` (the first used
            photo by name).

    Raises:
        CaptureError: fewer than three photos can be used together, with the reasons.
        OnePlace: most photos are from one place.
    """
    if len(photos) >= LEAST_PHOTOS and in_place(photos):
        raise one_place(len(photos))
    by_name = {photo.name: photo for photo in sorted(photos, key=lambda p: p.name)}
    rejected = _of_another_lens(by_name)
    features = {}
    for n, name in enumerate(by_name):
        report(f"features of {name}", 0.4 * n / len(photos))
        if name not in rejected:
            features[name] = find_features(by_name[name])
            if len(features[name]) < LEAST_INLIERS:
                rejected[name] = (f"{len(features.pop(name))} features, too few to align: blurred, dark or "
                                  "without detail")
    check_enough(features, rejected, *NEEDED)
    size = photos[0].size
    pairs = find_pairs(features, size, lambda share: report("features in common", 0.4 + 0.3 * share))
    hub, warps = chained_pairs(features, pairs)
    for name in [name for name in features if name not in warps]:
        mirrored = find_features(by_name[name], mirror=True)
        if count := find_pairs({hub: features[hub], name: mirrored}, size, lambda share: None)[0].count:
            rejected[name] = (f"mirrored beside {hub}, as {count} features of its mirror image tell; "
                              "give the file as the phone wrote it")
        else:
            rejected[name] = apart(name, pairs)
    check_enough(warps, rejected, *NEEDED)

    report("poses", 0.7)
    exif = [by_name[name].exif for name in warps]
    stated = [each["35 mm focal length"] for each in exif if "35 mm focal length" in each]
    lens = expected_lens(size, stated)
    focal_share = FOCAL_SHARE if stated else FOCAL_SHARE_ASSUMED
    pairs = [p for p in pairs if warps.keys() >= {*p.names}]
    lens, poses, matches, unsure = _posed(lens, focal_share, hub, warps, pairs, rejected)
    check_enough(poses, rejected, *NEEDED)

    placed, dropped = _placed(lens, poses, by_name, reference)
    rejected |= {name: "it shows too little of what the others show" for name in dropped}
    errors = _errors(lens, poses, matches)
    notes = [] if stated else [
        f"no EXIF states the focal length; the photos agree best with {lens.angle:.0f} degrees across the "
        "long side, and the heights of the cameras are as uncertain as that"]
    if unsure > UNSURE:
        notes.append(unsure_note(unsure))
    if repeats(features[hub]) > REPEATING:
        notes.append("the pattern of the material repeats itself: photos may be shifted against each other "
                     "by whole repeats, and views as wrong as that; lay a printed sheet around it "
                     "(`mitsvbrdf sheet`), or something with marks")
    return Rig(lens, placed, 1.0, "patch sides", "photos", {name: errors[name] for name in placed}, rejected,
               notes=tuple(notes))


def _of_another_lens(photos: dict[str, Photo]) -> dict[str, str]:
    """A dict: name to reason, for photos whose focal length is not that of most."""
    stated = {name: p.exif["35 mm focal length"] for name, p in photos.items()
              if "35 mm focal length" in p.exif}
    usual = Counter(stated.values()).most_common(1)
    return {name: f"a focal length of {own:g} mm, most have {usual[0][0]:g} mm: take all with one lens, "
            "without zoom" for name, own in stated.items() if abs(own / usual[0][0] - 1) > 2 * FOCAL_SHARE}


def _posed(lens: Lens, focal_share: float, hub: str, warps: dict[str, Array], pairs: list[Pair],
           rejected: dict[str, str]) -> tuple[Lens, dict[str, Pose], list[Match], float]:
    """Lens, poses, the matches that agree with them, and the focal length's standard deviation, as a share.

    Photos that do not agree are added to ``rejected``.
    """
    focal = lens.focal
    agreed = [p.matches.pick(p.agree) for p in pairs if p.warp is not None]
    # only pairs that agree with the tree of homographies, up to the distortion of the lens
    off = [m.at_b - mapped(warps[m.b] @ np.linalg.inv(warps[m.a]), m.at_a) for m in agreed]
    few = _limited([m for m, d in zip(agreed, off) if np.median(np.linalg.norm(d, axis=1))
                    < CHAINED * m.sigma / SIGMA], lens.size, MOST_MATCHES // 3)
    found = [adjust(lens, start, hub, few, focal, focal_share, steps=20) for start in starts(lens, warps)]
    lens, poses, _, unsure = min(found, key=lambda f: f[2])
    settled = 0
    while True:
        matches = [p.matches.pick(p.matches.errors(lens, poses) < REPROJECTION * p.matches.sigma / SIGMA)
                   for p in pairs]
        shares = {name: _agreeing(name, pairs, matches) for name in poses}
        worst = min(shares, key=shares.__getitem__)
        if shares[worst] < AGREEING:
            rejected[worst] = (f"only {shares[worst]:.0%} of what it has in common with other photos fits a "
                               "place of the camera")
            del poses[worst]
            pairs = [p for p in pairs if worst not in p.names]
            if len(poses) < LEAST_PHOTOS:
                return lens, poses, [], unsure
        elif settled == 2:
            return lens, poses, [m for m in matches if len(m.at_a)], unsure
        else:
            kept = hub if hub in poses else next(iter(poses))
            lens, poses, _, unsure = adjust(lens, poses, kept, _limited(matches, lens.size), focal,
                                            focal_share)
            settled += 1


def _agreeing(name: str, pairs: list[Pair], matches: list[Match]) -> float:
    """Ratio of a photo's matches that agree with the poses to those that agree with homographies."""
    own = [(p.count, len(m.at_a)) for p, m in zip(pairs, matches) if name in p.names and p.count]
    return sum(there for _, there in own) / max(1, sum(count for count, _ in own))


def _limited(matches: list[Match], size: tuple[int, int], most: int = MOST_MATCHES) -> list[Match]:
    """About ``most`` matches, spread evenly over the pairs and over each photo."""
    matches = [m for m in matches if len(m.at_a)]
    each = max(20, most // len(matches))
    return [m.pick(spread(m.at_a, size, each)) for m in matches]


def _errors(lens: Lens, poses: dict[str, Pose], matches: list[Match]) -> dict[str, float]:
    """A dict: photo to the RMS distance (pixels) of its features from those of others projected into it."""
    squares: dict[str, list[Array]] = {name: [] for name in poses}
    for m in matches:
        squares[m.b].append(m.errors(lens, poses) ** 2)
        squares[m.a].append(replace(m, a=m.b, b=m.a, at_a=m.at_b, at_b=m.at_a).errors(lens, poses) ** 2)
    return {name: float(np.sqrt(np.concatenate(own).mean())) for name, own in squares.items()}


def _placed(lens: Lens, poses: dict[str, Pose], photos: dict[str, Photo],
            reference: str) -> tuple[dict[str, Pose], list[str]]:
    """Poses in the frame of the patch, and names of the photos rejected to make the patch larger."""
    angles = {name: upright(pose, photos[name].orientation) for name, pose in poses.items()}
    # the photo most nearly from straight above, among those that were held upright like most
    like = {a: sum(math.cos(angles[a] - angles[b]) > 0.7 for b in poses) for a in poses}
    chosen = (min(poses) if reference == "first" else
              min((name for name in poses if like[name] == max(like.values())),
                  key=lambda name: poses[name].rotation[2, 2]))
    poses = {name: turned(pose, angles[chosen]) for name, pose in poses.items()}
    outlines = {name: outline(lens, pose) for name, pose in poses.items()}
    side, dropped = choose_patch(outlines, LEAST_PHOTOS, chosen if reference == "first" else None)
    if side <= 0:
        raise CaptureError("photos that all show the same part of a material",
                           f"no part that {len(poses) - len(dropped)} show", "take them with more overlap")
    kept = {name: poses[name] for name in sorted(poses) if name not in dropped}
    # Highlights are below the cameras. The largest square may be far away; one hardly smaller is closer.
    side *= CENTRED
    centre = centred_square([outlines[name] for name in kept], side,
                            np.mean([p.position[:2] for p in kept.values()], axis=0))
    return framed(kept, centre, side), dropped
