"""A batch on a real S3 interface, served by moto here: captures are read from it, a library written to it."""

import json
import os
import sys
import urllib.request
from pathlib import Path

import pytest
from helpers import photos_of

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.material.made import make_material

pytestmark = pytest.mark.slow
FIT = ["--resolution", "16", "--guess", "min", "--iterations", "4", "--workers", "1", "--pages", "none"]


@pytest.fixture
def store(tmp_path, monkeypatch):
    """An empty store with the bucket shots, and two captures in it."""
    tools = str(Path(sys.prefix, "s3"))  # of ./run slow
    monkeypatch.setattr(sys, "path", [*sys.path, tools])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), tools])))
    s3fs = pytest.importorskip("s3fs", reason="needs s3fs: pip install 'mitsvbrdf[s3]'")
    moto = pytest.importorskip("moto.server", reason="needs moto: pip install 'moto[server]'")
    server = moto.ThreadedMotoServer("127.0.0.1", 0)
    server.start()
    url = "http://{}:{}".format(*server.get_host_and_port())
    # it outlives its server
    urllib.request.urlopen(urllib.request.Request(f"{url}/moto-api/reset", method="POST")).close()
    for name, value in {"AWS_ENDPOINT_URL": url, "AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b",
                        "AWS_DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    fs = s3fs.S3FileSystem(use_listings_cache=False, skip_instance_cache=True)
    fs.mkdir("shots")
    for seed in range(2):
        material = make_material("inlay", 16, seed=seed)
        write_capture(photos_of(material, noise=0.003), tmp_path / f"shots/shot-{seed}")
    fs.put(f"{tmp_path / 'shots'}/", "shots/", recursive=True)
    yield fs
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


def listed(capsys):
    """The materials of the library, from the command."""
    capsys.readouterr()
    assert cli.main(["library", "s3://library", "--json"]) == 0
    return {row["name"]: row for row in map(json.loads, capsys.readouterr().out.splitlines())}


def batch(capsys):
    """What a batch says."""
    code = cli.main(["batch", "s3://shots/", "-o", "s3://library", *FIT])
    said = capsys.readouterr()
    assert code == 0, said
    return said.out


def test_a_library_in_a_store_from_its_first_fit_to_its_check(store, tmp_path, capsys):
    store.mkdir("library")
    # a folder, as Amazon's console makes it
    store.call_s3("put_object", Bucket="shots", Key="shot-0/", Body=b"")
    assert "2 to fit" in batch(capsys)
    first = listed(capsys)
    assert sorted(first) == ["shot-0", "shot-1"] and all(row["state"] == "done" for row in first.values())
    assert {"index.html", "library.js", "library.json"} < {
        path.removeprefix("library/") for path in store.find("library")}
    assert "0 to fit" in (said := batch(capsys)) and "2 done already" in said

    store.put(str(tmp_path / "shots/shot-1/target/00.png"), "shots/shot-0/target/00.png")  # a changed photo
    assert "1 to fit" in (said := batch(capsys)) and "1 done already" in said
    second = listed(capsys)
    assert second["shot-0"]["id"] != first["shot-0"]["id"] and second["shot-1"] == first["shot-1"]

    folder = second["shot-1"]["folder"]
    store.rm(f"library/{folder}/batch.json")  # as an upload that was cut leaves it
    assert "1 to fit" in batch(capsys)
    assert store.exists(f"library/{folder}/batch.json")
    assert any(f"{folder}.damaged." in path for path in store.find("library"))

    assert cli.main(["library", "s3://library", "--verify"]) == 0
    content = bytearray(store.cat_file(f"library/{folder}/maps/diffuse.exr"))
    content[-1] ^= 1
    store.pipe_file(f"library/{folder}/maps/diffuse.exr", bytes(content))
    assert cli.main(["library", "s3://library", "--verify"]) == 1
    assert f"{folder}: maps/diffuse.exr has changed" in capsys.readouterr().out


def test_what_is_wrong_with_a_store_is_said_before_any_fit(store, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.cli.batch.RayTasks", lambda *_, **__: pytest.fail("it begins"))
    command = ["batch", str(tmp_path / "shots"), "-o", "s3://nowhere", *FIT]
    assert cli.main(command) == 2
    said = capsys.readouterr().err
    assert "s3://nowhere" in said and "make the bucket" in said and "Traceback" not in said
    assert cli.main(["batch", "s3://nowhere/", "-o", str(tmp_path / "library"), *FIT]) == 2
    assert "none at s3://nowhere" in capsys.readouterr().err
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    type(store).clear_instance_cache()
    for words in (command, ["batch", "s3://shots/", "-o", str(tmp_path / "library"), *FIT],
                  ["library", "s3://nowhere"]):
        assert cli.main(words) == 2
        assert "credentials" in (said := capsys.readouterr().err) and said.count("error:") == 1
    assert not (tmp_path / "library").exists()
