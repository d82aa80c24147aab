"""Records that are none are named."""

import copy

import pytest
from helpers.bench_records import benchmark, case, record

from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.errors import ConfigError


@pytest.mark.parametrize("spoil, words", [
    (lambda b: b.update(schema_version=3), "version 3"),
    (lambda b: b.pop("machine"), "the fields"),
    (lambda b: b["records"][0].update(seed="0"), "records.0.seed"),
    (lambda b: b["records"][0].update(seed=True), "records.0.seed"),
    (lambda b: b["records"][0].update(kind="photo"), "records.0.kind"),
    (lambda b: b["records"][0]["errors"].update(mean=float("nan")), "records.0.errors.mean"),
    (lambda b: b["records"][0].pop("wall"), "records.0"),
    (lambda b: b["records"][0].update(extra=1), "records.0"),
    (lambda b: b["records"][1]["rows"][0]["both"].pop("low"), "records.1.rows.0.both"),
    (lambda b: b["records"].append(b["records"][0]), "twice"),
    (lambda b: b["records"].append({"suite": "other"}), "records.2"),
    (lambda b: b["records"][0].update(left_out=[4, 7]), "left_out of a capture"),
    (lambda b: b["records"].append(record(kind="capture")) or b["records"][-1].pop("left_out"),
     "left_out of a capture"),
    (lambda b: b.update(records={}), "a list"),
    (lambda b: b.update(seeds=[0.5]), "seeds.0"),
])
def test_schema_names_what_is_wrong(spoil, words):
    content = copy.deepcopy(benchmark([record(mean=0.1), case()]))
    assert check_benchmark(content, "here") is content
    spoil(content)
    with pytest.raises(ConfigError, match=words):
        check_benchmark(content, "here")
