"""From rectified photos and their views to a judgement: which photos to leave out, and where to take the next
one.

``photo_quality`` measures each photo beside the others, ``verdicts`` says which are better left out and why,
``next_view`` finds the place that shows most highlights that no photo has.
"""
