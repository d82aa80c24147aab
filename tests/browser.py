"""A real headless Chromium for tests of pages: opens a file, records what it says and asks for."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import pytest

# WebGL2 without a graphics card.
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")

STALL = "GPU stall due to ReadPixels"  # Chromium's remark on a test that reads pixels back, not on the page


def chromium() -> str:
    """Chromium's path, by the environment variable MITSVBRDF_CHROMIUM or on PATH; skips the test where there
    is none.
    """
    pytest.importorskip("playwright", reason="needs playwright: pip install 'mitsvbrdf[slow]'")
    names = (os.environ.get("MITSVBRDF_CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome")
    path = next((found for name in names if name and (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("needs Chromium on PATH or in MITSVBRDF_CHROMIUM")
    return path


@contextmanager
def opened(path: Path, *, width: int = 1280, height: int = 900, scheme: Literal["light", "dark"] = "light",
           phone: bool = False,
           flags: tuple[str, ...] = FLAGS, beside: bool | Path = False, at: str = "") -> Iterator:
    """A playwright page that shows this HTML file, opened from disk; the browser ends with the block.

    At the end of the block: no console message, no uncaught error, and no request but for the file itself, or
    with ``beside`` for files of its folder, or of the one that it names. ``phone``: touch, and two device
    pixels a CSS pixel; ``at``: what follows the file's address, from # on.
    """
    executable = chromium()
    from playwright.sync_api import sync_playwright

    said, asked, address = [], [], path.resolve().as_uri()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(flags))
        try:
            page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme,
                                    has_touch=phone, is_mobile=phone, device_scale_factor=2 if phone else 1)
            page.on("console", lambda message: STALL in message.text
                    or said.append(f"{message.type}: {message.text}"))
            page.on("pageerror", lambda error: said.append(f"uncaught: {error}"))
            page.on("request", lambda request: asked.append(request.url))
            page.goto(address + at)
            yield page
            folder = path.parent if beside is True else beside
            own = (folder.resolve().as_uri() + "/",) if folder else ()
            outside = [url for url in asked if url.split("#")[0] != address
                       and not url.startswith(("data:", "blob:", *own))]
            assert not said and not outside, f"the page said {said} and asked for {outside}"
        finally:
            browser.close()
