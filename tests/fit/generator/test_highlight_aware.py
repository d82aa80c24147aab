"""Highlight-aware convolution: what saturated pixels say is taken from their neighbours."""

import torch
import torch.nn.functional as F

from mitsvbrdf.fit.generator.highlight_aware import HighlightAwareConv, make_highlight_aware
from mitsvbrdf.fit.generator.networks import AllPhotosGenerator, TwoStreamGenerator


def layer(photos=2, extra=1, stride=1, mode="zeros"):
    torch.manual_seed(0)
    return HighlightAwareConv(torch.nn.Conv2d(3 * photos + extra, 5, 3, stride, 1, padding_mode=mode), photos)


def with_highlight(value, photos=2, extra=1):
    """Photos of display values below 0.8 with a hole of this value in the first photo, and further
    channels.
    """
    random = torch.Generator().manual_seed(1)
    x = torch.rand(1, 3 * photos + extra, 12, 12, generator=random) * 1.6 - 1
    x[:, :3, 5:7, 4:6] = value
    return x


def test_it_is_the_sum_over_taps_weighed_by_masks():
    # A loop over every tap, in float64, from the formula alone.
    for stride, mode in ((1, "zeros"), (2, "zeros"), (1, "reflect")):
        ha = layer(stride=stride, mode=mode).double()
        x = with_highlight(0.97).double()
        masks = ha.masks(x)[0]
        grown = F.pad(x, (1, 1, 1, 1), mode="constant" if mode == "zeros" else mode)[0]
        mask = F.pad(masks[None], (1, 1, 1, 1), mode="constant" if mode == "zeros" else mode)[0]
        inside = F.pad(torch.ones(1, 1, 12, 12), (1, 1, 1, 1), mode="constant" if mode == "zeros"
                       else mode)[0, 0]
        found = ha(x)[0]
        for row, column in ((0, 0), (2, 2), (3, 1), (5, 5)):
            at = (slice(row * stride, row * stride + 3), slice(column * stride, column * stride + 3))
            total = ha.conv.bias + (ha.conv.weight[:, 6] * grown[(6, *at)]).sum(dim=(1, 2))
            for photo in range(2):
                share = mask[(photo, *at)].sum() / inside[at].sum()
                for c in range(3 * photo, 3 * photo + 3):
                    total = total + (ha.conv.weight[:, c] * grown[(c, *at)] * mask[(photo, *at)]).sum(dim=(1,
                                                                                                           2)) / share
            assert torch.allclose(found[:, row, column], total, atol=1e-12)


def test_without_saturated_pixels_it_is_the_convolution():
    ha = layer()
    x = with_highlight(0.0)
    assert torch.allclose(ha(x), ha.conv(x), atol=1e-5)


def test_the_colour_of_a_highlight_hardly_counts():
    ha, white, brown = layer(), with_highlight(1.0), with_highlight(1.0)
    brown[:, 1:3, 5:7, 4:6] = -0.5  # clipped in red alone
    plain = (ha.conv(white) - ha.conv(brown)).abs().max()
    assert (ha(white) - ha(brown)).abs().max() < 0.05 * plain  # a shut mask begins 0.02 open


def test_a_mask_is_learned():
    ha = layer()
    ha(with_highlight(1.0)).square().sum().backward()
    assert ha.mask.weight.grad.abs().max() > 0 and ha.mask.bias.grad.abs().max() > 0


def test_both_generators_take_it_in_their_first_layers():
    for generator, blocks, photos, shape in ((TwoStreamGenerator(width=4), "encoder", 1, (1, 3, 32, 32)),
                                             (AllPhotosGenerator(11, width=4, change=False), "down", 2,
                                              (1, 11, 32, 32))):
        x = torch.rand(shape, generator=torch.Generator().manual_seed(2)) * 0.8
        before = generator(x)
        make_highlight_aware(getattr(generator, blocks), photos)
        assert sum(isinstance(m, HighlightAwareConv) for m in generator.modules()) == 2
        after = generator(x)
        # masks begin alike everywhere
        assert all(torch.allclose(before[name], after[name], atol=1e-3) for name in before)
