"""What a running fit shows of itself: its maps, about once a second, and the same bits as unwatched."""

import cv2
import numpy as np
import pytest
import torch
from helpers import ANALYTIC
from helpers.live_fits import FAST, SIDE, fit_into, served, state_of

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.fit import (
    DirectConfig,
    FitTask,
    GanConfig,
    HierarchicalConfig,
    HybridConfig,
    fit_svbrdf,
    make_method,
)
from mitsvbrdf.fit import live as fit_live
from mitsvbrdf.fit.checkpoint import load_tensors
from mitsvbrdf.fit.live import LiveRecord
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.io import results
from mitsvbrdf.material.made import make_material
from mitsvbrdf.render import make_renderer


def test_pictures_are_the_maps(tmp_path, capture, every_step):
    # The maps of the state measured last, here that of the result, in display values by the standards' own
    # formulas.
    out, shown = tmp_path / "out", {}

    def look(entry, share):
        if entry is None and state_of(ask):
            for name in ("diffuse", "specular", "roughness", "normal"):
                png = cv2.imdecode(np.frombuffer(ask(f"/maps/{name}.png")[2], np.uint8), cv2.IMREAD_UNCHANGED)
                shown[name] = png[..., ::-1].astype(float) / 255 if png.ndim == 3 else png[..., None] / 255

    with served(out) as ask:
        result = fit_into(out, capture, FAST, look)
    assert result.trace[-1]["rerender_rmse"] == result.rerender_rmse  # the best is the last here
    for name, picture in shown.items():
        value = result.svbrdf[name].double().numpy()
        if name in ("diffuse", "specular"):
            # IEC 61966-2-1
            value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
        value = (value + 1) / 2 if name == "normal" else value
        # Half a step of 8 bits, and what float16 keeps of the value: 2^-11, times 12.92 / 2.4 where sRGB is
        # steep.
        assert np.abs(picture - value).max() < 0.5 / 255 + 0.0005, name


def test_maps_are_the_latest_not_the_best(tmp_path, capture, every_step):
    # Where a fit gets worse for a while its maps are still seen to move.
    method = make_method(FitTask(capture, ANALYTIC, FAST, torch.full((SIDE, SIDE, 3), 0.3)))
    loop = Loop(method, capture, ANALYTIC, FAST, live=LiveRecord(tmp_path / results.LIVE))
    loop.best = 0.0, make_material("tiles", SIDE), capture.views  # nothing is better than that
    loop.run()
    assert torch.equal(load_tensors(tmp_path / results.LIVE)[0]["diffuse"],
                       method.estimate()[0]["diffuse"].half())
    assert loop.best[0] == 0.0


def test_larger_maps_are_shrunk_by_area(tmp_path, capture, monkeypatch):
    monkeypatch.setattr(fit_live, "SIDE", SIDE // 2)
    result = fit_svbrdf(capture, ANALYTIC, FAST, live=tmp_path / results.LIVE)
    tensors, note = load_tensors(tmp_path / results.LIVE)
    blocks = result.svbrdf["diffuse"].reshape(SIDE // 2, 2, SIDE // 2, 2, 3).mean(dim=(1, 3))
    assert torch.allclose(tensors["diffuse"].float(), blocks, rtol=2**-10, atol=1e-7)  # float16
    assert {t.dtype for t in tensors.values()} == {torch.float16} and note["resolution"] == SIDE


@pytest.mark.parametrize("name, config", [
    ("direct", DirectConfig(iterations=23)), ("hybrid", HybridConfig(width=4, iterations=12)),
    ("gan", GanConfig(width=4, iterations=12)), ("hierarchical", HierarchicalConfig(iterations=8))])
def test_a_fit_has_the_same_bits_unwatched(name, config, tmp_path, capture, every_step):
    records = []

    def look(entry, share):
        if (tmp_path / results.LIVE).exists():
            records.append(load_tensors(tmp_path / results.LIVE)[1])

    renderer = make_renderer("mitsuba") if name == "hierarchical" else ANALYTIC
    watched = fit_svbrdf(capture, renderer, config, live=tmp_path / results.LIVE, report=look)
    alone = fit_svbrdf(capture, renderer, config)
    assert records and records[0]["method"] == name
    assert all(torch.equal(watched.svbrdf[key], alone.svbrdf[key]) for key in alone.svbrdf.maps)
    assert torch.equal(watched.views.light, alone.views.light)
    without = [[{k: v for k, v in row.items() if k != "seconds"} for row in r.trace] for r in (watched,
                                                                                               alone)]
    assert without[0] == without[1]


def test_hierarchical_shows_each_round(tmp_path, capture, every_step):
    # Between measurements too: the maps then are those of its unknowns, at the size it works at.
    config, mitsuba = HierarchicalConfig(iterations=3), make_renderer("mitsuba")
    method = make_method(FitTask(capture, mitsuba, config, torch.full((SIDE, SIDE, 3), 0.3)))
    loop = Loop(method, capture, mitsuba, config, live=LiveRecord(tmp_path / results.LIVE))
    maps, step = [], method.step

    def looking_step(progress):
        maps.append(load_tensors(tmp_path / results.LIVE)[0]["roughness"])
        assert torch.equal(maps[-1][..., 0], method.answer.x[method.ties.unknowns.of("roughness")][0].half())
        return step(progress)

    method.step = looking_step
    loop.run()
    assert len(maps) == 3 and not torch.equal(maps[1], maps[2])


@pytest.mark.parametrize("cost, step", [(0.0004, 0.05), (0.2, 0.05), (3.0, 0.7), (0.1, 30.0)])
def test_records_are_a_second_apart_and_take_five_percent(cost, step, tmp_path, monkeypatch):
    now, written = 0.0, []

    def write(self, *arguments):
        nonlocal now
        written.append(now)
        now += cost

    monkeypatch.setattr(fit_live.time, "perf_counter", lambda: now)
    monkeypatch.setattr(LiveRecord, "write", write)
    record, steps = LiveRecord(tmp_path / "live"), 0
    while now < 600:
        record.offer(None, {})
        now += step
        steps += 1
    gaps = np.diff(written)
    assert gaps.min() >= 1.0 and (len(written) - 1) * cost <= 0.05 * now + 1e-9
    assert gaps.max() <= max(1.0, 20 * cost) + cost + 2 * step  # and no longer apart than that asks for
    record.offer(None, {}, "budget")
    assert len(written) == len(gaps) + 2  # the end is always shown


def test_a_record_that_cannot_be_written_ends_no_fit(tmp_path, capture, every_step):
    (tmp_path / "file").write_text("in the way")
    result = fit_svbrdf(capture, ANALYTIC, FAST, live=tmp_path / "file" / results.LIVE)
    assert result.stopped == "iterations" and [p.name for p in tmp_path.iterdir()] == ["file"]


def test_the_command_leaves_no_record(tmp_path, capture, monkeypatch):
    seen, write = [], LiveRecord.write

    def watched(self, *arguments):
        write(self, *arguments)
        seen.append(self.path)

    monkeypatch.setattr(LiveRecord, "write", watched)
    write_capture(capture, tmp_path / "photos")
    out = tmp_path / "out"
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(out), "--method", "direct", "--renderer",
                     "analytic",
                     "--resolution", str(SIDE), "--iterations", "3"]) == 0
    assert len(seen) >= 2 and set(seen) == {results.partial_folder(out).resolve() / results.LIVE}
    assert not list(out.rglob(f"*{results.LIVE}*")) and (out / "fit.json").is_file()
