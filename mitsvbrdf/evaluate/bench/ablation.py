"""The ingredients of the default method, each taken away alone: name -> the settings that change.

``mitsvbrdf bench --suite ablation`` fits the default method as it is, called ``full``, and once more for each entry.
"""

from __future__ import annotations

VARIANTS: dict[str, dict[str, object]] = {
    "no discriminator": {"adversarial": 0.0},
    "no diffuse loss": {"diffuse": 0.0},
    "no smoothness": {"smooth": 0.0},
    "no price on tilt": {"flat": 0.0},
    "no flash offset": {"flash_offset": False},
    "guess: minimum": {"guess": "min"},
}
