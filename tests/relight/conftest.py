"""Fixtures that the tests of this folder share."""



import pytest
import torch

from mitsvbrdf.render.llvm import mitsuba_module


@pytest.fixture(scope="session")
def mi():
    return mitsuba_module()


# Movies, read back by PyAV and pillow

@pytest.fixture(scope="session")
def frames():
    """Twelve frames of odd size, smooth colours that move."""
    y, x = torch.meshgrid(torch.linspace(0, 1, 63), torch.linspace(0, 1, 65), indexing="ij")
    return [torch.stack((x, y, torch.full_like(x, 0.2 + k / 20)), dim=-1) for k in range(12)]
