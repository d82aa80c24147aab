"""What texels say of the numbers they share, with the numbers of their own integrated out instead of
maximised.

The most probable slopes and diffuse colour of a texel explain its photos too well: slopes take up scatter
that belongs to the roughness. Beside thousands of such numbers the few that are shared come out wrong by an
amount that more texels do not mend (Neyman and Scott 1948). Laplace's approximation of the integral over the
own numbers y,

    int exp(-cost / 2) dy  ~  exp(-cost / 2) |H_yy|^(-1/2),    H = J^T W J + precision,

adds log |H_yy| to the cost, and that moves the maximum of the rest by -V grad log |H_yy| / 2, V = H^-1: the
first-order correction of Cox and Snell 1968 and Firth 1993. It grows with the square of the noise, so it
takes the noise that is seen, which is less than the noise that texels are allowed.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .solver import Observations, TexelSolver

STEP = 0.01  # of the differences, in numbers between 0 and 1
FARTHEST = 1.0  # standard deviations that a number may be moved by; the approximation knows no more


def integrated(solver: TexelSolver, observations: Observations, x: Tensor, precision: Tensor, shared: Tensor,
               low: Tensor, high: Tensor) -> Tensor:
    """The most probable unknowns of each texel, the shared ones as they are with the others integrated out.

    Args:
        solver: of the texels.
        observations: the photos.
        x: the most probable unknowns, U x R x R.
        precision: of the prior, U x R x R, above 0.
        shared: positions of the unknowns to move.
        low: lowest value of each unknown, U numbers.
        high: the highest.

    Returns:
        U x R x R, float32, within the bounds.
    """
    own = torch.tensor([u for u in range(len(x)) if u not in shared.tolist()], dtype=torch.long)
    if not len(own) or not len(shared):
        return x

    def matrix(at: Tensor) -> tuple[Tensor, Tensor]:
        cost, _, curve = solver.normal_equations(observations, at)
        return cost, curve.permute(2, 3, 0, 1).double() + torch.diag_embed(precision.permute(1, 2,
                                                                                             0).double())

    def volume(at: Tensor) -> Tensor:
        return torch.linalg.slogdet(matrix(at)[1][..., own[:, None], own]).logabsdet

    cost, here = matrix(x)
    values = max(3 * len(observations.photos) - len(x), 1)  # that a texel's unknowns leave to its errors
    noise = float((cost.mean() / values).clamp_max(1))
    slopes = []
    for u in shared.tolist():
        more, less = x.clone(), x.clone()
        more[u], less[u] = (x[u] + STEP).clamp_max(float(high[u])), (x[u] - STEP).clamp_min(float(low[u]))
        slopes.append((volume(more) - volume(less)) / (more[u] - less[u]).double())
    covariance = torch.linalg.inv(here)[..., shared[:, None], shared]
    step = -0.5 * noise * (covariance @ torch.stack(slopes, dim=-1)[..., None])[..., 0]
    reach = FARTHEST * covariance.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
    found = x.clone()
    found[shared] += torch.maximum(torch.minimum(step, reach), -reach).permute(2, 0, 1).float()
    return torch.maximum(torch.minimum(found, high[:, None, None]), low[:, None, None])
