"""What a running fit shows of itself, and the page that follows it: over real HTTP, and in a real browser."""

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
import torch

from mitsvbrdf import cli
from mitsvbrdf.capture import write_capture
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.fit import DirectConfig, FitTask, GanConfig, HierarchicalConfig, HybridConfig, fit_svbrdf, make_method
from mitsvbrdf.fit import live as fit_live
from mitsvbrdf.fit.checkpoint import load_tensors, save_tensors
from mitsvbrdf.fit.live import LiveRecord
from mitsvbrdf.fit.loop import Loop
from mitsvbrdf.material.made import make_material
from mitsvbrdf.render import make_renderer
from mitsvbrdf.report import live
from mitsvbrdf.report.live import ADDRESS, PORT, Watch, make_server
from mitsvbrdf.synth.photograph import photograph
from mitsvbrdf.system import files, images, result_folder
from mitsvbrdf.views import nine_view_grid

SIDE = 16
ANALYTIC = make_renderer("analytic")
FAST = DirectConfig(iterations=20)


@pytest.fixture(scope="module")
def capture():
    return photograph(make_material("inlay", SIDE), nine_view_grid(), ANALYTIC, 0.003)


@pytest.fixture
def every_step(monkeypatch):
    """A record at each step."""
    monkeypatch.setattr(fit_live, "SECONDS", 0.0)
    monkeypatch.setattr(fit_live, "SHARE", 1.0)


