"""Photos that were saved upside down: by their pixels, the flash lies on the other side of the lens.

The pose of such a photo is turned with it, so only the light tells. On paper, the falloff in each photo gives
a flash. One flash at f, or at -f in turned photos, leaves a chi squared of 2M - 2 degrees of freedom in M
photos. If that exceeds the noise, the noise is taken to be larger (quasi-likelihood, Wedderburn 1974).
"""

import math

import numpy as np

from ..lens import Array

RARE = 0.01  # prior share of captures with such photos, in which any number of them is equally probable


class Flashes:
    """The flash (x, y) that each of M photos shows.

    Args:
        places: M x 2.
        information: M x 2 x 2, the inverses of their covariances.
        prior: 2 x 2, the information of the prior on the one flash, which is expected at 0.
    """

    def __init__(self, places: Array, information: Array, prior: Array) -> None:
        pull = np.einsum("mij,mj->mi", information, places)
        self._all = float((places * pull).sum())
        self._pulls = pull @ np.linalg.cholesky(np.linalg.inv(information.sum(axis=0) + prior))

    def likeliest(self) -> Array:
        """The best M signs of the flash: 1 in most photos, -1 in those that are turned."""
        tried = [np.ones(len(self._pulls))]
        for toward in self._pulls:
            for _ in range(3):
                toward = (signs := np.where(self._pulls @ toward < 0, -1.0, 1.0)) @ self._pulls
            tried.append(signs)
        best = max(tried, key=lambda signs: float(np.linalg.norm(signs @ self._pulls)))
        sure = 2 * np.abs(self._pulls @ (best @ self._pulls)) > -math.log(RARE)
        return np.where(sure, best if best.sum() >= 0 else -best, 1.0)

    def turned(self, signs: Array) -> bool:
        """Whether the photos with a sign of -1 (of M signs) surely had to be turned to show these flashes."""
        if not (few := int((signs < 0).sum())):
            return False
        expected = RARE / (1 - RARE) / (len(signs) + 1) / math.comb(len(signs), few)
        gain = self._likelihood(np.ones(len(signs))) - self._likelihood(signs)
        return gain + math.log(expected) > -math.log(RARE)

    def _likelihood(self, signs: Array) -> float:
        freedom, left = 2 * len(signs) - 2, self._all - float(np.square(signs @ self._pulls).sum())
        noise = max(1.0, left / freedom)
        return -0.5 * (freedom * math.log(noise) + left / noise)
