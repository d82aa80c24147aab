"""The server of the live page: this machine alone, reading only; and the command."""

import http.client
import json
import re
import signal
import socket
import subprocess
import sys

import pytest
from helpers.live_fits import served

from mitsvbrdf import cli
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.io import results
from mitsvbrdf.report.live import ADDRESS, PORT, FitSite, Watch, make_server

# ---- the server ----

def test_only_this_machine(tmp_path):
    with served(tmp_path) as ask:
        assert ask()[0] == 200
        with pytest.raises(ConnectionRefusedError):  # another address of this very machine: not listened to
            socket.create_connection(("127.0.0.2", ask.port), timeout=5)
    assert ADDRESS == "127.0.0.1"


@pytest.mark.parametrize("host, status", [
    # forwarded ports have another number
    ("127.0.0.1", 200), ("localhost:8350", 200), ("LOCALHOST", 200), ("[::1]:9000", 200),
    ("evil.example", 403), ("evil.example:8350", 403), ("127.0.0.1.evil.example:80", 403),
    ("localhost.evil.example", 403),
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
        for lines in (b"GET / HTTP/1.1\r\n\r\n",
                      b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"):
            with socket.create_connection((ADDRESS, ask.port), timeout=5) as raw:
                raw.sendall(lines)
                assert raw.recv(100).split()[1] == b"403"


@pytest.mark.parametrize("path", [
    "/fit.json", "/secret.txt", "/../secret.txt", "/maps/../../secret.txt", "/maps/%2e%2e/secret.png",
    "/maps/..%2fsecret.png",
    "/report.html/", "/./report.html", "report.html", "http://localhost/report.html", "/maps/", "/maps/.png",
    "/maps/secret.png", "/maps", "/checkpoint.safetensors", "/.partial/live.safetensors", "/.mitsvbrdf",
    "/%72eport.html"])
def test_nothing_else_is_served(path, tmp_path):
    out = tmp_path / "out"
    (out / "maps").mkdir(parents=True)
    for name in ("fit.json", "report.html", "secret.txt", "maps/secret.png", "checkpoint.safetensors",
                 ".mitsvbrdf"):
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
            with socket.create_connection((ADDRESS, ask.port),
                                          timeout=5) as raw, raw.makefile("rb") as answer:
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


@pytest.mark.parametrize("error, told", [(ConnectionResetError, False), (TimeoutError, False),
                                         (ZeroDivisionError, True)])
def test_a_browser_that_goes_away_is_no_error(error, told, tmp_path, capfd):
    with make_server(FitSite(tmp_path), 0) as server:
        try:
            raise error
        except error:
            server.handle_error(None, (ADDRESS, 1))
    assert (error.__name__ in capfd.readouterr().err) == told


# ---- mistakes, and the command ----

def test_what_is_no_fits_folder_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mitsvbrdf.cli.view.make_server", lambda *_: pytest.fail("serves it"))
    (tmp_path / "file").write_text("")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "00.png").write_text("")
    (tmp_path / "capture").mkdir()
    for name in ("capture.json", results.MANIFEST):
        (tmp_path / "capture" / name).write_text("[]")
    for name, word, way_out in (("file", "the file", "such a folder"),
                                ("photos", "holds photos", "such a folder"),
                                ("capture", "holds photos", "such a folder"),
                                ("missing/out", "there is no", "start the fit or the batch first")):
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
            make_server(FitSite(tmp_path), port)
    # two at once: the second takes a free one
    first, second = make_server(FitSite(tmp_path)), make_server(FitSite(tmp_path))
    ports = {server.server_address[1] for server in (first, second)}
    first.server_close(), second.server_close()
    assert len(ports) == 2
    with socket.socket() as probe:
        if probe.connect_ex((ADDRESS, PORT)) == 0:
            pytest.skip(f"port {PORT} is taken on this machine")
    with make_server(FitSite(tmp_path)) as server:
        assert server.server_address == (ADDRESS, PORT) and server.url == f"http://127.0.0.1:{PORT}/"


def test_ctrl_c_ends_the_command_well(tmp_path):
    process = subprocess.Popen([sys.executable, "-m", "mitsvbrdf", "view", str(tmp_path / "out"), "--port",
                                "0"], text=True,
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
    assert process.returncode == 0 and rest.strip() == "ended; what runs goes on" and not errors
    assert not (tmp_path / "out").exists()
