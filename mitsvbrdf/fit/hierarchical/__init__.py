"""The hierarchical fit."""
