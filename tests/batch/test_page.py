"""The two files that the page of a library consists of."""

from __future__ import annotations

import json
import math
import re

import pytest
from helpers.libraries import library_of, random_rows

from mitsvbrdf.batch.library.page import COLUMNS, address, data_script, write_library_page


def data_of(script: str) -> dict:
    return json.loads(re.fullmatch(r"mitsvbrdfLibrary = (\{.*\});\n", script)[1])


@pytest.mark.parametrize("path, expected", [
    ("wood-1a2b3c4d/preview.jpg", "wood-1a2b3c4d/preview.jpg"),
    ("quarantine/a b/log.txt", "quarantine/a%20b/log.txt"),
    ("50%?#&\"'<é/x", "50%25%3F%23%26%22%27%3C%C3%A9/x"), ("a/b:c", "a/b%3Ac"), ("%2e%2e/x", "%252e%252e/x"),
    ("\udcff/x", "%FF/x"), ("...", "..."), *((path, None) for path in (
        None, "", "/etc/passwd", "//host/x", "../x", "a/../../x", "a/..", "./a", "a//b",
        "javascript:alert(1)", "http://host/x",
        "file:///etc", "C:x", "..\\x", "\\\\host\\x", "\ud800"))])
def test_addresses(path, expected):
    assert address(path) == expected


def test_the_data_file_is_json_in_an_assignment():
    rows = random_rows(20)
    rows[0] |= {"name": "</script><!-- \u2028 \u2029 \ud800", "error": math.nan, "seconds": math.inf,
                "surplus": object()}
    script = data_script(library_of(rows))
    assert script.isascii() and "<" not in script and script.count("\n") == 1
    columns = data_of(script)["columns"]
    assert set(columns) == {*COLUMNS, "preview", "report", "log"} and {len(column)
                                                                       for column in columns.values()} == {20}
    at = columns["name"].index(rows[0]["name"])
    assert columns["error"][at] is columns["seconds"][at] is None


def test_rows_are_in_the_order_of_their_names():
    names = ["oak-10", "Oak-2", "oak-2b", "oak", "ash", "oak-002", "10", "9"]
    rows = [random_rows(1)[0] | {"name": name} for name in names]
    assert data_of(data_script(library_of(rows)))["columns"]["name"] == ["9", "10", "ash", "oak", "Oak-2",
                                                                         "oak-002", "oak-2b",
                                                                         "oak-10"]


def test_a_page_bears_its_nonce_alone(tmp_path):
    pages = []
    for _ in range(2):
        write_library_page(tmp_path, library_of(random_rows(3), title="</title><script>hit()</script>"))
        pages.append((tmp_path / "index.html").read_text())
    nonces = [re.search(r"script-src 'nonce-([\w-]{22})';", page)[1] for page in pages]
    assert nonces[0] != nonces[1]
    for page, nonce in zip(pages, nonces):
        executed = [tag for tag in re.findall(r"<script[^>]*>", page) if "application/json" not in tag]
        assert len(executed) == 2 and all(f'nonce="{nonce}"' in tag for tag in executed)
        assert "default-src 'none'" in page and "unsafe-eval" not in page
        addresses = set(re.findall(r"https?://[^\s\"'<]*", page))
        assert addresses == {"http://www.w3.org/2000/svg"}  # the name of a language, not asked for
