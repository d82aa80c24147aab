"""What the gateway refuses, without Ray."""

from __future__ import annotations

import pytest

from mitsvbrdf.batch.workers.gateway import CannotStart, Gateway, Worker
from mitsvbrdf.batch.workers.worker import WorkerActor


@pytest.fixture
def gateway(tmp_path):
    made = Gateway(-1, tmp_path)
    made._options = {"library": "/shared/library", "threads": 1}
    return made


def test_a_node_with_another_version_is_refused(gateway):
    with pytest.raises(CannotStart, match="node-7 has mitsvbrdf 0.0.1"):
        gateway._greeted(Worker(None), {"host": "node-7", "pid": 1, "version": "0.0.1"})


def test_a_node_that_does_not_see_the_library_is_refused(gateway):
    with pytest.raises(CannotStart, match="node-7 does not see /shared/library"):
        gateway._up(Worker(None), {"host": "node-7", "pid": 1, "version": "0", "seen": False})


def test_a_worker_sees_a_file_only_with_its_content(tmp_path):
    (tmp_path / ".token").write_text("3f2a")
    see = WorkerActor.sees
    assert see(None, str(tmp_path / ".token"), "3f2a")
    assert not see(None, str(tmp_path / ".token"), "other")
    assert not see(None, str(tmp_path / "none"), "3f2a")
