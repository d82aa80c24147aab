"""Recover the maps of a material from a few flash photos, through a physically based differentiable renderer."""
