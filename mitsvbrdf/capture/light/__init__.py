"""From a rig and its photos to the light: where the flash is and how strong, vignetting, and the exposure of
each photo.

``samples`` averages small blocks of paper or material; ``problem`` states what the unknowns make of them;
``solve`` finds the most probable unknowns with the weights of ``robust``, and leaves photos out whose light
is even (``evenness``); ``shading`` turns the answer into a lens and an intensity.
"""
