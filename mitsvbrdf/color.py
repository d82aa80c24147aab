"""Responses of cameras (transfer functions), between linear radiance and display values.

Renderers never encode or clip. Photos, files and losses use this module. A new response needs a name in
:data:`Transfer` and two functions in :data:`RESPONSES`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast, get_args

from .errors import ConfigError

if TYPE_CHECKING:  # commands list these names as choices without loading torch
    from torch import Tensor

# A clipped photo value means "at least this bright". There are two thresholds:
CLIPPED = 0.995  # in fits: from this value on (254 and 255 of 8 bits), residuals are one-sided
NEARLY_CLIPPED = 0.99  # before fits (guess, flash, quality): 253 too, since omitted texels cost little there
QUANTIZATION_NOISE = 1 / (255 * math.sqrt(12))  # standard deviation of the rounding to 8 bits

# A fit may find a curve to apply after the response (:class:`Curve`).
Transfer = Literal["gamma2.2", "srgb", "linear"]
CURVE = re.compile(r"[^,]+, gamma (\d+\.\d+), shoulder (-?\d+\.\d+)")

# A line replaces the power curve below this linear value, because the slope of the curve at 0 is infinite.
# 2e-6 is 2/3 of one 8-bit step under gamma 2.2, so no photo value changes.
TOE = 2e-6


class Operations(NamedTuple):
    """Operations of torch or Dr.Jit that responses need: ``where(condition, a, b)``, ``at_least(x, c)``."""

    where: Callable
    at_least: Callable


class Response(NamedTuple):
    """A function and its inverse, both of a value and :class:`Operations`. Both map 0 to 0 and 1 to 1."""

    encode: Callable[[Any, Operations], Any]
    decode: Callable[[Any, Operations], Any]


def _same(value: Any, _: Operations) -> Any:
    return value


def _encode_srgb(linear: Any, do: Operations) -> Any:
    high = 1.055 * do.at_least(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return do.where(linear <= 0.0031308, 12.92 * linear, high)


def _decode_srgb(display: Any, do: Operations) -> Any:
    high = ((do.at_least(display, 0.04045) + 0.055) / 1.055) ** 2.4
    return do.where(display <= 0.04045, display / 12.92, high)


def _encode_gamma(linear: Any, do: Operations) -> Any:
    toe = TOE ** (1 / 2.2)
    return do.where(linear <= TOE, linear * (toe / TOE), do.at_least(linear, TOE) ** (1 / 2.2))


def _decode_gamma(display: Any, do: Operations) -> Any:
    toe = TOE ** (1 / 2.2)
    return do.where(display <= toe, display * (TOE / toe), do.at_least(display, toe) ** 2.2)


RESPONSES: dict[str, Response] = {
    "gamma2.2": Response(_encode_gamma, _decode_gamma),  # usual in SVBRDF research
    "srgb": Response(_encode_srgb, _decode_srgb),  # IEC 61966-2-1
    "linear": Response(_same, _same),
}


class Curve(NamedTuple):
    """A tone curve of two parameters that a camera applies after its response; 0 stays 0, and 1 stays 1.

    With u = d^gamma, it maps display values d to (1 + shoulder) u / (1 + shoulder u). Above u = 1, which no
    photo contains, it is linear in u, with the slope at u = 1. Both parameters may be Dr.Jit arrays.
    """

    gamma: Any
    shoulder: Any

    def bent(self, display: Any, do: Operations) -> Any:
        """Display values as the camera stores them."""
        low = TOE ** (1 / 2.2)  # a line replaces the power below it, as in the response
        power = do.where(display <= low, display * low ** (self.gamma - 1),
                         do.at_least(display, low) ** self.gamma)
        over = do.at_least(power - 1, 0)
        return (1 + self.shoulder) * (power - over) / (1 + self.shoulder * (power - over)) + over / (
            1 + self.shoulder)

    def straight(self, stored: Any, do: Operations) -> Any:
        """The inverse of :meth:`bent`."""
        low = TOE ** (1 / 2.2)
        over = do.at_least(stored - 1, 0)
        power = (stored - over) / (1 + self.shoulder * (1 - stored + over)) + over * (1 + self.shoulder)
        return do.where(power <= low**self.gamma, power * low ** (1 - self.gamma),
                        do.at_least(power, low**self.gamma) ** (1 / self.gamma))

    def behind(self, transfer: Transfer) -> Transfer:
        """``transfer`` with this curve in place of its own: "srgb, gamma 1.0800, shoulder 0.1200"."""
        return cast(Transfer, f"{parts(transfer)[0]}, gamma {self.gamma:.4f}, shoulder {self.shoulder:.4f}")


def parts(transfer: str) -> tuple[Transfer, Curve | None]:
    """Name of the response, and the curve (None: no curve). ConfigError: a wrong name or curve."""
    name, found = str(transfer).split(",")[0], CURVE.fullmatch(str(transfer))
    curve = Curve(*map(float, found.groups())) if found else None
    known = 0.1 <= curve.gamma <= 10 and -0.9 <= curve.shoulder <= 100 if curve else name == transfer
    if name not in RESPONSES or not known:
        raise ConfigError(f"a transfer function of {get_args(Transfer)}", repr(transfer),
                          "choose one; a curve may follow: gamma 0.1 to 10, shoulder -0.9 to 100")
    return cast(Transfer, name), curve


def response(transfer: Transfer) -> Response:
    """The two functions of a transfer function, its curve included; ConfigError for an unknown name."""
    name, curve = parts(transfer)
    plain = RESPONSES[name]
    if curve is None:
        return plain
    return Response(lambda linear, do: curve.bent(plain.encode(linear, do), do),
                    lambda display, do: plain.decode(curve.straight(display, do), do))


def of_torch() -> Operations:
    """The operations of torch."""
    import torch

    return Operations(torch.where, torch.clamp_min)


def encode(linear: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Linear radiance to display values: not clipped, with a finite slope everywhere.

    Args:
        linear: any shape, any float dtype; below 0 the response continues along its tangent at 0.

    Returns:
        Display values of the same shape; 1 maps to 1. :func:`clip` limits them as a photo does.
    """
    return response(transfer).encode(linear, of_torch())


def decode(display: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Display values in [0, 1] to linear radiance; the inverse of :func:`encode`.

    Args:
        display: any shape, any float dtype.
    """
    return response(transfer).decode(display, of_torch())


def shown(stored: Tensor) -> Tensor:
    """Display values in [0, 1], float32, from pixels of 8 or 16 bits; float pixels stay as they are."""
    if stored.is_floating_point():
        return stored
    import torch

    return stored.float() / torch.iinfo(stored.dtype).max


def clip(display: Tensor) -> Tensor:
    """Display values as a camera stores them: cut to [0, 1]."""
    return display.clamp(0.0, 1.0)


def to_display(linear: Tensor, transfer: Transfer = "gamma2.2") -> Tensor:
    """Linear radiance to the values of a photo: encoded and clipped to [0, 1]."""
    return clip(encode(linear, transfer))
