"""Measures of error: of maps, photos, images and gradients; no files.

``metrics`` are the pure functions. ``rerender`` and ``gradients`` render what is measured. ``tolerances``
says how far renderers may be off, ``z_test`` whether noise explains a difference, ``burn_in`` how much of a
map follows the highlights of the photos.
"""
