"""What is asked for of a capture: in words, and how long it may take."""

import io
import json
import os
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import asked, make_capture

from mitsvbrdf.batch.asked import Asked
from mitsvbrdf.batch.captures import Entry
from mitsvbrdf.cli.batch import check_asked, with_own_options
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import GanConfig, HierarchicalConfig
from mitsvbrdf.fit.options import FitOptions

SIZES = json.loads((Path(__file__).parents[2] / "docs/results/benchmark.json").read_text())["sizes"]
USUAL = Asked(Entry("/shots/wood"), HierarchicalConfig(), FitOptions(), True, ())


@pytest.mark.parametrize("line, words", [("--tag old", ""), ("--budget 7.5 --seed 3", "budget=7.5, seed=3"),
    ("--no-calibrate --grey-specular", "grey_specular=True, calibrate=False"),
    ("--fix normal=flat --fix 'diffuse=a b.png'", "fix=('normal=flat', 'diffuse=a b.png')"),
    ("--method gan --preset paper-one-stage --iterations 500",
     "method=gan, iterations=500, preset=paper-one-stage"),
    ("--method direct --learning-rate 0.1 --pages none --sheet 18.5",
     "method=direct, learning_rate=0.1, pages=False, sheet=18.5"),
    ("--resolution 512 --views 0,1,2 --strict", "resolution=512, views=0,1,2, strict=True")])
def test_options_in_words_are_those_that_differ_from_the_defaults(line, words):
    assert with_own_options(Entry("/shots/wood", tuple(shlex.split(line)), "line 1"), USUAL).words == words


@pytest.mark.parametrize("line, told", [
    ("--budget foo", "--budget foo (Error parsing --budget: "), ("--bugdet 3", "--bugdet"),
    ("--views x", "photo numbers"), ("--resolution 2", "--resolution of 8 or more"), ("--help", "--help"),
    ("--sheet nan", "--sheet of at most"), ("--sheet -1", "the size of the sheet in cm, got -1"),
    ("--resolution 99999", "--resolution of at most 16384")])
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_mistake_on_a_line_is_one_plain_error(line, told, encoding, monkeypatch, capsys):
    # by it tyro chooses how to draw
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    with pytest.raises(ConfigError) as error:
        check_asked(with_own_options(Entry("/shots/wood", tuple(line.split()), "line 3 of list.txt"), USUAL))
    assert told in str(error.value)
    assert not any(drawn in str(error.value) for drawn in ("│", "╭", "╰", "─", "\n", "----"))
    assert capsys.readouterr() == ("", "")


def test_files_on_a_line_lie_beside_the_list(tmp_path):
    line = Entry("/shots/wood", ("--fix", "normal=up.png", "--fix", "roughness=0.5"), "line 3", str(tmp_path))
    found = with_own_options(line, USUAL)
    assert found.config.fix == ("normal=up.png", "roughness=0.5") and found.entry.base == str(tmp_path)
    with pytest.raises(ConfigError, match="up.png.*line 3"):
        check_asked(found)
    (tmp_path / "up.png").touch()
    check_asked(found)
    common = replace(USUAL, config=HierarchicalConfig(fix=("diffuse=here.png",)))
    both = with_own_options(line, common)
    assert both.config.fix == (f"diffuse={os.path.abspath('here.png')}", *found.config.fix)
    alone = with_own_options(line._replace(own=("--fix", "roughness=0.5")), common)
    assert alone.config.fix == ("diffuse=here.png", "roughness=0.5") and not alone.entry.base


def test_tags_have_commas_between_them():
    typed = with_own_options(Entry("/shots/wood", ("--tag", "wood, old oak,,wood", "--tag", "new"), "line 1"),
                             replace(USUAL, tags=("print",)))
    assert typed.tags == ("print", "wood", "old oak", "new")


def test_no_fit_that_was_measured_would_be_ended_on_a_machine_ten_times_slower(tmp_path):
    capture = make_capture(tmp_path / "wood", [b"x"] * 9)
    for row in (row for row in SIZES if row["side"] <= 1024):  # larger fits take their budget
        limit = asked(capture, HierarchicalConfig(), resolution=row["side"]).limit
        assert limit >= 10 * row["fit"]["seconds"], row


def test_a_limit_grows_with_the_budget(tmp_path):
    few = make_capture(tmp_path / "few")
    assert asked(few, HierarchicalConfig(budget=100.0)).limit == 3600 + 300
    assert asked(few, HierarchicalConfig(iterations=4)).limit is None


def test_costs_grow_with_photos_and_texels_up_to_the_budget(tmp_path):
    few, many = make_capture(tmp_path / "few", [b"x"] * 3), make_capture(tmp_path / "many", [b"x"] * 9)

    def cost(capture, config=None, **options):
        return asked(capture, config or HierarchicalConfig(iterations=4), **options).cost

    assert cost(many) == 3 * cost(few) == 36.0 and cost(many, resolution=512) == 4 * cost(many)
    assert cost(many, HierarchicalConfig(budget=10)) == 10
    assert cost(many, GanConfig(budget=77)) == 77
