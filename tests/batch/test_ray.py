"""The pool with a real Ray, real workers, and a child that only acts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from mitsvbrdf.batch.workers.pool import RayPool
from mitsvbrdf.errors import BackendError

pytest.importorskip("ray", reason="needs Ray: pip install 'mitsvbrdf[batch]'", exc_type=ImportError)
pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")

CHILD = (sys.executable, "-P", str(Path(__file__).with_name("fake_child.py")))
HANG = 180.0  # seconds after which a test gives up


@pytest.fixture
def make_pool(tmp_path):
    made = []

    def make(workers=2, library=None, **more):
        library = library or tmp_path
        (library / ".token").write_text("3f2a")
        made.append(RayPool(str(library), workers=workers, child=CHILD, log=tmp_path / "ray.log", **more))
        return made[-1]

    yield make
    for pool in made:
        pool.close()


def await_events(pool, what, count=1):
    """So many events of one kind, whatever comes between."""
    found, deadline = [], time.monotonic() + HANG
    while len(found) < count:
        assert time.monotonic() < deadline, f"{count} {what} awaited, {found} came"
        found += [event for event in pool.events(0.5) if event["is"] == what]
    return found


def task(attempt, capture="print:hello"):
    return {"attempt": attempt, "capture": capture}


def processes(session):
    """The living processes of a session: pid to command line."""
    found = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its = file.read_text().rpartition(")")[2].split()[:4]
            if int(its) == session and state != "Z":
                found[int(file.parent.name)] = file.with_name("cmdline").read_text().replace("\0", " ")
        except OSError:
            pass
    return found


def await_end(pids):
    """Wait until these processes are gone."""
    deadline = time.monotonic() + HANG
    while left := [pid for pid in pids if Path(f"/proc/{pid}/cmdline").exists()
                   and Path(f"/proc/{pid}/cmdline").read_text()]:
        assert time.monotonic() < deadline, left
        time.sleep(0.05)


class Household:
    """The processes of a pool's gateway, and Ray's folder."""

    def __init__(self, session) -> None:
        self.session = session
        self.all = processes(self.session)
        self.folder = next(Path(words.split("--log_dir=")[1].split("/session_")[0]).parent
                           for words in self.all.values() if "gcs_server " in words)

    def find(self, victim):
        if victim in ("gateway", "driver"):  # it is the first's child
            return (self.session if victim == "gateway"
                    else min(pid for pid in self.all if pid != self.session))
        return next(pid for pid, words in self.all.items() if victim in words.split(" --")[0])


@pytest.mark.slow
def test_a_ray_of_its_own_listens_on_loopback_alone_and_leaves_nothing(make_pool):
    pool = make_pool(workers=1)
    worker = await_events(pool, "worker")[0]["worker"]
    pool.run(worker, task("a1"))
    done = await_events(pool, "done")[0]
    assert (done["attempt"], done["outcome"]["state"], done["outcome"]["log"]) == ("a1", "done", "hello\n")
    home = Household(pool._gateway._process.pid)
    assert home.folder.name.startswith("mitsvbrdf-ray-") and home.folder.stat().st_mode & 0o77 == 0
    assert listening(set(home.all)) == {"127.0.0.1"}
    pool.close()
    assert not processes(home.session) and not home.folder.exists()
    await_end([done["outcome"]["row"]["pid"]])


def listening(pids):
    """The addresses at which processes listen, as the kernel tells."""
    inodes = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                inodes.add(os.readlink(link))
            except OSError:
                pass
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A" and f"socket:[{words[9]}]" in inodes:
                # also of an address of version 4 in one of version 6
                last = bytes.fromhex(words[1].split(":")[0])[-4:][::-1]
                found.add(".".join(map(str, last)))
    return found


def test_a_folder_that_is_no_library_is_refused(make_pool, tmp_path):
    pool = make_pool()
    (tmp_path / ".token").unlink()
    with pytest.raises(BackendError, match=r"is no library: .* at \.token"):
        await_events(pool, "worker")


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["WorkerActor", "driver", "gateway", "gcs_server", "raylet"])
def test_whatever_is_killed_the_work_comes_back_and_nothing_stays(make_pool, victim):
    pool = make_pool()
    workers = [event["worker"] for event in await_events(pool, "worker", 2)]
    for worker in workers:
        pool.run(worker, task("first", ""))
    children = [event["outcome"]["row"]["pid"] for event in await_events(pool, "done", 2)]
    for worker in workers:
        pool.run(worker, task(f"of {worker}", "sleep:600"))
    home, killed = Household(pool._gateway._process.pid), 1 if victim == "WorkerActor" else 2
    os.kill(home.find(victim), signal.SIGKILL)
    lost = await_events(pool, "lost", killed)
    assert all(event["attempt"] == f"of {event['worker']}" and event["worker"] in workers for event in lost)
    if killed == 2:
        await_end(children)
        await_end(home.all)
        assert victim == "gateway" or not home.folder.exists()
    new = await_events(pool, "worker", killed)[0]["worker"]
    assert new not in workers
    assert not home.folder.exists() or killed == 1  # swept by the new gateway
    pool.run(new, task("again"))
    assert await_events(pool, "done")[0]["attempt"] == "again"


@pytest.mark.slow
def test_all_ends_when_the_supervisor_is_killed(tmp_path):
    (tmp_path / ".token").write_text("3f2a")
    program = ("from mitsvbrdf.batch.workers.pool import RayPool\n"
               f"pool = RayPool({str(tmp_path)!r}, workers=1, child={CHILD!r})\n"
               "while not pool.events(1.0): pass\nprint(pool._gateway._process.pid, "
               "flush=True)\npool.events(600.0)")
    supervisor = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    home = Household(int(supervisor.stdout.readline()))
    supervisor.kill()
    supervisor.communicate()
    await_end(home.all)
    assert len(home.all) > 5 and not home.folder.exists()


@pytest.mark.slow
def test_two_batches_do_not_meet(make_pool, tmp_path):
    libraries = [tmp_path / name for name in "ab"]
    for library in libraries:
        library.mkdir()
    pools = [make_pool(1, library) for library in libraries]
    workers = [await_events(pool, "worker")[0] for pool in pools]
    for pool, worker in zip(pools, workers):
        pool.run(worker["worker"], task("a1"))
        assert await_events(pool, "done")[0]["attempt"] == "a1"
    pools[0].close()
    pools[1].run(workers[1]["worker"], task("a2"))
    assert await_events(pools[1], "done")[0]["attempt"] == "a2"


@pytest.mark.slow
def test_the_gateway_does_not_grow(make_pool):
    pool, given, done = make_pool(), 0, 0
    sizes = {}
    while done < 2500:
        for event in pool.events(10.0):
            done += event["is"] == "done"
            pool.run(event["worker"], task(f"a{(given := given + 1)}"))
            if done in (500, 2500):
                status = Path(f"/proc/{Household(pool._gateway._process.pid).find('driver')}/status").read_text()
                sizes[done] = int(status.split("VmRSS:")[1].split()[0]) << 10
    assert sizes[2500] < sizes[500] + (10 << 20)  # 3 MB measured, the allocator's


@pytest.mark.slow
def test_workers_of_a_cluster_come_and_go_with_its_nodes(make_pool, monkeypatch):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    Path(tempfile.gettempdir(), "ray").mkdir(exist_ok=True)  # cluster_utils writes there
    from ray.cluster_utils import Cluster

    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp") as folder:
        node = {"num_cpus": 1, "object_store_memory": 80 << 20}
        cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False,
                                                                       "temp_dir": folder})
        try:
            second = cluster.add_node(**node)
            pool = make_pool(None, address=cluster.address)
            for worker in await_events(pool, "worker", 2):
                pool.run(worker["worker"], task(f"of {worker['worker']}", "sleep:600"))
            cluster.add_node(**node)
            third = await_events(pool, "worker")[0]["worker"]
            second.all_processes["raylet"][0].process.kill()
            lost = await_events(pool, "lost")
            assert lost[0]["attempt"] == f"of {lost[0]['worker']}"
            pool.run(third, task("a3"))
            assert await_events(pool, "done")[0]["worker"] == third
        finally:
            cluster.shutdown()
