"""Records of a benchmark, made by hand, and methods whose code is not that of records."""

from mitsvbrdf.bench.methods import method_table, settings_of
from mitsvbrdf.bench.page import configs_of

SETTINGS = {"resolution": 16, "views": "builtin:grid", "renderer": "analytic", "variant": "llvm_ad_rgb",
            "quick": False}


def record(method="hybrid", budget=10.0, seed=0, name="a", kind="material", suite="methods", seconds=None,
           **errors):
    return {"suite": suite, "method": method, "kind": kind, "name": name, "budget": budget, "seed": seed,
            "config": {},
            "seconds": budget if seconds is None else seconds, "wall": budget + 1, "iterations": 5,
            "stopped": "budget",
            "why": None, "errors": errors} | ({"left_out": [4, 7]} if kind == "capture" else {})


def timing(median):
    return {"median": median, "low": median * 0.9, "high": median * 1.2, "repeats": 3}


def case(truth="texels", resolution=64, views=9, skipped=()):
    samples = (1,) if truth == "texels" else (4, 16)
    rows = [{"renderer": name, "samples": n, "image": 1e-7 * n, "gradient": 2e-7, "forward": timing(0.01 * n),
             "both": timing(0.03)} for name in ("mitsuba", "mitsuba-scene")
            for n in ((1,) if name == "mitsuba" else samples)]
    return {"suite": "renderers", "bsdf": "principled", "resolution": resolution, "views": views,
            "truth": truth,
            "config": {"samples": [], "repeats": 3}, "rows": rows, "skipped": list(skipped)}


def benchmark(records, given=None):
    return {"schema_version": 2, "settings": SETTINGS | {"code": "0123456789ab"},
            "machine": {"cores": 2, "system": "Linux"},
            "versions": {"mitsuba": "3.9", "torch": None},
            "seeds": sorted({r["seed"] for r in records if "seed" in r}),
            "published": given or {}, "records": records}


METHODS = [record(m, b, s, n, k, **{e: base * (30 / b) ** 0.5 * (1 + s / 10) * (1.5 if n == "b" else 1)
                                     for e in (("mean", "novel_light", "diffuse", "specular", "roughness",
                                                "normal", "photos")
                                               if k == "material" else ("seen", "left_out"))})
           for m, base in (("hybrid", 0.05), ("direct", 0.08), ("peers-baseline", 0.2)) for b in (10.0, 30.0)
           for s in (0, 1, 2) for k in ("material", "capture") for n in ("a", "b")]
GIVEN = {"material": {"a": {"MaterialGAN": {"mean": 0.06}}},
         "capture 4,7": {n: {"MaterialGAN": {"seen": 0.01, "left_out": 0.02}} for n in ("a", "b")}}


def stiff(method="hybrid", name="nothing wrong", kind="case", seed=0, budget=5.0, photos=0.02, why=None,
          warnings=(), stated=None, condition=30.0, **errors):
    """A fit of a stiff scene, sound where nothing else is said."""
    maps = dict.fromkeys(("diffuse", "specular", "roughness", "normal"), 0.03) | errors
    found = {**maps, "mean": sum(maps.values()) / 4, "photos": photos, "photos_start": 0.2}
    return {"suite": "stiff", "method": method, "kind": kind, "name": name, "budget": budget, "seed": seed,
            "config": {},
            "condition": {"median": condition, "worst": None, "rank": 9, "unknowns": 9},
            "attainable": dict.fromkeys((*maps, "mean"), 0.02) | {"photos": 0.01},
            "start": dict.fromkeys((*maps, "mean"), 0.2),
            "seconds": budget, "wall": budget + 1, "iterations": 50, "stopped": "failed" if why else "budget",
            "why": why,
            "errors": {} if why else found, "stated": {} if why else dict.fromkeys((*maps, "mean"), 0.01)
            | (stated or {}),
            "near": {} if why else {"seconds": budget / 2, "iterations": 20}, "undone": 0, "restarts": 0,
            "warnings": list(warnings)}


def stale(record):
    """The classes of settings whose records are not of the code that is there."""
    code = {each["class"]: each["code"] for each in map(settings_of, method_table().values())}
    return {each["class"] for each in configs_of(record) if each.get("code") != code[each["class"]]}
