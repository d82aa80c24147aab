"""A result belongs to photos, calibration, options and version, and to nothing else."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import asked, make_capture

from mitsvbrdf.batch import asked as asked_module
from mitsvbrdf.batch.asked import capture_files
from mitsvbrdf.fit import GanConfig, HierarchicalConfig


@pytest.fixture
def capture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return make_capture(tmp_path / "wood")


def identity_of(capture, config=None, **options):
    return asked(capture, config, **options).identity


@pytest.mark.parametrize("change", [lambda folder: (folder / "target/01.png").write_bytes(b"twO"),
    lambda folder: (folder / "target/01.png").unlink(),
    lambda folder: (folder / "target/02.JPG").write_bytes(b"more"),
    lambda folder: (folder / "target/01.png").rename(folder / "target/02.png"),
    lambda folder: (folder / "capture.json").write_text('{"target_dir": "target", "light_pow": 2}'),
    lambda folder: (folder / "light_pos.txt").write_text("0 0 1"),
    lambda folder: (folder / "raw.dng").write_bytes(b"beside")])
def test_it_changes_with_photos_and_calibration(capture, change):
    before = identity_of(capture)
    change(capture)
    assert identity_of(capture) != before


@pytest.mark.parametrize("change", [lambda folder: (folder / "notes.txt").write_text("mine"),
    lambda folder: (folder / ".00.png").write_bytes(b"hidden"), lambda folder: (folder / "old").mkdir(),
    lambda folder: os.utime(folder / "target/00.png", (1, 1)),
    lambda folder: (folder / "target/00.png").chmod(0o600)])
def test_it_does_not_change_with_anything_else(capture, change):
    before = identity_of(capture)
    change(capture)
    assert identity_of(capture) == before


def test_a_capture_may_move_and_be_called_otherwise(capture, tmp_path):
    before = identity_of(capture)
    shutil.copytree(capture, tmp_path / "elsewhere/brick")
    assert identity_of(tmp_path / "elsewhere/brick") == before


def test_it_changes_with_options_settings_and_version(capture, monkeypatch):
    found = [identity_of(capture), identity_of(capture, resolution=128), identity_of(capture, views="0,1"),
             identity_of(capture, HierarchicalConfig(budget=11.0)), identity_of(capture,
             HierarchicalConfig(budget=10.0, seed=1)), identity_of(capture, GanConfig(budget=10.0)),
             replace(asked(capture), pages=True).identity, replace(asked(capture), strict=True).identity]
    monkeypatch.setattr(asked_module, "__version__", "99")
    assert len({*found, identity_of(capture)}) == len(found) + 1


def test_the_size_of_a_sheet_changes_it_only_where_somebody_looks_for_one(capture, tmp_path):
    raw = tmp_path / "raw"
    raw.mkdir()
    (raw / "IMG_1.jpg").write_bytes(b"a photo")

    def known(source, sheet):
        return replace(asked(source), sheet=sheet).identity

    assert known(capture, None) == known(capture, 18.0) and known(raw, None) != known(raw, 18.0)


@pytest.mark.parametrize("config", [HierarchicalConfig(fix=("normal=flat.png",)),
                                    GanConfig(pretrained="flat.png")], ids=["fix", "pretrained"])
def test_it_changes_with_a_file_that_an_option_names(capture, config):
    missing = identity_of(capture, config)
    Path("flat.png").write_bytes(b"flat")
    there = identity_of(capture, config)
    Path("flat.png").write_bytes(b"bumpy")
    assert len({missing, there, identity_of(capture, config)}) == 3


def test_it_does_not_change_with_a_file_whose_name_is_the_value_of_an_option(capture):
    config = HierarchicalConfig(fix=("normal=flat", "roughness=0.5"))
    before = identity_of(capture, config)
    for name in ("mitsuba", "hierarchical", "auto", "robust", "none", "flat", "0.5", "llvm_ad_rgb",
                 "roughconductor"):
        Path(name).write_text("mine")
    assert identity_of(capture, config) == before


def test_a_json_file_in_the_place_of_a_folder_is_read_with_its_photos(capture):
    (capture / "other.json").write_text('{"target_dir": "target"}')
    before = identity_of(capture / "other.json")
    (capture / "target/00.png").write_bytes(b"new")
    changed = identity_of(capture / "other.json")
    (capture / "other.json").write_text('{"target_dir": "target", "light_pow": 2}')
    assert len({before, changed, identity_of(capture / "other.json")}) == 3
    assert capture / "other.json" not in capture_files(capture)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"target_dir": 3}', '{"target_dir": "nowhere"}',
                                  '{"target_dir": "\\u0000"}', "[" * 100_000])
def test_a_broken_calibration_has_an_identity_and_the_fit_says_what_is_wrong(capture, text):
    (capture / "capture.json").write_text(text)
    assert [path.name for path in capture_files(capture)] == ["capture.json"]
    assert len(identity_of(capture)) == 64
