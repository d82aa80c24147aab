"""From rectified photos and their views to a judgement.

``photo_quality`` measures each photo beside the others. ``verdicts`` says which are rejected, and why.
``next_view`` finds where one more photo would show most new highlights.
"""
