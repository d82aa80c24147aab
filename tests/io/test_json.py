"""JSON is read in one way: what is no JSON, or would do harm, is one error that names the file."""

import json
import os

import pytest

from mitsvbrdf.capture import read_capture
from mitsvbrdf.capture.calibrated import from_json
from mitsvbrdf.errors import CaptureError, MitsvbrdfError
from mitsvbrdf.fit.result import Fit
from mitsvbrdf.io import json as io_json
from mitsvbrdf.io.json import NUMBER, load, parsed, shape_error
from mitsvbrdf.material.encoding import read_material_json
from mitsvbrdf.relight.frames import go_on

WRONG = {
    '{"a": [0, NaN]}': r"a\[1\] is no finite number", '{"a": {"b": -Infinity}}': r"a\.b is no finite number",
    '{"a": 1e999}': "a is no finite number", '{"a": 1' + "0" * 5000 + "}": "a is no finite number",
    '{"a": 9223372036854775808}': "a is no finite number", '{"a": 1, "b": 2, "a": 3}': "the key 'a' twice",
    "[" * 100_000: "nested too deeply", '{"a":' * 100_000: "nested too deeply",
    "[1]": "an object was expected, not list", '"text"': "not str", "null": "not NoneType",
    "": "Expecting value", "{": "Expecting", "{'a': 1}": "Expecting"}


@pytest.mark.parametrize("text", WRONG, ids=lambda text: text[:20])
def test_what_is_refused(text):
    for given in (text, text.encode()):
        with pytest.raises(ValueError, match=WRONG[text]):
            parsed(given)


@pytest.mark.parametrize("content", [b"\xff\xfe{}", b'{"a": "\xe4"}', bytes(1000)])
def test_bytes_that_are_no_text_are_refused(content):
    with pytest.raises(ValueError, match="decode byte|Expecting value"):
        parsed(content)


def test_what_is_read_is_what_json_says():
    value = {"a": [1, -2.5, 1e-320, 1.7e308, True, None, "ä"], "b": {"c": []}, "d": 2**63 - 1, "e": 1 - 2**63}
    assert parsed(json.dumps(value)) == value == parsed(b"\xef\xbb\xbf" + json.dumps(value).encode())
    assert parsed("[1]", list) == [1] and type(parsed('{"a": 1}')["a"]) is int


def test_a_file_that_cannot_be_read_is_one_error(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")  # opening it would wait for ever
    (tmp_path / "folder").mkdir()
    (tmp_path / "large").write_bytes(b"{}" + b" " * 100)
    monkeypatch.setattr(io_json, "MOST_BYTES", 100)
    words = {"pipe": "no regular file", "folder": "no regular file", "none": "No such file",
             "large": "more than"}
    for name, word in words.items():
        with pytest.raises(CaptureError, match=f"expected a valid JSON file, got {tmp_path / name}: {word}"):
            from_json(tmp_path / name, "inverse-square", None)
    (tmp_path / "large").write_bytes(b"{}" + b" " * 98)
    assert load(tmp_path / "large") == {}


@pytest.mark.parametrize("value, shape, said", [({"a": 1, "b": [1.5, 2]}, {"a": int, "b": [NUMBER]}, ""),
                          ({"a": {"x": 1, "more": 2}}, {"a": {"x": int}}, ""),
                          ({"a": 1}, {"a": int, "b": [NUMBER]},
                           "the whole (object missing required field b)"),
                          ({"a": [[1, "x"]]}, {"a": [[NUMBER]]}, "a[0][1] (expected int | float, got str)"),
                          ({"a": {"x": 1, "y": None}}, {"a": {str: int}}, "a[...] (expected int, got null)"),
                          ({"a": []}, {"a": {str: object}}, "a (expected object, got array)"),
                          ({"a": 3}, {"a": str | None}, "a (expected str | null, got int)"),
                          ({"a": None}, {"a": dict | None}, "")])
def test_where_a_value_does_not_fit(value, shape, said):
    assert shape_error(value, shape) == said


READERS = {"capture.json": read_capture, "fit.json": Fit.of_maps, "material.json": read_material_json,
           "relight.json": lambda folder: go_on({}, folder, folder)}


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": NaN}', '{"a": 1, "a": 1}', "[]", "{"],
                         ids=lambda text: text[:16])
@pytest.mark.parametrize("name", READERS)
def test_every_reader_names_the_file(name, text, tmp_path):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(text)
    with pytest.raises(MitsvbrdfError) as found:
        READERS[name](tmp_path)
    assert str(tmp_path) in str(found.value) and len(str(found.value)) < 500


def test_a_link_is_followed_only_where_it_may_be(tmp_path):
    (tmp_path / "real.json").write_text('{"a": 1}')
    (tmp_path / "link.json").symlink_to(tmp_path / "real.json")
    assert load(tmp_path / "link.json") == load(tmp_path / "real.json", links=False) == {"a": 1}
    with pytest.raises(OSError):
        load(tmp_path / "link.json", links=False)
