"""From a rig and its photos to the light: place and strength of the flash, vignetting, exposures.

``samples`` averages small blocks of paper or material. ``problem`` predicts these from the unknowns.
``solve`` finds the most probable unknowns with robust weights, and excludes photos without flash.
``shading`` turns the unknowns into a lens and an intensity; ``lit`` makes the photos and their views.
"""
