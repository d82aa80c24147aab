"""The tables of the suites that are no fits at equal time: renderers, captures of a phone, starts of
processes.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping

from ..report.page import figure
from .tables import Table, best_in_row

# Of the suite capture: what a table shows, by heading, in per cent (%), as a ratio (x) or as it is.
FROM_PHONE = {"cameras": ("cameras", "%"), "rectification, px": ("rectification", ""),
              "flash, cm": ("flash", ""),
              "power": ("power", "x"), "maps": ("found mean", "."), "true views": ("true mean", "."),
              "ratio": ("ratio", "x"),
              "diffuse, scaled": ("found scaled diffuse", "."), "with true views": ("true scaled diffuse",
                                                                                    ".")}
WITHOUT_VIEWS = {"lateral": ("fitted lateral", "."), "depth": ("fitted depth", "%"),
                 "photos": ("found photos", "."),
                 "views given": ("given photos", "."), "ratio": ("ratio", "x"),
                 "left out, refined": ("refined left out", "."),
                 "held": ("held left out", ".")}


def renderer_tables(record: Mapping) -> list[Table]:
    """Seconds of a gradient step, of a picture alone, errors, and jittered pixels."""
    cases = [r for r in record["records"] if r["suite"] == "renderers"]
    texels = sorted((r for r in cases if r["truth"] == "texels"),
                    key=lambda r: (r["bsdf"] != "roughconductor", r["resolution"],
                                  r["views"]))
    names = list(dict.fromkeys(row["renderer"] for r in texels for row in r["rows"]))
    heads = ["", *(f"`{name}`" for name in names)]

    def rows(cell: Callable[[Mapping], str], best: str | None) -> list[list[str]]:
        made, values = [], []
        for r in texels:
            by_name = {row["renderer"]: row for row in r["rows"]}
            made.append([f"{r['bsdf']}, {r['resolution']} px, {r['views']} view{'s' * (r['views'] > 1)}",
                         *(cell(by_name[name]) if name in by_name else _sat_out(r, name) for name in names)])
            values.append([by_name[name][best]["median"] if best and name in by_name else None
                           for name in names])
        return best_in_row(made, values)

    why = sorted({f"`{s['renderer']}`, {r['resolution']} px, {r['views']} views: {s['why']}"
                  for r in texels for s in r["skipped"]})
    note = f"Left out for want of memory: {'; '.join(why)}." if why else ""
    tables = []
    if texels:
        tables += [Table("Seconds forward and backward", heads, rows(lambda row: _time(row["both"]), "both"),
                         note),
                   Table("Seconds of a picture alone", heads, rows(lambda row: _time(row["forward"]),
                                                                   "forward")),
                   Table("Error of image / gradient", heads,
                         rows(lambda row: f"{figure(row['image'])} / {figure(row['gradient'])}", None),
                         "Image: mean relative error; gradient: relative L2 of the worst map; roughness 0.1 "
                         "and more.")]
    for r in (r for r in cases if r["truth"] == "pixels"):
        made = [[f"`{row['renderer']}`, " + ("texel centre" if row["samples"] == 1 else f"{row['samples']} "
                                                                                        "jittered rays"),
                 figure(row["image"]), figure(row["gradient"]), _time(row["forward"]), _time(row["both"])]
                for row in r["rows"]]
        tables.append(Table(f"Against the average over each pixel, {r['bsdf']}, {r['resolution']} px, "
                            f"{r['views']} views",
                            ["", "image", "gradient", "forward", "forward and backward"], made))
    return tables


def _sat_out(case: Mapping, name: str) -> str:
    """Why a renderer took no part in a case."""
    return "no memory" if any(s["renderer"] == name for s in case["skipped"]) else "not run"


def capture_tables(record: Mapping) -> list[Table]:
    """Captures of known materials, with and without a sheet, against the truth, and real ones without their
    views.
    """
    found = [r for r in record["records"] if r["suite"] == "capture"]
    parts = (("A phone and a sheet of tags, known materials", FROM_PHONE, [r for r in found if r["sheet"]]),
             ("A phone alone, known materials", FROM_PHONE,
              [r for r in found if r["kind"] == "material" and not r["sheet"]]),
             ("Real captures without views", WITHOUT_VIEWS, [r for r in found if r["kind"] == "capture"]))
    tables = []
    for title, columns, rows in parts:
        done = [r["errors"] for r in rows if r["errors"]]
        cells = [[r["name"], *(_counted(r["errors"].get(key), how, r["why"])
                               for key, how in columns.values())] for r in rows]
        if len(done) > 1:
            values = [[e[key] for e in done if key in e] for key, _ in columns.values()]
            share = "" if len(done) == len(rows) else f" of {len(done)} of {len(rows)}"
            cells.append([f"median{share}", *(_counted(statistics.median(v) if v else None, how)
                                              for v, (_, how) in zip(values, columns.values()))])
        failed = "; ".join(f"{r['name']}: {r['why']}" for r in rows if r["why"])
        if rows:
            tables.append(Table(title, ["", *columns], cells, f"Failed: {failed}." if failed else ""))
    stages: dict[str, list[float]] = {}
    for r in found:
        for stage, seconds in r["seconds"].items() if r["kind"] == "material" else ():
            stages.setdefault(stage, []).append(seconds)
    if stages:
        tables.append(Table("Seconds from a phone to maps, median", ["", "seconds"],
                            [[stage, f"{statistics.median(seconds):.3g}"]
                             for stage, seconds in stages.items()]))
    return tables


def start_table(record: Mapping) -> Table | None:
    """Seconds of `mitsvbrdf fit` from the start of its process to its end, by method and state of the kernel
    cache.
    """
    found = [r for r in record["records"] if r["suite"] == "start"]
    parts = ("wall", "imports", "preparation", "loop", "writing")
    rows = [[f"`{r['method']}`, cache {row['cache']}", *(f"{row[part]['median']:.3g} s" for part in parts),
             f"{row['iterations']['median']:g}"] for r in found for row in r["rows"]]
    if not rows:
        return None
    config, names = found[0]["config"], ", ".join(dict.fromkeys(r["name"] for r in found))
    return Table(f"Seconds of `mitsvbrdf fit`, {names}, {config['resolution']} px, budget "
                 f"{config['budget']:g} s",
                 ["", "whole process", "imports", "preparation", "loop", "writing", "iterations"], rows,
                 f"Medians; processes of each row: {config['repeats']}. Cache: Dr.Jit's compiled kernels, "
                 "none of them or all "
                 "that the same command left there. Preparation: Mitsuba, photos, the first guess. The "
                 "budget begins with the "
                 "loop: kernels that are compiled in it cost iterations.")


def _counted(value: float | None, how: str, why: str | None = None) -> str:
    if value is None:
        return "failed" if why else "not measured"
    return {"%": f"{100 * value:.2f} %", "x": f"{value:.3f}", ".": f"{value:.4f}", "": f"{value:.3g}"}[how]


def _time(spread: Mapping) -> str:
    scale, unit = (1e3, "ms") if spread["median"] < 1 else (1, "s")
    median, low, high = (f"{scale * spread[name]:.3g}" for name in ("median", "low", "high"))
    return f"{median} {unit} ({low}–{high})"
