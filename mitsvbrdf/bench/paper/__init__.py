"""The tables of section IV of the paper, reproduced: what docs/results/gan.md shows.

``printed`` is what the paper prints; ``references`` measures what fits are compared with: guesses, start,
published maps; ``schedule`` runs the paper's preset and keeps how its errors fall; ``steps`` times an
iteration. ``tables``, ``plots`` and ``page`` show them beside the fits of the suites ``methods`` and ``gan``;
``sheets`` draws figures like the paper's 4 to 6.
"""
