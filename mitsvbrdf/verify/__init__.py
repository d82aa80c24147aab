"""The renderers against truths that do not share their code: float64, fifty digits, each other.

``crosscheck`` compares images and gradients of given maps; ``float32_limits`` says how exact float32 can be
there; ``stability`` sweeps to the ends of every range; ``soak`` runs thousands of steps;
``generator_gradients`` compares what reaches a generator's weights through the whole method. Each makes a
record for JSON, and a page beside it shows that record. What is allowed stands in
:mod:`mitsvbrdf.measure.tolerances`.
"""
