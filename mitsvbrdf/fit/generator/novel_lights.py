"""Lights that no photo had, and the crops of photos with which renderings under these lights are compared.

A novel light is the camera and the flash of a photo, both shifted sideways by whole texels. Half vectors,
distances and exposure at a shifted place equal those of the photo at the original place, to the bit. A
rendering and a photo can therefore be compared, although they show different pieces of the material.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ...views import Views

BEYOND = 0.1  # how far a moved camera may leave the rectangle of the cameras, as a share of its sides
JITTER = 0.12  # standard deviation of a crop's middle around the highlight, in patch sides


@dataclass(frozen=True)
class NovelLight:
    """Camera and light of a photo, both shifted over the patch, and the crop to compare."""

    photo: int  # its row in the capture
    down: int  # texels by which camera and light are shifted down
    right: int  # the same to the right
    row: int  # first row of the crop under the novel light; in the photo it is ``row - down``
    column: int  # first column; in the photo it is ``column - right``

    def under_it(self, picture: Tensor, side: int) -> Tensor:
        """The crop of a picture under the novel light, H x W x C."""
        return picture[self.row:self.row + side, self.column:self.column + side]

    def in_photo(self, picture: Tensor, side: int) -> Tensor:
        """The crop with the same half vectors, of a picture in the photo's own view."""
        row, column = self.row - self.down, self.column - self.right
        return picture[row:row + side, column:column + side]


def draw(views: Views, albedo: Tensor, side: int, tries: int, random: torch.Generator) -> NovelLight:
    """A random light near the cameras (about half a side from a single one), and a crop near its highlight.

    ``side``: texels a side of each crop. ``albedo``: R x R x 3 display values. Of ``tries`` random lights,
    the one is chosen whose two crops differ least in the albedo.
    """
    resolution, sides = albedo.shape[0], views.in_patch_sides()
    camera, middle = sides.camera[:, :2], (sides.camera + sides.light)[:, :2] / 2
    one = 0.5 * (len(views) == 1)  # only used for a material that repeats itself
    low, high = camera.min(dim=0).values - one, camera.max(dim=0).values + one
    photo = int(torch.randint(len(views), (), generator=random))
    found: list[tuple[float, NovelLight]] = [(torch.inf,
                                              NovelLight(photo, 0, 0, *2 * [(resolution - side) // 2]))]
    for _ in range(tries):
        share = torch.rand(2, generator=random, dtype=torch.float64) * (1 + 2 * BEYOND) - BEYOND
        right, up = ((low + (high - low) * share - camera[photo]) * resolution).round().int().tolist()
        jitter = JITTER * torch.randn(2, generator=random, dtype=torch.float64)
        x, y = ((middle[photo] + jitter) * resolution).tolist()
        rows, columns = (range(max(0, shift), min(resolution - side, resolution - side + shift) + 1)
                         for shift in (-up, right))
        if not rows or not columns:
            continue  # shifted so far that the two crops have no room
        row = min(max(round(resolution / 2 - (y + up) - side / 2), rows[0]), rows[-1])
        column = min(max(round(resolution / 2 + x + right - side / 2), columns[0]), columns[-1])
        moved = NovelLight(photo, -up, right, row, column)
        unlike = (moved.under_it(albedo, side) - moved.in_photo(albedo, side)).permute(2, 0, 1)
        found.append((float(F.avg_pool2d(unlike, min(4, side)).square().mean()), moved))
    return min(found, key=lambda each: each[0])[1]


def novel_views(views: Views, lights: list[NovelLight], resolution: int) -> Views:
    """One view for each novel light, in the same order."""
    picked = views.pick([each.photo for each in lights])
    shift = (torch.tensor([[each.right, -each.down, 0] for each in lights], dtype=torch.float64) / resolution
             * views.size)
    return picked.carried(shift)
