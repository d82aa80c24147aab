"""From photos to a rig: the lens, and where it stood in each photo.

With a printed sheet: ``sheet`` says where its tags are, ``tag_edges`` measures them in each photo,
``from_sheet`` explains all measurements at once. Without: ``features`` finds and matches what photos share,
``pairs`` chains their homographies, ``planar`` finds lens and poses by bundle adjustment, ``patch`` chooses
the square that all show; ``from_photos`` leads through these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

from ...io.profile import switch

if TYPE_CHECKING:
    from ..photo import Photo
    from ..rig import Rig


def find_rig(photos: Sequence[Photo], sheet_cm: float | None, depth_cm: float,
             reference: Literal["best", "first"], report: Callable[[str, float], object]) -> Rig:
    """Lens and poses, from the tags of a sheet of this size or, without one, from what the photos share."""
    def told(text: str, share: float) -> None:
        switch(text.partition(" of ")[0])
        report(text, share)

    if sheet_cm is not None:
        from .from_sheet import rig_from_sheet
        return rig_from_sheet(photos, sheet_cm, depth_cm, told)
    from .from_photos import rig_from_photos
    return rig_from_photos(photos, reference, told)
