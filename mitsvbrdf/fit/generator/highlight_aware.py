"""Highlight-aware convolution (Guo Jie et al. 2021; named in IV.C): features of saturated pixels come from
their neighbours.

A convolution whose taps are weighed by a mask in (0, 1) and divided by the mask's mean under the kernel, as a
partial convolution is (Liu et al. 2018); the mask is learned. Here each photo has a mask of its own, which
begins open, and nearly shut where the photo is saturated. The two-stream network of Guo et al. is not built:
one encoder has to serve here.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

OPEN = 4.0  # logit of a mask that begins open: 0.98; shut is its negative: 0.02
SATURATED = (0.9, 0.98)  # display values between which a pixel comes to count as saturated


class HighlightAwareConv(nn.Module):
    """In place of a convolution: every photo in its input is seen through a mask.

    Args:
        conv: the convolution, whose weights it keeps.
        photos: how many photos the input begins with, three channels each in -1 to 1; the channels after them
            are seen whole. None: the input is features, all of which one mask covers.
    """

    def __init__(self, conv: nn.Conv2d, photos: int | None = None) -> None:
        super().__init__()
        self.conv, self.photos = conv, photos
        self.groups = photos or 1
        self.masked = 3 * photos if photos else conv.in_channels
        self.mask = nn.Conv2d(conv.in_channels, self.groups, 1)
        nn.init.zeros_(self.mask.weight)
        nn.init.constant_(self.mask.bias, OPEN)  # type: ignore[arg-type]

    def masks(self, x: Tensor) -> Tensor:
        """How far each photo is believed at each pixel, N x photos x R x R, for an input N x C x R x R."""
        logits = self.mask(x)
        if self.photos:
            low, high = SATURATED
            brightest = (x[:, :self.masked].unflatten(1, (self.photos, 3)).amax(dim=2) + 1) / 2
            logits = logits - 2 * OPEN * ((brightest - low) / (high - low)).clamp(0, 1)
        return torch.sigmoid(logits)

    def forward(self, x: Tensor) -> Tensor:
        """As the convolution does; exactly so where every mask is the same everywhere."""
        mask, groups = self.masks(x), self.groups
        seen = (x[:, :self.masked].unflatten(1, (groups, -1)) * mask[:, :, None]).flatten(1, 2)
        weight = self.conv.weight[:, :self.masked].unflatten(1, (groups, -1)).transpose(0, 1).flatten(0, 1)
        parts = self._convolved(seen, weight, groups).unflatten(1, (groups, -1))
        tap = torch.ones(groups, 1, *self.conv.kernel_size, dtype=x.dtype)
        # fewer taps at a border padded with zeros
        inside = self._convolved(torch.ones_like(mask), tap, groups)
        share = self._convolved(mask, tap, groups) / inside
        out = (parts / share[:, :, None]).sum(dim=1)
        if self.masked < x.shape[1]:
            out = out + self._convolved(x[:, self.masked:], self.conv.weight[:, self.masked:])
        return out if self.conv.bias is None else out + self.conv.bias[:, None, None]

    def _convolved(self, x: Tensor, weight: Tensor, groups: int = 1) -> Tensor:
        conv, padding = self.conv, self.conv.padding
        if conv.padding_mode != "zeros":
            below, beside = (int(side) for side in padding)
            x, padding = F.pad(x, (beside, beside, below, below), mode=conv.padding_mode), (0, 0)
        return F.conv2d(x, weight, None, conv.stride, padding, groups=groups)


def make_highlight_aware(blocks: nn.Sequential | nn.ModuleList, photos: int) -> None:
    """Put highlight-aware convolutions into the first two blocks of an encoder, each a convolution with what
    follows it.

    Args:
        blocks: the encoder's; its first convolution sees photos.
        photos: how many that is.
    """
    for block, seen in zip(list(blocks)[:2], (photos, None)):
        assert isinstance(block, nn.Sequential) and isinstance(block[0], nn.Conv2d)
        block[0] = HighlightAwareConv(block[0], seen)
