"""Errors of maps, of photos and of gradients."""
