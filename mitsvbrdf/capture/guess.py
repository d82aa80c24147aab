"""The guessed diffuse map: what a few photos say about the diffuse colour before any fit (paper, III.C)."""

import math
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from numpy.typing import ArrayLike
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

# The texel model of `robust`: its surface, of which something is known beforehand, and its albedo.
SURFACE = Layout(tilt=(2,), log_alpha=(), log_f0=())  # tilt: slopes of the normal
TEXEL = Layout(surface=(SURFACE.size,), log_albedo=())
# a dielectric; hardly a highlight
STARTS = [{"log_alpha": math.log(0.3), "log_f0": math.log(f0)} for f0 in (0.04, 0.001)]
PRIOR_SD = {"tilt": 0.5, "log_alpha": 0.5, "log_f0": 1.0}  # of a surface beside what is typical
NOISE = 0.03  # what a display value is trusted to: the photo, the calibration and this model
# starts tried for either slope: a fit started flat sticks to a wrong highlight
TILTS = (-0.6, -0.3, 0.0, 0.3, 0.6)
STEPS = 8
DELTA = 1e-3  # of the finite differences
FIT_SIZE = 256  # texels a side that are fitted; of larger photos, area averages
CHUNK = 4096  # texels fitted at once: their Jacobian stays in the cache


@entry()
def guess_diffuse(capture: Capture, method: GuessMethod = "robust") -> Tensor:
    """A diffuse albedo map from the photos alone.

    Args:
        capture: N >= 1 photos of R x R pixels.
        method:
            ``min``: the paper's (III.C, after Peter and Hannes 2015): the minimum radiance over the photos,
            for each pixel and channel, no falloff correction; one constant turns radiance L into albedo, pi L
            / E, with E the mean irradiance at the patch centre.
            ``mean-blur``: the baseline (III.C; Zhao 2020, Aittala 2016): the mean radiance over the photos,
            blurred by a Gaussian of R / 32; the same constant.
            ``robust``: ours: falloff and cosine undone; one tilted, rough, grey highlight fitted to each
            texel's few values and subtracted; then the median over the photos, without clipped pixels.
            Diffuse RMSE on six known materials 0.048 where ``min`` has 0.085. Its weak side: where no photo
            looks far from the highlight, or the calibration is off, broad highlights take colour from the
            diffuse map (real bamboo, red plastic).

    Returns:
        R x R x 3 float32, linear, in [0, 1], finite.

    Raises:
        ConfigError: another method.
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
    """The quotient, 0 where there is no light in a channel."""
    return torch.where(irradiance > 0, value / irradiance, 0.0)


def _blurred(image: Tensor) -> Tensor:
    """H x W x 3 under a Gaussian blur that repeats the border."""
    sigma = max(1e-3, BLUR * image.shape[0])
    reach = min(math.ceil(3 * sigma), image.shape[0] - 1)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / sigma) ** 2)
    kernel = (kernel / kernel.sum()).expand(3, 1, 1, -1)
    chw = F.pad(image.permute(2, 0, 1)[None], (reach,) * 4, mode="replicate")
    chw = F.conv2d(F.conv2d(chw, kernel, groups=3), kernel.mT, groups=3)
    return chw[0].permute(1, 2, 0)


def _robust(capture: Capture) -> Tensor:
    size = min(capture.resolution, FIT_SIZE)
    light, half, irradiance = geometry(capture.views, size)
    most = over(torch.tensor(math.pi), irradiance)  # apparent albedo of a clipped pixel
    albedo = averaged_rows(lambda rows: _apparent(capture, rows).mean(dim=-1, keepdim=True),
                           capture.resolution, size)
    # photos that show each texel; all where none does
    shows = None if capture.measured is None else (capture.measured | ~capture.measured.any(dim=0))[..., None]
    known = torch.ones_like(most[..., :1])
    if shows is not None:
        known = (resized((~shows).float(), size) == 0).float()
    texels = [known, albedo, most.mean(-1, True), light, half]
    texels = [x.flatten(1, 2).transpose(0, 1).squeeze(-1).contiguous() for x in texels]  # M x N (x 3)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more save at most a third on such small chunks, or cost 50 times the time
    try:
        prior = _typical(*(x[:: -(-len(x) // CHUNK)] for x in texels))
        fitted = [_shade(_fit(prior, *part), *part[3:]) for part in zip(*(x.split(CHUNK) for x in texels))]
    finally:
        torch.set_num_threads(threads)
    shading, lobe = (torch.cat(x).T.reshape(-1, size, size, 1) for x in zip(*fitted))

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
    """The albedo of a flat Lambertian that looks like these rows of the photos, N x ? x R x 3."""
    irradiance = geometry(capture.views, capture.resolution, rows)[2]
    return over(math.pi * color.decode(color.shown(capture.stored[:, rows]), capture.transfer), irradiance)


def _shade(texels: Tensor, light: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
    """The cosine and the GGX lobe of M texels in N views, over a flat Lambertian's cosine: M x N each.

    The lobe takes n.l = n.v = n.h, exact for a light at the camera.
    """
    surface = SURFACE.unpack(TEXEL.unpack(texels[:, None]).surface)
    tilt_x, tilt_y = surface.tilt.unbind(dim=-1)
    length = (1 + tilt_x**2 + tilt_y**2).sqrt()
    along_light, cosine = (((v[..., 0] * tilt_x + v[..., 1] * tilt_y + v[..., 2]) / length).clamp_min(0.05)
                           for v in (light, half))
    shading = along_light / light[..., 2]
    a2, c2 = torch.exp(2 * surface.log_alpha), cosine**2
    smith = 2 / (cosine + (a2 + (1 - a2) * c2).sqrt())  # G1 / cosine
    return shading, surface.log_f0.exp() * a2 / (a2 * c2 + 1 - c2) ** 2 * smith**2 / 4 * shading


def _errors(texels: Tensor, prior: Tensor, known: Tensor, albedo: Tensor, most: Tensor, light: Tensor,
            half: Tensor) -> Tensor:
    """M x (N + 4) errors in standard deviations: of about display values known (1, else 0), and the prior."""
    shading, lobe = _shade(texels, light, half)
    parts = TEXEL.unpack(texels)
    said = torch.minimum(parts.log_albedo[:, None].exp() * shading + lobe, most)
    data = (said + 1e-4) ** 0.4 - (albedo + 1e-4) ** 0.4
    return torch.cat((known * data / NOISE, (parts.surface - prior) / _surface(**PRIOR_SD)), dim=1)


def _typical(*seen: Tensor) -> Tensor:
    """The usual surface of this material: medians, from the start that explains the photos better."""
    found = []
    for start in STARTS:
        prior = _surface(**start)
        for _ in range(2):
            texels = _fit(prior, *seen)
            cost = _errors(texels, prior, *seen).square().sum(dim=1).mean()
            prior = TEXEL.unpack(texels).surface.median(dim=0).values
            prior[SURFACE["tilt"]] = 0  # a patch is level
        found.append((float(cost), prior))
    return min(found, key=lambda pair: pair[0])[1]


def _surface(**parts: ArrayLike) -> Tensor:
    """A texel's surface by its parts, float32. Default of a part: 0."""
    return torch.from_numpy(SURFACE.pack(**parts)).float()


