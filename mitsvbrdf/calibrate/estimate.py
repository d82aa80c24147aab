"""Views from rectified photos alone: where camera and flash stood, and how strong the flash was.

One specular lobe for all texels explains the photos roughly, with flash and camera both at (x, y, z):

    radiance = e s(d, z) (rho + k lobe(roughness)),   s = z / d^3 (z / d)^b

d is the distance to the texel. rho (diffuse) and k (specular, near one level) of each texel are eliminated
(variable projection, Golub and Pereyra 1973). The unknowns that remain are the places, the exposures e
and three numbers for all texels: the roughness, the level of k, and b. b models the beam of the flash and the
darker corners of the lens: light falls off faster than from a point light. Without b, heights are halved.

- The mirror point is at the highlight. The flash is above it, so x and y are well determined, in patch sides.
- The height is badly determined: flash, material and lens can all cause the same gradient. So the prior is
  the height usual for phones (:data:`HEIGHT`, :data:`SPREAD`), and the uncertainty is stated.
- The light power is estimated from what materials usually reflect (:data:`F0`,
  :data:`~mitsvbrdf.material.maps.USUAL_ALBEDO`).
"""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from torch import Tensor

from ..capture import Capture
from ..capture.photo import listed
from ..capture.rig import LEAST_PHOTOS
from ..color import CLIPPED
from ..io.entry import entry
from ..io.layout import Layout
from ..material.maps import DIELECTRIC_F0, USUAL_ALBEDO, WHITEST
from ..views import Views
from .readings import mean_radiance

ESTIMATE_SIDE = 32  # pixels a side of the averaged photos
GAMMA = 2.2  # errors are in radiance^(1 / GAMMA), for any transfer function of the photos
NOISE = 0.05  # standard deviation of these errors: one lobe for all texels is a rough model
ALIKE = 40.0  # number of pixels that count as one, because errors of this model are correlated
ROBUST = 1.5  # errors above this many times the noise count linearly
# an estimate needs more: mean radiance of a photo; standard deviation of log radiance between photos
DARK_RADIANCE, SAME_LOG = 0.01, 0.01

# (Usual value, standard deviation of its natural logarithm.) In twelve real captures with known views,
# heights were 1.7 to 4.0 patch sides (median 1.9), and the root mean square spread of cameras along an axis
# was 0.10 to 0.18 of their height.
HEIGHT, SPREAD = (2.2, 0.15), (0.14, 0.15)
HEIGHTS, EXPOSURES = 0.06, 0.05  # standard deviations of natural logarithms between the photos of one capture
SIDEWAYS = 0.5  # standard deviation of x and y from the centre, in patch sides
BEAM = (2.5, 1.5)  # usual b, standard deviation; in the same captures 0.7 to 5, except the most matte
ROUGHNESS = (0.3, 0.5)  # usual alpha of the lobe, standard deviation of its natural logarithm
LEVELS = (0.1, 1.0)  # the same for the level of k, as a share of the brightest diffuse
OWN = 0.7  # standard deviation of a texel's k from the level, as a share of the level
F0 = (DIELECTRIC_F0, 0.4)  # the same for F0, to which the level of k is compared
POWER = (F0[1] ** -2 + USUAL_ALBEDO[1] ** -2) ** -0.5  # standard deviation of log light power by F0, albedo

PHOTO = Layout(place=(2,), height=(), exposure=())  # the unknowns of one photo
ESTIMATED = Layout(camera=(3,), log_exposure=())  # what is estimated for a photo; lengths in patch sides


@dataclass(frozen=True)
class EstimatedViews:
    """Views estimated from photos, with standard deviations; camera and flash are at the same place."""

    views: Views  # N views, in the unit of the capture's views
    deviation: Tensor  # standard deviations N x 4, columns as in ESTIMATED


def why_not(capture: Capture) -> str | None:
    """The reason why views cannot be estimated from the photos; None if they can."""
    if len(capture) < LEAST_PHOTOS:
        return f"{LEAST_PHOTOS} photos or more are needed"
    if capture.views.falloff == "none":
        return "without falloff there is nothing to tell them by"
    light, known = _radiance(capture, ESTIMATE_SIDE)
    if dark := [name for name, photo, told in zip(capture.names, light, known)
                if not (photo * told).sum() > DARK_RADIANCE * told.sum()]:
        return f"too dark: photo {listed(dark)}"
    logs = np.log(light + DARK_RADIANCE)
    logs -= logs.mean(axis=(1, 2), keepdims=True)
    return "the photos are all alike" if (logs - logs.mean(axis=0)).std() < SAME_LOG else None


