"""Matches of features."""

from __future__ import annotations

import cv2
import numpy as np

from mitsvbrdf.capture.align.features import Features, match


def test_matches_are_each_others_nearest():
    rng = np.random.default_rng(1)
    ours, noise, others = (rng.random((count, 128), dtype=np.float32) for count in (60, 30, 40))
    theirs = np.concatenate((ours[:30] + np.linspace(0, 6, 30, dtype=np.float32)[:, None] * noise, others))
    theirs[35] = theirs[3]  # two look alike: neither is a match
    ours[40] = ours[5] + 0.2 * noise[5]  # the nearest of 5 is another
    a, b = (Features(np.zeros((len(d), 2)), d / np.linalg.norm(d, axis=1, keepdims=True), 1.0)
            for d in (ours, theirs))
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a.descriptors, b.descriptors, k=2)
    back = cv2.BFMatcher(cv2.NORM_L2).match(b.descriptors, a.descriptors)
    expected = [(p.queryIdx, p.trainIdx) for p, q in pairs
                if p.distance < 0.8 * q.distance and back[p.trainIdx].trainIdx == p.queryIdx]
    assert match(a, b).tolist() == [list(e) for e in expected] and 5 < len(expected) < 15
    assert match(a, b, most=6).tolist() == [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4], [5, 5]]
