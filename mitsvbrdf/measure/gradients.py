"""A rendered image, the gradients of every map, and the seconds of both, for comparisons of renderers."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import ConfigError
from ..io.entry import entry
from ..io.timing import timed
from ..material.maps import SVBRDF
from ..render import Renderer
from ..views import Views


@dataclass(frozen=True)
class Measured:
    """One forward and one backward pass."""

    image: Tensor  # linear radiance N x R x R x 3
    # map name to the gradient of the inner product of image and cotangent, of the map's shape
    gradients: dict[str, Tensor]
    forward: float  # seconds of the forward pass
    backward: float  # seconds of the backward pass


def fixed_cotangent(shape: torch.Size) -> Tensor:
    """The same normally distributed numbers in every run, float32."""
    return torch.randn(shape, generator=torch.Generator().manual_seed(1))


@entry(gradients=True)
def render_and_gradients(renderer: Renderer, svbrdf: SVBRDF, views: Views, cotangent: Tensor | None = None,
                         ) -> Measured:
    """Render, and differentiate the inner product of image and ``cotangent`` (N x R x R x 3) by every map.

    Default: :func:`fixed_cotangent`. ``analytic64`` gets the maps in float64, so its gradients are float64
    too. ConfigError: the image has no gradient.
    """
    dtype = torch.float64 if renderer.name == "analytic64" else torch.float32
    leaves = svbrdf.to(dtype).map(lambda t: t.detach().clone().requires_grad_())
    image, forward = timed(renderer.render, leaves, views)
    if not image.requires_grad:
        raise ConfigError("an image that carries gradients to the maps", f"one of {renderer.name} without",
                          "make the renderer differentiable, or compare the images alone (gradients=math.inf "
                          "in assert_renderers_agree)")
    cotangent = (fixed_cotangent(image.shape) if cotangent is None else cotangent).to(image)
    # a sum: given the cotangent of an image, autograd.grad would import sympy, which takes a second
    product = (image * cotangent).sum()
    gradients, backward = timed(torch.autograd.grad, product, list(leaves.maps.values()))
    return Measured(image.detach(), dict(zip(leaves.maps, gradients)), forward, backward)
