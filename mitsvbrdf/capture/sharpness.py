"""How many pixels of photos carry detail: sampling tells the most, and sharpness how many of them."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..color import QUANTIZATION_NOISE
from ..io.images import display

MIDDLE = 512  # pixels a side of the middle of each photo, which tells
MOST_PHOTOS = 4  # that are looked at
# An octave of detail counts where its contrast is half of that of the octave below (MTF50) and above the
# rounding to 8 bits, and where other photos show it half as surely.
CONTRAST, SURELY = 0.5, 0.5
BEYOND_CHANCE = 3  # deviations of the correlation that noise has
FEWEST = 8  # pixels a side of the middle in the coarsest octave


CLEARLY = 2  # times the pixels a side of what they are shrunk to: of fewer nothing is asked


def middle(pixels: np.ndarray) -> np.ndarray:
    """The middle of a square picture in grey display values."""
    side = min(len(pixels), MIDDLE)
    first = (len(pixels) - side) // 2
    return display(pixels[first:first + side, first:first + side]).mean(axis=-1)


def carried(middles: Sequence[np.ndarray], side: int, least: int) -> int:
    """Pixels a side that photos carry detail of: ``side``, or that halved as often as they are too soft.

    Noise is in no two photos the same, and what was enlarged has little contrast in its finest octave. So
    bands of an octave each are compared: with the next coarser band, and between photos.

    Of ``middles`` of two or more aligned photos (:func:`middle`), ``side`` pixels a side as a whole, the
    largest of ``side``, ``side`` / 2, ... whose octave counts; ``least`` at least.
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
        # of relief lit from the other side, minus as much
        both = [abs((one[band] * other[band].conj()).real.sum()) for one, other in combinations(waves, 2)]
        alone = float(np.mean([np.square(np.abs(wave[band])).sum() for wave in waves]))
        sizes, shared = [*sizes, side], [*shared, float(np.mean(both) / np.square(window).mean())]
        alike = float(np.mean(both)) / max(alone, 1e-12)
        # half of the waves are the others mirrored; chance makes so many alike
        chance = (2 / band.sum())**0.5
        sure, side = [*sure, alike if alike > BEYOND_CHANCE * chance else 0.0], side // 2
    for k, size in enumerate(sizes[:-1]):
        if (shared[k] > max(CONTRAST**2 * shared[k + 1], QUANTIZATION_NOISE**2)
                and sure[k] > SURELY * sure[k + 1] > 0):
            return max(least, size)
    return least
