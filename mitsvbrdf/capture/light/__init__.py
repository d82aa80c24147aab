"""From a rig and its photos to the light: place and strength of the flash, vignetting, exposures.

``samples`` averages small blocks of paper or material. ``problem`` states what the unknowns make of them.
``solve`` finds the most probable unknowns with robust weights, without photos whose light is even.
``shading`` makes a lens and an intensity of them, ``lit`` the photos and their views.
"""