def _fit(prior: Tensor, *seen: Tensor) -> Tensor:
    """M x 5 fitted texels by Levenberg-Marquardt with finite differences, from the best of some tilts."""
    least = torch.where(seen[0] > 0, seen[1], torch.inf).amin(dim=1, keepdim=True)
    low = (least / 2).clamp(1e-4, 1e4).log()
    starts = [torch.cat(((prior + _surface(tilt=(x, y))).expand(len(low), -1), low), dim=1)
              for x in TILTS for y in TILTS]
    costs = torch.stack([_errors(start, prior, *seen).square().sum(dim=1) for start in starts])
    texels = torch.stack(starts)[costs.argmin(dim=0), torch.arange(len(low))]
    errors, damping = _errors(texels, prior, *seen), torch.full((len(low), 1), 0.01)
    for _ in range(STEPS):
        nudged = (_errors(texels + DELTA * axis, prior, *seen) for axis in torch.eye(TEXEL.size))
        j = torch.stack([(e - errors) / DELTA for e in nudged], dim=2)
        curve, slope = j.mT @ j, j.mT @ errors[..., None]
        curve.diagonal(dim1=1, dim2=2).mul_(1 + damping).add_(1e-6)
        trial = texels - torch.linalg.solve(curve, slope)[..., 0].clamp(-1, 1)
        found = _errors(trial, prior, *seen)
        good = (found.square().sum(dim=1) < errors.square().sum(dim=1))[:, None]
        texels, errors = torch.where(good, trial, texels), torch.where(good, found, errors)
        damping = torch.where(good, damping * 0.3, damping * 5).clamp(1e-4, 1e4)
    return texels
