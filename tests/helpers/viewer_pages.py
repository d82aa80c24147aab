"""Materials for the live viewer."""

from contextlib import contextmanager

import cv2
import numpy as np
import torch
from browser import opened

from mitsvbrdf.material.maps import SVBRDF
from mitsvbrdf.report.page import page_text
from mitsvbrdf.report.viewer import viewer_html


def changed(svbrdf: SVBRDF, **maps) -> SVBRDF:
    return SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {
        name: torch.as_tensor(value).expand_as(svbrdf[name]).clone() for name, value in maps.items()})


@contextmanager
def shown(svbrdf: SVBRDF, folder, width: int = 420, **window):
    """The viewer in a page like ours, drawn once; software draws a small canvas soon."""
    file = folder / "viewer.html"
    file.write_text(page_text("report/base.html", title="A material").replace("</body>", viewer_html(svbrdf)
                                                                             + "</body>"))
    with opened(file, width=width, **window) as page:
        assert page.evaluate("mitsvbrdfViewer.ready") is True
        yield page


def canvas_picture(page) -> np.ndarray:
    """What the window shows of the canvas, RGB bytes, after it has come to rest."""
    page.wait_for_timeout(50)  # what was just changed is drawn in the next frame
    page.wait_for_function("mitsvbrdfViewer.fine", timeout=120_000)  # a large canvas, drawn by software
    data = np.frombuffer(page.locator("canvas").screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1].astype(int)


def looked(page, **options) -> dict:
    """What the viewer draws with these options, and how; ``data`` is size x size x 4, row 0 at the top."""
    code = ("options => { const it = mitsvbrdfViewer.pixels(options); "
            "return {...it, data: Array.from(it.data)}; }")
    found = page.evaluate(code, options)
    return found | {"data": np.array(found["data"]).reshape(found["size"], found["size"], 4)}
