"""The page says what the record says, and the published one is that of the published record."""

import json
from dataclasses import asdict

import pytest
from helpers import ROOT
from helpers.bench_records import benchmark, stale, stiff

from mitsvbrdf import cli
from mitsvbrdf.bench import child
from mitsvbrdf.bench.code import shared_code
from mitsvbrdf.bench.jobs import key_of
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.stiff.fits import SHAPING, StiffFit, StiffPlan
from mitsvbrdf.bench.stiff.page import write_stiff_page
from mitsvbrdf.bench.stiff.plots import convergence_figure
from mitsvbrdf.bench.stiff.scenes import CASES, SERIES, Scene, digest
from mitsvbrdf.bench.stiff.tables import convergence, each, fits_of, inputs, overview, warnings

SILENT_LIGHT = {"name": "light stated 4x too weak", "diffuse": 0.3}
RECORDS = [stiff(), stiff(seed=1, roughness=0.05), stiff(seed=2, roughness=0.3), stiff(**SILENT_LIGHT),
           stiff(seed=1, warnings=["the light may be stronger than stated"], **SILENT_LIGHT), stiff("direct"),
           stiff("direct", why="RuntimeError: out of luck", **SILENT_LIGHT), stiff("gan"),
           stiff("gan", budget=300.0), *(stiff(method, f"roughness: {member}", "series", condition=c)
             for method in ("hybrid", "direct") for member, c in zip(SERIES["roughness"],
                                                                     (10.0, 30.0, 1e3, None, None)))]


def test_the_published_page_is_that_of_the_published_record(tmp_path):
    record = check_benchmark(json.loads((ROOT / "docs/results/stability-fits.json").read_text()), "docs")
    page, picture = write_stiff_page(tmp_path / "stability-fits.md", record)
    assert page.read_bytes() == (ROOT / "docs/stability-fits.md").read_bytes()
    assert (ROOT / "docs" / picture.name).is_file()
    assert {r["name"] for r in record["records"]} == {*CASES,
                                                      *(f"{s}: {m}" for s, members in SERIES.items()
                                                        for m in members)}


def test_tables_count_what_the_record_holds():
    record = check_benchmark(benchmark(RECORDS), "here")
    assert list(fits_of(record, "case")) == ["hybrid", "direct", "gan", "gan, 300 s"]
    assert overview(record).rows == [
        ["nothing wrong", "sound (2 of 3); degraded silently (1 of 3)", "sound", "sound", "sound"],
        ["light stated 4x too weak", "degraded silently (1 of 2); degraded, says so (1 of 2)", "failed", "–",
         "–"]]
    assert warnings(record).rows == [["light power", "1 of 2", "0 of 1", "–", "–"]]
    control, light = each("hybrid", fits_of(record, "case")["hybrid"]).rows
    # Means of the maps: 0.03, 0.035, 0.0975, of attainable 0.02; roughness in the median of the three.
    assert control[2:5] == ["0.035 (0.030 to 0.098)", "1.8 (1.5 to 4.9)", "roughness 0.050"]
    assert light[-2:] == ["light power (1 of 2)", "light power (1 of 2)"]
    assert [row[5] for row in inputs(record).rows] == ["–", "light power"]
    rows = convergence("direct", fits_of(record, "series")["direct"]).rows
    assert [row[1] for row in rows] == ["10, worst ∞", "30, worst ∞", "1e+03, worst ∞", "rank 9 of 9",
                                        "rank 9 of 9"]


def test_the_page_names_what_is_silent_and_what_failed(tmp_path):
    page, picture = write_stiff_page(tmp_path / "fits.md", benchmark(RECORDS))
    text = page.read_text()
    assert "- Failed: `direct` on light stated 4x too weak (RuntimeError: out of luck)." in text
    assert ("- Degraded silently: `hybrid` on nothing wrong (roughness 0.30); `hybrid` on light stated 4x "
            "too weak "
            "(diffuse 0.30).") in text
    assert f"]({picture.name})" in text and "A quick run" not in text
    record = benchmark(RECORDS)
    record["settings"] = record["settings"] | {"quick": True}
    assert "A quick run" in write_stiff_page(tmp_path / "quick.md", record)[0].read_text()
    whole = picture.read_bytes()
    write_stiff_page(tmp_path / "fits.md", benchmark(RECORDS))
    assert picture.read_bytes() == whole
    assert write_stiff_page(tmp_path / "cases.md", benchmark(RECORDS[:4])) == [tmp_path / "cases.md"]


