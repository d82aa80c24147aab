"""What ties texels to each other."""

from __future__ import annotations

SHARED = ("specular", "metallic", "roughness")
# Standard deviations of the first prior; that of the diffuse map stays.
VAGUE = {"diffuse": 0.5, "base_color": 0.5, "specular": 0.1, "metallic": 0.3, "roughness": 0.1, "normal": 0.1}
HELD = 1e8  # precision of a number that is not to move
# How far a texel may leave its tied answer at full size, in units of config.own: standard deviations at first and at least.
FREEDOM = {"normal": (0.5, 0.17), "roughness": (0.5, 0.5), "specular": (1.0, 1.0), "metallic": (1.0, 1.0)}
FREEST = 2.5  # the same, at most
CHANCE = 0.08  # of a map's variance: what a pattern of its own may have in common with the coverage angle
TAIL_FLOOR = 0.03  # least that a pixel counts
