"""Records of the suites that the paper's tables are made of, by hand."""

from helpers.bench_records import benchmark, record, timing
from mitsvbrdf.bench.paper.printed import printed

MAPS = ("diffuse", "specular", "roughness", "normal")


def maps(mean, **more):
    """Errors of four maps around a mean: 0.4, 0.8, 1.2 and 1.6 times as large."""
    return ({name: mean * share for name, share in zip(MAPS, (0.4, 0.8, 1.2, 1.6))}
            | {"mean": mean, "novel_light": mean} | more)


def reference(name, start, peers=None, kind="material"):
    errors = {"the start": maps(start) if kind == "material" else {"seen": start, "left_out": start}}
    guesses = ({"guess robust": {"diffuse": 0.4 * start}, "guess min": {"diffuse": start}}
               if kind == "material" else {})
    return {"suite": "references", "kind": kind, "name": name, "config": {"guesses": []},
            "errors": guesses | errors | {who: maps(error) for who, error in (peers or {}).items()}} | (
                {"left_out": [4, 7]} if kind == "capture" else {})


def fitted(suite, method, means, name, guess="robust", kind="material"):
    """A fit of each seed."""
    errors = maps if kind == "material" else (lambda mean: {"seen": mean, "left_out": 2 * mean})
    return [record(method, 30.0, seed, name, kind, suite, **errors(mean))
            | {"config": {"class": "GanConfig", "guess": guess}} for seed, mean in enumerate(means)]


SCHEDULE = {"suite": "schedule", "method": "gan-two-stage", "kind": "material", "name": "a", "seed": 0,
            "seconds": 900.0,
            "wall": 901.0, "iterations": 200, "stopped": "iterations", "errors": maps(0.3, photos=0.1),
            "config": {"class": "GanConfig", "guess": "min", "resolution": 64, "width": 16,
                       "iterations": 200},
            "trace": [maps(0.4 - k / 2000, iteration=k, seconds=4.5 * k, photos=0.2) for k in (0, 100, 200)]}
OF_PHOTOS = SCHEDULE | {"kind": "capture", "name": "c", "left_out": [4, 7],
                        "errors": {"seen": 0.10, "left_out": 0.12},
                        "trace": [{"iteration": k, "seconds": 4.5 * k, "seen": 0.11, "left_out": 0.13}
                                  for k in (0, 100, 200)]}
STEPS = {"suite": "steps", "preset": "paper-two-stage", "resolution": 256, "width": 64,
         "config": {"repeats": 3},
         "rows": [{"version": name, "bfloat16": name == "now", "seconds": timing(seconds),
                   "parts": {"network": 0.75, "other": 0.25}} for name, seconds in (("now", 2.0),
                                                                                    ("earlier", 5.0))],
         "ratio": timing(2.5)}
SHEET = {"suite": "sheets", "kind": "material", "name": "inlay", "file": "gan-inlay.jpg",
         "errors": {"gan": {"diffuse": 0.1}},
         "config": {"budget": 5.0, "seed": 0, "methods": {"gan": {}, "hierarchical": {}}}}
FITS = [*fitted("methods", "gan-two-stage", (0.3, 0.4, 0.5), "a", "min"),
        *fitted("methods", "gan-two-stage", (0.4, 0.4, 0.4), "b", "min"),
        *fitted("methods", "gan", (0.04, 0.05, 0.09), "a"), *fitted("methods", "gan", (0.06, 0.07, 0.05),
                                                                    "b"),
        *fitted("methods", "hierarchical", (0.01, 0.01, 0.01), "a"),
        *fitted("methods", "gan", (0.03,), "c", kind="capture"),
        *fitted("gan", "full", (0.04, 0.05, 0.09), "a"), *fitted("gan", "full", (0.06, 0.07, 0.05), "b"),
        *fitted("gan", "no adversarial loss", (0.10, 0.12, 0.11), "a"),
        *fitted("gan", "no adversarial loss", (0.05, 0.05, 0.05), "b"),
        *fitted("gan", "bce", (0.06, 0.06, 0.06), "a"), *fitted("gan", "bce", (0.08, 0.08, 0.08), "b")]
WHOLE = benchmark([reference("a", 0.1, {"Gao 2019": 0.07, "MaterialGAN": 0.04}), reference("b", 0.08),
                   reference("c", 0.09, kind="capture"), *FITS, SCHEDULE, OF_PHOTOS, STEPS, SHEET],
                  printed() | {"capture 4,7": {"c": {"MaterialGAN": {"seen": 0.02, "left_out": 0.021}}}})
