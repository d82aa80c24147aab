"""The command: interrupted runs go on, data is found, and mistakes are one error."""

import json
from importlib.util import find_spec

import pytest
from helpers import ANALYTIC, GRID, photos_of
from helpers.bench_records import SETTINGS, record

from mitsvbrdf import cli
from mitsvbrdf.bench import jobs
from mitsvbrdf.bench.methods import method_table
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.bench.store import Store
from mitsvbrdf.bench.tasks import known_material
from mitsvbrdf.capture import write_capture
from mitsvbrdf.cli.measuring import outlook
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import HybridConfig
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps

TINY = ["bench", "--renderer", "analytic", "--materials", "inlay", "--captures", "none", "--resolution", "16",
        "--budgets",
        "0.1,0.2", "--seeds", "0,1"]


def test_other_settings_are_refused(tmp_path):
    store = Store(tmp_path / "b.json", SETTINGS)
    store.add(record(mean=0.1))
    assert Store(tmp_path / "b.json", SETTINGS).records == store.records
    with pytest.raises(ConfigError, match="resolution 16"):
        Store(tmp_path / "b.json", SETTINGS | {"resolution": 32})
    assert Store(tmp_path / "b.json", SETTINGS | {"resolution": 32}, anew=True).records == []
    for part, name in (("versions", "mitsuba"), ("machine", "cores"), ("settings", "code")):
        content = json.loads((tmp_path / "b.json").read_text())
        content[part][name] = "another"
        (tmp_path / "c.json").write_text(json.dumps(content))
        with pytest.raises(ConfigError, match=f"{name} 'another'"):
            Store(tmp_path / "c.json", SETTINGS)


def test_a_changed_variant_is_measured_anew(tmp_path):
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    old, new = ({"full": HybridConfig(), "less": HybridConfig(smooth=smooth)} for smooth in (0.0, 0.005))
    store = Store(tmp_path / "b.json", SETTINGS)
    for job in jobs.fit_jobs("ablation", old, [task], [0.1], [0, 1], ANALYTIC):
        store.add(record(job.method, 0.1, job.seed, "inlay", suite="ablation", mean=0.1)
                  | {"config": job.settings})
    assert store.pending(jobs.fit_jobs("ablation", old, [task], [0.1], [0, 1], ANALYTIC)) == []
    missing = store.pending(jobs.fit_jobs("ablation", new, [task], [0.1], [0], ANALYTIC))
    assert [(job.method, job.seed) for job in missing] == [("less", 0)]
    # what was measured with the old settings is gone
    assert [r["method"] for r in store.records] == ["full", "full"]


def test_records_of_other_code_of_their_method_go_with_the_first_new_one_and_no_others(tmp_path):
    task = known_material("builtin:inlay", 16, GRID, ANALYTIC)
    both = jobs.fit_jobs("methods", {name: method_table()[name] for name in ("direct", "hybrid")}, [task],
                         [0.1], [0], ANALYTIC)
    store = Store(tmp_path / "b.json", SETTINGS)
    for job, code in zip(both, ({"code": "0123456789ab"}, {})):
        store.add(record(job.method, 0.1, name="inlay", mean=0.1) | {"config": job.settings | code})
    assert [job.method for job in store.pending(both)] == ["direct"]
    said = outlook(both, store)
    assert said.startswith("1 of 2 jobs") and said.endswith("code of a method, which go when the first new "
                                                            "one comes: 1")
    assert "of a method" not in outlook(both[1:], Store(tmp_path / "b.json", SETTINGS))


@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    return tmp_path / "b.json"


def test_interrupted_runs_go_on_with_the_same_records(out, monkeypatch, capsys):
    arguments = [*TINY, "--suite", "methods", "--methods", "direct,hybrid", "--json", str(out)]
    run, count = jobs.FitJob.run, []

    def thrice(job, report):
        count.append(job.title)
        if len(count) == 4:
            raise KeyboardInterrupt
        return run(job, report)

    monkeypatch.setattr(jobs.FitJob, "run", thrice)
    assert cli.main(arguments) == 130
    assert "3 of 6 jobs need no more" in capsys.readouterr().out
    first = json.loads(out.read_text())
    check_benchmark(first, "here")
    monkeypatch.setattr(jobs.FitJob, "run", run)
    assert cli.main([*arguments, "--page", str(out.with_suffix(".md"))]) == 0
    assert "3 of 6 jobs need no more" in capsys.readouterr().out
    second = check_benchmark(json.loads(out.read_text()), "here")
    assert second["records"][:3] == first["records"] and len(second["records"]) == 6 and second["seeds"] == [
        0, 1]
    # Methods take turns, seed by seed: what drifts hits all. `direct` is the same from every seed.
    assert [(r["seed"], r["budget"], r["method"]) for r in second["records"]] == [
        (s, b, m) for s, methods in ((0, ("direct", "hybrid")), (1, ("hybrid",))) for b in (0.1, 0.2)
        for m in methods]
    for r in second["records"]:
        assert set(r["errors"]) == {"diffuse", "specular", "roughness", "normal", "mean", "novel_light",
                                    "photos"} | (
            {"flip_novel_light", "flip_photos"} if find_spec("flip_evaluator") else set())
    before = out.read_bytes()
    assert cli.main(arguments) == 0 and "nothing to do" in capsys.readouterr().out and out.read_bytes() == before
    page = out.with_suffix(".md").read_text()
    assert "--materials inlay --captures none --methods direct,hybrid --budgets 0.1,0.2 --seeds 0,1" in page


