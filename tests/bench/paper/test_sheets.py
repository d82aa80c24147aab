"""Sheets like the paper's figures: what is on them, and how large they are."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers import ANALYTIC, GRID
from helpers.bench_records import benchmark

from mitsvbrdf.bench.paper import sheets
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.tasks import known_material
from mitsvbrdf.fit import DirectConfig, GanConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps


def test_a_sheet_has_a_row_for_the_truth_each_method_and_published_maps(tmp_path):
    save_maps(make_material("leather", 16), tmp_path / "hide")
    save_maps(make_material("tiles", 16), tmp_path / "hide/peers/materialgan")
    task = known_material(str(tmp_path / "hide"), 16, GRID, ANALYTIC)
    methods = {"gan": GanConfig(width=4), "direct": DirectConfig()}
    job = sheets.SheetJob(methods, task, 0.1, 0, ANALYTIC, tmp_path / "out")
    found = job.key | {"config": job.settings} | job.run()
    check_benchmark(benchmark([json.loads(json.dumps(found))]), "here")
    assert found["file"] == "gan-hide.jpg" and set(found["errors"]) == {"gan", "direct", "MaterialGAN"}
    assert set(found["errors"]["gan"]) == {"diffuse", "specular", "roughness", "normal", "seconds"}
    picture = cv2.imread(str(tmp_path / "out/gan-hide.jpg"))
    assert picture.shape[1] == 1680 and (tmp_path / "out/gan-hide.jpg").stat().st_size <= sheets.MOST_BYTES


def test_pictures_stand_in_their_columns(tmp_path):
    task = known_material("builtin:tiles", 16, GRID, ANALYTIC)
    white = replace(task.truth, maps={**task.truth.maps, "diffuse": task.truth["diffuse"] * 0 + 1})
    sheets.write_comparison(tmp_path / "s.jpg", "tiles", task.photos, [sheets.SheetRow("Truth", white)],
                            ANALYTIC)
    picture = cv2.imread(str(tmp_path / "s.jpg"))[..., ::-1].astype(float) / 255
    side = (1680 - 2 * 34 - 4 * 8) // 5
    top = 92 + 34 + 34
    diffuse = picture[top + 10:top + side // 2 - 20, 34 + side + 18:34 + side + side // 2 - 12]
    assert diffuse.min() > 0.97  # white
    shown = picture[top:top + side, 34:34 + side].mean(axis=(0, 1))
    # JPEG; measured 0.0004
    assert shown == pytest.approx(task.photos.photos[0].mean(dim=(0, 1)).numpy(), abs=0.004)
    guess = picture[top + 16:top + side - 16, 34 + 2 * (side + 8) + 16:34 + 3 * side]
    assert np.ptp(guess, axis=(0, 1)).max() < 0.01  # the truth has none


def test_a_picture_that_is_too_large_is_written_worse(tmp_path, monkeypatch):
    task = known_material("builtin:tiles", 16, GRID, ANALYTIC)
    sizes = []
    for most in (10**9, 1):
        monkeypatch.setattr(sheets, "MOST_BYTES", most)
        sheets.write_comparison(tmp_path / "s.jpg", "tiles", task.photos,
                                [sheets.SheetRow("Truth", task.truth)], ANALYTIC)
        sizes.append((tmp_path / "s.jpg").stat().st_size)
    assert sizes[1] < sizes[0]
