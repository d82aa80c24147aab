"""Methods with one ingredient taken away or put in: what the suites ``ablation`` and ``gan`` fit beside the
method as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import NamedTuple

from ..errors import ConfigError
from ..fit import FitConfig
from ..fit.gan_config import PRESETS

FULL = "full"  # the method as it is, among its variants

# An ingredient of the default method that is off -> the settings that take it away.
VARIANTS: dict[str, dict[str, object]] = {
    "one basis material": {"materials": 1},
    "own numbers integrated out": {"integrated": True},
    "no neighbours as starts": {"neighbours": False},
    "sharing not enforced": {"spread": 10.0},  # deviations as large as expectation-maximisation finds them
    "relief 5 times as deep": {"relief": 0.1},
    "detail believed alike in all photos": {"noise": 0.03},
    "no freedom at full size": {"own": 0.0},
    "all pixels alike at 64 px": {"tails": 0.0},
    "burn-in not taken out": {"independent": False},
    # common to all photos; each flash is still refined within 0.01
    "no flash offset": {"flash_offset": False},
    "views as calibrated": {"calibrate": False},  # neither camera nor flash
}

NO_GAME = "no adversarial loss"
PAPERS_LOSSES = "the paper's losses alone"
KEPT = ("width", "learning_rate", "discriminator_rate", "decay")  # ours there too: the paper's need hours

# What lies between the paper's method and our `gan` -> the settings that change it.
GAN_VARIANTS: dict[str, dict[str, object]] = {
    # Every ingredient as in the paper: its generator from untrained weights, its game and its diffuse loss,
    # its guess.
    PAPERS_LOSSES: {name: value for name, value in PRESETS["paper-one-stage"].items() if name not in KEPT},
    NO_GAME: {"adversarial": 0.0, "features": 0.0},
    "no diffuse loss": {"diffuse": 0.0},
    "the paper's guess": {"guess": "min"},
    "no start at the guess": {"start": False},
    "two-stream generator": {"generator": "two-stream"},
    "two-stream and five fresh steps": {"generator": "two-stream", "normal_roughness_steps": 5,
                                        "fresh_pictures": True},
    "bce": {"game": "bce"},
    "hinge": {"game": "hinge"},
    "no level": {"level": False},
    "no angles": {"angles": False},
    "not paired": {"paired": False},
    "no feature matching": {"features": 0.0},
    "no clipping": {"clipping": False},
    "no growing": {"grow": False},
    "one picture a step": {"pictures": 1},
    "no head start": {"head_start": 0.0},
    "no smoothness": {"smooth": 0.0},
    "no falling step sizes": {"decay": False},
    "with average": {"average": 0.99},
    "one specular level": {"grey_specular": True},
    "no flash offset": {"flash_offset": False},
    "networks in float32": {"precision": "float32"},
    "networks in bfloat16": {"precision": "bfloat16"},
}


class Ablation(NamedTuple):
    """A method of ``fit``, by name, and its variants."""

    method: str
    variants: Mapping[str, Mapping[str, object]]


def ablations() -> dict[str, Ablation]:
    """Suite -> what it takes apart."""
    return {"ablation": Ablation("hierarchical", VARIANTS), "gan": Ablation("gan", GAN_VARIANTS)}


def variant_table(config: FitConfig, variants: Mapping[str, Mapping[str, object]]) -> dict[str, FitConfig]:
    """Name -> settings: the configuration as it is, and with the changes of each variant.

    Raises:
        ConfigError: a variant that changes what the configuration does not have, or to a value it refuses.
    """
    table = {FULL: config}
    for name, changes in variants.items():
        unknown = [key for key in changes if key not in {f.name for f in fields(config)}]
        if unknown or name == FULL:
            raise ConfigError(f"a variant of {type(config).__name__}",
                              f"{name!r} with {unknown or 'the name of the whole'}",
                              "mend the table in mitsvbrdf/bench/variants.py")
        table[name] = replace(config, **changes)  # type: ignore[arg-type]
        table[name].check()
    return table
