"""From maps to Mitsuba's BSDF plugins: the plugin, its texture slots, and the values of each slot.

One description serves the fit (texel renderer), the traced scene and the exported scene file.
"""

from collections.abc import Callable
from typing import Any

from torch import Tensor

from ..material.maps import CHANNELS, SVBRDF
from .needs import Needs

MIN_ALPHA_PRINCIPLED = 0.001  # lowest in Mitsuba's `principled`; below, its gradient in roughness is 0

# plugins of plugins.py: they replace roughconductor's own reflectance, and normalmap
FRESNEL, NORMAL_MAP = "exact_fresnel", "exact_normalmap"

BELOW_ONE = 2.0**-24  # from 1 to the next float32 below

# The refractive index is unbounded as F0 -> 1, and its slope in F0 as F0 -> 0: so both ends are cut. Outside,
# the reflectance is proportional to F0: it still is 0 at F0 = 0, and its slope is not 0.
F0_RANGE = (1e-6, 0.999)


def index_from_f0(f0: Any) -> Any:
    """Real refractive index (1 + sqrt F0) / (1 - sqrt F0) of a reflectance F0 within its range."""
    root = f0**0.5
    return (1 + root) / (1 - root)


def needed_maps(svbrdf: SVBRDF, needs: Needs) -> dict[str, Tensor]:
    """The maps that are read: a dict, name to map. A specular map that needs no colour has one channel."""
    unread = {"diffuse": not needs.diffuse_lobe, "specular": not needs.specular_lobe,
              "metallic": not needs.metallic, "normal": not needs.normal_map,
              "roughness": svbrdf.bsdf == "roughconductor" and not needs.specular_lobe}
    maps = {name: svbrdf[name] for name in CHANNELS[svbrdf.bsdf] if not unread.get(name)}
    if "specular" in maps and not needs.coloured_specular:
        maps["specular"] = maps["specular"][..., :1]
    return maps


def _with_slope(metallic: Any) -> Any:
    """Metallic unchanged; but if it needs a gradient, values of 1 become the next lower float32.

    Mitsuba's ``principled`` skips its diffuse lobe where metallic is 1, and so the lobe's slope in metallic:
    the gradient was 161 instead of 70.6 for a base colour of 0.5. With the change, the image contains 6e-8 of
    the diffuse lobe.
    """
    if hasattr(metallic, "clamp"):  # a torch tensor, to be written to a file
        return metallic
    import drjit
    return metallic - drjit.select(metallic == 1, BELOW_ONE, 0) if drjit.grad_enabled(metallic) else metallic


def slot_values(bsdf: str, maps: dict[str, Any], needs: Needs, stock: bool = False) -> dict[str, Any]:
    """The plugin's texture slots for these maps: slot to array (torch or Dr.Jit, same layout as the maps).

    ``stock``: values for Mitsuba's own plugins only, from torch maps.

    Two lobes of ``roughconductor`` are summed by a ``blendbsdf`` of weight 0.5, so both carry a factor 2.
    """
    slots = {"normal": maps["normal"] * 0.5 + 0.5 if stock else maps["normal"]} if needs.normal_map else {}
    if bsdf == "principled":
        slots |= {"base_color": maps["base_color"], "roughness": maps["roughness"]}
        return slots | ({"metallic": _with_slope(maps["metallic"])} if needs.metallic else {})
    if needs.diffuse_lobe:
        slots[f"diffuse_x{needs.lobes}"] = maps["diffuse"] * needs.lobes
    if needs.specular_lobe:
        slots["alpha"] = maps["roughness"] * maps["roughness"]
        f0 = maps["specular"]
        if needs.fresnel_curve and not stock:
            return slots | {"f0": f0}
        if needs.fresnel_curve:
            cut = f0.clamp(*F0_RANGE)
            slots["eta"], f0 = index_from_f0(cut), f0 / cut
        slots[f"specular_x{needs.lobes}"] = f0 * needs.lobes
    return slots


def plugin(bsdf: str, needs: Needs, texture: Callable[[str], Any], stock: bool = False) -> dict:
    """The Mitsuba plugin dictionary of a material; ``texture`` gives a slot's texture (:func:`slot_values`).

    ``stock``: use Mitsuba's own plugins only, as in a file for others.
    """
    if bsdf == "principled":
        shading = {"type": "principled", "base_color": texture("base_color"),
                   "roughness": texture("roughness")}
        if needs.metallic:
            shading["metallic"] = texture("metallic")
    else:
        shading = _lobes(needs, texture, stock)
    if not needs.normal_map:
        return shading
    if not stock:
        return {"type": NORMAL_MAP, "normals": texture("normal"), "inner": shading}
    # Both default to true and would change the image: the model has no normal flipping or extra shadowing.
    return {"type": "normalmap", "flip_invalid_normals": False, "use_shadowing_function": False,
            "normalmap": texture("normal"), "bsdf": shading}


def _lobes(needs: Needs, texture: Callable[[str], Any], stock: bool) -> dict:
    diffuse = ({"type": "diffuse", "reflectance": texture(f"diffuse_x{needs.lobes}")} if needs.diffuse_lobe
               else {})
    if not needs.specular_lobe:
        return diffuse
    lobe = {"type": "roughconductor", "distribution": "ggx", "alpha": texture("alpha")}  # default: Beckmann
    if needs.fresnel_curve and not stock:
        lobe |= {"material": "none", "specular_reflectance": {"type": "uniform", "value": float(needs.lobes)}}
        lobe = {"type": FRESNEL, "f0": texture("f0"), "inner": lobe}
    else:
        lobe |= {"specular_reflectance": texture(f"specular_x{needs.lobes}")}
        lobe |= ({"eta": texture("eta"), "k": {"type": "uniform", "value": 0.0}} if needs.fresnel_curve
                 else {"material": "none"})
    return {"type": "blendbsdf", "weight": 0.5, "diffuse": diffuse, "specular": lobe} if diffuse else lobe
