"""A library that a batch made: listed and checked; and its page."""

import json
import shutil

import pytest
from helpers.batches import publish, result_of
from helpers.libraries import random_rows

from mitsvbrdf import cli
from mitsvbrdf.batch.library import Library, data_script, library_page
from mitsvbrdf.batch.records import Material, Row
from mitsvbrdf.batch.results import ResultStore
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two materials done, one of them twice since its photos changed; and one that failed."""
    root = tmp_path_factory.mktemp("made")
    save_maps(make_material("inlay", 16), root / "maps")
    files = {f"maps/{path.name}": path.read_bytes() for path in (root / "maps").iterdir()}
    results = ResultStore(str(root / "library"))
    with results.claimed():
        for letter, name, day in (("a", "oak-2", 1), ("b", "oak-2", 2), ("c", "oak-10", 3)):
            stated = {"identity": letter * 64, "name": name, "source": f"/shots/{name}", "tags": ["wood"]}
            done = result_of(**stated, date=f"2026-11-0{day}T00:00:00Z", row=Row(error=0.01 * day))
            publish(results, done, letter, files)
        stated = {"identity": "d" * 64, "name": "ash", "source": "/shots/ash", "date": "2026"}
        results.fail(Material(**stated, reason="SIGSEGV", log=True), "its last words")
        Library(results).write()
    return root / "library"


@pytest.fixture
def library(made, tmp_path):
    return shutil.copytree(made, tmp_path / "library")


@pytest.fixture
def ask(library, capsys):
    """Call `mitsvbrdf library`: options -> exit code, lines, errors."""
    def ask(*options, folder=library):
        capsys.readouterr()
        code = cli.main(["library", str(folder), *map(str, options)])
        said = capsys.readouterr()
        return code, said.out.splitlines(), said.err

    return ask


def folders(library):
    return sorted(path.parent.name for path in library.glob("*/batch.json"))


def test_rows_are_those_of_the_folders_and_of_the_file_for_pandas(ask, library):
    rows = [json.loads(line) for line in ask("--json")[1]]
    assert [(row["name"], row["state"], row["id"]) for row in rows] == [
        ("ash", "failed", "d" * 8), ("oak-10", "done", "c" * 8), ("oak-2", "done", "b" * 8)]
    assert rows == json.loads((library / "library.json").read_text())["materials"]
    assert rows[0]["log"] == "failed/ash-dddddddd/log.txt"
    assert (library / rows[0]["log"]).read_text() == "its last words"


@pytest.mark.parametrize("options, names", [
    ([], ["ash", "oak-10", "oak-2"]), (["--search", "WOOD"], ["oak-10", "oak-2"]),
    (["--search", "sigs"], ["ash"]), (["--state", "failed"], ["ash"]), (["--state", "replaced"], ["oak-2"]),
    (["--search", "k-1", "--state", "done"], ["oak-10"]), (["--search", "x y"], [])])
def test_search_is_by_text_and_state(ask, options, names):
    assert [json.loads(line)["name"] for line in ask("--json", *options)[1]] == names


def test_listing(ask):
    code, said, _ = ask()
    assert code == 0 and "3 materials" in said[0]
    assert any("oak-10-cccccccc" in line and "0.0300" in line for line in said)
    assert any(line == "failed: ash-dddddddd: SIGSEGV" for line in said)
    assert ask("--search", "nothing")[1] == ["no material matches"]


@pytest.mark.parametrize("name", ["library.json", "index.html", "library.js", ".token", "failed"])
@pytest.mark.parametrize("content", [None, "", "{", '{"materials": [NaN]}'])
def test_nothing_but_the_folders_counts(ask, library, name, content):
    path = library / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    if content is not None and name != "failed":
        path.write_text(content)
    code, said, _ = ask("--json", "--state", "done")
    assert code == 0 and [json.loads(line)["name"] for line in said] == ["oak-10", "oak-2"]
    assert "NaN" not in "".join(said)


def test_verify_finds_what_changed(ask, library):
    code, said, _ = ask("--verify")
    assert (code, said[-1]) == (0, "unchanged: 2 of 2 results")
    (library / "oak-10-cccccccc/maps/diffuse.png").write_bytes(b"another")
    code, said, _ = ask("--verify")
    assert code == 1 and "changed: oak-10-cccccccc: maps/diffuse.png has changed" in said
    assert ask("--verify", "--search", "oak-2")[0] == 0
    (library / "oak-2-bbbbbbbb/batch.json").write_text("{")
    code, said, _ = ask("--verify")
    assert code == 1 and "changed: oak-2-bbbbbbbb: batch.json is missing" in "".join(said)
    assert said[-1] == "unchanged: 1 of 3 results"  # the one that it had replaced counts again


def test_mistakes(ask, tmp_path):
    for folder in (tmp_path, tmp_path / "missing"):
        code, _, errors = ask(folder=folder)
        assert code == 2 and "`mitsvbrdf batch` makes one" in errors


def test_a_library_in_use_is_looked_at(ask, library):
    with ResultStore(str(library)).claimed():
        assert ask("--json")[0] == 0


@pytest.mark.parametrize("name", ["..", ".", "//host", "a/b", "a\\b", "\ud800"])
def test_no_row_names_a_folder_that_lies_elsewhere(library, ask, name):
    record = library / "oak-10-cccccccc/batch.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"name": name}))
    assert [json.loads(line)["name"] for line in ask("--json", "--state", "done")[1]] == ["oak-2"]


def test_the_data_of_the_page_is_json_in_an_assignment():
    rows = random_rows(50)
    rows[0]["name"] = "</script><script>hit()</script>"
    script = data_script({"title": "a", "materials": rows})
    assert "<" not in script and script.isascii()
    assert json.loads(script[script.index("{"):script.rindex("}") + 1]) == {"title": "a", "materials": rows}


def test_a_page_bears_its_nonce_alone():
    page = library_page("<b>wood</b>")
    assert "&lt;b&gt;wood" in page and page.count("<script") == page.count('<script nonce="')
    assert page != library_page("<b>wood</b>")
