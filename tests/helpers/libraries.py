"""Libraries of many materials for tests of their page: rows as ``library.json`` has them, and small pictures
of their own.
"""

import datetime
from pathlib import Path

import cv2
import numpy as np

from mitsvbrdf.batch.library import DATA, PAGE, data_script, library_page

KINDS = ("wood", "brick", "leather", "fabric", "metal", "stone", "tile", "paper", "plaster", "rubber", "cork",
         "sand")
PLACES = ("bamboo", "hall", "old", "wet", "kitchen", "façade", "red", "worn", "seat", "gate", "木目", "roof")
WARNINGS = ("the light's power and the whole brightness cannot be told apart", "2 photos are blurred",
            "views are too alike")
REASONS = ("crashed with signal 11", "took longer than 600 s", "needed more than 4.0 GiB of memory",
           "expected at least 2 photos, got 1; add photos")


def random_rows(count: int, seed: int = 0, unfinished: bool = False) -> list[dict]:
    """Rows as a long batch leaves them: some failed or with warnings; running and pending ones on the way."""
    random, begun = np.random.default_rng(seed), datetime.datetime(2026, 11, 1)
    rows = []
    for k in range(count):
        state = "failed" if random.random() < 0.03 else "done"
        if unfinished and k >= 0.8 * count:
            state = "running" if k < 0.8 * count + 8 else "pending"
        begun += datetime.timedelta(seconds=5)
        rows.append(random_row(k, random, state, begun.isoformat(timespec="seconds") + "Z"))
    return rows


def random_row(k: int, random: np.random.Generator, state: str, date: str) -> dict:
    kind, place = (str(random.choice(words)) for words in (KINDS, PLACES))
    name, identity = f"{kind}-{place}-{k}", f"{int(random.integers(2**32)):08x}"
    fitted, ended = state == "done", state in ("done", "failed")
    folder = f"{'failed/' if state == 'failed' else ''}{name}-{identity}"

    def number(value: float, share: float) -> float | None:
        return round(float(value), 5) if fitted and random.random() < share else None

    return {
        "name": name, "id": identity, "folder": folder, "state": state,
        "error": number(random.lognormal(-3.5, 0.5), 1), "held_out_error": number(random.lognormal(-2.8, 0.5),
                                                                                  0.8),
        "burn_in": number(random.beta(1, 12), 0.8),
        "warnings": random.choice(WARNINGS, random.choice([0, 0, 0, 1, 2]), replace=False).tolist() if fitted
        else [], "seconds": round(random.lognormal(3.6, 0.4), 2) if ended else None,
        "attempts": int(random.choice([1, 1, 1, 1, 2, 3])) if ended else 0, "date": date if ended else None,
        "tags": [kind, *(["old wood"] if random.random() < 0.05 else [])],
        "method": "gan" if random.random() < 0.2 else "hierarchical", "resolution": 512
        if random.random() < 0.3 else 256, "photos": int(random.integers(1, 12)),
        "host": f"node-{random.integers(3)}" if ended else None,
        "source": f"captures/{kind}/{name}", "options": "--budget 60",
        "reason": str(random.choice(REASONS)) if state == "failed" else "",
        "preview": f"{folder}/preview.jpg" if fitted else None, "report": f"{folder}/report.html" if fitted
        else None, "log": f"{folder}/log.txt" if state == "failed" else None}


def write_page(folder: Path, rows: list[dict], title: str = "A library", progress: str = "") -> None:
    """The page of a library and its data."""
    told = {"title": title, "made": "2026-11-23T10:00:00Z", "version": "1.0.0", "progress": progress}
    (folder / DATA).write_text(data_script(told | {"materials": rows}))
    (folder / PAGE).write_text(library_page(title))


def picture(seed: int, side: int = 128) -> bytes:
    """A JPEG of a bumpy patch under a light from one side: a colour of its own, noise of two sizes."""
    random = np.random.default_rng(seed)
    height = sum(size * cv2.resize(random.standard_normal((n, n), np.float32), (side, side),
                                   interpolation=cv2.INTER_CUBIC)
                 for n, size in ((int(random.integers(4, 12)), 1.5), (32, 0.4)))
    y, x = np.gradient(height)
    shade = np.clip(0.75 + 2 * (x + y), 0.05, 2)[..., None] * random.uniform(0.1, 0.8, 3) * 220
    return cv2.imencode(".jpg", np.clip(shade, 0, 255).astype(np.uint8),
                        [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


def write_library(folder: Path, rows: list[dict], pictures: int | None = None, **more: object) -> Path:
    """The page of a library of ``rows`` in a folder, with pictures and small reports; give the path of
    ``index.html``. Beyond ``pictures`` (one a row if left out), a row's picture is that of an earlier one;
    ``more``: of the library, beside ``materials``.
    """
    drawn: list[str] = []
    for k, row in enumerate(rows):
        if row["log"]:
            (folder / row["folder"]).mkdir(parents=True, exist_ok=True)
            (folder / row["log"]).write_text(f"the log of {row['name']}")
        if not row["preview"]:
            continue
        if pictures is not None and len(drawn) >= pictures:
            row["preview"] = drawn[k % len(drawn)]
            continue
        drawn.append(row["preview"])
        (folder / row["folder"]).mkdir(parents=True, exist_ok=True)
        (folder / row["preview"]).write_bytes(picture(k))
        (folder / row["report"]).write_text("<!doctype html><link rel=icon "
                                            f"href=data:,><title>{row['name']}</title>a report")
    write_page(folder, rows, **more)
    return folder / "index.html"
