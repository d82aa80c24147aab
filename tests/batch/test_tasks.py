"""Ray itself: alone on loopback, gone with its command, a cluster whose nodes die, a head that dies."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

pytest.importorskip("ray")

from batch import chaos

from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.batch.settings import BatchSettings
from mitsvbrdf.batch.tasks import PREFIX, RayTasks
from mitsvbrdf.errors import BackendError

pytestmark = pytest.mark.slow
SIDE = 16


@pytest.fixture
def shots(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    chaos.make_captures(tmp_path / "shots", 8, SIDE)
    return tmp_path / "shots"


def started(shots, *words, workers=2):
    """A batch that has one result, and as a library."""
    batch = subprocess.Popen([*chaos.command(shots, Path("library"), SIDE, workers), *words], text=True,
                             stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    wait(lambda: chaos.done_in(Path("library")) or batch.poll() is not None)
    return batch


def wait(until, seconds=300.0):
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end
        time.sleep(0.05)


def again(shots):
    return subprocess.run(chaos.command(shots, Path("library"), SIDE, 2), capture_output=True,
                          text=True).returncode


def whole(count=8):
    found = chaos.counted(Path("library"))
    return (found["folders"], found["identities"], found["torn"], found["left over"]) == (count, count, 0, [])


def listening(pids):
    """Addresses on which these processes listen, as the system states them."""
    inodes = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                inodes.add(os.readlink(link))
            except OSError:
                continue
    lines = [line.split() for name in ("tcp", "tcp6")
             for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {words[1].rpartition(":")[0] for words in lines
            if words[3] == "0A" and f"socket:[{words[9]}]" in inodes}


def folders_of_ray():
    return Path(tempfile.gettempdir()).glob(f"{PREFIX}*")


def test_a_ray_of_its_own_listens_on_loopback_alone_and_ends_with_the_command(shots):
    batch = started(shots)
    pids = chaos.below(batch.pid, "")
    words = "".join(Path(f"/proc/{pid}/cmdline").read_text() for pid in pids)
    (folder,) = (each for each in folders_of_ray() if str(each) in words)  # beside those of other batches
    assert folder.stat().st_mode & 0o077 == 0
    assert listening(pids) <= {"0100007F", "0000000000000000FFFF00000100007F"}, listening(pids)
    assert batch.wait(300) == 0 and whole()
    wait(lambda: not [pid for pid in pids if Path(f"/proc/{pid}").exists()], 60)
    assert not folder.exists()


def test_no_worker_outlives_a_command_that_is_killed_and_the_same_goes_on(shots):
    batch = started(shots)
    workers = chaos.below(batch.pid, *chaos.WORKER)
    batch.kill()
    batch.wait()
    wait(lambda: not [pid for pid in workers if Path(f"/proc/{pid}").exists()], 60)
    assert again(shots) == 0 and whole()


@pytest.mark.parametrize("part", chaos.HEAD)
def test_a_head_that_dies_is_an_error_and_the_same_goes_on(shots, part):
    batch = started(shots)
    os.kill(chaos.below(batch.pid, part)[0], signal.SIGKILL)
    said = batch.communicate(timeout=120)[0]
    assert batch.returncode == 2 and "run the same command again: it goes on" in said, said
    assert again(shots) == 0 and whole()


def test_code_of_the_current_folder_does_not_run_in_workers(shots):
    for name in ("torch", "mitsuba", "cv2"):
        Path(f"{name}.py").write_text(f"open({str(shots.parent / 'hit')!r}, 'w')\nraise SystemExit")
    start = chaos.command(shots, Path("library"), SIDE, 1)
    assert subprocess.run([start[0], "-P", *start[1:]]).returncode == 0
    assert whole() and not Path("hit").exists()


def test_a_node_that_dies_loses_nothing(shots):
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
        batch = started(shots, "--address", cluster.address)
        cluster.remove_node(nodes[0], allow_graceful=False)
        said = batch.communicate(timeout=500)[0]
    finally:
        cluster.shutdown()
    assert batch.returncode == 0 and whole(), said


def test_an_address_without_a_cluster_is_an_error(shots):
    batch = started(shots, "--address", "127.0.0.1:1")
    said = batch.communicate()[0]
    assert batch.returncode == 2 and "ray start --head" in said, said
    assert not ResultStore("library").names()


def test_ray_that_was_imported_before_is_one_clear_error(monkeypatch, tmp_path):
    """It has read no token then, and would wait for half a minute."""
    monkeypatch.setitem(sys.modules, "ray", sys)
    monkeypatch.delenv("RAY_AUTH_MODE")
    with pytest.raises(BackendError, match="not imported yet"):
        RayTasks(BatchSettings())._start(tmp_path)
