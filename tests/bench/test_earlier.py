"""Benchmarks of the first version of the file are read as they would be written now."""

import copy

from helpers.bench_records import benchmark, case, record

from mitsvbrdf.bench.earlier import upgraded
from mitsvbrdf.bench.schema import check_benchmark


def test_photos_left_out_go_from_the_settings_to_the_records_of_captures():
    now = benchmark([record(mean=0.1), record(kind="capture", seen=0.1) | {"left_out": [7, 8]}, case()],
                    {"material": {}, "capture 7,8": {"a": {"MaterialGAN": {"seen": 0.1}}}})
    first = copy.deepcopy(now) | {"schema_version": 1, "published": {
        "material": {}, "capture": {"a": {"MaterialGAN": {"seen": 0.1}}}}}
    first["settings"]["left_out"] = [7, 8]
    del first["records"][1]["left_out"]
    before = copy.deepcopy(first)
    assert check_benchmark(upgraded(first), "here") == now and first == before and upgraded(now) is now


def test_those_that_say_nothing_left_out_the_usual_ones():
    first = benchmark([record(kind="capture", seen=0.1)]) | {"schema_version": 1}
    del first["records"][0]["left_out"]
    assert upgraded(first)["records"][0]["left_out"] == [4, 7]
    for other in ({"schema_version": 1}, [], {"schema_version": 1, "settings": {}, "records": 3,
                                              "published": {}}):
        assert upgraded(other) is other  # for the schema to refuse