@pytest.mark.slow
def test_the_published_records_are_of_this_code():
    record = json.loads((ROOT / "docs/results/stability-fits.json").read_text())
    assert record["settings"]["code"] == shared_code(
        SHAPING), "shared code has changed: run `mitsvbrdf stability --fits` anew"
    assert record["settings"]["scenes"] == digest()
    assert not stale(record), "the code of methods has changed: run `mitsvbrdf stability --fits`, which goes on"


def test_the_picture_has_a_place_for_every_fit():
    error, time = convergence_figure(benchmark(RECORDS)).axes[0], convergence_figure(benchmark(RECORDS)).axes[
        2]
    for panel, height in ((error, 0.03), (time, 2.5)):
        (line,) = [line for line in panel.lines if len(line.get_xdata()) == 5 and line.get_marker() != "_"]
        assert list(line.get_xdata()[:3]) == [10.0, 30.0,
                                              1e3] and 3e3 < line.get_xdata()[3] < line.get_xdata()[4]
        assert list(line.get_ydata()) == pytest.approx([height] * 5)


ASKED = ["stability", "--fits", "quick", "--methods", "direct", "--renderer", "analytic", "--resolution",
         "16", "--budget",
         "0.05"]


def test_the_command_goes_on_and_makes_the_page_anew(tmp_path, monkeypatch, capsys):
    for table, kept in ((CASES, ("nothing wrong", "black albedo")), (SERIES, ("roughness",))):
        for name in [name for name in table if name not in kept]:
            monkeypatch.delitem(table, name)
    monkeypatch.setitem(SERIES, "roughness", {"0.1": Scene("inlay", roughness=0.1)})
    out, count, there = ["--json", str(tmp_path / "s.json")], [], 3

    def second_interrupted(job, report):
        count.append(job.title)
        if len(count) == 2:
            raise KeyboardInterrupt
        return {name: value for name, value in stiff(why="out of luck" if len(count) == 3 else None).items()
                if name not in job.key and name != "config"}

    monkeypatch.setattr(StiffFit, "run", second_interrupted)
    monkeypatch.setattr(StiffFit, "warm_up", lambda job: None)
    assert cli.main([*ASKED, *out]) == 130 and f"1 of {there} jobs need no more" in capsys.readouterr().out
    assert cli.main([*ASKED, *out, "--md", str(tmp_path / "s.md")]) == 1
    assert f"failed: direct on {list(CASES)[1]}, seed 0: out of luck" in " ".join(
        capsys.readouterr().out.split())
    assert len(count) == 1 + there and len(json.loads((tmp_path / "s.json").read_text())["records"]) == there
    first = (tmp_path / "s.md").read_bytes()
    assert cli.main(["stability", "--fits", "none", *out, "--md", str(tmp_path / "s.md"), "--overwrite"]) == 1
    assert (tmp_path / "s.md").read_bytes() == first and len(count) == 1 + there


def test_workers_make_the_same_fits_of_what_was_asked_for(tmp_path, monkeypatch):
    asked = StiffPlan(True, ["direct", "hybrid"], 0.05, 16, "analytic")
    told = json.loads(json.dumps(["StiffPlan", asdict(asked)]))
    monkeypatch.setattr(child, "_made", [])
    monkeypatch.setattr(StiffFit, "warm_up", lambda job: None)
    monkeypatch.setattr(StiffFit, "run", lambda job: {"ran": job.title})
    monkeypatch.chdir(tmp_path)
    jobs = asked.jobs()[0]
    for job in jobs[::9]:
        assert child.measure({"folder": str(tmp_path), "plan": told,
                              "key": key_of(job)}) == {"ran": job.title}
    assert [*child._made[0][1]] == [key_of(job) for job in jobs]


@pytest.mark.parametrize("asked, words", [
    (["--methods", "direct"], "add --fits"), (["--workers", "2"], "add --fits"),
    (["--fits", "all", "--workers", "0"], "--workers"),
    (["--budget", "0"], "add --fits"), (["--fits", "all", "--only", "flat"], "sweeps"),
    (["--fits", "all", "--html", "a.html"], "sweeps"), (["--fits", "all", "--budget", "0"],
                                                        "a budget above 0"),
    (["--fits", "none", "--json", "{}/gone.json"], "No such file"),
    (["--fits", "none", "--json", "{}/other.json"], "others in"),
    (["--fits", "all", "--md", "{}"], "a file to write"),
])
def test_mistakes_are_one_error(asked, words, tmp_path, capsys):
    (tmp_path / "other.json").write_text(json.dumps(benchmark([])))
    assert cli.main(["stability", *(part.format(tmp_path) for part in asked)]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
