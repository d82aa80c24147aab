"""What a scene may do without: pictures with and without agree, and the files say what was measured."""

import json
import os
import signal

import pytest
import torch
from helpers.bench_records import benchmark

from mitsvbrdf.bench.leave_out import plan, renders
from mitsvbrdf.bench.leave_out.fits import PairJob
from mitsvbrdf.bench.leave_out.renders import Case
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.cli import main

# Two float32 results of one scene. Measured at 16 px: the same bits but for the Fresnel formula and for rays,
# 1.3e-6.
DIFFERENCE = 3e-6


@pytest.mark.slow
def test_leaving_out_changes_nothing_and_is_written_down(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("record.json", "page.md")]
    assert main(["leave-out", "--resolution", "16", "--repeats", "1", "--json", files[0], "--md",
                 files[1]]) == 0
    items = json.loads((tmp_path / "record.json").read_text())["records"]
    page, shown = (tmp_path / "page.md").read_text(), capsys.readouterr().out
    for item in items:
        assert item["worst"] < DIFFERENCE or item["name"] == "light falloff", item["name"]
        assert f"| {item['name']} |" in page
    assert {"specular lobe", "diffuse lobe", "normal map", "ray tracing", "shadow rays", "path depth",
            "environment",
            "discriminator", "all of these"} <= {item["name"] for item in items}
    assert "all of these" in shown


def picture(value=1.0):
    return torch.full((1, 2, 2, 3), value)


CASES = [Case(name, "mitsuba", "it is 0", picture, lambda: picture(1.1), lambda: picture(1.0))
         for name in ("a", "b", "c")]


def test_a_case_is_a_record_of_differences():
    record = CASES[0].key | {"config": CASES[0].settings} | CASES[0].run()
    check_benchmark(benchmark([record]), "here")
    assert record["worst"] == pytest.approx(0.1) == record["mean"] == record["lean_error"] and record[
        "full_error"] == 0
    assert record["seconds"]["full"]["repeats"] == 9 and record["says"] == ["a"]
    assert Case("a", "hybrid", "", picture, picture).run()["full_error"] is None


@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.delenv("MITSVBRDF_DATA", raising=False)
    monkeypatch.setattr(plan, "render_cases", lambda resolution, repeats: CASES)
    return tmp_path / "l.json"


def test_the_command_goes_on_after_ctrl_c_and_forgets_only_when_asked(out, monkeypatch, capsys):
    run, count = Case.run, []

    def second_interrupted(job, report):
        count.append(job.what)
        if len(count) == 2:
            os.kill(os.getpid(), signal.SIGINT)
        return run(job)

    monkeypatch.setattr(renders.Case, "run", second_interrupted)
    command = ["leave-out", "--json", str(out)]
    assert main(command) == 130 and "1 of 3 jobs need no more than the records" in capsys.readouterr().out
    assert main([*command, "--md", str(out.with_suffix(".md"))]) == 0 and count == ["a", "b", "b", "c"]
    assert "left out of a scene" in capsys.readouterr().out.lower()
    page, before = out.with_suffix(".md"), out.read_bytes()
    assert main([*command, "--md", str(page)]) == 2 and "--overwrite" in capsys.readouterr().err
    made = page.read_bytes()
    assert main([*command, "--page-only", "--md", str(page), "--overwrite"]) == 0
    assert page.read_bytes() == made and out.read_bytes() == before and len(count) == 4
    assert main([*command, "--repeats", "3"]) == 2
    assert "--anew forgets it" in " ".join(capsys.readouterr().err.split()) and out.read_bytes() == before
    assert main([*command, "--repeats", "3", "--anew"]) == 0 and count[4:] == ["a", "b", "c"]


def test_the_time_of_the_fits_is_said_first(out, monkeypatch, capsys):
    monkeypatch.setattr(PairJob, "run", lambda job, report: pytest.fail("began"))
    monkeypatch.setattr(renders.Case, "run", lambda job, report: os.kill(os.getpid(), signal.SIGINT))
    assert main(["leave-out", "--json", str(out), "--fits", "--fit-resolution", "16", "--parts",
                 "look-alikes"]) == 130
    said = capsys.readouterr().out
    assert said.index("after the renders: 0 of 4 jobs") < said.index(
        "0 of 3 jobs") and "the other 4 take about" in said


@pytest.mark.parametrize("extra, words", [
    (["--resolution", "4"], "resolutions of 8"), (["--fits", "--fit-repeats", "0"], "repeats of 1"),
    (["--parts", "look-alikes"], "add --fits"), (["--workers", "2"], "add --fits"),
    (["--captures", "oak"], "add --fits"),
    (["--fits", "--parts", "luck"], "check --parts"), (["--fits", "--captures", "oak"], "none called oak"),
    (["--fits", "--workers", "0"], "--workers"), (["--page-only"], "No such file")])
def test_mistakes_are_one_error(extra, words, out, capsys):
    assert main(["leave-out", "--json", str(out), "--fit-resolution", "16", *extra]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("error:") == 1 and words in said and not out.exists()
