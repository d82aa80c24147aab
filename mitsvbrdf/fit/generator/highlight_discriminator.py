"""Two ways to compare renderings with photos: a small discriminator, and random projections of patches."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

PATCH, STRIDE = 7, 3  # pixels: side of the compared patches, and distance from one patch to the next
DIRECTIONS = 64


class HighlightDiscriminator(nn.Module):
    """A patch discriminator. Layer 1 has no norm, so brightness counts; layers 2 and 3 have instance norm."""

    def __init__(self, inputs: int, width: int = 32) -> None:
        super().__init__()
        w = width
        self.layers = nn.Sequential(nn.Conv2d(inputs, w, 4, stride=2, padding=1), nn.LeakyReLU(0.2),
            nn.Conv2d(w, 2 * w, 4, stride=2, padding=1), nn.GroupNorm(2 * w, 2 * w), nn.LeakyReLU(0.2),
            nn.Conv2d(2 * w, 4 * w, 3, padding=1), nn.GroupNorm(4 * w, 4 * w), nn.LeakyReLU(0.2),
            nn.Conv2d(4 * w, 1, 3, padding=1))

    def forward(self, pictures: Tensor) -> Tensor:
        """Logits N x 1 x h x w of the patches of N x inputs x H x W; only differences of logits matter."""
        return self.layers(pictures)


def patch_distance(rendered: Tensor, photos: Tensor, angle: Tensor, random: torch.Generator,
                   bins: int = 3) -> Tensor:
    """Sliced Wasserstein-1 distance between the patches of paired pictures, in groups by half-vector angle.

    Args:
        rendered, photos: N x H x W x 3, H and W at least :data:`PATCH`.
        angle: N x H x W, one for both pictures of a pair: any number that grows with the half-vector angle.
        random: draws new projections in each call.
        bins: number of groups, of equal size, into which the patches of a picture are sorted by angle.

    Source: Heitz et al. 2021, "A Sliced Wasserstein Loss for Neural Texture Synthesis", here on patches
    instead of features.
    """
    directions = F.normalize(torch.randn(PATCH * PATCH * 3, DIRECTIONS, generator=random), dim=0)
    # The projections of all patches at once are a convolution.
    kernel = directions.T.reshape(DIRECTIONS, 3, PATCH, PATCH)
    first, second = (F.conv2d(x.permute(0, 3, 1, 2), kernel, stride=STRIDE).flatten(2)
                     for x in (rendered, photos))
    middle = angle[:, PATCH // 2:, PATCH // 2:][:, ::STRIDE, ::STRIDE]
    sides = [(side - PATCH) // STRIDE + 1 for side in angle.shape[1:]]
    order = middle[:, :sides[0], :sides[1]].flatten(1).argsort(dim=1)
    parts = [(a[:, which].sort(dim=1).values - b[:, which].sort(dim=1).values).abs().mean()
             for a, b, ranks in zip(first, second, order) for which in ranks.chunk(bins)]
    return torch.stack(parts).mean()
