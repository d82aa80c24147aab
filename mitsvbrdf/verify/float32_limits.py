"""How accurate float32 can be at a texel, and why the worst texels of a comparison are the worst.

**The limit.** Float32 knows a direction to about one rounding, u = 2^-24 rad: a normal stored as (n + 1) / 2
is rounded by up to 2^-25 a component and doubled when it is read. Turned by u, it changes a number L by
u |dL/dn|, with dL/dn in the tangent plane. The float64 twin gives both components: its normals turned by u
about two perpendicular axes. u is large for float64 and small beside any lobe, so the second order does not
count. The limit of the relative error is

    u + u |dL/dn| / |L|

with the first u for the rounding of L itself. Near a mirror direction L goes like GGX's D, whose slope
|d log D / d angle| is 2 (1 - alpha^2) / alpha at its steepest, about alpha beside the highlight: the limit is
u + 2 u / alpha there, 1.2e-5 at roughness 0.1, and 6e-8 where the material is rough. The same changes of a
gradient give its limit. It is an order of magnitude, no bound: directions of view and light are rounded too,
and a renderer with directions in float64, or with their differences, stays below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ..material.maps import SVBRDF
from ..measure.gradients import Measured, render_and_gradients
from ..measure.metrics import relative_error
from ..measure.tolerances import UNIT_ROUNDOFF
from ..render import Renderer
from ..views import Views, texel_positions

# An error up to this many times the limit counts as explained by float32: directions of normal, view, light
# and half vector are all rounded. Measured on the made and corner materials in co-located views: 8 at most.
EXPLAINED = 10.0


@dataclass(frozen=True)
class Limit:
    """By how much one rounding of the normals changes what the float64 twin computes.

    Args:
        image: N x R x R x 3, not negative.
        gradients: by map name, each of the map's shape, not negative.
    """

    image: Tensor
    gradients: dict[str, Tensor]


def float32_limit(twin: Renderer, svbrdf: SVBRDF, views: Views, exact: Measured, cotangent: Tensor) -> Limit:
    """The changes that one float32 rounding of every normal makes; see the module's text.

    ``exact`` is what ``analytic64`` finds with the normals as they are and this cotangent, N x R x R x 3.
    """
    turned = [render_and_gradients(twin, m, views, cotangent) for m in turned_normals(svbrdf, UNIT_ROUNDOFF)]
    return Limit(_length([t.image - exact.image for t in turned]),
                 {name: _length([t.gradients[name] - value for t in turned])
                  for name, value in exact.gradients.items()})


def turned_normals(svbrdf: SVBRDF, angle: float) -> tuple[SVBRDF, SVBRDF]:
    """The material in float64, every normal turned by a small angle (rad) about two perpendicular axes."""
    maps = svbrdf.to(torch.float64).maps
    normal = maps["normal"]  # its length stays as it is: a gradient hangs on that too
    x = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand_as(normal)
    first = F.normalize(torch.linalg.cross(normal, x), dim=-1)  # z > 0, so a normal is never along x
    second = F.normalize(torch.linalg.cross(normal, first), dim=-1)
    one, two = (SVBRDF(svbrdf.bsdf, {**maps, "normal": normal + angle * axis}) for axis in (first, second))
    return one, two


def _length(parts: list[Tensor]) -> Tensor:
    return torch.stack(parts).square().sum(dim=0).sqrt()


@dataclass(frozen=True)
class Truth:
    """A rendered material with what is needed to explain its errors.

    Args:
        svbrdf: the maps.
        views: camera and light positions.
        names: one for each view.
        image: of the float64 twin, N x R x R x 3.
        diffuse: the part of ``image`` that the diffuse lobe reflects.
        limit: of the relative error of each value, N x R x R x 3.
    """

    svbrdf: SVBRDF
    views: Views
    names: list[str]
    image: Tensor
    diffuse: Tensor
    limit: Tensor


def diffuse_radiance(twin: Renderer, svbrdf: SVBRDF, views: Views) -> Tensor:
    """What the diffuse lobe alone reflects, N x R x R x 3, of a float64 twin.

    ``principled``: its diffuse lobe is (1 - metallic) times that of the dielectric, which alone depends on
    the base colour where metallic is 0.
    """
    def drawn(**maps: Tensor) -> Tensor:
        return twin.render(SVBRDF(svbrdf.bsdf, {**svbrdf.maps, **maps}).detach(), views)

    if svbrdf.bsdf == "roughconductor":
        return drawn() - drawn(diffuse=torch.zeros_like(svbrdf["diffuse"]))
    plastic = torch.zeros_like(svbrdf["metallic"])
    both, lobe = drawn(metallic=plastic), drawn(metallic=plastic,
                                                base_color=torch.zeros_like(svbrdf["base_color"]))
    return (1 - svbrdf["metallic"].double()) * (both - lobe)


def worst_texels(truth: Truth, image: Tensor, among: Tensor, count: int = 3) -> list[dict]:
    """The ``count`` texels of ``among`` (R x R, bool) furthest from the twin, worst first, each with why."""
    error = torch.nan_to_num(relative_error(image, truth.image).abs(), nan=torch.inf)
    size, channel = torch.where(among[..., None], error, -1.0).max(dim=-1)
    size, view = size.max(dim=0)
    found = []
    for place in size.flatten().topk(min(count, int(among.sum()))).indices.tolist():
        row, column = divmod(place, size.shape[1])
        k = int(view[row, column])
        found.append(_texel(truth, image, error, (k, row, column, int(channel[k, row, column]))))
    return found


def _texel(truth: Truth, image: Tensor, error: Tensor, at: tuple[int, int, int, int]) -> dict:
    view, row, column, channel = at
    reference, mean = float(truth.image[at]), float(truth.image.abs().mean())
    value = float(image[at])
    finite = abs(value) != float("inf") and value == value
    angles = {name: float(angle[row, column])
              for name, angle in _angles(truth.svbrdf, truth.views.pick([view])).items()}
    texel = {
        "view": truth.names[view], "row": row, "column": column, "channel": "rgb"[channel],
        "value": value if finite else None, "reference": reference,
        "relative_error": float(error[at]) if finite else None,
        "share_of_mean": reference / mean if mean else 0.0,
        "roughness": float(truth.svbrdf["roughness"][row, column]), **angles,
        "specular_share": 1 - float(truth.diffuse[at]) / reference if reference else 0.0,
        "limit": float(truth.limit[at]),
    }
    return texel | {"why": why(texel)}


def _angles(svbrdf: SVBRDF, views: Views) -> dict[str, Tensor]:
    """Degrees from the normal to the half vector, the light and the camera of the first view, each R x R."""
    views = views.in_patch_sides()
    position, normal = texel_positions(svbrdf.resolution), F.normalize(svbrdf["normal"].double(), dim=-1)
    light, camera = (F.normalize(place[0].double() - position, dim=-1)
                     for place in (views.light, views.camera))

    def angle(direction: Tensor) -> Tensor:
        # with the sine, small angles keep their digits
        across = torch.linalg.cross(normal, direction).norm(dim=-1)
        return torch.rad2deg(torch.atan2(across, (normal * direction).sum(dim=-1)))

    return {"half_vector_angle": angle(F.normalize(light + camera, dim=-1)), "incidence_angle": angle(light),
            "camera_angle": angle(camera)}


def why(texel: dict) -> str:
    """One sentence on why a texel of :func:`worst_texels` is as far off as it is."""
    limit = f"float32 limit {texel['limit']:.1e}"
    if texel["value"] is None:
        return "not finite"
    if not texel["reference"]:
        return "black in the reference: it faces away from light or camera"
    if texel["relative_error"] > EXPLAINED * texel["limit"]:
        return f"not explained by float32: {texel['relative_error'] / texel['limit']:.0f} times the {limit}"
    steepest = max(texel["incidence_angle"], texel["camera_angle"])
    if steepest > 80:
        return f"grazing, {steepest:.2f} degrees: {limit}"
    if texel["specular_share"] > 0.5 and texel["limit"] > 4 * UNIT_ROUNDOFF:
        surface = f"{'low roughness' if texel['roughness'] < 0.3 else 'roughness'} {texel['roughness']:.2g}"
        return f"{surface}, {texel['half_vector_angle']:.2g} degrees beside the mirror direction: {limit}"
    if texel["share_of_mean"] < 0.01:
        return f"dark: value {texel['share_of_mean']:.1e} of the mean; {limit}"
    return f"rounding, {texel['relative_error'] / UNIT_ROUNDOFF:.0f} times 2^-24; {limit}"