@pytest.mark.slow
def test_quick_measures_everything(out, monkeypatch, tmp_path):
    monkeypatch.setattr("mitsvbrdf.bench.plan.QUICK_CASES", {"sizes": (8,), "views": (1,), "samples": ()})
    monkeypatch.setattr("mitsvbrdf.bench.variants.VARIANTS", {"no neighbours": {"neighbours": False}})
    for suite in ("ablation", "all"):
        assert cli.main(["bench", "--quick", "--suite", suite, "--renderer", "analytic", "--resolution", "16",
                         "--budgets",
                         "0.1", "--repeats", "1", "--json", str(out), "--page", str(tmp_path / "p.md"),
                         "--overwrite"]) == 0
    found = check_benchmark(json.loads(out.read_text()), "here")
    suites = [r["suite"] for r in found["records"]]
    assert suites.count("renderers") == 2 * (1 + 1) and suites.count("ablation") == 2
    assert suites.count("methods") == len(method_table())
    page = (tmp_path / "p.md").read_text()
    for heading in ("## In short", "## Known materials", "## Renderers", "## Each ingredient off"):
        assert heading in page
    assert cli.main(["bench", "--suite", "none", "--json", str(out), "--page", str(tmp_path / "q.md")]) == 0
    assert (tmp_path / "q.md").read_text() == page.replace("p-", "q-")


def test_captures_are_fitted_without_each_choice_of_photos(out, tmp_path):
    for name in ("cards", "wood"):
        write_capture(photos_of(make_material("inlay", 16)), tmp_path / "data/captures" / name)
    blind = {"per_view": [0.1] * 9, "left_out_7_8_rmse_256": {"gao2019": 0.2}}
    (tmp_path / "data/peers.json").write_text(json.dumps({"materials": {}, "captures": {"wood": blind}}))
    arguments = ["bench", "--suite", "methods", "--methods", "direct", "--renderer", "analytic",
                 "--resolution", "16",
                 "--budgets", "0.1", "--seeds", "0", "--json", str(out), "--materials", "none",
                 "--data", str(tmp_path / "data")]
    assert cli.main([*arguments, "--left-out", "4,7/peers"]) == 0
    found = json.loads(out.read_text())["records"]
    assert [(r["name"], r["left_out"]) for r in found] == [("cards", [4, 7]), ("wood", [4, 7]),
                                                           ("wood", [7, 8])]
    assert found[1]["errors"] != found[2]["errors"]
    assert cli.main([*arguments, "--left-out", "8,7", "--page", str(tmp_path / "p.md")]) == 0
    (new,) = json.loads(out.read_text())["records"][3:]
    assert (new["name"], new["left_out"]) == ("cards", [7, 8])
    page = (tmp_path / "p.md").read_text()
    for words in ("## Real captures without photos 4 and 7", "## Real captures without photos 7 and 8",
                  "--left-out 7,8"):
        assert words in page, words


def test_data_is_found_where_it_is_named(out, monkeypatch, tmp_path):
    shots = photos_of(make_material("inlay", 16))
    write_capture(shots, tmp_path / "data/captures/cards-blue")
    save_maps(make_material("leather", 16), tmp_path / "data/materials/hide")
    arguments = ["bench", "--suite", "methods", "--methods", "direct", "--renderer", "analytic",
                 "--resolution", "16",
                 "--budgets", "0.1", "--seeds", "0", "--json", str(out)]
    assert cli.main([*arguments, "--data", str(tmp_path / "data")]) == 0
    found = json.loads(out.read_text())
    made = ["inlay", "tiles", "leather", "plates"]
    assert [r["name"] for r in found["records"]] == [*made, "hide",
                                                     "cards-blue"] and found["settings"][
                                                         "views"] == "cards-blue"
    monkeypatch.setenv("MITSVBRDF_DATA", str(tmp_path / "data"))
    assert cli.main([*arguments, "--materials", "hide", "--captures", "cards-blue"]) == 0  # all there already
    assert json.loads(out.read_text()) == found


@pytest.mark.parametrize("extra, words", [
    (["--methods", "magic"], "hybrid"), (["--budgets", "10,none"], "--budgets"),
    (["--budgets", "0"], "--budgets"),
    (["--seeds", "-1"], "--seeds"), (["--seeds", "99999999999"], "seed"),
    (["--resolution", "4"], "--resolution"),
    (["--materials", "builtin:gold"], "made material"), (["--materials", "nowhere"], "nowhere"),
    (["--captures", "nowhere"], "nowhere"), (["--data", "nowhere"], "nowhere"),
    (["--views", "nowhere"], "nowhere"),
    (["--materials", "none"], "--materials"), (["--suite", "none"], "--json"),
    (["--repeats", "0"], "--repeats"),
    (["--materials", "inlay,builtin:inlay"], "inlay twice"), (["--left-out", "x"], "4,7"),
    (["--left-out", "4,7/7,4"], "once"),
    (["--left-out", "4,7/peers"], "peers.json"), (["--suite", "start"], "no capture"),
    (["--suite", "start", "--methods", "peers-baseline"], "peers-baseline"),
    (["--suite", "capture", "--captures", "all"], "none called all"),
])
def test_mistakes_are_one_error(extra, words, out, capsys):
    assert cli.main([*TINY, "--suite", "methods", "--json", str(out), *extra]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and words in message
    assert not out.exists()


def test_a_file_that_is_no_benchmark_is_refused_and_kept(out, capsys):
    for content in ("{", "[]", '{"schema_version": 1}'):
        out.write_text(content)
        assert cli.main([*TINY, "--suite", "methods", "--methods", "direct", "--json", str(out)]) == 2
        assert "--anew" in capsys.readouterr().err and out.read_text() == content
