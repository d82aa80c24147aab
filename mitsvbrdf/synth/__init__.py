"""Simulated photos of known maps."""

from .photograph import photograph

__all__ = ["photograph"]
