"""The ingredients of the default method, each taken away alone: name -> the settings that change.

``mitsvbrdf bench --suite ablation`` fits the default method as it is, called ``full``, and once more for each entry. All but
the first two change only fits to photos that do not follow the model, as real ones: made ones without noise show nothing there.
"""

from __future__ import annotations

VARIANTS: dict[str, dict[str, object]] = {
    "one basis material": {"materials": 1},
    "no neighbours as starts": {"neighbours": False},
    "sharing not enforced": {"spread": 10.0},  # deviations as large as expectation-maximisation finds them
    "relief 5 times as deep": {"relief": 0.1},
    "no freedom at full size": {"own": 0.0},
    "all pixels alike at 64 px": {"tails": 0.0},
    "burn-in not taken out": {"independent": False},
    "no flash offset": {"flash_offset": False},  # common to all photos; each flash is still refined within 0.01
    "views as calibrated": {"calibrate": False},  # neither camera nor flash
}
