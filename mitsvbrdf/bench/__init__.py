"""Error against run time: every method on known materials and real captures.

``tasks`` finds what is fitted, ``run`` fits and keeps the records, ``table`` takes medians over seeds,
``plot`` draws the curve.
"""
