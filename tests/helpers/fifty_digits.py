"""One texel in fifty digits: the model as textbooks print it, in mpmath, to say how far float64 itself can be
trusted.

Written apart from :mod:`mitsvbrdf.render.analytic`, and without any of its care for rounding: with so many
digits c^2 (a^2 - 1) + 1 may cancel and a refractive index may be 1e25. Scalars, one at a time; a texel in one
view takes about a millisecond.

Sources: Walter et al. 2007 (GGX, Smith's G), Fresnel's equations, Burley 2012 and 2015 (``principled``).
"""

from collections.abc import Callable

from mpmath import mp, mpf

from mitsvbrdf.material.maps import CHANNELS, DIELECTRIC_F0, SVBRDF
from mitsvbrdf.render.analytic import MIN_ALPHA
from mitsvbrdf.render.bsdf import F0_RANGE
from mitsvbrdf.render.needs import half_angle_bound
from mitsvbrdf.views import Views

DIGITS = 50
# of the central differences: their error goes like its square, rounding like 10^-50 over it
DIFFERENCE_STEP = mpf(10) ** -18

Maps = dict[str, list]


def texel_sum(svbrdf: SVBRDF, views: Views, row: int, column: int, cotangent: list) -> tuple[mpf,
                                                                                             dict[str, list]]:
    """One texel's radiance in all views times the numbers ``cotangent``, N x 3, summed; and by map name the
    derivatives of the sum by the map's channels. What the material's float32 values stand for is taken
    exactly.
    """
    with mp.workdps(DIGITS):
        maps = {name: [mpf(x) for x in value[row, column].tolist()] for name, value in svbrdf.maps.items()}
        curve = half_angle_bound(views) > 0
        x, y = (mpf(2 * column + 1) / (2 * svbrdf.resolution) - mpf(1) / 2,
                mpf(1) / 2 - mpf(2 * row + 1) / (2 * svbrdf.resolution))

        def total(changed: Maps) -> mpf:
            return sum(mpf(w) * value for k, weights in enumerate(cotangent) for w, value in zip(
                weights, radiance(svbrdf.bsdf, changed, views, k, (x, y), curve)))

        return total(maps), {name: [_slope(total, maps, name, i) for i in range(channels)]
                             for name, channels in CHANNELS[svbrdf.bsdf].items()}


def _slope(total: Callable[[Maps], mpf], maps: Maps, name: str, i: int) -> mpf:
    """Central difference; one-sided at the ends of [0, 1], where the square root of F0 ends."""
    def at(step: mpf) -> mpf:
        return total(maps | {name: [x + step * (j == i) for j, x in enumerate(maps[name])]})

    value = maps[name][i]
    bounded = name != "normal"
    up, down = (0 if bounded and value >= 1 else DIFFERENCE_STEP), (0 if bounded and value <= 0
                                                                    else DIFFERENCE_STEP)
    return (at(up) - at(-down)) / (up + down)


def radiance(bsdf: str, maps: Maps, views: Views, k: int, place: tuple, curve: bool) -> list:
    """Linear radiance (rgb) of a texel at ``place`` (x, y, in patch sides) in view ``k``."""
    size = mpf(float(views.size))
    camera, light, power = ([mpf(x) for x in rows[k].tolist()] for rows in (views.camera, views.light,
                                                                            views.intensity))
    to_camera, to_light = ([p / size - q for p, q in zip(position, (*place, 0))] for position in (camera,
                                                                                                  light))
    v, l, n = _unit(to_camera), _unit(to_light), _unit(maps["normal"])  # noqa: E741
    h = _unit([a + b for a, b in zip(v, l)])
    n_l, n_v, n_h, h_l = _dot(n, l), _dot(n, v), _dot(n, h), _dot(h, l)
    if n_l <= 0 or n_v <= 0:
        return [mpf(0)] * 3
    reach = to_light if views.falloff == "inverse-square" else [p / size for p in light]
    alpha = max(maps["roughness"][0] ** 2, mpf(MIN_ALPHA[bsdf]))
    a2 = alpha**2
    d = a2 / (mp.pi * (n_h**2 * (a2 - 1) + 1) ** 2)
    g = _smith(a2, n_l) * _smith(a2, n_v)
    lobes = _roughconductor if bsdf == "roughconductor" else _principled
    return [f * n_l * i / size**2 / _dot(reach, reach) for f, i in zip(lobes(maps, n_l, n_v, h_l, d, g,
                                                                             curve), power)]


def _roughconductor(maps: Maps, n_l: mpf, n_v: mpf, h_l: mpf, d: mpf, g: mpf, curve: bool) -> list:
    return [rho / mp.pi + d * g * (_fresnel(f0, h_l) if curve else f0) / (4 * n_l * n_v)
            for rho, f0 in zip(maps["diffuse"], maps["specular"])]


def _principled(maps: Maps, n_l: mpf, n_v: mpf, h_l: mpf, d: mpf, g: mpf, curve: bool) -> list:
    (metallic,), (roughness,) = maps["metallic"], maps["roughness"]
    glass = _fresnel(mpf(DIELECTRIC_F0), h_l)
    w_l, w_v, retro = (1 - n_l) ** 5, (1 - n_v) ** 5, 2 * roughness * h_l**2
    burley = (1 - w_l / 2) * (1 - w_v / 2) + retro * (w_l + w_v + w_l * w_v * (retro - 1))
    return [(1 - metallic) * base / mp.pi * burley + d * g / (4 * n_l * n_v) * (
        metallic * (base + (1 - base) * (1 - h_l) ** 5) + (1 - metallic) * glass)
            for base in maps["base_color"]]


def _smith(a2: mpf, cosine: mpf) -> mpf:
    return 2 * cosine / (cosine + mp.sqrt(a2 + (1 - a2) * cosine**2))


def _fresnel(f0: mpf, cosine: mpf) -> mpf:
    """Mean of the s- and p-polarised reflectance, by refractive index and both angles."""
    low, high = map(mpf, F0_RANGE)
    cut = min(max(f0, low), high)
    eta = (1 + mp.sqrt(cut)) / (1 - mp.sqrt(cut))
    inside = mp.sqrt(1 - (1 - cosine**2) / eta**2)
    s = (cosine - eta * inside) / (cosine + eta * inside)
    p = (eta * cosine - inside) / (eta * cosine + inside)
    return f0 / cut * (s**2 + p**2) / 2


def _dot(a: list, b: list) -> mpf:
    return sum(x * y for x, y in zip(a, b))


def _unit(a: list) -> list:
    length = mp.sqrt(_dot(a, a))
    return [x / length for x in a]