@contextmanager
def served(out):
    """A function that asks the live page of this folder: (path) -> status, headers, content."""
    with make_server(Watch(out), 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()

        def ask(path="/state.json", method="GET", **headers):
            connection = http.client.HTTPConnection(*server.server_address, timeout=20)
            connection.putrequest(method, path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            found = answer.status, answer.headers, answer.read()
            connection.close()
            return found

        ask.port = server.server_address[1]
        try:
            yield ask
        finally:
            server.shutdown()
            thread.join()


def state_of(ask):
    status, _, content = ask()
    assert status == 200
    return json.loads(content, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def fit_into(out, capture, config, report=None, overwrite=False, fails=None):
    """What `mitsvbrdf fit` does with its folder, with results that a test can tell apart."""
    with result_folder.output_folder(out, overwrite) as folder:
        result = fit_svbrdf(capture, ANALYTIC, config, checkpoint=folder / result_folder.CHECKPOINT, live=folder / result_folder.LIVE,
                            report=report)
        if report:
            report(None, 1.0)
        if fails:
            raise fails
        (folder / "report.html").write_text(f"<p>{result.rerender_rmse}</p>")
        (folder / "sheet.png").write_bytes(images.encode_png(torch.zeros(2, 2, 3)))
        files.write_json(folder / "fit.json", {
            "method": "direct", "renderer": "analytic", "bsdf": "roughconductor", "stopped": result.stopped,
            "trace": result.trace, "warnings": [], "seconds": 1.0, "iterations": 20,
            "capture": {"name": None, "resolution": SIDE}})
    return result


# ---- the page follows a fit ----

def test_a_fit_is_followed_from_before_it_starts_to_after_it_ends(tmp_path, capture, every_step):
    out, seen, pictures, rows = tmp_path / "out", [], [], []

    def look(entry, share):
        seen.append(state_of(ask))
        rows.append(entry)
        if seen[-1]["fit"]:
            pictures.append(ask(f"/maps/diffuse.png?{seen[-1]['fit']['version']}")[2])

    with served(out) as ask:
        before = state_of(ask)
        assert before["phase"] == "waiting" and str(out) in before["says"] and before["fit"] is before["report"] is None
        assert ask("/report.html")[0] == ask("/maps/diffuse.png")[0] == 404
        result = fit_into(out, capture, FAST, look)
        after = state_of(ask)
        assert ask("/report.html")[2].decode() == f"<p>{result.rerender_rmse}</p>"

    # The report of a measurement comes before the record of that step: the page is one measurement behind, at most.
    assert [s["phase"] for s in seen] == ["starting", "running", "running", "writing"]
    assert [s["fit"]["iteration"] for s in seen[1:]] == [9, 19, 20]
    assert [s["fit"]["trace"] for s in seen[1:]] == [rows[:1], rows[:2], rows[:3]] and rows[2] == result.trace[2]
    assert seen[1]["fit"]["latest"]["iteration"] == 9 and seen[1]["fit"]["latest"]["photometric"] > 0
    assert [round(s["fit"]["share"], 3) for s in seen[1:]] == [0.45, 0.95, 1.0]
    assert len({s["fit"]["run"] for s in seen[1:]}) == 1 and len({s["fit"]["version"] for s in seen[1:]}) == 3
    assert pictures[0] != pictures[1] != pictures[2]
    assert seen[1]["says"] == "Fitting" and "all iterations done" in seen[3]["says"]
    assert after["phase"] == "done" and after["report"] and after["fit"]["trace"] == result.trace
    assert not (out / result_folder.LIVE).exists() and result_folder.LIVE not in json.loads((out / result_folder.MANIFEST).read_text())
    assert not result_folder.partial_folder(out).exists()


def test_a_fit_that_starts_anew_is_followed_again(tmp_path, capture, every_step):
    out, seen = tmp_path / "out", []
    with served(out) as ask:
        fit_into(out, capture, FAST)
        first = state_of(ask)
        fit_into(out, capture, FAST, lambda entry, share: seen.append(state_of(ask)), overwrite=True)
        last = state_of(ask)
        assert ask("/maps/diffuse.png")[0] == 404  # no running fit's any more
    assert [s["phase"] for s in seen] == ["starting", "running", "running", "writing"]
    assert seen[0]["fit"] is None and seen[1]["report"] == first["report"]  # the earlier report is still there
    assert first["phase"] == last["phase"] == "done" and first["report"] != last["report"]


def test_pictures_are_the_maps(tmp_path, capture, every_step):
    # The maps of the state measured last, here that of the result, in display values by the standards' own formulas.
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
            value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)  # IEC 61966-2-1
        value = (value + 1) / 2 if name == "normal" else value
        # Half a step of 8 bits, and what float16 keeps of the value: 2^-11, times 12.92 / 2.4 where sRGB is steep.
        assert np.abs(picture - value).max() < 0.5 / 255 + 0.0005, name


def test_maps_are_the_latest_not_the_best(tmp_path, capture, every_step):
    # Where a fit gets worse for a while its maps are still seen to move.
    method = make_method(FitTask(capture, ANALYTIC, FAST, torch.full((SIDE, SIDE, 3), 0.3)))
    loop = Loop(method, capture, ANALYTIC, FAST, live=LiveRecord(tmp_path / result_folder.LIVE))
    loop.best = 0.0, make_material("tiles", SIDE), capture.views  # nothing is better than that
    loop.run()
    assert torch.equal(load_tensors(tmp_path / result_folder.LIVE)[0]["diffuse"], method.estimate()[0]["diffuse"].half())
    assert loop.best[0] == 0.0


def test_larger_maps_are_shrunk_by_area(tmp_path, capture, monkeypatch):
    monkeypatch.setattr(fit_live, "SIDE", SIDE // 2)
    result = fit_svbrdf(capture, ANALYTIC, FAST, live=tmp_path / result_folder.LIVE)
    tensors, note = load_tensors(tmp_path / result_folder.LIVE)
    blocks = result.svbrdf["diffuse"].reshape(SIDE // 2, 2, SIDE // 2, 2, 3).mean(dim=(1, 3))
    assert torch.allclose(tensors["diffuse"].float(), blocks, rtol=2**-10, atol=1e-7)  # float16
    assert {t.dtype for t in tensors.values()} == {torch.float16} and note["resolution"] == SIDE


@pytest.mark.parametrize("name, config", [
    ("direct", DirectConfig(iterations=23)), ("hybrid", HybridConfig(width=4, iterations=12)),
    ("gan", GanConfig(width=4, iterations=12)), ("hierarchical", HierarchicalConfig(iterations=8))])
def test_a_fit_has_the_same_bits_unwatched(name, config, tmp_path, capture, every_step):
    records = []

    def look(entry, share):
        if (tmp_path / result_folder.LIVE).exists():
            records.append(load_tensors(tmp_path / result_folder.LIVE)[1])

    renderer = make_renderer("mitsuba") if name == "hierarchical" else ANALYTIC
    watched = fit_svbrdf(capture, renderer, config, live=tmp_path / result_folder.LIVE, report=look)
    alone = fit_svbrdf(capture, renderer, config)
    assert records and records[0]["method"] == name
    assert all(torch.equal(watched.svbrdf[key], alone.svbrdf[key]) for key in alone.svbrdf.maps)
    assert torch.equal(watched.views.light, alone.views.light)
    without = [[{k: v for k, v in row.items() if k != "seconds"} for row in r.trace] for r in (watched, alone)]
    assert without[0] == without[1]


def test_hierarchical_shows_each_round(tmp_path, capture, every_step):
    # Between measurements too: the maps then are those of its unknowns, at the size it works at.
    config, mitsuba = HierarchicalConfig(iterations=3), make_renderer("mitsuba")
    method = make_method(FitTask(capture, mitsuba, config, torch.full((SIDE, SIDE, 3), 0.3)))
    loop = Loop(method, capture, mitsuba, config, live=LiveRecord(tmp_path / result_folder.LIVE))
    maps, step = [], method.step

    def looking_step(progress):
        maps.append(load_tensors(tmp_path / result_folder.LIVE)[0]["roughness"])
        assert torch.equal(maps[-1][..., 0], method.x[method.names.index("roughness")].half())
        return step(progress)

    method.step = looking_step
    loop.run()
    assert len(maps) == 3 and not torch.equal(maps[1], maps[2])


# ---- what it costs ----

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
    result = fit_svbrdf(capture, ANALYTIC, FAST, live=tmp_path / "file" / result_folder.LIVE)
    assert result.stopped == "iterations" and [p.name for p in tmp_path.iterdir()] == ["file"]


# ---- what stays, and what does not ----

def test_the_command_leaves_no_record(tmp_path, capture, monkeypatch):
    seen, write = [], LiveRecord.write

    def watched(self, *arguments):
        write(self, *arguments)
        seen.append(self.path)

    monkeypatch.setattr(LiveRecord, "write", watched)
    write_capture(capture, tmp_path / "photos")
    out = tmp_path / "out"
    assert cli.main(["fit", str(tmp_path / "photos"), "-o", str(out), "--method", "direct", "--renderer", "analytic",
                     "--resolution", str(SIDE), "--iterations", "3"]) == 0
    assert len(seen) >= 2 and set(seen) == {result_folder.partial_folder(out).resolve() / result_folder.LIVE}
    assert not list(out.rglob(f"*{result_folder.LIVE}*")) and (out / "fit.json").is_file()


def test_resuming_starts_with_the_checkpoint_alone(tmp_path):
    partial = result_folder.partial_folder(tmp_path / "out")
    (partial / "maps").mkdir(parents=True)
    for name in (result_folder.CHECKPOINT, result_folder.LIVE, result_folder.LOCK, "maps/half.exr", ".live-0123.safetensors"):  # of a killed fit
        (partial / name).write_bytes(b"old")
    with result_folder.output_folder(tmp_path / "out", False, resume=True) as folder:
        assert sorted(p.name for p in folder.iterdir()) == [result_folder.LOCK, result_folder.CHECKPOINT]


def test_looking_at_the_lock_does_not_refuse_a_fit(tmp_path):
    fcntl = pytest.importorskip("fcntl")
    out = tmp_path / "out"
    assert not result_folder.in_use(out)
    with result_folder.output_folder(out, False) as folder:
        assert result_folder.in_use(out)
        (folder / "one").write_text("1")
    assert not result_folder.in_use(out)
    partial = result_folder.partial_folder(out)
    partial.mkdir()
    with (partial / result_folder.LOCK).open("w") as lock:  # that a look takes longer than any does
        fcntl.flock(lock, fcntl.LOCK_SH)
        threading.Timer(0.01, lambda: fcntl.flock(lock, fcntl.LOCK_UN)).start()
        with result_folder.output_folder(out, True):
            assert result_folder.in_use(out)


# ---- fits that end badly ----

def test_a_fit_that_fails_shows_its_last_state(tmp_path, capture, every_step):
    out, seen = tmp_path / "out", []
    with served(out) as ask:
        fit_into(out, capture, FAST)
        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, lambda *_: seen.append(state_of(ask)), overwrite=True, fails=ZeroDivisionError())
        died = state_of(ask)
        assert ask("/maps/normal.png")[0] == 200
        again = []
        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, lambda *_: again.append(state_of(ask)), overwrite=True, fails=ZeroDivisionError())
    assert again[0]["phase"] == "starting" and again[0]["fit"] is None  # not the state of the fit before
    assert died["phase"] == "died" and died["fit"] == seen[-1]["fit"] and died["report"]  # the earlier fit's
    assert "without a result" in died["says"] and "--resume" in died["says"]
    # Somebody who looks only now sees no maps, but that there is something to go on with.
    with served(out) as ask:
        late = state_of(ask)
    assert late["phase"] == "died" and late["fit"] is None and "--resume" in late["says"]


def test_a_fit_that_is_killed_shows_its_last_state(tmp_path, capture):
    # By a signal that nothing can be done about: all its files stay as they are, and nobody holds the lock.
    out = tmp_path / "out"
    code = f"""
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {str(os.path.dirname(__file__))!r})
import test_view
from mitsvbrdf.fit import live as fit_live
fit_live.SECONDS, fit_live.SHARE = 0.0, 1.0
capture = test_view.photograph(test_view.make_material("inlay", 16), test_view.nine_view_grid(), test_view.ANALYTIC)
def die(entry, share):
    if entry["iteration"] == 10:
        os.kill(os.getpid(), signal.SIGKILL)
test_view.fit_into(Path({str(out)!r}), capture, test_view.FAST, die)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    assert (result_folder.partial_folder(out) / result_folder.LOCK).exists()
    with served(out) as ask:
        died = state_of(ask)
        assert died["phase"] == "died" and died["fit"]["iteration"] == 9 and ask("/maps/diffuse.png")[0] == 200
        assert "anew" in died["says"]  # no checkpoint yet
        fit_into(out, capture, FAST)
        assert state_of(ask)["phase"] == "done"


def test_a_fit_that_ends_while_somebody_looks_has_not_died(tmp_path, capture, every_step, monkeypatch):
    out, states = tmp_path / "out", []
    watch = Watch(out)

    def ends_just_before(folder):  # the record was read a moment ago; now everything is in its place, and the lock is free
        files.write_json(out / "fit.json", {})
        return False

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            with monkeypatch.context() as patch:
                patch.setattr(files, "in_use", ends_just_before)
                states.append(watch.state()["phase"])

    with pytest.raises(ZeroDivisionError):
        fit_into(out, capture, FAST, look, fails=ZeroDivisionError())
    assert states == ["done"]


@pytest.mark.parametrize("kept", [0, 1, 7, 100, 5000, -2, -700])
def test_half_a_record_is_none(kept, tmp_path, capture, every_step):
    out, states = tmp_path / "out", []

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            states.append(state_of(ask))
            record = result_folder.partial_folder(out) / result_folder.LIVE
            record.write_bytes(record.read_bytes()[:kept])
            states.append(state_of(ask))
            assert ask("/maps/diffuse.png")[0] == 200

    with served(out) as ask:
        fit_into(out, capture, FAST, look)
        assert states[0] == states[1] and states[0]["phase"] == "running"
        (out / "fit.json").write_bytes((out / "fit.json").read_bytes()[:min(kept, 500)])
        half = state_of(ask)
        assert half["phase"] == "done" and half["fit"] is None and half["report"]


def test_records_of_others_do_no_harm(tmp_path, capture):
    out = tmp_path / "out"
    strange = [{}, {"bsdf": "none"}, {"bsdf": "roughconductor"}, {"bsdf": ["list"]}]
    with served(out) as ask, result_folder.output_folder(out, False) as folder:
        for note in strange:
            save_tensors(folder / result_folder.LIVE, {"diffuse": torch.zeros(3), "../../passwd": torch.zeros(2, 2, 3)}, note)
            assert state_of(ask)["phase"] == "starting"
        for name, content in (("fit.json", b"[]"), ("fit.json", b'{"trace": NaN}'), ("fit.json", b"\xff")):
            (out / name).write_bytes(content)
            assert state_of(ask)["phase"] == "starting"


@pytest.mark.filterwarnings("error")
def test_numbers_that_neither_json_nor_a_picture_has(tmp_path, capture, every_step):
    out = tmp_path / "out"

    def look(entry, share):
        if entry and entry["iteration"] == 10:
            record = result_folder.partial_folder(out) / result_folder.LIVE
            tensors, note = load_tensors(record)
            note["trace"][0]["rerender_rmse"] = float("nan")
            note["latest"]["photometric"] = float("inf")
            save_tensors(record, tensors | {"normal": tensors["normal"] * torch.nan}, note)
            fit = state_of(ask)["fit"]
            assert ask("/maps/normal.png")[0] == 200
            assert fit["trace"][0]["rerender_rmse"] is None and fit["latest"]["photometric"] is None

    with served(out) as ask:
        fit_into(out, capture, FAST, look)


# ---- the server ----

def test_only_this_machine(tmp_path):
    with served(tmp_path) as ask:
        assert ask()[0] == 200
        with pytest.raises(ConnectionRefusedError):  # another address of this very machine: not listened to
            socket.create_connection(("127.0.0.2", ask.port), timeout=5)
    assert ADDRESS == "127.0.0.1"


@pytest.mark.parametrize("host, status", [
    ("127.0.0.1", 200), ("localhost:8350", 200), ("LOCALHOST", 200), ("[::1]:9000", 200),  # forwarded ports have another number
    ("evil.example", 403), ("evil.example:8350", 403), ("127.0.0.1.evil.example:80", 403), ("localhost.evil.example", 403),
    ("", 403), ("127.0.0.1@evil.example", 403), ("evil.example#127.0.0.1:80", 403)])
def test_a_foreign_name_that_leads_here_is_refused(host, status, tmp_path):
    (tmp_path / "report.html").write_text("secret")
    with served(tmp_path) as ask:
        for path in ("/", "/state.json", "/report.html"):
            found, _, content = ask(path, Host=host)
            assert found == status and (b"secret" in content) == (status == 200 and path == "/report.html")
        assert ask("/report.html", method="POST", Host=host)[0] == (405 if status == 200 else 403)


def test_a_request_without_a_name_or_with_two_is_refused(tmp_path):
    with served(tmp_path) as ask:
        for lines in (b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"):
            with socket.create_connection((ADDRESS, ask.port), timeout=5) as raw:
                raw.sendall(lines)
                assert raw.recv(100).split()[1] == b"403"


@pytest.mark.parametrize("path", [
    "/fit.json", "/secret.txt", "/../secret.txt", "/maps/../../secret.txt", "/maps/%2e%2e/secret.png", "/maps/..%2fsecret.png",
    "/report.html/", "/./report.html", "report.html", "http://localhost/report.html", "/maps/", "/maps/.png",
    "/maps/secret.png", "/maps", "/checkpoint.safetensors", "/.partial/live.safetensors", "/.mitsvbrdf", "/%72eport.html"])
def test_nothing_else_is_served(path, tmp_path):
    out = tmp_path / "out"
    (out / "maps").mkdir(parents=True)
    for name in ("fit.json", "report.html", "secret.txt", "maps/secret.png", "checkpoint.safetensors", ".mitsvbrdf"):
        (out / name).write_text("secret")
    (tmp_path / "secret.txt").write_text("secret")
    with served(out) as ask:
        status, _, content = ask(path)
        assert status == 404 and b"secret" not in content
        assert ask("/report.html")[2] == b"secret"


def test_only_reading(tmp_path):
    with served(tmp_path) as ask:
        for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
            status, headers, _ = ask("/", method=method)
            assert status == 405 and headers["Allow"] == "GET, HEAD"
        for path, status in (("/", b"200"), ("/state.json", b"200"), ("/nothing", b"404")):
            with socket.create_connection((ADDRESS, ask.port), timeout=5) as raw, raw.makefile("rb") as answer:
                raw.sendall(f"HEAD {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
                head, blank, content = answer.read().partition(b"\r\n\r\n")
            assert head.split()[1] == status and blank and not content
            assert f"Content-Length: {len(ask(path)[2])}\r\n".encode() in head
    assert not list(tmp_path.iterdir())


def test_answers_are_not_kept_and_unchanged_ones_not_repeated(tmp_path):
    (tmp_path / "report.html").write_text("one")
    with served(tmp_path) as ask:
        for path in ("/", "/state.json", "/report.html"):
            headers = ask(path)[1]
            assert headers["Cache-Control"] == "no-store" and headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        tag = ask()[1]["ETag"]
        assert ask(If_None_Match=tag)[0] == 304 and ask(If_None_Match='"other"')[0] == 200
        (tmp_path / "report.html").write_text("another")
        status, _, content = ask(If_None_Match=tag)
        assert status == 200 and json.loads(content)["phase"] == "done"


def test_pages_may_ask_nobody_else(tmp_path):
    (tmp_path / "report.html").write_text("one")
    with served(tmp_path) as ask:
        (first, page), (second, _) = (ask("/")[1:] for _ in range(2))
        rules = first["Content-Security-Policy"]
        nonce = re.search("'nonce-(.+?)'", rules)[1]
        assert f'<script nonce="{nonce}">' in page.decode() and nonce not in second["Content-Security-Policy"]
        report = ask("/report.html")[1]["Content-Security-Policy"]
    for policy in (rules, report):
        assert policy.startswith("default-src 'none'") and "http" not in policy and "*" not in policy
        assert "form-action 'none'" in policy and "base-uri 'none'" in policy
    assert "unsafe" not in re.search("script-src [^;]*", rules)[0]


@pytest.mark.parametrize("error, told", [(ConnectionResetError, False), (TimeoutError, False), (ZeroDivisionError, True)])
def test_a_browser_that_goes_away_is_no_error(error, told, tmp_path, capfd):
    with make_server(Watch(tmp_path), 0) as server:
        try:
            raise error
        except error:
            server.handle_error(None, (ADDRESS, 1))
    assert (error.__name__ in capfd.readouterr().err) == told


# ---- mistakes, and the command ----

def test_what_is_no_fits_folder_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(live, "make_server", lambda *_: pytest.fail("serves it"))
    (tmp_path / "file").write_text("")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "00.png").write_text("")
    (tmp_path / "capture").mkdir()
    for name in ("capture.json", result_folder.MANIFEST):
        (tmp_path / "capture" / name).write_text("[]")
    for name, word, way_out in (("file", "the file", "name the OUT"), ("photos", "no fit's", "name the OUT"),
                                ("capture", "holds photos", "name the OUT"),
                                ("missing/out", "there is no", "start the fit first")):
        assert cli.main(["view", str(tmp_path / name)]) == 2
        message = capsys.readouterr().err
        assert word in message and way_out in message and message.count("error:") == 1
    (tmp_path / "empty").mkdir()
    for name in ("empty", "not there yet"):
        assert Watch(tmp_path / name).state()["phase"] == "waiting"


def test_ports(tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind((ADDRESS, 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert cli.main(["view", str(tmp_path), "--port", str(port)]) == 2
        assert f"port {port} to be free" in (said := capsys.readouterr().err) and "leave --port out" in said
    for port in (-1, 65536):
        with pytest.raises(ConfigError, match="--port"):
            make_server(Watch(tmp_path), port)
    first, second = make_server(Watch(tmp_path)), make_server(Watch(tmp_path))  # two at once: the second takes a free one
    ports = {server.server_address[1] for server in (first, second)}
    first.server_close(), second.server_close()
    assert len(ports) == 2
    with socket.socket() as probe:
        if probe.connect_ex((ADDRESS, PORT)) == 0:
            pytest.skip(f"port {PORT} is taken on this machine")
    with make_server(Watch(tmp_path)) as server:
        assert server.server_address == (ADDRESS, PORT) and server.url == f"http://127.0.0.1:{PORT}/"


def test_ctrl_c_ends_the_command_well(tmp_path):
    process = subprocess.Popen([sys.executable, "-m", "mitsvbrdf", "view", str(tmp_path / "out"), "--port", "0"], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        line = process.stdout.readline()
        port = int(re.search(r"http://127\.0\.0\.1:(\d+)/", line)[1])
        assert str(tmp_path / "out") in line and "waits" in process.stdout.readline()
        connection = http.client.HTTPConnection(ADDRESS, port, timeout=20)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 0 and rest.strip() == "ended; the fit, if one runs, goes on" and not errors
    assert not (tmp_path / "out").exists()


# ---- a real browser ----

PHASE = "document.body.dataset.phase"


@pytest.fixture
def browser():
    from browser import FLAGS, chromium
    executable = chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.mark.slow
def test_a_browser_sees_a_fit_start_run_end_and_start_anew(browser, tmp_path):
    photos, out = tmp_path / "photos", tmp_path / "out"
    assert cli.main(["synth", "builtin:inlay", "-o", str(photos), "--resolution", "64", "--noise", "0.003"]) == 0
    fit = [sys.executable, "-m", "mitsvbrdf", "fit", str(photos), "-o", str(out), "--method", "direct", "--resolution", "64",
           "--budget", "8"]
    said, asked = [], []
    with served(out) as ask:
        page = browser.new_page()
        page.on("console", lambda message: "GPU stall" in message.text or said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"http://{ADDRESS}:{ask.port}/")
        page.wait_for_selector("body[data-phase=waiting]")
        assert f"No fit in {out} yet" in page.inner_text("#says") and page.is_hidden("#live")
        for options in ([], ["--overwrite"]):
            process = subprocess.Popen([*fit, *options], stdout=subprocess.DEVNULL)
            page.wait_for_selector("body[data-phase=running]", timeout=120_000)
            assert page.locator("iframe").count() == 0 and page.is_visible("#live")
            points, pictures, shares = set(), set(), []
            while page.evaluate(PHASE) == "running":
                points.add(page.eval_on_selector("#error polyline", "line => line.points.numberOfItems"))
                pictures.add(page.eval_on_selector("#maps img", "image => image.currentSrc"))
                shares.append(page.eval_on_selector("progress", "bar => bar.value"))
                time.sleep(0.5)
            # Eight seconds with a record a second, on a machine that may be busy.
            assert len(points) >= 3 and len(pictures) >= 3 and shares == sorted(shares) and shares[-1] > shares[0]
            assert page.eval_on_selector_all("#maps img", "images => images.map(i => [i.naturalWidth, i.naturalHeight])") == [
                [64, 64]] * 4
            assert process.wait(timeout=120) == 0
            page.wait_for_selector("body[data-phase=done]", timeout=60_000)
            page.wait_for_selector("iframe")
            frame = page.frame_locator("iframe")
            assert f"{json.loads((out / 'fit.json').read_text())['rerender_rmse']:.4f}" in frame.locator("body").inner_text()
            assert page.is_hidden("#live") and page.title().startswith("photos")
    assert not said
    outside = [url for url in asked if not url.startswith((f"http://{ADDRESS}:{ask.port}/", "data:", "blob:"))]
    assert not outside and len([url for url in asked if "/report.html?" in url]) == 2


@pytest.mark.slow
def test_a_browser_is_told_of_a_fit_that_dies_and_of_a_server_that_ends(browser, tmp_path, capture, every_step):
    out = tmp_path / "out"
    with served(out) as ask:
        page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
        page.goto(f"http://{ADDRESS}:{ask.port}/")
        with pytest.raises(ZeroDivisionError):
            fit_into(out, capture, FAST, lambda *_: state_of(ask), fails=ZeroDivisionError())
        page.wait_for_selector("body[data-phase=died]")
        assert "without a result" in page.inner_text("#says") and "last state" in page.inner_text("#maps-note")
        page.wait_for_selector("#maps img[src*=normal]")
        assert page.eval_on_selector_all("#maps img", "images => images.map(i => i.naturalWidth)") == [16] * 4
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.is_hidden("#lost")
    page.wait_for_selector("#lost", state="visible")
