"""Where camera and flash stood in photos that are rectified already.

``estimate`` finds views from the photos alone, where a capture has none; ``refine`` moves views to agree with
maps that are known.
"""
