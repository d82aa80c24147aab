"""A library served to a browser: what is looked up, and what is not."""

import json
import os
import re

import pytest
from helpers.libraries import library_of, random_rows, write_whole_library
from helpers.live_fits import served

from mitsvbrdf.batch.library.site import LibrarySite
from mitsvbrdf.cli.view import _Followed
from mitsvbrdf.errors import OutputError

NAMES = ("preview.jpg", "report.html", "look.html")


@pytest.fixture
def library(tmp_path):
    root = tmp_path / "library"
    rows = [row for row in random_rows(30, unfinished=True) if row["state"] != "failed"]
    for k, row in enumerate(rows):
        row["folder"] = f"m{k}-1" if k else "a?b#c é-1"
        row |= {name: f"{row['folder']}/{file}" for name, file in (("preview", "preview.jpg"),
                                                                   ("report", "report.html"))
                if row[name]}
    write_whole_library(root, rows)
    return root, rows


def shown(ask):
    """The columns of the data file."""
    script = ask("/library.js")[2].decode()
    return json.loads(script[script.index("{"):script.rindex("}") + 1])["columns"]


def test_the_page_its_data_and_what_the_rows_name(library):
    root, rows = library
    (root / rows[1]["folder"] / "look.html").write_text("a look")
    with served(root, LibrarySite) as ask:
        status, headers, page = ask("/")
        nonce = re.search("'nonce-(.+?)'", headers["Content-Security-Policy"])[1]
        assert status == ask("/index.html")[0] == 200 and page.decode().count(f'nonce="{nonce}"') == 2
        columns = shown(ask)
        assert sorted(columns["name"]) == sorted(row["name"] for row in rows)
        for path, report, name in zip(columns["preview"], columns["report"], columns["name"]):
            if path:
                row = next(row for row in rows if row["name"] == name)
                assert ask(f"/{path}")[2] == (root / row["preview"]).read_bytes()
                status, headers, content = ask(f"/{report}")
                assert content == (root / row[
                    "report"]).read_bytes() and "connect-src data: blob:" in headers[
                    "Content-Security-Policy"]
        assert ask(f"/{rows[1]['folder']}/look.html")[2] == b"a look"
        assert ask(f"/{rows[2]['folder']}/look.html")[0] == 404


def test_the_log_of_what_failed_is_served_and_no_other(tmp_path):
    rows = random_rows(3)
    for row, state in zip(rows, ("failed", "done", "pending")):
        folder = f"quarantine/{state}-1"
        row |= {"state": state, "folder": folder, "log": f"{folder}/log.txt", "preview": None, "report": None}
    write_whole_library(tmp_path, rows)
    with served(tmp_path, LibrarySite) as ask:
        assert [ask(f"/{row['log']}")[0] for row in rows] == [200, 404, 404]
        _, headers, content = ask(f"/{rows[0]['log']}")
        assert content.decode() == f"the log of {rows[0]['name']}"
        assert headers["Content-Type"] == "text/plain; charset=utf-8" and headers[
            "X-Content-Type-Options"] == "nosniff"
        assert ask(f"/{rows[0]['folder']}/reason.json")[0] == 404


@pytest.mark.parametrize("path", [
    "/manifest.sqlite", "/library.json", "/.token", "/.work/1-1/report.html", "/{0}", "/{0}/",
    "/{0}/fit.json",
    "/{0}/batch.json",
    "/{0}/../manifest.sqlite", "/{0}/..%2fmanifest.sqlite", "/{0}//report.html", "/./{0}/report.html",
    "/{0}/report.htm%6c",
    "/other-1/report.html", "/quarantine/{1}/log.txt", "{0}/report.html", "/{1}/report.html",
    "/../secret.html", "/..", "/state.json"])
