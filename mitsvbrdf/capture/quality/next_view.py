"""The next best view: where one more photo would show most new highlights, described in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...views import Views, coverage_angle

# A half vector this close to the flat normal shows a highlight (roughness 0.35: alpha is tan 7 degrees).
HIGHLIGHT_ANGLE = math.radians(7)
# places tried: step of their grid and largest distance sideways, in patch sides; largest slant
GRID_STEP, FARTHEST, SLANT = 0.05, 1.0, math.radians(35)
WORTH = 0.02  # share of the patch: a smaller gain is not worth one more photo


@dataclass(frozen=True)
class NextView:
    """A place to take one more photo from."""

    camera: tuple[float, float, float]  # x, y, z in the unit of the views
    gain: float  # share of the patch where it would be the first to show a highlight
    near: int  # index of the photo that was taken closest to this place
    words: str  # what to do, for a person


def next_best_view(views: Views, names: Sequence[str], unit: str) -> NextView | None:
    """The place, at the median height, where one more photo shows most new highlights; None: hardly any.

    ``names`` are those of the photos so far, ``unit`` is ``cm`` or ``patch sides``.
    """
    side, size = 32, views.size
    sides = views.in_patch_sides().to(torch.float64)
    unseen = coverage_angle(sides, side) > HIGHLIGHT_ANGLE
    height, beside = float(sides.camera[:, 2].median()), (sides.light - sides.camera).mean(dim=0)
    far = min(FARTHEST, height * math.tan(SLANT))
    steps = torch.arange(-round(far / GRID_STEP), round(far / GRID_STEP) + 1, dtype=torch.float64) * GRID_STEP
    places = torch.cartesian_prod(steps, steps)
    above = torch.full((len(places), 1), height, dtype=torch.float64)
    places = torch.cat((places, above), dim=1)[places.norm(dim=1) <= far]
    tried = replace(sides, camera=places, light=places + beside,
                    intensity=sides.intensity[:1].expand(len(places), 3))
    new = [unseen & (coverage_angle(tried.pick([i]), side) <= HIGHLIGHT_ANGLE) for i in range(len(places))]
    gains = torch.stack([shown.double().mean() for shown in new])
    # Of places with the same gain, take the one closest to the middle: the least slanted view.
    best = int((gains - 1e-3 * places[:, :2].norm(dim=1)).argmax())
    if gains[best] < WORTH:
        return None
    near = int((sides.camera - places[best]).norm(dim=1).argmin())
    way = (places[best] - sides.camera[near]).tolist()
    at = places[best] * size
    words = _words(way, height, names[near], unit, size)
    return NextView(tuple(at.tolist()), float(gains[best]), near, words)


def _words(way: Sequence[float], height: float, name: str, unit: str, size: float) -> str:
    def length(x: float) -> str:
        return f"{abs(x) * size:.0f} cm" if unit == "cm" else f"{abs(x):.0%} of the patch's side"

    least = (*[0.5 / size if unit == "cm" else 0.03] * 2, 0.1 * height)
    ways = ("further left", "further right"), ("nearer to you", "further away from you"), ("lower", "higher")
    moves = [f"{length(x)} {a if x < 0 else b}" for x, (a, b), enough in zip(way, ways, least)
             if abs(x) >= enough]
    above = length(height) if unit == "cm" else f"{height:.1f} patch sides"
    if abs(way[2]) < least[2]:
        moves.append(f"at the same height ({above})")
    # else the photos show which way is up
    upright = "; the sheet's arrow points away from you" if unit == "cm" else ""
    return f"from where {name} was taken, hold the phone {', '.join(moves)}{upright}"
