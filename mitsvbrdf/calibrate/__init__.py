"""Where camera and flash stood."""
