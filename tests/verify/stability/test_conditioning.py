"""Jacobians in closed form."""

import math

import pytest
import torch
import torch.nn.functional as F
from helpers import TWIN

from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.verify.stability.conditioning import condition, jacobian, tangents
from mitsvbrdf.verify.stability.sweeps import tilted
from mitsvbrdf.views import Views


def test_singular_values_in_closed_form():
    # Co-located straight above an upright texel: D = 1 / (pi r^4), so radiance is E (rho / pi + F0 / (4 pi
    # r^4)), with E the irradiance of each view. Per channel the row E (1 / pi, 1 / (4 pi r^4), -F0 / (pi
    # r^5)); tilting changes nothing to first order in n.h, and 1 - cos is flat. So J J^T is a multiple of the
    # identity plus an outer product.
    r, f0, heights = 0.5, (0.1, 0.3, 0.7), (1.0, 2.0, 4.0)
    maps = dict(flat(1, roughness=r).maps) | {"specular": torch.tensor(f0).expand(1, 1, 3)}
    views = Views.of([[0, 0, z] for z in heights])
    j = jacobian(TWIN, SVBRDF("roughconductor", maps), views, display=lambda radiance: radiance)
    power = sum(z**-4 for z in heights)
    base = (1 / math.pi) ** 2 + (1 / (4 * math.pi * r**4)) ** 2
    u2 = sum((torch.tensor(f0).double() / (math.pi * r**5)) ** 2).item()
    expected = [math.sqrt(power * x) for x in (base + u2, base, base)]
    assert j.shape == (1, 9, 9)
    # the maps are float32
    assert torch.linalg.svdvals(j)[0, :3].tolist() == pytest.approx(expected, rel=1e-6)
    found = condition(j)
    assert found["rank"] == 3 and found["unknowns"] == 9 and found["median"] is None and found[
        "worst"] is None


def test_condition_of_known_matrices():
    # Orthogonal matrices around a diagonal: the condition number is the diagonal's.
    q = torch.linalg.qr(torch.randn(3, 6, 6, generator=torch.Generator().manual_seed(0),
                                    dtype=torch.float64)).Q
    diagonals = torch.tensor([[8.0, 4, 2], [100, 10, 1], [5, 5, 5]], dtype=torch.float64)
    found = condition(q[..., :3] @ torch.diag_embed(diagonals) @ q[:, :3, :3].mT)
    assert found["rank"] == 3
    # The middle of 1, 4 and 100 up to the angle between the random blocks: recompute it the slow way.
    slow = sorted(float(torch.linalg.cond(m)) for m in q[..., :3] @ torch.diag_embed(diagonals) @ q[:, :3,
                                                                                                    :3].mT)
    assert found["median"] == pytest.approx(slow[1], rel=1e-9) and found["worst"] == pytest.approx(slow[2],
                                                                                                   rel=1e-9)


def test_tangents_are_an_orthonormal_frame():
    n = F.normalize(torch.cat((tilted(89.9), tilted(0), tilted(90, 0))), dim=-1)
    frame = torch.cat((tangents(n), n[..., None, :]), dim=-2)
    assert torch.allclose(frame @ frame.mT, torch.eye(3, dtype=torch.float64), atol=1e-12)
