"""The page of a comparison: it shows the numbers of the record and computes none."""

from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from ..capture import Capture
from ..evaluate.photos import Entry
from ..material.maps import SVBRDF, TITLES, shown_map
from .page import write_page
from .pictures import at_most, png_uri

LARGEST = 256  # pixels along a side of a picture
MAPS = ("diffuse", "specular", "roughness", "normal")


def write_compare_page(path: str | Path, record: dict, entries: Sequence[Entry], capture: Capture,
                       pictures: Sequence[Tensor], guess: Tensor, reference: SVBRDF | None = None) -> None:
    """Write one HTML file: the photos, the maps of each method, errors, and re-renderings beside photos.

    The record and the pictures are those of one call of :func:`mitsvbrdf.evaluate.photos.compare`.
    """
    methods, side = record["methods"], record["resolution"]
    rows = ([] if reference is None
            else [{"name": "Known maps", "note": record["reference"], "maps": _maps(reference, side)}])
    for entry, method in zip(entries, methods):
        size = "" if method["resolution"] == side else f", {method['resolution']} px"
        light = "" if method["falloff"] == "inverse-square" else ", light without falloff"
        rows.append({"name": entry.name, "note": f"{entry.folder}{size}; {method['views']}{light}",
                     "maps": _maps(entry.svbrdf, side)})
    photos = [{"name": name, "photo": png_uri(at_most(photo, LARGEST)),
               "rendered": [(method, png_uri(at_most(images[i], LARGEST)))
                            for method, images in zip(methods, pictures)]}
              for i, (name, photo) in enumerate(zip(record["photos"], capture.photos))]
    title = f"{record['capture'] or 'Capture'}: {', '.join(m['name'] for m in methods)}"
    write_page(path, "report/compare.html", title=title, record=record, rows=rows, photos=photos,
               guess=_uri("diffuse", guess), groups=_table(record))


def _maps(svbrdf: SVBRDF, resolution: int) -> list[tuple[str, str]]:
    maps = svbrdf.as_roughconductor().resized(resolution)
    return [(TITLES[name], _uri(name, maps[name])) for name in MAPS]


def _uri(name: str, value: Tensor) -> str:
    return png_uri(at_most(shown_map(name, value.detach().cpu()), LARGEST))


def _table(record: dict) -> list[dict]:
    """Groups of rows: what was measured, each method's value, and the best if all are comparable."""
    methods, groups = record["methods"], []

    def row(name: str, values: list[float | None], alike: bool = True) -> dict:
        known = [value for value in values if value is not None]
        return {"name": name, "values": values, "best": min(known) if alike and len(known) > 1 else None}

    if record["reference"] is not None:
        groups.append({"title": "Map RMSE",
                       "rows": [row(TITLES.get(name, name), [m["map_rmse"][name] for m in methods])
                                for name in (*MAPS, "mean")]})
    counted = record["same_views"] and len({(m["transfer"], m["falloff"]) for m in methods}) == 1
    unmoved = counted and not any(m["flash_offset"] for m in methods)
    calibrated = not any(m["fitted_views"] for m in methods)
    alike = calibrated and unmoved
    rows = [row("all photos, as pictured", [m["rerender_rmse"] for m in methods], alike)]
    if any(m["held_out"] for m in methods):  # not comparable: each fit has its own photos
        rows.append(row("those that the fit saw, as pictured", [m["rmse_seen"] for m in methods], False))
        rows.append(row("those that the fit did not see", [m["rmse_held_out"] for m in methods], False))
    if not calibrated:
        rows.append(row("all, calibration and flash offset",
                        [m["calibrated"]["rerender_rmse"] for m in methods], unmoved))
    if methods[0]["refined"]:
        rows.append(row("all, views refined for every method",
                        [m["refined"]["rerender_rmse"] for m in methods], counted))
    rows += [row(f"photo {name}", [m["per_photo"][name] for m in methods], alike)
             for name in record["photos"]]
    groups.append({"title": "Re-rendering RMSE", "rows": rows})
    return groups
