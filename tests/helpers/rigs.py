"""Lens and poses as a file states them."""

import numpy as np

from mitsvbrdf.capture.lens import Lens, Pose


def lens_and_poses(stated: dict) -> tuple[Lens, dict[str, Pose]]:
    """Of ``capture.json["rig"]`` or ``truth.json["rig"]``."""
    lens = Lens(**{name: tuple(x) if isinstance(x, list) else x for name, x in stated["lens"].items()})
    return lens, {name: Pose(np.array(pose["position"]), np.array(pose["rotation"]))
                  for name, pose in stated["poses"].items()}
