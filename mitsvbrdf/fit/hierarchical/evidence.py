"""The likelihood of each texel's shared numbers (specular, metallic, roughness) over all roughnesses.

The tails of GGX show only F0 alpha^2. If no photo shows a texel's highlight, a valley of answers explains its
photos equally well, and a search that starts at the wrong end of the valley stays there. So each texel is
solved at each of several roughnesses, with all other numbers free (profile likelihood; Murphy and van der
Vaart 2000). Around each answer, the likelihood is a Gaussian of the shared numbers (Schur complement).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from .solver import Observations, TexelSolver
from .specular_test import least_errors
from .texel_prior import LEAST_PRECISION, TexelEstimate, TexelPrior

WIDTHS = tuple(0.8 / 1.32**k for k in range(13, -1, -1))  # roughnesses; alpha grows by 1.74 a step
STEPS, OTHERS = 6, 4  # solver steps from each start; other starts of a texel, with half as many steps each
# search and learning of lobes, in solver steps; with 9 photos, learning takes 2 to 3 times as long as search
SEARCH_STEPS = 4 * 2 * len(WIDTHS) * (2 * STEPS + OTHERS * (STEPS // 2))
ROUNDING = 1e-5  # of float32 sums; a diagonal is raised by this share, so that matrices stay definite


class Evidence(NamedTuple):
    """Costs of the photos of M texels around G answers each, as functions of S shared numbers; float64.

    At shared numbers x + d, a texel costs cost + 2 slope d + d curve d: -2 log of its likelihood, with its
    other numbers integrated out (Laplace). So a narrow lobe that fits only one pixel's noise gains nothing.

    Args:
        x: shared numbers of the answers, G x M x S.
        cost: G x M.
        slope: G x M x S.
        curve: G x M x S x S.
    """

    x: Tensor
    cost: Tensor
    slope: Tensor
    curve: Tensor


def searched(solver: TexelSolver, photos: Observations, prior: TexelPrior,
             x: Tensor) -> tuple[list[Tensor], Tensor]:
    """The answers of texels at each of :data:`WIDTHS`, and the best ones, U x R x R each.

    Each answer is a start of the search at the next roughness; the first start is ``x``, U x R x R. The noise
    of the photos does not matter.
    """
    found = [x] * len(WIDTHS)
    best, least = x, torch.full_like(x[0], torch.inf, dtype=torch.float64)
    for turn in (0, 1):
        last = x
        for k in range(len(WIDTHS))[::1 - 2 * turn]:  # upwards, then downwards
            held = prior.within("roughness", WIDTHS[k], WIDTHS[k])
            last, errors = least_errors(solver, photos, held, [found[k], last], 1, STEPS, turn)
            found[k] = last
            best, least = torch.where(errors < least, last, best), errors.minimum(least)
    return found, best


def evidence(solver: TexelSolver, photos: Observations, answer: TexelEstimate, shared: Tensor,
             answers: list[Tensor]) -> Evidence:
    """The :class:`Evidence` on the unknowns at S positions ``shared``, around ``answers``, U x R x R each.

    The other unknowns of each texel have the prior of ``answer``.
    """
    own = torch.tensor([u for u in range(len(answers[0])) if u not in shared.tolist()], dtype=torch.long)
    mean, precision = (t[own].flatten(1).T.double() for t in (answer.mean, answer.precision))
    parts = list[tuple[Tensor, ...]]()
    for x in answers:
        cost, slope, curve = (t.flatten(-2).movedim(-1, 0).double()
                              for t in solver.normal_equations(photos, x))
        curve = curve + torch.diag_embed(ROUNDING * curve.diagonal(dim1=1, dim2=2) + LEAST_PRECISION)
        off = x[own].flatten(1).T.double() - mean
        inner = curve[:, own[:, None], own] + torch.diag_embed(precision)
        outer = curve[:, own[:, None], shared]
        known = torch.cat((outer, (slope[:, own] + precision * off)[..., None]), dim=2)
        taken = outer.mT @ torch.linalg.solve(inner, known)
        cost = cost + (precision * off.square() - precision.log()).sum(dim=1)
        parts.append((x[shared].flatten(1).T.double(), cost + torch.linalg.slogdet(inner).logabsdet,
                      slope[:, shared] - taken[..., -1], curve[:, shared[:, None], shared] - taken[..., :-1]))
    return Evidence(*(torch.stack(part) for part in zip(*parts, strict=True)))
