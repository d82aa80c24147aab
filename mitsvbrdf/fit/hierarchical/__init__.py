"""The hierarchical fit."""

from .rounds import Hierarchical

__all__ = ["Hierarchical"]
