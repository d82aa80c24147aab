"""Poses of the photos."""
