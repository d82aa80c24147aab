"""What ``error<0.05 tag:wood`` means, on the command line and on the page."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from importlib.resources import files

import pytest
from helpers.libraries import random_rows

from mitsvbrdf.batch.library.page import COLUMNS
from mitsvbrdf.batch.library.where import FIELDS, SEARCHED, STATES, described, matcher, number_of
from mitsvbrdf.errors import ConfigError

ROW = {"name": "Old Oak", "id": "1a2b3c4d", "state": "done", "error": 0.03, "left_out_error": None,
       "burn_in": 0.0,
       "warnings": ["one", "two"], "seconds": 61.5, "peak_bytes": 3 * 2**29, "attempts": 1,
       "date": "2026-11-02T10:00:00",
       "tags": ["wood", "old wood", 'sa"w'], "method": "hierarchical", "resolution": 256, "photos": 9,
       "worker": "w1",
       "host": "node-1", "source": "captures/Phone/oak", "options": "--budget 60", "reason": ""}

TRUE = ["", "  ", "oak", "OAK phone", "error<0.05 tag:wood", "error<=.03 error>=3e-2 error=0.03 error:0.03",
        'tag:"old wood"',
        "tag:stone,Wood", 'tag:"sa""w"', '"old oak"', "warnings>1 warnings:2",
        "memory:1.5 seconds>60 attempts=1",
        "burn_in<0.1", "date>2026-11-01 date<2026-11-03 date:2026-11 date>=2026-11-02T10",
        "method:hierarchical",
        "method:gan,hierarchical",
        "resolution:256 photos>=9", "state:done,failed STATE=DONE", "source:phone/oak", "host=NODE-1",
        "id:1a2b", 'd" o"ak',
        "old\u00a0wood", "worker=w1 options:budget", 'name="old oak"',
        "name:old_oak tag:old_wood", "name:pine,oak", 'name:pine,"old oak",ash', "host=node-2,node-1",
        "old_oak"]
FALSE = ["pine", "oak pine", "error<0.03", "error>0.03", "left_out_error<1", "left_out_error>0", "tag:woo",
         'tag:"wood,stone"',
         "state:failed,running,pending", "host=node", "date>2026-11-02", "date<2026-11-02", "reason:x",
         '"oak old"',
         "method:hier", 'name:"pine,oak"', "host=node,1", 'name:"",pine']
WRONG = {'tag:"old wood': 'a " at the end', "eror<1": "one of error, left_out_error",
         "error<": "a value after error<",
         "error<five": "a number after error<", "error<1e": "a number", "error<0x1": "a number",
         "error<∞": "a number",
         "tag<wood": "tag: or tag=", "date>yesterday": "a date after date>",
         "date>2026-1": "a date", "state:faild": "done, failed",
         "http://x": "one of error", 'name:""': "a value after name:", "error<nan": "a number",
         "seconds>١": "a number"}


@pytest.mark.parametrize("text", TRUE)
def test_holds(text):
    assert matcher(text)(ROW)


@pytest.mark.parametrize("text", FALSE)
def test_does_not_hold(text):
    assert not matcher(text)(ROW)


@pytest.mark.parametrize("text", WRONG)
def test_what_is_not_understood(text):
    with pytest.raises(ConfigError, match="^expected " + WRONG[text]):
        matcher(text)


@pytest.mark.parametrize("field", FIELDS)
def test_examples_are_understood(field):
    matcher(FIELDS[field].example)


@pytest.mark.parametrize("word, nearest", [("eror", "error"), ("tags", "tag"), ("eatd", "date"),
                                           ("sekonds", "seconds"), ("left_error", "left_out_error")])
def test_an_unknown_key_is_told_the_nearest_one(word, nearest):
    with pytest.raises(ConfigError, match=f"got {word}; {nearest} is the nearest; "):
        matcher(f"{word}<.1")


def test_a_name_is_found_as_its_folder_was_called():
    """Names have _ in the place of a space; who looks for one types what the folder is called."""
    for text in ('name:"old oak"', 'name="old oak"', '"old oak"', "name=old_oak"):
        assert matcher(text)(ROW | {"name": "old_oak", "source": "/shots/1"})


def test_a_row_may_lack_anything():
    everything = ["word", "name:x", *(field.example for field in FIELDS.values())]
    for row in ({}, {"name": None, "warnings": None, "tags": None, "error": math.nan,
                     "peak_bytes": math.inf}):
        assert not any(matcher(text)(row) for text in everything)
        assert number_of(row, "error") is number_of(row, "memory") is None and number_of(row, "warnings") == 0


def test_not_finite_is_missing():
    assert not matcher("error>0")({"error": math.inf}) and not matcher("error<1e999")({"error": math.nan})


DRIVER = """
const asked = JSON.parse(process.argv[2] ? require("fs").readFileSync(process.argv[2], "utf8") : "");
console.log(JSON.stringify(answers(asked)));
"""
ANSWERS = """
function answers({ where, rows, texts }) {
  return texts.map((text) => {
    try { return rows.map(matcher(where, text)).map(Number).join(""); } catch (error) { return error.message; }
  });
}
"""


def answers_of_script(asked: dict, folder) -> list[str]:
    """What ``where.js`` says of the rows, in node where that is installed, else in Chromium."""
    script = files("mitsvbrdf").joinpath("batch/library/where.js").read_text() + ANSWERS
    if node := shutil.which("node"):
        (folder / "where.js").write_text(script + DRIVER)
        (folder / "asked.json").write_text(json.dumps(asked))
        done = subprocess.run([node, folder / "where.js", folder / "asked.json"], capture_output=True,
                              text=True, check=True)
        return json.loads(done.stdout)
    from browser import opened

    (folder / "empty.html").write_text(f"<!doctype html><link rel=icon href=data:,><script>{script}</script>")
    with opened(folder / "empty.html") as page:
        return page.evaluate("asked => answers(asked)", asked)


def answers_of_package(asked: dict) -> list[str]:
    found = []
    for text in asked["texts"]:
        try:
            test = matcher(text)
        except ConfigError as error:
            found.append(str(error))
        else:
            found.append("".join(str(int(test(row))) for row in asked["rows"]))
    return found


@pytest.mark.slow
def test_the_page_agrees_with_the_command_line(tmp_path):
    rows = [ROW, *random_rows(300, seed=3, unfinished=True)]
    assert set(rows[1]) - {"preview", "report", "log"} == set(COLUMNS)
    some = ["error<0.03", "error>=0.02 left_out_error>0.05", "seconds>40 memory<0.85", "burn_in>0.1",
            "attempts>1",
            "warnings=1", "date>2026-11-01T00:10", "date:2026-11-01T00:05", "tag:wood", 'tag:"OLD WOOD"',
            "tag:wood,brick method:gan",
            "state:failed,running", "reason:signal", "façade", "FAÇADE resolution:512", "木目",
            "host=node-1 photos<5", "id:1a"]
    asked = {"where": {"fields": described(), "states": STATES, "searched": SEARCHED}, "rows": rows,
             "texts": [*TRUE, *FALSE, *WRONG, *some, *(field.example for field in FIELDS.values())]}
    expected = answers_of_package(asked)
    assert answers_of_script(asked, tmp_path) == expected
    # not all or none
    assert sum("1" in answer and "0" in answer for answer in expected[-len(some) - len(FIELDS):]) > 20
