"""How quick the page of a large library is, in Chromium without a window.

``PYTHONPATH=.:tests python tests/batch/measure_page.py 10000 FOLDER`` prints medians of three openings, on a
desktop and at a phone's width with the processor slowed down four times. Asserted nowhere.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from pathlib import Path

from browser import FLAGS, chromium
from helpers.libraries import random_rows, write_library

PICTURES, TIMES = 10_000, 3
WATCH = """
window.seen = {first: null, long: []};
document.addEventListener("load", event => { if (event.target.tagName === "IMG") seen.first ??= performance.now(); }, true);
new PerformanceObserver(list => seen.long.push(...list.getEntries().map(task => task.duration))).observe({type: "longtask"});
"""
# From an event to the frame that shows what it changed.
ACT = """async ([id, kind, value]) => {
  const element = document.getElementById(id), begun = performance.now();
  element.value = value;
  element.dispatchEvent(new Event(kind, {bubbles: true}));
  await new Promise(requestAnimationFrame);
  await new Promise(done => { const c = new MessageChannel(); c.port1.onmessage = done; c.port2.postMessage(0); });
  return performance.now() - begun;
}"""
SCROLL = """async ([distance, seconds]) => {
  const start = performance.now(), end = Math.min(distance, document.documentElement.scrollHeight - innerHeight);
  let last = start, longest = 0, nodes = 0, frames = 0;
  seen.long.length = 0;
  for (let now = start; now < start + 1000 * seconds; frames++) {
    scrollTo(0, end * (now - start) / 1000 / seconds);
    now = await new Promise(requestAnimationFrame);
    longest = Math.max(longest, now - last);
    nodes = Math.max(nodes, document.getElementsByTagName("*").length);
    last = now;
  }
  return {longest, frames, nodes, long: Math.max(0, ...seen.long)};
}"""
FORMS = {"desktop": ({"width": 1280, "height": 900}, 1), "phone, 4x slower": ({"width": 390, "height": 844},
                                                                              4)}


def measured(browser, file: Path, window: dict, slower: int) -> dict:
    phone = slower > 1
    page = browser.new_page(viewport=window, has_touch=phone, is_mobile=phone, device_scale_factor=2 if phone
                            else 1)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.add_init_script(WATCH)
    session = page.context.new_cdp_session(page)
    # of the page's main thread, whatever else runs here
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    session.send("Emulation.setCPUThrottlingRate", {"rate": slower})
    page.goto(file.as_uri())
    while page.evaluate("seen.first") is None:
        time.sleep(0.05)
    found = {"first picture, ms": page.evaluate("seen.first"),
             "until then of the processor, ms": 1000 * metric(session, "TaskDuration"),
             "pictures asked for at first": pictures(asked)}
    asked.clear()
    for name, act in {"first letter": ("where", "input", "w"), "next letter": ("where", "input", "wo"),
                      "expression": ("where", "input", "error<0.03 tag:wood"), "no filter": ("where", "input",
                                                                                             ""),
                      "sort by error": ("sort", "change", "error"), "by date": ("sort", "change", "date"),
                      "back to name": ("sort", "change", "name")}.items():
        before = metric(session, "TaskDuration")
        found[name + ", ms"] = page.evaluate(ACT, act)
        found[name + ", of the processor"] = 1000 * (metric(session, "TaskDuration") - before)
        page.wait_for_timeout(300)
    asked.clear()
    for name, way in {"all in 5 s": [1e12, 5], "3,000 px/s": [15000, 5]}.items():
        for key, value in page.evaluate(SCROLL, way).items():
            found[f"scrolling {name}: {key}"] = value
        page.wait_for_timeout(500)
        found[f"scrolling {name}: pictures"] = pictures(asked)
        asked.clear()
    session.send("HeapProfiler.collectGarbage")
    return found | {"JS heap, MB": metric(session, "JSHeapUsedSize") / 1e6}


def metric(session, name: str) -> float:
    return next(each["value"] for each in session.send("Performance.getMetrics")["metrics"]
                if each["name"] == name)


def pictures(asked: list[str]) -> int:
    return sum(url.endswith(".jpg") for url in asked)


def main() -> None:
    from playwright.sync_api import sync_playwright

    count, folder = int(sys.argv[1]), Path(sys.argv[2]).resolve()
    begun = time.perf_counter()
    file = write_library(folder, random_rows(count), pictures=PICTURES)
    seconds, size = time.perf_counter() - begun, (folder / "library.js").stat().st_size
    print(f"{count} rows written in {seconds:.1f} s, library.js has {size:,} bytes", flush=True)
    with sync_playwright() as playwright:
        for name, (window, slower) in FORMS.items():
            runs = []
            for _ in range(TIMES):
                # no WebGL in software
                browser = playwright.chromium.launch(executable_path=chromium(), args=[FLAGS[0]])
                runs.append(measured(browser, file, window, slower))
                browser.close()
            print(name, json.dumps({key: round(statistics.median(run[key] for run in runs), 1)
                                    for key in runs[0]}, indent=1))


if __name__ == "__main__":
    main()
