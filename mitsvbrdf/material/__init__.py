"""A material: named maps (``maps``), their files (``map_files``), made ones (``made``).

``conversion`` turns the maps of one BSDF into the other's, ``resample`` changes their size, ``corner_cases``
are the materials that renderers are checked with.
"""
