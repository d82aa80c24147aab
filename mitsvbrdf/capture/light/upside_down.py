"""Photos that were saved upside down: in their pixels, the flash is on the other side of the lens.

The pose of such a photo is turned with it, so only the light shows the turn. On paper, each photo's falloff
gives a flash. One flash, at f or (in turned photos) at -f, leaves a chi squared of 2M - 2 degrees of freedom
in M photos. If chi squared is larger than that, so is the noise (quasi-likelihood, Wedderburn 1974).
"""

import math

import numpy as np

from ..lens import Array

RARE = 0.01  # prior share of captures with such photos; each number of them is equally probable


class Flashes:
    """The flash (x, y) as estimated from each of M photos.

    Args:
        places: M x 2.
        information: M x 2 x 2, the inverse covariance of each place.
        prior: 2 x 2, the inverse covariance of the prior on the flash, whose mean is 0.
    """

    def __init__(self, places: Array, information: Array, prior: Array) -> None:
        pull = np.einsum("mij,mj->mi", information, places)
        self._all = float((places * pull).sum())
        self._pulls = pull @ np.linalg.cholesky(np.linalg.inv(information.sum(axis=0) + prior))

    def likeliest(self) -> Array:
        """The likeliest sign of the flash in each of M photos: -1 if the photo is surely turned, else 1."""
        tried = [np.ones(len(self._pulls))]
        for toward in self._pulls:
            for _ in range(3):
                toward = (signs := np.where(self._pulls @ toward < 0, -1.0, 1.0)) @ self._pulls
            tried.append(signs)
        best = max(tried, key=lambda signs: float(np.linalg.norm(signs @ self._pulls)))
        sure = 2 * np.abs(self._pulls @ (best @ self._pulls)) > -math.log(RARE)
        return np.where(sure, best if best.sum() >= 0 else -best, 1.0)

    def turned(self, signs: Array) -> bool:
        """Whether it was surely right to turn photos with a sign of -1; ``self`` is the result."""
        if not (few := int((signs < 0).sum())):
            return False
        expected = RARE / (1 - RARE) / (len(signs) + 1) / math.comb(len(signs), few)
        gain = self._likelihood(np.ones(len(signs))) - self._likelihood(signs)
        return gain + math.log(expected) > -math.log(RARE)

    def _likelihood(self, signs: Array) -> float:
        freedom, left = 2 * len(signs) - 2, self._all - float(np.square(signs @ self._pulls).sum())
        noise = max(1.0, left / freedom)
        return -0.5 * (freedom * math.log(noise) + left / noise)
