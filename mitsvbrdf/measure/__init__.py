"""Measures of error: of maps, photos, images and gradients; no files."""