@entry()
def self_calibrated(capture: Capture) -> tuple[Capture, EstimatedViews | None]:
    """An uncalibrated capture with estimated views and a note, and the estimate.

    A calibrated capture is returned as it is, with None. If views cannot be estimated (:func:`why_not`),
    the capture keeps the default geometry and gets a note with the reason; the estimate is None.
    """
    if capture.calibrated:
        return capture, None
    why = why_not(capture)
    if why:
        return capture.but(notes=(*capture.notes, f"views not estimated: {why}; the default geometry "
                                                       "is taken")), None
    found = estimate_views(capture)
    height = float(found.views.camera[:, 2].mean()) / found.views.size
    x, y, z = ESTIMATED.unpack(found.deviation.mean(dim=0)).camera.tolist()
    note = (f"views estimated from the photos alone: cameras about {height:.2f} patch sides away "
            f"(standard deviation {z:.2f}, sideways {max(x, y):.2f}); the light power is known to a factor "
            f"of {math.exp(POWER):.1f}")
    return capture.but(views=found.views, notes=(*capture.notes, note)), found


@entry()
def estimate_views(capture: Capture) -> EstimatedViews:
    """The most probable views of photos of an unknown material; takes a few seconds. See the module.

    For ``capture``, :func:`why_not` must return None. Only the unit of its views is used.
    """
    problem = Problem(capture)
    start = np.zeros(problem.layout.size)
    problem.photos(start).place[:] = problem.mirror_points() / SIDEWAYS
    found = least_squares(problem.errors, start, max_nfev=40, ftol=1e-4, xtol=1e-4)
    camera, exposure, _ = problem.places(found.x)
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    slope = problem.slopes(found.x)
    deviation = np.sqrt(np.einsum("npu,uv,npv->np", slope, covariance, slope))
    power, size = problem.power(found.x), capture.views.size
    places = torch.from_numpy(camera * size)
    intensity = torch.from_numpy(power * exposure[:, None] * size**2).repeat(1, 3)
    views = Views(places, places.clone(), intensity, size)
    return EstimatedViews(views, torch.from_numpy(deviation))


