"""Captures and results behind fsspec, on file systems that need no network."""

import json
import sys

import fsspec
import pytest
from fsspec.registry import _registry
from helpers.batches import ELSEWHERE, NO_RECORDS
from helpers.captures import write_captures

from mitsvbrdf import cli
from mitsvbrdf.batch.entries import entries
from mitsvbrdf.batch.identity import identity
from mitsvbrdf.batch.places.address import check_address, download, home_of, local_capture, place_of, upload
from mitsvbrdf.batch.places.place import RECORD
from mitsvbrdf.batch.places.remote import RemotePlace, file_system, remote_captures, remote_contents
from mitsvbrdf.errors import BackendError, CaptureError, OutputError
from mitsvbrdf.io.files import file_hash


@pytest.fixture(params=["memory", "file"])
def url(request, tmp_path):
    """An empty place behind a URL."""
    if request.param == "memory":
        fsspec.filesystem("memory").rm("/", recursive=True)
        return "memory://place"
    return f"file://{tmp_path}/place"


def put(url, content=b"x"):
    fs, path = file_system(url)
    fs.pipe_file(path, content)


def made(folder, **content):
    """A result: files and their record."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in content.items():
        (folder / name).write_text(text)
    files = {name: {"bytes": len(text), "sha256": file_hash(folder / name)} for name, text in content.items()}
    (folder / RECORD).write_text(json.dumps({"identity": "1", "attempt": "1-1", "row": {}, "files": files}))
    return folder


def test_captures_are_found_as_in_a_folder(url):
    for name in ("a/capture.json", "a/target/00.png", "b/camera_pos.txt", "c/00.JPG", "fit/fit.json",
                 "fit/sheet.png",
                 "empty/x.txt", ".hidden/00.png", "deep/er/capture.json"):
        put(f"{url}/{name}")
    found = remote_captures(url)
    assert [each.rsplit("/", 1)[-1] for each in found] == ["a", "b", "c"] and remote_captures(url
                                                                                              + "/") == found
    assert remote_captures(f"{url}/[bc]") == found[1:] and remote_captures(f"{url}/a/capture.json") == found[
        :1]
    assert [entry.source for entry in entries([url])] == found
    assert remote_captures(found[0]) == found[:1] and remote_captures(f"{url}/c") == found[2:]
    for wrong in ("fit", "empty", "nowhere", "no*"):
        with pytest.raises(CaptureError, match="none at"):
            remote_captures(f"{url}/{wrong}")


def test_a_capture_is_copied_whole_and_known_by_its_content(url, tmp_path):
    capture, = write_captures(tmp_path, 1)
    names = sorted(str(path.relative_to(capture)) for path in capture.rglob("*") if path.is_file())
    for name in names:
        put(f"{url}/{name}", (capture / name).read_bytes())
    assert [name for name, *_ in remote_contents(url)] == names
    with local_capture(url) as copy:
        assert {name: (copy / name).read_bytes() for name in names} == {
            name: (capture / name).read_bytes() for name in names}
    assert not copy.exists()
    before = identity(url, {}, file_hash)
    assert identity(url, {}, file_hash) == before
    put(f"{url}/target/00.png", (capture / "target/01.png").read_bytes())
    assert identity(url, {}, file_hash) != before


def test_a_result_is_there_with_its_record_and_not_before(url, tmp_path, monkeypatch):
    place = place_of(url)
    check_address(url)
    assert place.record("m-1") is None
    result = made(tmp_path / "made", a="one", b="two")

    def cut(local, path, **_):
        if path.endswith("/b"):
            raise ConnectionResetError("cut")
        return put_file(local, path)

    put_file = place.fs.put_file
    with monkeypatch.context() as patch, pytest.raises(OutputError, match="cut"):
        patch.setattr(place.fs, "put_file", cut)
        place.publish(result, "m-1")
    assert place.record("m-1") is None and place.fs.exists(f"{place.root}/m-1/a")
    assert place.publish(result, "m-1") and place.record("m-1")["identity"] == "1"
    assert not place.publish(made(tmp_path / "other", a="other"), "m-1")
    assert place.fs.cat_file(f"{place.root}/m-1/a") == b"one"


def test_damage_is_named_and_set_aside(url, tmp_path):
    place = RemotePlace(url)
    for folder in ("m-00000001", "m-00000002", "m-00000003", "m-00000004"):
        place.publish(made(tmp_path / "made", a="one", b="two"), folder)
    record = place.record("m-00000001")
    assert place.damage("m-00000001", record, hashes=True) == ""
    put(f"{url}/m-00000001/a", b"eno")
    assert place.damage("m-00000001", record, hashes=False) == ""
    assert "a has changed" in place.damage("m-00000001", record, hashes=True)
    put(f"{url}/m-00000001/a", b"longer")
    assert "a has changed" in place.damage("m-00000001", record, hashes=False)
    place.fs.rm_file(f"{place.root}/m-00000002/b")
    assert "b is missing" in place.damage("m-00000002", record, hashes=False)
    place.fs.rm_file(f"{place.root}/m-00000003/{RECORD}")
    place.set_aside("m-00000001")
    place.set_aside("m-00000003")  # without its record
    place.set_aside("nothing")
    assert place.fs.cat_file(f"{place.root}/m-00000001.damaged/a") == b"longer"
    assert place.fs.exists(f"{place.root}/m-00000003.damaged/a")
    place.remove("m-00000002")
    place.remove("nothing")
    assert place.aside() == ["m-00000001.damaged", "m-00000003.damaged"]
    assert sorted({path.split("/place/")[1].split("/")[0] for path in place.fs.find(place.root)}) == [
        "m-00000001.damaged", "m-00000003.damaged", "m-00000004"]


@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_name_that_leads_elsewhere_is_none_of_a_result(url, name, tmp_path):
    place = RemotePlace(url)
    for folder in ("mine-00000001", "../mine", "mine"):
        place.fs.pipe_file(f"{place.root}/{folder}/{RECORD}", b"{}")
    result = made(tmp_path / "made", a="one")
    before = place.fs.find(place.root.rpartition("/")[0])
    for work in (place.record, place.remove, place.set_aside, lambda name: place.damage(name, {"files": {}},
                                                                                        False),
                 lambda name: place.publish(result, name)):
        with pytest.raises(OutputError, match="the name of a result"):
            work(name)
    assert place.fs.find(place.root.rpartition("/")[0]) == before


def test_a_record_that_is_none_counts_for_nothing(url):
    place = RemotePlace(url)
    for text in NO_RECORDS:
        put(f"{url}/m-1/{RECORD}", text.encode("latin-1"))
        assert place.record("m-1") is None, text


def test_what_others_wrote_is_seen(tmp_path):
    here, other = RemotePlace(f"file://{tmp_path}/place"), RemotePlace(f"file://{tmp_path}/place")
    other.publish(made(tmp_path / "made", a="one"), "m-1")
    assert here.fs.find(here.root) and here.record("m-1")
    other.publish(made(tmp_path / "made", a="one"), "m-2")
    assert here.record("m-2") and here.damage("m-2", here.record("m-2"), hashes=True) == ""
    assert here.fs.storage_options["use_listings_cache"] is False  # s3fs and others would answer from memory


def test_the_manifest_goes_where_the_library_goes(url, tmp_path, monkeypatch):
    def home(machine):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / machine))
        (found := home_of(url)).mkdir(exist_ok=True)
        return found

    def manifest(machine):
        download(home(machine), url)
        return (home(machine) / "manifest.sqlite").read_text()

    def end(machine, text):
        for name in ("manifest.sqlite", ".lock", ".token", ".work/x", "quarantine/m-1/log.txt"):
            (home(machine) / name).parent.mkdir(parents=True, exist_ok=True)
            (home(machine) / name).write_text(text)
        upload(home(machine), url)

    download(home("one"), url)
    assert not (home("one") / "manifest.sqlite").exists()
    end("one", "first")
    fs, root = file_system(url)
    assert sorted(path[len(root) + 1:] for path in fs.find(root)) == ["manifest.sqlite",
                                                                      "quarantine/m-1/log.txt"]
    assert manifest("two") == "first"
    end("two", "second by two")
    assert manifest("one") == "second by two"
    (home("one") / "manifest.sqlite").write_text("of a batch that was killed")  # and nobody else wrote since
    assert manifest("one") == "of a batch that was killed"


def test_mistakes(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("mitsvbrdf.cli.batch.RayPool", lambda *_, **__: pytest.fail("it begins"))
    shots = tmp_path / "shots"
    write_captures(shots, 1)
    with pytest.raises(OutputError, match="fsspec knows"):
        file_system("gopher://x")
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "s3fs", None)
        patch.delitem(_registry, "s3", raising=False)
        with pytest.raises(BackendError, match=r"mitsvbrdf\[s3\]"):
            file_system("s3://x")
        assert cli.main(["batch", str(shots), "-o", "s3://library"]) == 2
    assert (said := capsys.readouterr().err).count("error:") == 1 and "mitsvbrdf[s3]" in said
    (tmp_path / "file").write_text("")
    assert cli.main(["batch", str(shots), "-o", f"file://{tmp_path}/file/library"]) == 2
    assert (said := capsys.readouterr().err).count("error:") == 1 and "expected a store" in said
    assert cli.main(["batch", f"file://{tmp_path}/none", "-o", str(tmp_path / "library")]) == 2
    assert cli.main(["library", f"file://{tmp_path}/none"]) == 2
    assert "which has no manifest" in capsys.readouterr().err
