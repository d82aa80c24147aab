"""Fixtures that the tests of this folder share."""

import os

import pytest
from helpers import photos_of

from mitsvbrdf.material.made import make_material


@pytest.fixture(scope="module", autouse=True)
def one_thread_a_worker():
    """Workers share the cores: a second thread of Dr.Jit waits for the other one. Scenes need it."""
    import drjit
    threads = drjit.thread_count()
    if "PYTEST_XDIST_WORKER" in os.environ:
        drjit.set_thread_count(1)
    yield
    drjit.set_thread_count(threads)


@pytest.fixture(scope="session")
def leather():
    return photos_of(make_material("leather", 16))


@pytest.fixture(scope="session")
def capture():
    return photos_of(make_material("inlay", 32))
