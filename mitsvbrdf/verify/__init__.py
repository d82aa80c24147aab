"""The renderers against truths that do not share their code: float64, and each other.

``crosscheck`` compares images and gradients of given maps, and sums up what it found.
``float32_limits`` computes how accurate float32 can be. ``stability`` sweeps to the ends of every range.
The tolerances stand in :mod:`mitsvbrdf.measure.tolerances`.
"""
