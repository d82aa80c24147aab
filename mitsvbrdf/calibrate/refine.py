"""Views refined with the maps frozen: where camera and flash stood in each photo, and how much light it got.

Each photo has seven unknowns: the offset of its camera from the calibration (x, y, z), the offset of its
flash from the place beside the camera (x, y, z), and the natural logarithm of its exposure (light power,
shutter and gain have the same effect). Levenberg-Marquardt finds the most probable values: Gaussian priors
are centred on the calibration; residuals are in display values, and robust (Huber). If a pixel is clipped,
only a darker rendering counts. Derivatives are central differences of the float64 analytic renderer.

Residuals are not independent noise: an error of a map affects all pixels around it. So noise is measured on
the residuals themselves (:meth:`Problem.evidence`). Without this, the flash of photos held out of a
real fit moved by more than a patch side, to explain errors of the maps; with it, by 0.02. A map error that
looks like a shifted highlight still moves the flash.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..capture import Capture
from ..capture.capture import Calibration
from ..capture.guess import over
from ..color import CLIPPED, QUANTIZATION_NOISE
from ..errors import CaptureError, ConfigError
from ..io.entry import entry
from ..io.layout import Layout
from ..kinds import check_fields
from ..material.maps import SVBRDF
from ..material.resample import resized
from ..render import Renderer
from ..render.analytic import AnalyticRenderer
from ..render.needs import Needs
from ..views import NEAREST, Views

UNKNOWNS = ("camera_x", "camera_y", "camera_z", "flash_x", "flash_y", "flash_z", "log_exposure")
CHANGE = Layout(camera=(3,), flash=(3,), log_exposure=())  # the same, as parts
REFINE_SIDE = 128  # most pixels a side; larger photos and maps are area-averaged
# step of the differences, in patch sides: 1e-3 of a highlight of roughness 0.1; slopes are exact to 1e-6
STEP = 1e-5
STEP_FLOAT32 = 1e-4  # for renderers that may compute in float32
# residuals above this many standard deviations count linearly: 95 % efficient on normal noise (Huber 1981)
HUBER = 1.345
BLOCKS = 8  # blocks a side; averages over these show the correlation of residuals
ITERATIONS, SETTLED = 30, 1e-2  # most steps; a step below this many prior standard deviations is the last


@dataclass(frozen=True)
class Priors:
    """Standard deviations of a calibration, in patch sides. 0: the number is not refined.

    Args:
        camera: (x, y, z) of each photo's camera; the flash moves with it. Calibrations that could be
            checked were right to 0.003 sideways, and to 1 to 3 % of the height of 1.8 sides. For other
            captures, the default is ten times as much sideways.
        flash: (x, y, z) of each photo's flash from its place beside the camera. In real captures, one flash
            offset for all photos predicts the highlight centres to within 0.01 to 0.03.
        exposure: natural logarithm; an automatic exposure or flash varies by about 10 %.
        common_flash: (x, y) of a second offset of the flash, the same in all photos; a phone's flash is up to
            0.25 beside its lens.
    """

    camera: tuple[float, float, float] = (0.03, 0.03, 0.05)
    flash: tuple[float, float, float] = (0.03, 0.03, 0.03)
    exposure: float = 0.1
    common_flash: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        deviations = (*self.camera, *self.flash, self.exposure, *self.common_flash)
        if not all(isinstance(sd, (int, float)) and 0 <= sd < math.inf for sd in deviations):
            raise ConfigError("standard deviations of 0 and more, finite", str(self),
                              "give 0 to hold a number fixed")


# Source of views -> priors with which a fit refines them together with its maps. A phone is about two patch
# sides away. A sheet determines its place to 0.3 % of that, features of the photos to 2 to 3 %. "none": views
# were estimated from rectified photos, their places from highlights. The estimate has determined distance and
# strength of the flash, too; refining must not undo it.
PRIORS: dict[Calibration, Priors] = {
    "given": Priors(camera=(0.01, 0.01, 0.02), flash=(0.01, 0.01, 0.01), exposure=0.03,
                    common_flash=(0.15, 0.15)),
    "sheet": Priors(camera=(0.006, 0.006, 0.006), flash=(0.002, 0.002, 0.002), exposure=0.02,
                    common_flash=(0.03, 0.03)),
    "photos": Priors(camera=(0.05, 0.05, 0.05), flash=(0.005, 0.005, 0.005), exposure=0.05,
                     common_flash=(0.15, 0.15)),
    "none": Priors(camera=(0.03, 0.03, 0.06), flash=(0.01, 0.01, 0.01), exposure=0.05,
                   common_flash=(0.15, 0.15)),}


@dataclass(frozen=True)
class RefinedViews:
    """Refined views, their change, and its covariance."""

    views: Views  # the refined views, in the unit of the given ones
    change: Tensor  # N x 7, columns UNKNOWNS: patch sides; last, the logarithm of the exposure
    covariance: Tensor  # of each photo's change, N x 7 x 7
    common_flash: Tensor  # (x, y): the part of the flash's change that all photos share
    common_covariance: Tensor  # its covariance, 2 x 2
    iterations: int  # steps tried

    @property
    def deviation(self) -> Tensor:
        """Standard deviations of ``change``, N x 7."""
        return self.covariance.diagonal(dim1=1, dim2=2).sqrt()


@entry()
def refine_views(svbrdf: SVBRDF, views: Views, capture: Capture, priors: Priors = Priors(),  # noqa: B008
                 iterations: int = ITERATIONS, start: Tensor | None = None,
                 renderer: Renderer | None = None) -> RefinedViews:
    """The most probable views of photos of a known material; about a second for two photos.

    Args:
        svbrdf: the material, which stays as it is; any resolution.
        views: the N views to start from; the centre of the priors. For example the capture's.
        capture: the N photos.
        start: changes N x 7 from which the search begins, such as those found with earlier maps; default: 0.
        renderer: one that omits nothing; default: the analytic one, in float64.

    Returns:
        A local optimum: a rendered highlight moves to the photo's highlight only if both overlap.

    Raises:
        CaptureError: the numbers of views and photos differ.
    """
    problem = Problem(svbrdf, views, capture, priors, renderer)
    change = torch.zeros(len(views), len(UNKNOWNS)).double() if start is None else start
    here = problem.linear(torch.linalg.pinv(problem.spread) @ change.flatten())
    damping, tried, size = 1e-3, 0, float("inf")
    while tried < iterations and size > SETTLED:
        tried += 1
        step = -torch.linalg.solve(here.matrix + damping * here.matrix.diagonal().diag(), here.gradient)
        size = float(step.abs().max())
        better = problem.cost(here.u + step, here.evidence) < here.cost
        damping = damping / 10 if better else damping * 10
        here = problem.linear(here.u + step) if better else here
    change = problem.change(here.u)
    covariance = torch.linalg.inv(here.matrix)
    own, shared = problem.spread.reshape(len(views), len(UNKNOWNS), -1), problem.shared
    return RefinedViews(moved(problem.given, change), change, own @ covariance @ own.mT, shared @ here.u,
                        shared @ covariance @ shared.T, tried)


def moved(views: Views, change: Tensor) -> Views:
    """The views after changes N x 7, columns as in :data:`CHANGE`."""
    parts = CHANGE.unpack(change)
    camera, flash = parts.camera * views.size, parts.flash * views.size
    return replace(views, camera=views.camera + camera, light=views.light + camera + flash,
                   intensity=views.intensity * parts.log_exposure[:, None].exp())


class Linear(NamedTuple):
    """Value, gradient and Gauss-Newton matrix of the cost at u, and the evidence they were computed with."""

    u: Tensor
    evidence: tuple[Tensor, Tensor]
    cost: float
    gradient: Tensor
    matrix: Tensor


class Problem:
    """The least-squares problem in whitened unknowns u, whose prior is the standard normal distribution.

    ``spread @ u`` gives the changes of all photos. ``whitened`` is the layout of u: ``own`` has a number for
    each unknown of each photo, ``common_flash`` the offset of the flash that all photos share. The cost is
    |u|^2 / 2 plus, for each photo, the sum of Huber's function of residual / noise, divided by the number of
    pixels that count as one.
    """

    def __init__(self, svbrdf: SVBRDF, views: Views, capture: Capture, priors: Priors,
                 renderer: Renderer | None = None) -> None:
        count = len(views)
        if count != len(capture):
            raise CaptureError(f"a view for each of {len(capture)} photos", f"{count} views",
                               "give the views of these photos")
        side = min(REFINE_SIDE, svbrdf.resolution, capture.resolution)
        maps = svbrdf.detach().map(lambda value: resized(value.double(), side))
        self.maps = maps if side == svbrdf.resolution else SVBRDF(svbrdf.bsdf, {
            **maps.maps, "normal": F.normalize(maps["normal"], dim=-1)})
        self.given, self.transfer = views.to(torch.float64), capture.transfer
        self.photos, most = (torch.cat(pooled).permute(0, 2, 3, 1) for pooled in zip(*(
            (F.adaptive_avg_pool2d(photo, side), F.adaptive_max_pool2d(photo, side))
            for photo in (capture.photo(row)[None].double().permute(0, 3, 1, 2) for row in range(count)))))
        self.clipped = most >= CLIPPED  # also pixels that are clipped in part
        self.measured = capture.measured_at(side)
        if self.measured is not None:
            self.clipped |= ~self.measured[..., None]
        # Needs() omits nothing: light and camera move apart.
        self.renderer = renderer or AnalyticRenderer(torch.float64, Needs())
        self.step = STEP_FLOAT32 if renderer else STEP
        self.at_once = None if renderer else count  # the analytic renderer needs much memory for a view
        self.whitened = Layout(own=(count, CHANGE.size), common_flash=(2,))
        own = CHANGE.pack(camera=priors.camera, flash=priors.flash, log_exposure=priors.exposure)
        self.shared = torch.zeros(2, self.whitened.size, dtype=torch.float64)
        self.shared[:, self.whitened["common_flash"]] = torch.tensor(priors.common_flash,
                                                                     dtype=torch.float64).diag()
        to_flash = torch.zeros(CHANGE.size, 2, dtype=torch.float64)
        to_flash[CHANGE["flash"]][:2] = torch.eye(2)  # x and y
        self.spread = (F.pad(torch.from_numpy(own).repeat(count).diag(), (0, 2))
                       + to_flash.repeat(count, 1) @ self.shared)

    def drawn(self, views: Views) -> Tensor:
        """Radiance V x R x R x 3, float64, of V views."""
        each = torch.arange(len(views)).split(self.at_once or len(views))
        return torch.cat([self.renderer.render(self.maps, views.pick(part)).double() for part in each])

    def change(self, u: Tensor) -> Tensor:
        """Changes N x 7, columns :data:`UNKNOWNS`."""
        return (self.spread @ u).reshape(-1, len(UNKNOWNS))

    def residuals(self, radiance: Tensor) -> Tensor:
        """Rendered minus photos' display values, N x R x R x 3; 0 if masked, or if clipped and not darker."""
        error = color.encode(radiance, self.transfer) - self.photos
        error = torch.where(self.clipped, error.clamp_max(0), error)
        return error if self.measured is None else error * self.measured[..., None]

    def evidence(self, error: Tensor) -> tuple[Tensor, Tensor]:
        """Noise of each photo's residuals, and how many of them count as one: both N x 1 x 1 x 1.

        The noise is 1.48 times the median size of the residuals (the standard deviation, if they were
        normal). For independent residuals, averages over blocks of m have 1 / m of the mean square of single
        residuals. The factor by which theirs is larger is the number that counts as one.
        """
        sizes = torch.where(self._bright_enough(error), torch.nan, error.abs()).flatten(1)
        noise = (sizes.nanmedian(dim=1).values.nan_to_num(0) * 1.4826).clamp_min(QUANTIZATION_NOISE).reshape(
            -1, 1, 1, 1)
        cut = error.clamp(-HUBER * noise, HUBER * noise)
        block = max(1, error.shape[1] // BLOCKS)
        means = F.avg_pool2d(cut.permute(0, 3, 1, 2), block).mean(dim=1).square().mean(dim=(1, 2))
        each = cut.square().mean(dim=(1, 2, 3)).clamp_min(torch.finfo(torch.float64).tiny)
        return noise, (3 * block**2 * means / each).clamp_min(1).reshape(-1, 1, 1, 1)

    def cost(self, u: Tensor, evidence: tuple[Tensor, Tensor]) -> float:
        """The cost at u; infinite where a camera or light would be in the patch's plane."""
        views = moved(self.given, self.change(u))
        if float(torch.cat((views.camera[:, 2], views.light[:, 2])).min()) < NEAREST * views.size:
            return float("inf")
        return self._cost(u, self.residuals(self.drawn(views)), evidence)

    def linear(self, u: Tensor, evidence: tuple[Tensor, Tensor] | None = None) -> Linear:
        """The cost, linearized around u; default of ``evidence``: that of the residuals at u."""
        change = self.change(u)
        radiance = self.drawn(moved(self.given, change))
        error = self.residuals(radiance)
        noise, alike = evidence = evidence or self.evidence(error)
        brighter, darker = (color.encode(radiance * math.exp(by), self.transfer)
                            for by in (self.step, -self.step))
        by_exposure = (brighter - darker) / (2 * self.step)
        steep = over(by_exposure, radiance)  # the slope of the display value
        moves = self.step * torch.eye(CHANGE.size, dtype=torch.float64)[:CHANGE["log_exposure"].start]
        each = torch.cat([change + step for step in (*moves, *-moves)])  # of camera and flash
        drawn = self.drawn(moved(self.given.pick(torch.arange(len(each)) % len(change)), each))
        more, less = drawn.reshape(2, len(moves), *radiance.shape)
        columns = [each * steep / (2 * self.step) for each in more - less]
        slopes = torch.stack((*columns, by_exposure), dim=-1).flatten(1, 3)
        weights = (HUBER * noise / error.abs()).clamp_max(1) / (noise**2 * alike)
        weights = torch.where(self._bright_enough(error), 0.0, weights).flatten(1)[..., None]
        matrix = torch.block_diag(*(slopes.mT @ (weights * slopes)))
        gradient = (slopes.mT @ (weights * error.flatten(1)[..., None])).flatten()
        return Linear(u, evidence, self._cost(u, error, evidence), self.spread.T @ gradient + u,
                      self.spread.T @ matrix @ self.spread + torch.eye(len(u), dtype=torch.float64))

    def _cost(self, u: Tensor, error: Tensor, evidence: tuple[Tensor, Tensor]) -> float:
        noise, alike = evidence
        size = (error / noise).abs()
        return float((torch.where(size < HUBER, size**2 / 2, HUBER * size - HUBER**2 / 2) / alike).sum()
                     + u @ u / 2)

    def _bright_enough(self, error: Tensor) -> Tensor:
        return self.clipped & (error == 0)
