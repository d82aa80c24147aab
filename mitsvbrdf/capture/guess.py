"""The guessed diffuse map: an estimate from the photos alone, before any fit (paper, III.C)."""

import math
from typing import Literal, get_args

import torch
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from torch import Tensor

from .. import color
from ..color import NEARLY_CLIPPED
from ..errors import ConfigError
from ..io.entry import entry
from ..io.layout import Layout
from ..material.resample import averaged_rows, enlarged_rows, resized
from ..views import geometry, strips
from .capture import Capture

GuessMethod = Literal["robust", "min", "mean-blur"]
BLUR = 1 / 32  # standard deviation of mean-blur, as a share of the image side

# The unknowns of a texel in `robust`: slopes of its normal, width and strength of its lobe, and its albedo.
TEXEL = Layout(tilt=(2,), log_alpha=(), log_f0=(), log_albedo=())
# standard deviations of the prior on these, around the typical texel; the albedo has no prior
SURFACE_SD = torch.tensor((0.5, 0.5, 0.5, 1.0, torch.inf))
# two starts: a dielectric, and a surface with almost no highlight
STARTS = [{"log_alpha": math.log(0.3), "log_f0": math.log(f0)} for f0 in (0.04, 0.001)]
DISPLAY, BLACK = 0.4, 1e-4  # a display value is about (albedo + BLACK)^DISPLAY
NOISE = 0.03  # standard deviation of a display value; errors of photo, calibration and this model
# start values of each slope of the normal: a fit that starts flat gets stuck at a wrong highlight
TILTS = (-0.6, -0.3, 0.0, 0.3, 0.6)
STEPS = 8
DELTA = 1e-3  # step of the finite differences
FIT_SIZE = 256  # texels a side that are fitted; larger photos are area-averaged
CHUNK = 4096  # texels fitted at once: their Jacobian stays in the cache


@entry()
def guess_diffuse(capture: Capture, method: GuessMethod = "robust") -> Tensor:
    """A diffuse albedo map from the photos alone.

    Args:
        capture: N >= 1 photos of R x R pixels.
        method:
            ``min``: the paper's method (III.C, after Peter and Hannes 2015): L is the minimum radiance over
            the photos, for each pixel and channel, without correction of falloff. The albedo is pi L / E; E
            is the mean irradiance at the patch centre.
            ``mean-blur``: the baseline (III.C; Zhao 2020, Aittala 2016): L is the mean radiance over the
            photos, blurred by a Gaussian of standard deviation R / 32. The albedo is pi L / E, too.
            ``robust``: our method. It divides by falloff and cosine. It fits one grey highlight with tilt and
            roughness to each texel, and subtracts it. The result is the median over photos, without clipped
            pixels. Its diffuse RMSE on six known materials is 0.048, that of ``min`` 0.085. Weakness: if all
            photos show a texel near its highlight, or the calibration is wrong, part of the diffuse colour is
            mistaken for a broad highlight (real bamboo, red plastic).

    Returns:
        R x R x 3 float32, linear, in [0, 1], finite.

    Raises:
        ConfigError: an unknown method.
    """
    if method not in get_args(GuessMethod):
        raise ConfigError(f"a guess of {get_args(GuessMethod)}", repr(method), "choose one of these")
    if method == "robust":
        return _robust(capture)
    radiance = capture.linear.min(dim=0).values if method == "min" else _blurred(capture.linear.mean(dim=0))
    light, intensity = capture.views.light, capture.views.intensity
    centre = (intensity * light[:, 2:] / light.norm(dim=1, keepdim=True) ** 3).mean(dim=0).float()
    return over(math.pi * radiance, centre).clamp(0, 1)


def over(value: Tensor, irradiance: Tensor) -> Tensor:
    """``value`` / ``irradiance``; 0 where a channel has no light."""
    return torch.where(irradiance > 0, value / irradiance, 0.0)


