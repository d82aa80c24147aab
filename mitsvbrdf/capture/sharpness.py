"""How many pixels a side contain detail: all of them, or fewer if the photos are soft."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..color import QUANTIZATION_NOISE
from ..io.images import display

MIDDLE = 512  # pixels a side of the middle of each photo, where detail is measured
MOST_PHOTOS = 4  # photos that are measured, at most
# An octave of detail counts if its contrast exceeds half that of the next coarser octave (MTF50) and also
# the noise of 8 bits, and if its correlation between photos exceeds half that of the coarser octave.
CONTRAST, SURELY = 0.5, 0.5
BEYOND_CHANCE = 3  # standard deviations of noise's correlation; a smaller correlation counts as 0
FEWEST = 8  # the coarsest octave's shortest wave fits this often into the middle, at least
CLEARLY = 2  # detail is measured only if photos are shrunk by this factor or more


def middle(pixels: np.ndarray) -> np.ndarray:
    """The middle of a square picture in grey display values."""
    side = min(len(pixels), MIDDLE)
    first = (len(pixels) - side) // 2
    return display(pixels[first:first + side, first:first + side]).mean(axis=-1)


def carried(middles: Sequence[np.ndarray], side: int, least: int) -> int:
    """Pixels a side that contain detail: ``side``, halved for each of the finest octaves without detail.

    Noise differs between photos, and an enlarged photo has little contrast in its finest octave. So a band of
    each octave is compared with the band of the next coarser octave, and between photos.

    ``middles``: :func:`middle` of each of two or more aligned photos of ``side`` pixels a side. The result is
    the largest of ``side``, ``side`` / 2, ... whose octave counts, but not below ``least``.
    """
    if len(middles) < 2:
        return least
    count = len(middles[0])
    window, line = np.hanning(count + 2)[1:-1], np.fft.fftfreq(count)
    window = np.outer(window, window)
    waves = [np.fft.fft2((each - each.mean()) * window) / count**2 for each in middles[:MOST_PHOTOS]]
    radius, sizes, shared, sure = np.hypot(line[:, None], line), list[int](), list[float](), list[float]()
    while side > least / 2 and 2**(len(sizes) + 1) * FEWEST <= count:
        band = (radius <= 0.5**(len(sizes) + 1)) & (radius > 0.5**(len(sizes) + 1.5))
        # absolute: relief that is lit from the other side correlates negatively
        both = [abs((one[band] * other[band].conj()).real.sum()) for one, other in combinations(waves, 2)]
        alone = float(np.mean([np.square(np.abs(wave[band])).sum() for wave in waves]))
        sizes, shared = [*sizes, side], [*shared, float(np.mean(both) / np.square(window).mean())]
        alike = float(np.mean(both)) / max(alone, 1e-12)
        # deviation of correlation by chance; only half of the waves are independent: the others mirror them
        chance = (2 / band.sum())**0.5
        sure, side = [*sure, alike if alike > BEYOND_CHANCE * chance else 0.0], side // 2
    for k, size in enumerate(sizes[:-1]):
        if (shared[k] > max(CONTRAST**2 * shared[k + 1], QUANTIZATION_NOISE**2)
                and sure[k] > SURELY * sure[k + 1] > 0):
            return max(least, size)
    return least
