"""The response curve of a phone's photos: two numbers, gamma and shoulder, that all photos share.

Maps adapt to a wrong curve, so with fixed maps the curve would not move. Therefore the curve moves as if
every texel followed at once: texels are eliminated from the normal equations (Schur complement; Triggs et al.
1999). Held-out photos decide whether the curve is used.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from ... import color
from ...render import Renderer
from .scales import Scale
from .solver import Observations
from .starts import stepped
from .texel_prior import LEAST_PRECISION, TexelEstimate, TexelPrior
from .time_budget import STEPS

ROUNDS = 10  # at most
TRIALS = 3  # lengths of a step that are tried at most; each is a quarter of the one before
STILL = 0.05  # a shorter step ends the search
WORK = ROUNDS * (TRIALS * STEPS + 5)  # in steps of the solver, at most
CLEAR = 0.02  # least share of the data cost that a curve must save to be used
LIMITS = torch.tensor(((0.4, 4.0), (-0.8, 10.0)), dtype=torch.float64)  # of gamma and shoulder
LONGEST, DIFFERENCE = 0.5, 1e-3  # longest step of a number; step of the central differences
VAGUE = 1.0  # prior precision of both numbers
Sharing = Callable[[Scale, Observations, TexelEstimate], TexelEstimate]  # gives the prior of the next round


def curved(scale: Scale, answer: TexelEstimate, observed: Callable[[Scale, TexelEstimate], Observations],
           prior: TexelPrior, next_prior: Sharing, renderer: Renderer) -> tuple[Scale, TexelEstimate] | None:
    """The scale with the last curve of the search, and its answer; None if no round saved :data:`CLEAR`.

    The photos of ``scale`` have no curve yet; ``observed`` gives the photos of a round.
    """
    plain, solver = scale.capture.transfer, scale.solver
    first = stepped(solver, observed(scale, answer), answer, prior, STEPS)
    curve, answer, data = color.Curve(1.0, 0.0), answer._replace(x=first.x), float(first.data.mean())
    least, found = data, (scale, answer)
    for _ in range(ROUNDS):
        photos = observed(*found)
        before = stepped(solver, photos, answer, prior, 0)
        step, shorter = _step(curve, *found, photos, renderer), 1.0
        for _ in range(TRIALS):
            bend = color.Curve(*(torch.tensor(curve) + shorter * step).clamp(*LIMITS.T).tolist())
            bent = replace(scale, capture=scale.capture.but(transfer=bend.behind(plain)))
            photos = observed(bent, answer)
            solved = stepped(solver, photos, answer, prior, STEPS)
            if (solved.data + solved.prior).mean() < (before.data + before.prior).mean():
                break
            shorter /= 4
        else:
            break
        curve, least = bend, min(least, float(solved.data.mean()))
        answer = next_prior(bent, photos, answer._replace(x=solved.x))
        found = bent, answer
        if shorter * float(step.abs().max()) < STILL:
            break
    return found if least < (1 - CLEAR) * data else None


def _step(curve: color.Curve, scale: Scale, answer: TexelEstimate, photos: Observations,
          renderer: Renderer) -> Tensor:
    """The Gauss-Newton step of the curve, two numbers, if every texel follows the curve."""
    with torch.no_grad():
        images = renderer.render(scale.solver.svbrdf(answer.x), photos.views)
    display, do = color.encode(images, color.parts(photos.transfer)[0]), color.of_torch()
    shown, (seen, weights) = curve.bent(display, do), photos.read()
    error = shown - seen
    slopes = [(curve._replace(**{name: value + DIFFERENCE}).bent(display, do)
               - curve._replace(**{name: value - DIFFERENCE}).bent(display, do)) / (2 * DIFFERENCE)
              for name, value in curve._asdict().items()]
    weight = ((seen < color.CLIPPED) | (error < 0)).float()
    if photos.robust is not None:
        weight = weight / (1 + (error / photos.robust).square()).sqrt()
    weight = weight.amin(dim=-1) * (1 if weights is None else weights)  # one weight a pixel, for the solver
    alone = replace(photos, robust=None, weights=weight, sensor=None)
    columns = []
    for column in (error, *slopes):  # J^T W of each
        _, slope, matrix = scale.solver.normal_equations(replace(alone, photos=shown - column), answer.x)
        columns.append(slope)
    columns[0] = columns[0] + answer.precision * (answer.x - answer.mean)
    hold = torch.diag_embed((answer.precision + LEAST_PRECISION).expand_as(answer.x).movedim(0, -1))
    right = torch.stack(columns, dim=-1).movedim(0, -2).double()  # R x R x U x 3
    followed = torch.linalg.solve(matrix.permute(2, 3, 0, 1).double() + hold.double(), right)
    values = torch.stack([column.flatten() for column in (error, *slopes)]).double()
    weight = (weight[..., None].expand_as(error).flatten() / photos.noise**2).double()
    left = (values * weight) @ values.T - torch.einsum("abuk,abul->kl", right, followed)
    step = torch.linalg.solve(left[1:, 1:] + VAGUE * torch.eye(2, dtype=torch.float64), -left[1:, 0])
    return step.clamp(-LONGEST, LONGEST)
