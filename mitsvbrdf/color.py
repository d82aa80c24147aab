"""The only transfer functions of the package, between linear radiance and display values.

Renderers never encode or clip; photos, files and losses come here.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import torch
from torch import Tensor

from .errors import ConfigError

# Photo values that say no more than "at least this bright". Two thresholds, which go different ways:
CLIPPED = 0.995  # in fits, whose residuals are one-sided from here on: 254 and 255 of 8 bits
# before them (guess, flash, quality), where texels left out cost little: 253 of 8 bits, too
NEARLY_CLIPPED = 0.99
QUANTIZATION_NOISE = 1 / (255 * math.sqrt(12))  # standard deviation of the rounding to 8 bits

Transfer = Literal["gamma2.2", "srgb", "linear"]

# Below this linear value the slope of the power curve is frozen (a tangent line instead): its derivative at 0
# is infinite. 2e-6 is the linear value of 2/3 of one 8-bit step under gamma 2.2, so no photo value is touched
# by it.
TOE = 2e-6


def encode(linear: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Linear radiance to display values, not clipped, differentiable everywhere with a finite slope.

    Args:
        linear: any shape, any float dtype; negative values are extended along the tangent at 0.
        transfer: ``gamma2.2`` (the field's habit), ``srgb`` (IEC 61966-2-1) or ``linear``.

    Returns:
        Display values of the same shape; 1 maps to 1. Clip with :func:`clip` where a photo would.
    """
    if transfer == "linear":
        return linear
    if transfer == "srgb":
        high = 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
        return torch.where(linear <= 0.0031308, 12.92 * linear, high)
    if transfer == "gamma2.2":
        toe = TOE ** (1 / 2.2)
        return torch.where(linear <= TOE, linear * (toe / TOE), linear.clamp_min(TOE) ** (1 / 2.2))
    raise ConfigError(f"a transfer function of {get_args(Transfer)}", repr(transfer), "choose one of these")


def decode(display: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Display values in [0, 1] to linear radiance; the inverse of :func:`encode`.

    Args:
        display: any shape, any float dtype.
        transfer: as in :func:`encode`.
    """
    if transfer == "linear":
        return display
    if transfer == "srgb":
        high = ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
        return torch.where(display <= 0.04045, display / 12.92, high)
    if transfer == "gamma2.2":
        toe = TOE ** (1 / 2.2)
        return torch.where(display <= toe, display * (TOE / toe), display.clamp_min(toe) ** 2.2)
    raise ConfigError(f"a transfer function of {get_args(Transfer)}", repr(transfer), "choose one of these")


def clip(display: Tensor) -> Tensor:
    """Display values as a camera stores them: cut to [0, 1]."""
    return display.clamp(0.0, 1.0)


def to_display(linear: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Linear radiance to what a photo would show: encoded and clipped to [0, 1]."""
    return clip(encode(linear, transfer))
