"""The losses, each a plain function of tensors, unweighted."""

from collections.abc import Collection, Mapping, Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import color
from ..color import CLIPPED
from ..material.maps import CHANNELS, SVBRDF, Bsdf

# NAMES: the losses that have a weight, with their names for users. ABOUT: the maps that a loss concerns; the
# other losses concern the photos.
NAMES = {"photometric": "photometric loss", "diffuse": "diffuse loss",
         "smooth": "smoothness of specular and roughness",
         "flat": "price on tilted normals", "adversarial": "adversarial loss", "features": "feature matching"}
Game = Literal["relativistic", "bce", "hinge"]
ABOUT = {"diffuse": ("diffuse", "base_color", "metallic"), "smooth": ("specular", "metallic", "roughness"),
         "flat": ("normal",)}


def unused(weights: Mapping[str, float], bsdf: Bsdf, fixed: Collection[str]) -> dict[str, str]:
    """The losses that a fit does not compute: name to reason. Their weight is 0, or their maps are fixed."""
    reasons = {}
    for name, weight in weights.items():
        about = [m for m in ABOUT.get(name, ()) if m in CHANNELS[bsdf]]
        if weight == 0:
            reasons[name] = "its weight is 0"
        elif about and set(about) <= set(fixed):
            reasons[name] = f"{' and '.join(about)} held fixed"
    return reasons


def weighted(terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> Tensor:
    """The sum of losses, each times its weight."""
    return sum((weights[name] * value for name, value in terms.items()), torch.zeros(()))


def photometric(rendered: Tensor, photos: Tensor, transfer: color.Transfer) -> Tensor:
    """Mean of |e| + 5 e^2 of the error e in display values; at clipped pixels only too dark values count.

    The absolute part is robust; with the squared part, the few bright highlights keep their weight.
    Measured on `cards-blue` at equal time, against the absolute part alone: photos seen 0.0369 -> 0.0342,
    held out 0.0628 -> 0.0616.

    Rendered is linear radiance N x R x R x 3, unclamped; photos are display values in [0, 1].
    """
    error = color.encode(rendered, transfer) - photos
    size = torch.where(photos >= CLIPPED, error.clamp_max(0), error).abs()
    return (size + 5 * size**2).mean()


def diffuse(svbrdf: SVBRDF, guess: Tensor) -> Tensor:
    """Mean absolute distance of diffuse map and guess, gamma 2.2 encoded (paper III.A, III.F)."""
    return F.l1_loss(color.encode(svbrdf.as_roughconductor()["diffuse"]), color.encode(guess))


def total_variation(svbrdf: SVBRDF, edges: Tensor, fixed: Collection[str] = ()) -> Tensor:
    """Mean absolute step of specular/metallic and roughness, with less weight at edges of the guess (ours).

    Args:
        fixed: names of the fixed maps, which are not counted.
        edges: the two R x R x 1 weights of :func:`edge_weights`, for steps down and to the right.
    """
    down, right = edges
    loss = torch.zeros(())
    for name in ABOUT["smooth"]:
        if name in svbrdf.maps and name not in fixed and svbrdf.resolution > 1:
            m = svbrdf[name]
            loss = (loss + ((m[1:] - m[:-1]).abs() * down[:-1]).mean()
                    + ((m[:, 1:] - m[:, :-1]).abs() * right[:, :-1]).mean())
    return loss


def edge_weights(guess: Tensor) -> Tensor:
    """Weights 2 x R x R x 1 in (0, 1]: exp(-10 * step of the encoded guess) down and right."""
    g = color.encode(guess)
    down = F.pad((g[1:] - g[:-1]).abs().amax(-1, keepdim=True), (0, 0, 0, 0, 0, 1))
    right = F.pad((g[:, 1:] - g[:, :-1]).abs().amax(-1, keepdim=True), (0, 0, 0, 1, 0, 0))
    return torch.exp(-10.0 * torch.stack((down, right)))


def tilt(svbrdf: SVBRDF) -> Tensor:
    """Mean of the sine of the normals' tilt; it keeps normals flat unless the photos need relief (ours)."""
    x, y = svbrdf["normal"][..., 0], svbrdf["normal"][..., 1]
    return torch.sqrt(x**2 + y**2 + 1e-8).mean()


def discriminator(real: Tensor, fake: Tensor, game: Game = "bce") -> Tensor:
    """The loss of the discriminator.

    Args:
        real: logits of photos.
        fake: logits of renderings, the same shape.
        game: ``bce``, cross entropy with photos 1 and renderings 0 (Goodfellow 2014); ``hinge``, the hinge
            loss (Lim 2017); ``relativistic``, -log of the probability that a photo looks more real than its
            paired rendering (Jolicoeur-Martineau 2019).
    """
    if game == "relativistic":
        return F.softplus(fake - real).mean()
    if game == "hinge":
        return (F.relu(1 - real).mean() + F.relu(1 + fake).mean()) / 2
    return (F.softplus(-real).mean() + F.softplus(fake).mean()) / 2


def adversarial(real: Tensor, fake: Tensor, game: Game = "bce") -> Tensor:
    """The generator's loss, from the same logits; ``bce``: -log of the probability of being a photo."""
    if game == "relativistic":
        return F.softplus(real - fake).mean()
    return -fake.mean() if game == "hinge" else F.softplus(-fake).mean()


def features(real: Sequence[Tensor], fake: Sequence[Tensor]) -> Tensor:
    """Mean distance of activations, each layer divided by its mean size for photos (Salimans 2016)."""
    return torch.stack(
        [(f - r).abs().mean() / r.abs().mean().clamp_min(1e-3) for r, f in zip(real, fake)]).mean()