def test_nothing_else_is_served(path, library):
    root, rows = library
    done, pending = rows[1]["folder"], rows[-1]["folder"]
    for name in (f"{done}/fit.json", f"{done}/batch.json", ".token", ".work/1-1/report.html",
                 "other-1/report.html",
                 f"quarantine/{pending}/log.txt", f"{pending}/report.html", "../secret.html"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("secret")
    with served(root, LibrarySite) as ask:
        status, _, content = ask(path.format(done, pending))
        assert status == 404 and b"secret" not in content
        assert ask("/", Host="evil.example")[0] == ask("/library.js", Host="evil.example")[0] == 403


@pytest.mark.parametrize("folder", ["..", "../other", "/etc", ".", "", "a/../../other", "\\other", "file:x",
                                    "a/b", 7, None])
def test_rows_that_name_what_is_outside_are_not_believed(folder, library):
    root, rows = library
    for name in NAMES:
        (root / "a" / "b").mkdir(parents=True, exist_ok=True)
        for place in (root.parent, root, root / "a" / "b"):
            (place / name).write_text("secret")
    rows[0] |= {"folder": folder}
    (root / "library.json").write_text(json.dumps(library_of(rows)))
    site = LibrarySite(root)
    site.answer("/library.js")
    assert all(path.parent.parent == root and path.parent.name not in (".", "..", "")
               for path in site._files.values())


def test_links_that_lead_outside_are_not_followed(library):
    root, rows = library
    secret = root.parent / "secret.html"
    secret.write_text("secret")
    file, folder, within = (row["folder"] for row in rows[1:4])
    for name, target in ((f"{file}/report.html", secret),
                         (f"{within}/look.html", root / rows[4]["folder"] / "report.html")):
        (root / name).unlink(missing_ok=True)
        (root / name).symlink_to(target)
    os.rename(root / folder, root.parent / "moved")
    (root / folder).symlink_to(root.parent / "moved")
    (root / file / "look.html").unlink(missing_ok=True)
    os.mkfifo(root / file / "look.html")
    with served(root, LibrarySite) as ask:
        for path in (f"/{file}/report.html", f"/{folder}/report.html", f"/{folder}/preview.jpg",
                     f"/{file}/look.html"):
            assert ask(path)[0] == 404
        assert ask(f"/{within}/look.html")[0] == ask(f"/{within}/report.html")[0] == 200
        data = (root / "library.json").rename(root.parent / "library.json")
        (root / "library.json").symlink_to(data)
        rows.pop()
        data.write_text(json.dumps(library_of(rows)))
        assert len(shown(ask)["name"]) == len(rows) + 1  # as it was: what the link leads to is not read


def test_what_changes_is_seen_and_what_does_not_is_not_sent_again(library):
    root, rows = library
    with served(root, LibrarySite) as ask:
        tag = ask("/library.js")[1]["ETag"]
        assert ask("/library.js", If_None_Match=tag)[0] == 304 and ask("/library.js",
                                                                       If_None_Match='"other"')[0] == 200
        gone, new = rows[1]["folder"], rows[-1]
        new |= {"state": "done", "preview": f"{new['folder']}/preview.jpg",
                "report": f"{new['folder']}/report.html"}
        assert ask(f"/{gone}/report.html")[0] == 200 and ask(f"/{new['report']}")[0] == 404
        del rows[1]
        write_whole_library(root, rows)
        assert ask("/library.js", If_None_Match=tag)[0] == 200
        assert ask(f"/{gone}/report.html")[0] == 404 and ask(f"/{new['report']}")[0] == 200
        for broken in ("", "[]", '{"materials": [7]}', '{"materials": 7}', "{"):
            (root / "library.json").write_text(broken)
            assert len(shown(ask)["name"]) == len(rows) and ask(f"/{new['report']}")[0] == 200


def test_no_script_of_the_folder_runs(library):
    root, _ = library
    for name in ("index.html", "library.js"):
        (root / name).write_text("alert('secret')")
    with served(root, LibrarySite) as ask:
        assert all(b"secret" not in ask(path)[2] for path in ("/", "/index.html", "/library.js"))


def test_a_folder_that_becomes_a_library_is_shown_as_one(tmp_path, library):
    root = tmp_path / "later"
    with served(root, _Followed) as ask:
        assert ask("/state.json")[0] == 200 and b"No fit in" in ask("/state.json")[2]
        root.mkdir()
        (root / ".token").write_text("")  # a batch has begun, and not written its list yet
        assert ask("/state.json")[2] == b"null" and shown(ask)["name"] == []
        write_whole_library(root, library[1])
        assert len(shown(ask)["name"]) == len(library[1])


@pytest.mark.parametrize("file, told", [("IMG_1.JPG", "which holds photos"),
                                        ("capture.json", "which holds photos"),
                                         ("notes.txt", "which has other files")])
def test_what_is_neither_a_fit_nor_a_library_is_told_with_what_can_be_opened(tmp_path, file, told):
    (tmp_path / file).touch()
    with pytest.raises(OutputError, match=told) as error:
        _Followed(tmp_path)
    assert "mitsvbrdf fit -o OUT" in str(error.value) and "mitsvbrdf batch -o LIBRARY" in str(error.value)
