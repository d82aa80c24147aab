"""Where camera and flash stood in photos that are rectified already."""