def _blurred(image: Tensor) -> Tensor:
    """An image, H x W x 3, blurred by a Gaussian; the border is repeated outwards."""
    sigma = max(1e-3, BLUR * image.shape[0])
    return torch.from_numpy(gaussian_filter(image.numpy(), (sigma, sigma, 0), mode="nearest", truncate=3))


def _robust(capture: Capture) -> Tensor:
    size = min(capture.resolution, FIT_SIZE)
    light, half, irradiance = geometry(capture.views, size)
    most = over(torch.tensor(math.pi), irradiance)  # apparent albedo of a clipped pixel
    albedo = averaged_rows(lambda rows: _apparent(capture, rows).mean(dim=-1, keepdim=True),
                           capture.resolution, size)
    # which photos show each texel; all of them if none does
    shows = None if capture.measured is None else (capture.measured | ~capture.measured.any(dim=0))[..., None]
    known = (torch.ones_like(most[..., :1]) if shows is None
             else (resized((~shows).float(), size) == 0).float())
    texels = [known, _display(albedo), most.mean(-1, True), light, half]
    texels = [x.permute(3, 0, 1, 2).flatten(2).squeeze(0) for x in texels]  # N x M or 3 x N x M
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more threads save a third of the time at most, or take 50 times as long
    try:
        prior = _typical(*(x[..., :: -(-size**2 // CHUNK)].contiguous() for x in texels))
        fitted = [_shade(_fit(prior, *part), *part[3:]) for part in zip(
            *([part.contiguous() for part in x.split(CHUNK, dim=-1)] for x in texels))]
    finally:
        torch.set_num_threads(threads)
    shading, lobe = (torch.cat(x, dim=1).reshape(-1, size, size, 1) for x in zip(*fitted))

    def diffuse(rows: slice) -> Tensor:
        photos = color.shown(capture.stored[:, rows])
        shown = torch.tensor(True) if shows is None else shows[:, rows]
        least = torch.where(shown, photos, torch.inf).amin(dim=0)
        seen = shown & ((photos < NEARLY_CLIPPED) | (photos == least))
        found = (_apparent(capture, rows) - enlarged_rows(lobe, capture.resolution, rows)
                 ) / enlarged_rows(shading, capture.resolution, rows)
        return torch.where(seen, found, torch.nan).nanmedian(dim=0).values.clamp(0, 1)

    return torch.cat([diffuse(rows) for rows in strips(capture.resolution)])


def _apparent(capture: Capture, rows: slice) -> Tensor:
    """The apparent albedo (as if flat and Lambertian) in some rows of the photos: N x rows x R x 3."""
    irradiance = geometry(capture.views, capture.resolution, rows)[2]
    return over(math.pi * color.decode(color.shown(capture.stored[:, rows]), capture.transfer), irradiance)


def _shade(texels: Tensor, light: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
    """The cosine and the GGX lobe of M texels in N views, divided by the cosine of a flat texel: N x M each.

    The lobe assumes n.l = n.v = n.h, which is exact if the light is at the camera.
    """
    tilt_x, tilt_y, log_alpha, log_f0, _ = texels
    length = (1 + tilt_x**2 + tilt_y**2).sqrt()
    along_light, cosine = (((x * tilt_x + y * tilt_y + z) / length).clamp_min(0.05)
                           for x, y, z in (light, half))
    shading = along_light / light[2]
    a2, c2 = torch.exp(2 * log_alpha), cosine**2
    smith = 2 / (cosine + (a2 + (1 - a2) * c2).sqrt())  # G1 / cosine
    return shading, (log_f0.exp() * a2 / 4) * (smith / (a2 * c2 + 1 - c2)) ** 2 * shading


def _errors(texels: Tensor, known: Tensor, display: Tensor, most: Tensor, light: Tensor, half: Tensor
            ) -> Tensor:
    """Errors of approximate display values in standard deviations, N x M; 0 where ``known`` is 0."""
    shading, lobe = _shade(texels, light, half)
    return known * (_display(torch.minimum(texels[4].exp() * shading + lobe, most)) - display) / NOISE


def _slopes(texels: Tensor, errors: Tensor, known: Tensor, display: Tensor, most: Tensor, light: Tensor,
            half: Tensor) -> Tensor:
    """Derivatives of the errors, 5 x N x M. For tilt and width, they are finite differences."""
    (shading, lobe), albedo = _shade(texels, light, half), texels[4].exp()
    level = albedo * shading
    said = level + lobe
    nudged = (_shade(texels + DELTA * axis[:, None], light, half) for axis in torch.eye(3, len(texels)))
    by = [(albedo * other + its - said) / DELTA for other, its in nudged]
    steep = known * DISPLAY / NOISE * (display + NOISE * errors) / (said + BLACK) * (said < most)
    return torch.stack((*by, lobe, level)) * steep


def _display(albedo: Tensor) -> Tensor:
    return (albedo + BLACK) ** DISPLAY


def _cost(errors: Tensor, texels: Tensor, prior: Tensor) -> Tensor:
    """The cost of M texels: squared errors plus squared deviations of the texels from the prior."""
    return errors.square().sum(dim=0) + (SURFACE_SD**-2 @ (texels - prior).square())


def _typical(*seen: Tensor) -> Tensor:
    """Parameters of a typical texel: medians of fitted texels, from the start with the lower mean cost."""
    found = []
    for start in STARTS:
        prior = _surface(**start)
        for _ in range(2):
            texels = _fit(prior, *seen)
            cost = _cost(_errors(texels, *seen), texels, prior).mean()
            prior = texels.median(dim=1, keepdim=True).values
            prior[TEXEL["tilt"]] = 0  # the patch as a whole is flat
        found.append((float(cost), prior))
    return min(found, key=lambda pair: pair[0])[1]


def _surface(**parts: ArrayLike) -> Tensor:
    """One texel from its named parts, 5 x 1, float32; missing parts are 0."""
    return torch.from_numpy(TEXEL.pack(**parts)).float()[:, None]


def _fit(prior: Tensor, *seen: Tensor) -> Tensor:
    """Fit M texels by Levenberg-Marquardt, each from the best of several tilts: 5 x M."""
    least = torch.where(seen[0] > 0, seen[1], torch.inf).amin(dim=0) ** (1 / DISPLAY) - BLACK
    starts = [(prior + _surface(tilt=(x, y))).repeat(1, len(least)) for x in TILTS for y in TILTS]
    for start in starts:
        start[4] = (least / 2).clamp(1e-4, 1e4).log()
    costs = torch.stack([_cost(_errors(start, *seen), start, prior) for start in starts])
    texels = torch.stack(starts, dim=1)[:, costs.argmin(dim=0), torch.arange(len(least))]
    errors, damping = _errors(texels, *seen), torch.full_like(least, 0.01)
    cost = _cost(errors, texels, prior)
    for _ in range(STEPS):
        j = _slopes(texels, errors, *seen)
        slope = (j * errors).sum(dim=1) + SURFACE_SD[:, None]**-2 * (texels - prior)
        curve = torch.stack([(j * column).sum(dim=1) for column in j]) + (SURFACE_SD**-2).diag()[..., None]
        curve.diagonal().mul_((1 + damping)[:, None]).add_(1e-6)
        trial = texels - torch.linalg.solve(curve.permute(2, 0, 1), slope.T).T.clamp(-1, 1)
        found = _errors(trial, *seen)
        its = _cost(found, trial, prior)
        good = its < cost  # False for NaN
        texels, errors = torch.where(good, trial, texels), torch.where(good, found, errors)
        cost = torch.where(good, its, cost)
        damping = torch.where(good, damping * 0.3, damping * 5).clamp(1e-4, 1e4)
    return texels
