"""Maps to Mitsuba's BSDF plugins: which plugin, which texture slots, and what each slot holds.

One description serves the fit (texel renderer), the traced scene and the exported scene file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

MIN_ALPHA_PRINCIPLED = 0.001  # Mitsuba's `principled` never goes below; its gradient in roughness is 0 there

# The refractive index grows without bound as F0 -> 1, and its slope in F0 as F0 -> 0; both ends are cut.
F0_RANGE = (1e-6, 0.999)


def index_from_f0(f0: Any) -> Any:
    """Real refractive index with reflectance F0 at normal incidence, (1 + sqrt F0) / (1 - sqrt F0).

    Works on torch and Dr.Jit arrays. F0 is cut to :data:`F0_RANGE` (with zero slope outside).
    """
    low, high = F0_RANGE
    if hasattr(f0, "clamp"):
        f0 = f0.clamp(low, high)
    else:
        import drjit
        f0 = drjit.clip(f0, low, high)
    root = f0**0.5
    return (1 + root) / (1 - root)


def slot_values(bsdf: str, maps: dict[str, Any], fresnel_curve: bool) -> dict[str, Any]:
    """What the plugin's texture slots hold for these maps (torch or Dr.Jit arrays, same layout as the maps).

    The two lobes of ``roughconductor`` are summed by a ``blendbsdf`` of weight 0.5, so both carry a factor 2.
    """
    slots = {"normal": maps["normal"] * 0.5 + 0.5}
    if bsdf == "principled":
        return slots | {name: maps[name] for name in ("base_color", "metallic", "roughness")}
    slots |= {"diffuse_x2": maps["diffuse"] * 2, "alpha": maps["roughness"] * maps["roughness"]}
    return slots | ({"eta": index_from_f0(maps["specular"])} if fresnel_curve else {"specular_x2": maps["specular"] * 2})


def plugin(bsdf: str, fresnel_curve: bool, texture: Callable[[str], Any]) -> dict:
    """The Mitsuba plugin dictionary of a material.

    Args:
        bsdf: ``roughconductor`` or ``principled``.
        fresnel_curve: real Fresnel reflectance (needed away from co-located views) instead of constant F0.
        texture: makes the texture of a slot, by its name in :func:`slot_values`.
    """
    if bsdf == "principled":
        shading = {"type": "principled", "base_color": texture("base_color"), "metallic": texture("metallic"),
                   "roughness": texture("roughness")}
    else:
        lobe = {"type": "roughconductor", "distribution": "ggx", "alpha": texture("alpha")}  # the default is Beckmann
        if fresnel_curve:
            lobe |= {"eta": texture("eta"), "k": {"type": "uniform", "value": 0.0},
                     "specular_reflectance": {"type": "uniform", "value": 2.0}}
        else:
            lobe |= {"material": "none", "specular_reflectance": texture("specular_x2")}
        shading = {"type": "blendbsdf", "weight": 0.5,
                   "diffuse": {"type": "diffuse", "reflectance": texture("diffuse_x2")}, "specular": lobe}
    # Both flags default to true and would change the image: the model has no normal flipping and no extra shadowing.
    return {"type": "normalmap", "flip_invalid_normals": False, "use_shadowing_function": False,
            "normalmap": texture("normal"), "bsdf": shading}
