"""Quick fits, and the page that follows them over real HTTP."""

import http.client
import json
import threading
from contextlib import contextmanager

import pytest
import torch

from helpers import ANALYTIC
from mitsvbrdf.fit import DirectConfig, fit_svbrdf
from mitsvbrdf.io import files, images, results
from mitsvbrdf.report.live import FitSite, make_server

SIDE = 16
FAST = DirectConfig(iterations=20)


@contextmanager
def served(out, site=FitSite):
    """A function that asks the live page of this folder: (path) -> status, headers, content."""
    with make_server(site(out), 0) as server:
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
    with results.output_folder(out, overwrite) as folder:
        result = fit_svbrdf(capture, ANALYTIC, config, checkpoint=folder / results.CHECKPOINT,
                            live=folder / results.LIVE, report=report)
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
