"""What the coverage of a fit's deviations counts, and that the page says what the record says."""

import dataclasses
import json

import pytest
import torch
from helpers import ANALYTIC, photos_of

from mitsvbrdf.bench.coverage import figures, main, page
from mitsvbrdf.fit import DirectConfig, fit_svbrdf
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import SVBRDF


@pytest.fixture(scope="module")
def fitted():
    truth = make_material("leather", 16)
    return fit_svbrdf(photos_of(truth), ANALYTIC, DirectConfig(iterations=2)), truth


def test_errors_are_counted_in_the_numbers_of_map_errors(fitted):
    result, truth = fitted
    brighter = (truth["specular"] ** (1 / 2.2) + 0.03) ** 2.2
    off = dict(truth.maps) | {"roughness": truth["roughness"] + 0.05, "specular": brighter}
    spread = {"roughness": torch.full((16, 16, 1), 0.04), "specular": torch.full((16, 16, 3), 0.2)}
    spread["specular"][:4] = 0.02
    found = figures(dataclasses.replace(result, svbrdf=SVBRDF("roughconductor", off), deviations=spread),
                    truth)
    rough, specular = found["roughness"], found["specular"]
    assert rough["rmse"] == pytest.approx(0.05, rel=1e-4) and (rough["within_68"], rough["within_95"]) == (0,
                                                                                                           1)
    assert specular["rmse"] == pytest.approx(0.03, rel=1e-4) and specular["within_68"] == 0.75
    assert (rough["determined"], rough["right"]) == (1, 1) and (specular["determined"],
                                                                specular["right"]) == (0.25, 1)
    for sure in (0.3, 0.05):  # errors of 0.05 and more are right up to 0.196
        material = SVBRDF("roughconductor", off | {"roughness": truth["roughness"] - 0.25})
        stated = {"roughness": torch.full((16, 16, 1), sure)}
        wrong = figures(dataclasses.replace(result, svbrdf=material, deviations=stated), truth)
        assert wrong["roughness"]["right"] == (0 if sure < 0.1 else None)


def test_the_page_says_what_the_record_says(tmp_path):
    main(tmp_path, materials=("tiles",), noises=(0.01,), seeds=(3,), resolution=8)
    record = json.loads((tmp_path / "coverage.json").read_text())
    (row,) = record["fits"]
    text = (tmp_path / "coverage.md").read_text()
    assert text == page(record) and f"| diffuse | {row['maps']['diffuse']['rmse']:.4f} |" in text
    shares = " | ".join(f"{row['maps'][name]['within_68']:.0%}" for name in ("diffuse", "specular",
                                                                             "roughness", "normal"))
    assert f"| tiles | 0.01 | {shares} |" in text
