"""Error measures: pure functions of tensors, no files and no rendering. All sums are float64."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from .. import color
from ..errors import BackendError, CaptureError, ConfigError, MapsError
from ..material.encoding import ENCODINGS
from ..material.maps import SVBRDF
from ..views import strips

# Errors are relative to the pixel of the reference, or to this share of the reference's mean if it is larger.
FLOOR = 1e-3


def map_rmse(svbrdf: SVBRDF, reference: SVBRDF, encoding: str = "linear") -> dict[str, float]:
    """RMSE of the maps as the field reports it: over all texels and channels of maps encoded to [0, 1].

    Diffuse and specular are compared as linear^(1/2.2) and normals as (n + 1) / 2; roughness as r, or as
    r^(1/2.2) if the reference is stored with gamma. Principled maps are first converted to
    ``roughconductor`` maps. If the resolutions differ, the larger is area-averaged to the smaller first
    (:meth:`SVBRDF.resized`).

    Normals are compared as given. Published numbers use the vectors in the files, whose length is not
    exactly 1 after 8 bits or JPEG: the unit normals of ``load_maps`` give up to 0.001 less.

    Args:
        reference: the truth.
        encoding: of the reference's files, as in ``material.json``: ``linear``, ``gamma 2.2`` or ``srgb``.

    Returns:
        ``diffuse``, ``specular``, ``roughness``, ``normal`` and their ``mean``.

    Raises:
        ConfigError: an unknown encoding.

    Source: tables 1 and 2 of the paper; MaterialGAN (Guo et al. 2020).
    """
    if encoding not in ENCODINGS:
        raise ConfigError(f"an encoding of {list(ENCODINGS)}", repr(encoding), "choose one of these")
    size = min(svbrdf.resolution, reference.resolution)
    first, second = (s.detach().as_roughconductor().resized(size).maps for s in (svbrdf, reference))
    code, squares = ENCODINGS[encoding]["roughness"], dict.fromkeys(first, 0.0)
    for rows in strips(size):
        for name in first:
            one, other = (_encoded(name, maps[name][rows].double(), code) for maps in (first, second))
            squares[name] += float((one - other).square().sum())
    errors = {name: math.sqrt(square / first[name].numel()) for name, square in squares.items()}
    return errors | {"mean": sum(errors.values()) / len(errors)}


def _encoded(name: str, value: Tensor, roughness: str) -> Tensor:
    if name == "normal":
        return (value + 1) / 2
    return value if name == "roughness" and roughness != "gamma 2.2" else color.encode(value)


def photo_rmse(rerendered: Tensor, photos: Tensor, transfer: color.Transfer = "gamma2.2",
               measured: Tensor | None = None) -> tuple[float, list[float]]:
    """RMSE of re-rendered photos, in display values clipped to [0, 1], over all measured pixels and channels.

    Args:
        rerendered: N x R x R x 3, linear radiance.
        photos: N x R x R x 3, display values in [0, 1], or of 8 or 16 bits.
        transfer: how the photos encode radiance.
        measured: N x R x R, bool: which pixels count; None: all.

    Returns:
        The error over all photos (:func:`of_all`), and one for each photo; 0 without a measured pixel.

    Raises:
        CaptureError: shapes that differ, or no photo.
    """
    if rerendered.shape != photos.shape or photos.ndim != 4 or not len(photos):
        shapes = f"{tuple(rerendered.shape)} and {tuple(photos.shape)}"
        raise CaptureError("re-rendered and real photos of one shape N x R x R x 3", shapes,
                           "render every view at the photos' resolution")
    total = torch.zeros(len(photos), dtype=torch.float64)
    pixels = photos[0, ..., 0].numel() if measured is None else measured.sum(dim=(1, 2)).clamp_min(1)
    for rows in strips(photos.shape[1]):
        shown = color.to_display(rerendered[:, rows].detach().double(), transfer)
        squares = (shown - color.clip(color.shown(photos[:, rows]).double())).square()
        total += (squares if measured is None else squares * measured[:, rows, :, None]).sum(dim=(1, 2, 3))
    each = (total / pixels / photos.shape[3]).sqrt().tolist()
    return of_all(each, measured), each


def of_all(each: Sequence[float], measured: Tensor | None = None) -> float:
    """The RMSE over all measured pixels (N x R x R; None: all pixels), from the RMSE of each of N photos."""
    pixels = [1] * len(each) if measured is None else measured.sum(dim=(1, 2)).tolist()
    return math.sqrt(sum(n * error**2 for n, error in zip(pixels, each)) / max(sum(pixels), 1))


def image_error(image: Tensor, reference: Tensor) -> dict[str, float]:
    """Error of an image, value by value: :func:`relative_error` and :func:`error_statistics`."""
    return error_statistics(relative_error(image, reference))


def relative_error(image: Tensor, reference: Tensor) -> Tensor:
    """(image - reference) / max(|reference|, FLOOR mean |reference|), same shape, float64."""
    flat_image, flat_reference = _pair(image, reference)
    size = flat_reference.abs()
    least = max(FLOOR * float(size.mean()), torch.finfo(torch.float64).tiny)  # not 0 where all is black
    return ((flat_image - flat_reference) / size.clamp_min(least)).reshape(reference.shape)


def error_statistics(signed: Tensor) -> dict[str, float]:
    """Statistics of signed errors: ``mean``, ``p99.9`` and ``worst`` size, and ``bias`` (the signed mean)."""
    size = signed.abs().flatten()
    rank = math.ceil(0.999 * size.numel())
    return {"mean": float(size.mean()), "p99.9": float(size.kthvalue(rank).values),
            "worst": float(size.max()), "bias": float(signed.mean())}


def flip(image: Tensor, reference: Tensor, transfer: color.Transfer = "gamma2.2") -> Tensor:
    """How different two pictures look: FLIP error in [0, 1] of each pixel, at 67 pixels a degree.

    Args:
        image: H x W x 3, linear radiance; both are encoded by ``transfer`` and clipped, as a screen shows
            them.
        reference: the same shape.
        transfer: how the screen encodes light.

    Returns:
        H x W, float32.

    Raises:
        BackendError: the extra ``flip`` is not installed.
        MapsError: shapes that differ or are not H x W x 3.

    Source: Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images".
    """
    try:
        import flip_evaluator
    except ImportError:
        raise BackendError("flip-evaluator, which computes FLIP", "none",
                           'pip install "mitsvbrdf[flip]"') from None
    if image.shape != reference.shape or image.ndim != 3 or image.shape[2] != 3:
        raise MapsError("two pictures of one shape H x W x 3",
                        f"{tuple(image.shape)} and {tuple(reference.shape)}", "compare one view at a time")
    shown = (color.to_display(x.detach().float(), transfer).contiguous().numpy() for x in (reference, image))
    return torch.as_tensor(flip_evaluator.evaluate(*shown, "LDR", applyMagma=False,
                                                   computeMeanError=False)[0])[..., 0]


def gradient_error(gradient: Tensor, reference: Tensor) -> dict[str, float]:
    """How far a gradient is from a reference gradient, as whole vectors.

    ``relative_l2``: |g - r| / |r|; ``cosine`` of the angle between them; ``worst``: max |g - r| / max |r|;
    ``bias``: (g - r) r / |r|^2, by how much g is longer than r in the direction of r. If the reference is 0
    everywhere, all four are infinite or NaN.
    """
    gradient, reference = _pair(gradient, reference)
    off, length = gradient - reference, reference.norm()
    cosine = gradient @ reference / (gradient.norm() * length)
    return {"relative_l2": float(off.norm() / length), "cosine": float(cosine),
            "worst": float(off.abs().max() / reference.abs().max()),
            "bias": float(off @ reference / length**2)}


def _pair(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    if first.shape != second.shape or not first.numel():
        raise MapsError("two tensors of one shape, not empty",
                        f"{tuple(first.shape)} and {tuple(second.shape)}",
                        "compare the same maps, views and resolution")
    return first.detach().double().flatten(), second.detach().double().flatten()
