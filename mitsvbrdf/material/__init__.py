"""A material: named maps (``maps``), their files (``map_files``), and materials made by code (``made``).

``conversion`` converts maps from one BSDF to the other. ``resample`` changes their size. ``corner_cases`` has
the materials for checks of renderers.
"""
