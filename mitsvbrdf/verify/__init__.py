"""Renderers against the truth."""
