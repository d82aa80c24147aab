"""From rectified photos and their views to a judgement."""
