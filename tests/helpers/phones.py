"""A small simulated phone."""

from mitsvbrdf.synth.phone import HandheldPhone

SMALL = HandheldPhone(megapixels=0.2, jpeg=0)