class Problem:
    """The least-squares problem in unknowns whose prior is the standard normal distribution.

    ``layout`` names them. ``photos`` are those of each photo (:data:`PHOTO`: x and y, height relative to the
    common one, exposure). All photos share the others: ``height``, ``beam`` (b), ``alpha`` (of the lobe) and
    ``level`` (of k, relative to the brightest diffuse).
    """

    def __init__(self, capture: Capture) -> None:
        photos = capture.photos.permute(0, 3, 1, 2)
        self.light, self.known = _radiance(capture, ESTIMATE_SIDE)
        self.side = self.light.shape[1]
        self.shown = self.light ** (1 / GAMMA)
        self.clipped = (F.adaptive_max_pool2d(photos.amax(dim=1), self.side) >= CLIPPED).numpy()
        self.count = len(capture)
        self.layout = Layout(photos=(self.count, PHOTO.size), height=(), beam=(), alpha=(), level=())
        line = (np.arange(self.side) + 0.5) / self.side - 0.5
        self.texels = np.stack([*np.meshgrid(line, -line), np.zeros((self.side, self.side))], axis=-1)
        self.typical = float(np.median(self.light, axis=0).max())

    def mirror_points(self) -> np.ndarray:
        """N x 2: the place in each photo that is brightest relative to other photos, mostly a highlight."""
        level = np.median(self.light, axis=(1, 2), keepdims=True) + DARK_RADIANCE
        logs = np.log(self.light / level + DARK_RADIANCE)
        excess = logs - np.median(logs, axis=0)
        found = []
        for picture in excess:
            smooth = gaussian_filter(picture, self.side / 27)
            peak = self.texels[np.unravel_index(smooth.argmax(), smooth.shape)]
            near = np.linalg.norm(self.texels - peak, axis=-1) < 0.15
            weight = near * np.clip(smooth - np.quantile(smooth, 0.97), 1e-9, None)
            found.append((weight[..., None] * self.texels[..., :2]).sum(axis=(0, 1)) / weight.sum())
        return np.array(found)

    def photos(self, u: np.ndarray) -> SimpleNamespace:
        """The parts of ``u`` that belong to photos, as in :data:`PHOTO`; they share its memory."""
        return PHOTO.unpack(self.layout.unpack(u).photos)

    def places(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
        """Cameras N x 3, exposures N, and a dict of the numbers that all photos share."""
        own, common = self.photos(u), self.layout.unpack(u)
        shared = {"height": HEIGHT[0] * math.exp(HEIGHT[1] * common.height),
                  "beam": BEAM[0] + BEAM[1] * common.beam,
                  "alpha": min(ROUGHNESS[0] * math.exp(ROUGHNESS[1] * common.alpha), 1.0),
                  "level": self.typical * LEVELS[0] * math.exp(LEVELS[1] * common.level)}
        camera = np.column_stack((own.place * SIDEWAYS, shared["height"] * np.exp(HEIGHTS * own.height)))
        return camera, np.exp(EXPOSURES * own.exposure), shared

    def slopes(self, u: np.ndarray) -> np.ndarray:
        """Derivatives of :data:`ESTIMATED` by the U unknowns: N x 4 x U."""
        camera, _, _ = self.places(u)
        (x, y, z), exposure = ESTIMATED.numbers.camera, ESTIMATED.numbers.log_exposure
        slope, common = np.zeros((self.count, ESTIMATED.size, self.layout.size)), self.layout.numbers
        own, photo = PHOTO.unpack(common.photos), np.arange(self.count)
        slope[photo, x, own.place[:, 0]] = slope[photo, y, own.place[:, 1]] = SIDEWAYS
        slope[photo, z, own.height] = HEIGHTS * camera[:, 2]
        slope[:, z, common.height] = HEIGHT[1] * camera[:, 2]
        slope[photo, exposure, own.exposure] = EXPOSURES
        return slope

    def shading(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Factors of rho (1 below a flash at the common height) and k, N x R x R each; and the level of k."""
        camera, exposure, shared = self.places(u)
        away = camera[:, None, None] - self.texels
        square = (away**2).sum(axis=-1)
        cosine = away[..., 2] / np.sqrt(square)
        bright = exposure[:, None, None] * shared["height"] ** 2 * cosine ** (1 + shared["beam"]) / square
        a2 = shared["alpha"] ** 2
        smith = 2 / (cosine + np.sqrt(a2 + (1 - a2) * cosine**2))  # G1 / cosine
        return bright, bright * a2 / (a2 * cosine**2 + 1 - cosine**2) ** 2 * smith**2 / 4, shared["level"]

    def texel_fit(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The best rho and k of each texel, R x R, and the errors that they leave, N x R x R."""
        diffuse, lobe, level = self.shading(u)
        rho = np.median(np.maximum(self.light - level * lobe, 1e-4) / diffuse, axis=0)
        k = np.full_like(rho, level)
        for _ in range(4):
            error, slope = self._error(rho * diffuse + k * lobe)
            weight = self.known * slope**2 / (1 + (error / NOISE) ** 2) / NOISE**2
            along, residual = error / slope, (k - level) / (OWN * level) ** 2
            rr, rk = (weight * diffuse**2).sum(axis=0) + 1e-6, (weight * diffuse * lobe).sum(axis=0)
            kk = (weight * lobe**2).sum(axis=0) + 1 / (OWN * level) ** 2
            r, s = (weight * diffuse * along).sum(axis=0), (weight * lobe * along).sum(axis=0) + residual
            common = rr * kk - rk**2
            rho = np.maximum(rho - (kk * r - rk * s) / common, 1e-4)
            k = np.clip(k - (rr * s - rk * r) / common, 0.05 * level, 5 * level)
        return rho, k, self._error(rho * diffuse + k * lobe)[0]

    def _error(self, radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors (0 if masked, or if clipped and the model is brighter), and their slope by radiance."""
        error = radiance ** (1 / GAMMA) - self.shown
        slope = np.maximum(radiance, 1e-3) ** (1 / GAMMA - 1) / GAMMA
        return np.where(self.clipped & (error > 0), 0, error) * self.known, slope

    def errors(self, u: np.ndarray) -> np.ndarray:
        """Errors of the photos and of the priors, in standard deviations; the fit minimizes their squares."""
        _, k, error = self.texel_fit(u)
        camera, _, shared = self.places(u)
        own = (k / shared["level"] - 1) / OWN / 3  # counts little: one lobe for all is only an approximation
        left = np.concatenate((error / NOISE, own[None])).ravel()
        robust = (np.sign(left) * np.sqrt(2 * (np.sqrt(1 + (left / ROBUST) ** 2) - 1)) * ROBUST
                  / math.sqrt(ALIKE))
        spread = camera[:, :2].std(axis=0)
        ratio = math.sqrt((spread**2).mean() + 1e-6) / shared["height"]
        return np.concatenate((robust, u, [math.log(ratio / SPREAD[0]) / SPREAD[1]]))

    def power(self, u: np.ndarray) -> float:
        """Radiant intensity (patch sides squared) that agrees best with the usual albedo and F0."""
        rho, _, _ = self.texel_fit(u)
        _, _, shared = self.places(u)
        votes = [(math.log(shared["level"] / F0[0]), F0[1]), (math.log(np.median(rho) / USUAL_ALBEDO[0]),
                                                              USUAL_ALBEDO[1])]
        weight = sum(sd**-2 for _, sd in votes)
        white = math.exp(sum(value * sd**-2 for value, sd in votes) / weight)
        # radiance of a white texel below the flash
        white = max(white, float(np.quantile(rho, 0.99)) / WHITEST)
        return math.pi * white * shared["height"] ** 2


def _radiance(capture: Capture, side: int) -> tuple[np.ndarray, np.ndarray]:
    """:func:`mean_radiance` at ``side`` at most, with the mean of the other photos at masked pixels."""
    light, known = (each.numpy() for each in mean_radiance(capture, min(side, capture.resolution)))
    return np.where(known, light, light.sum(axis=0) / known.sum(axis=0).clip(1)), known
