"""What a fit or a render can do without, and what omitting it saves and costs.

``python docs/results/omitted.py`` makes omitted.md and omitted.svg from omitted.json. With ``fits``,
``renders`` or ``detail`` behind it that part is measured first (an hour, minutes, an hour; MITSVBRDF_DATA
names the photos; ``fits`` goes on where it was stopped). ``earlier`` stays as it was measured.
"""

import json
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown

HERE = Path(__file__).parent
ERRORS = {"material": {"mean": "maps", "novel_light": "new light"},
          "capture": {"held_out": "held-out photos", "seen": "photos seen"}}
FLOOR = 0.001  # errors below count as this
PATCHES, RMSE = 0.8, 1.1  # of the maps' errors: the bar of detail
HELD_OUT = (4, 7)
SIDE, TURNS = 256, 41  # of renders
STEPS = 300  # of hybrid

# A part of the default method -> the settings of HierarchicalConfig that take it away. Photos of known
# materials follow the model exactly, so what is for other photos is omitted from them by itself.
VARIANTS = {
    "basis materials": {"materials": 1},
    "neighbours as starts": {"neighbours": False},
    "multi-start": {"multi_start": False},
    "freedom at full size": {"detail_spread": 0.0},
    "weights of pixels": {"highlight_reach": 0.0},
    "flash offset": {"flash_offset": False},
    "view refinement": {"calibrate": False},
    "cross-validation": {"noise": 0.03},
    "tied stage": {"exact": True, "multi_start": False},
}
WITH = {"tied stage": {"exact": False}}  # what a part is compared with, where that is not the whole method
PARTS = {"material": [*list(VARIANTS)[:3], "tied stage"],
         "capture": [part for part in VARIANTS if part != "multi-start"]}  # which is for exact photos
# The same of ``hybrid``: its losses.
HYBRID = {"photometric loss": {"photometric": 0.0}, "diffuse loss": {"diffuse": 0.0},
          "smoothness of specular and roughness": {"smooth": 0.0}, "price on tilted normals": {"flat": 0.0},
          "adversarial loss": {"adversarial": 0.0}}
# A part of a render -> renderer, BSDF, maps by name (None: as made), and what of Needs is put in again.
RENDERS = {
    "specular lobe, where the map is 0": ("mitsuba", "roughconductor", {"specular": 0.0}, "specular_lobe"),
    "diffuse lobe, where the map is 0": ("mitsuba", "roughconductor", {"diffuse": 0.0}, "diffuse_lobe"),
    "colour of the specular map, where it is grey": ("mitsuba", "roughconductor", {"specular": 0.3},
                                                     "coloured_specular"),
    "normal map, where it is flat": ("mitsuba", "roughconductor", {"normal": None}, "normal_map"),
    "metallic map, where it is 0": ("mitsuba", "principled", {"metallic": 0.0}, "metallic"),
    "Fresnel curve, where the light is at the camera": ("mitsuba", "roughconductor", {}, "fresnel_curve"),
    "interreflection and path depth": ("mitsuba-scene", "roughconductor", {}, "path_depth"),
    "shadow rays": ("mitsuba-scene", "roughconductor", {}, "shadow_rays"),
    "environment": ("mitsuba-scene", "roughconductor", {}, "environment"),
}


def ratios(records: list, kind: str, method: str, value) -> pd.DataFrame:  # noqa: ANN001
    """A value of fits without each part of a method, over that with it; a row for each task."""
    rows = [{"method": r["method"], "name": r["name"], "value": value(r)} for r in records
            if r["kind"] == kind and r["config"]["class"] == method]
    found = pd.DataFrame(rows).pivot(index="name", columns="method", values="value")
    parts = PARTS[kind] if method == "HierarchicalConfig" else HYBRID
    return pd.DataFrame({part: found[part] / found[f"{part}, with" if part in WITH else "full"]
                         for part in parts})


def spread(values: pd.Series) -> str:
    """Median and quartiles."""
    low, middle, high = values.quantile([0.25, 0.5, 0.75])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def fits(records: list, kind: str, method: str) -> pd.DataFrame:
    """Errors and seconds without each part, over those with it."""
    found = {title: ratios(records, kind, method, lambda r, error=error: max(r["errors"][error], FLOOR))
             for error, title in ERRORS[kind].items()}
    found["seconds"] = ratios(records, kind, method, lambda r: r["seconds"])
    return pd.DataFrame({title: {part: spread(each[part]) for part in each} for title, each in found.items()})


def renders(records: list) -> pd.DataFrame:
    """Milliseconds with and without what is omitted, their ratio, and how far pictures differ."""
    rows = {}
    for r in records:
        each = pd.Series(r["with"]) / pd.Series(r["without"])
        rows[f"{r['part']} (`{r['renderer']}`)"] = [
            *(f"{1e3 * statistics.median(r[side]):.3g}" for side in ("with", "without")), spread(each),
            f"{r['difference']:.1g}"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=[
        "with, ms", "without, ms", "ratio", "largest difference"])


def detail(rows: list) -> pd.DataFrame:
    """Figures of held-out photos: of the maps, and with detail."""
    found = {}
    for row in rows:
        maps, look = row["maps"], row["detail"]
        share = {error: look[error] / maps[error] for error in ("patches", "rmse", "flip")}
        met = share["patches"] <= PATCHES and share["rmse"] <= RMSE
        found[row["name"]] = [
            f"{row['highlights']:.0%}",
            *(f"{maps[error]:.4f} → {look[error]:.4f} ({share[error]:.2f})" for error in share),
            "met" if met else "missed"]
    return pd.DataFrame.from_dict(found, orient="index",
                                  columns=["highlights", "patches", "RMSE", "FLIP", "bar"])


def page(record: dict) -> str:
    """The text of omitted.md."""
    versions = " and ".join(dict.fromkeys(r["version"] for r in record["fits"]))
    lobe, guess = record["earlier"], record["guess"]
    counts = {kind: len({r["name"] for r in record["fits"] if r["kind"] == kind})
              for kind in ("material", "capture")}
    added = detail(record["detail"])
    middle = statistics.median(r["detail"]["patches"] / r["maps"]["patches"] for r in record["detail"])
    return f"""# What is omitted, and what that saves

## Of a fit

{as_markdown(fits(record["fits"], "material", "HierarchicalConfig"))}

{counts["material"]} known materials. Their photos follow the model, so a fit omits by itself what is for \
other photos (`fit --explain`).

{as_markdown(fits(record["fits"], "capture", "HierarchicalConfig"))}

{counts["capture"]} captures; photos 4 and 7 are held out. All tables of fits divide errors and seconds of \
the loop without a part by those with it: median and quartiles. Above 1.00 the fit is worse, or slower, \
without the part. 128 px, seed 0, version {versions}, one core beside other work. Without the *tied stage* \
there are no view refinement and cross-validation either; it is compared with a fit that has it and omits \
multi-start. No switch takes away the search for a specular lobe: on a matte material, version 0.1.0 took \
{statistics.median(a / b for a, b in zip(*lobe["seconds"].values())):.2f} times the seconds with it.

![Errors of held-out photos without each part](omitted.svg)

### `hybrid`

{as_markdown(fits(record["fits"], "material", "HybridConfig"))}

The same known materials at 64 px, {STEPS} steps each. The guessed diffuse map of nine photos of \
{SIDE} px, which the diffuse loss compares with, takes {1e3 * statistics.median(guess["seconds"]):.0f} ms. \
Parts of `gan` are measured [on its page](gan.md#each-ingredient).

## Of a render

{as_markdown(renders(record["renders"]))}

Nine views of {SIDE} px, forward and backward to the maps that are not held fixed, median and quartiles of \
{TURNS} turns. No scene here needs the part, but for light falloff; *with* computes it all the same. The \
largest difference of the pictures is divided by the brightest pixel.

## Plausible detail

{as_markdown(added)}

Held-out photos 4 and 7 compared with renderings of the maps → of the maps of `fit --detail gan` (ratio), \
128 px. *Patches* is the sliced Wasserstein distance of 7 x 7 patches inside highlights, *highlights* the \
share of pixels there. {(added["bar"] == "met").sum()} of {len(added)} captures meet the bar (patches at \
most {PATCHES} and RMSE at most {RMSE} times those of the maps); the median ratio of patches is \
{middle:.2f}. So detail is omitted unless asked for.
"""


def figure(record: dict) -> Figure:
    """A box for each part: held-out error without it over that with it."""
    found = ratios(record["fits"], "capture", "HierarchicalConfig", lambda r: r["errors"]["held_out"])
    drawing = Figure(figsize=(7, 3), layout="constrained")
    axes = drawing.subplots()
    axes.boxplot([found[name] for name in found], orientation="horizontal", tick_labels=list(found))
    axes.axvline(1, color="0.6", linewidth=1)
    axes.invert_yaxis()
    axes.set_xlabel("RMSE of held-out photos without the part / with it")
    return drawing


def measure_fits(lines: Path) -> Iterator[dict]:
    """Fits with all parts, and without each."""
    from mitsvbrdf import HierarchicalConfig, HybridConfig, make_renderer
    from mitsvbrdf.bench.run import run
    from mitsvbrdf.bench.tasks import data_folder, find_tasks

    renderer, full = make_renderer("mitsuba"), HierarchicalConfig()
    losses = HybridConfig(iterations=STEPS)
    plans = [("material", 64, {"full": losses, **{part: replace(losses, **changes)
                                                  for part, changes in HYBRID.items()}})]
    plans += [(kind, 128, {"full": full, **{part: replace(full, **VARIANTS[part]) for part in parts},
                           **{f"{part}, with": replace(full, **WITH[part]) for part in WITH}})
              for kind, parts in PARTS.items()]
    for kind, side, methods in plans:
        names, shots = (None, ["none"]) if kind == "material" else (["none"], None)
        tasks = find_tasks(names, shots, data_folder(), side, HELD_OUT, None, renderer)
        yield from run(methods, tasks, [600], [0], renderer, lines,
                       lambda text, share: print(f"{share:4.0%} {text}", flush=True))


def measure_guess() -> dict:
    """Seconds of the guessed diffuse map."""
    from mitsvbrdf import guess_diffuse, make_renderer
    from mitsvbrdf.bench.run import version
    from mitsvbrdf.bench.tasks import find_tasks

    task, = find_tasks(["inlay"], ["none"], None, SIDE, (), "builtin:grid", make_renderer("mitsuba"))
    taken = []
    for _ in range(TURNS):
        begun = time.perf_counter()
        guess_diffuse(task.photos)
        taken.append(round(time.perf_counter() - begun, 6))
    return {"seconds": taken, "version": version()}


def timed_render(renderer, svbrdf, wanted: tuple, views) -> tuple[float, object]:  # noqa: ANN001
    """Seconds of pictures and of their gradient to the wanted maps, and the pictures."""
    import torch

    leaves = svbrdf.map(lambda values: values.clone())
    for name in wanted:
        leaves.maps[name].requires_grad_()
    begun = time.perf_counter()
    images = renderer.render(leaves, views)
    torch.autograd.grad((images * torch.ones_like(images)).sum(), [leaves.maps[name] for name in wanted])
    return time.perf_counter() - begun, images.detach()


def measure_renders() -> Iterator[dict]:
    """Renders that compute a part which the scene does not need, and that omit it, in turn."""
    import torch

    from mitsvbrdf import SVBRDF, make_renderer
    from mitsvbrdf.bench.tasks import data_folder, find_tasks
    from mitsvbrdf.render.needs import Needs, scene_needs

    task, = find_tasks(["inlay"], ["none"], data_folder(), SIDE, (), "builtin:grid", make_renderer("mitsuba"))
    views, made = task.photos.views, dict(task.truth.maps)
    maps = {"roughconductor": made,
            "principled": {"base_color": made["diffuse"], "metallic": made["specular"][..., :1],
                           "roughness": made["roughness"], "normal": made["normal"]}}
    level = torch.tensor([0.0, 0.0, 1.0]).repeat(SIDE, SIDE, 1)

    def material(bsdf: str, changes: dict) -> SVBRDF:
        changed = {name: level if value is None else torch.full_like(maps[bsdf][name], value)
                   for name, value in changes.items()}
        return SVBRDF(bsdf, maps[bsdf] | changed)

    def in_turn(part: str, names: str, full: tuple, lean: tuple, lean_views=views) -> dict:  # noqa: ANN001
        sides = {"with": full, "without": lean}
        seconds, images = {side: [] for side in sides}, {}
        for turn in range(TURNS + 1):  # the first compiles kernels
            for side, what in sides.items():
                taken, images[side] = timed_render(*what, views if side == "with" else lean_views)
                if turn:
                    seconds[side].append(round(taken, 6))
        print(part, flush=True)
        return {"part": part, "renderer": names, **seconds,
                "difference": float((images["with"] - images["without"]).abs().max() / images["with"].max())}

    fast = make_renderer("mitsuba")
    for part, (name, bsdf, changes, flag) in RENDERS.items():
        svbrdf, wanted = material(bsdf, changes), ("roughness" if "normal" in changes else "normal",)
        more = replace(scene_needs(svbrdf, views, name), **{flag: True})
        yield in_turn(part, name, (make_renderer(name, needs=more), svbrdf, wanted),
                      (make_renderer(name), svbrdf, wanted))
    plain, inlay = material("roughconductor", {"specular": 0.3, "normal": None}), task.truth
    yield in_turn("gradients of three maps that are held fixed", "mitsuba", (fast, inlay, tuple(made)),
                  (fast, inlay, ("diffuse",)))
    yield in_turn("light falloff", "mitsuba", (fast, inlay, ("normal",)), (fast, inlay, ("normal",)),
                  replace(views, falloff="none"))
    for bsdf, names in (("roughconductor", tuple(made)), ("principled", ("base_color", "metallic"))):
        whole, all_names = material(bsdf, {}), tuple(maps[bsdf])
        for name in names:
            yield in_turn(f"gradient of {name}", "mitsuba", (fast, whole, all_names),
                          (fast, whole, tuple(each for each in all_names if each != name)))
    yield in_turn("ray tracing", "mitsuba-scene, mitsuba",
                  (make_renderer("mitsuba-scene"), inlay, ("normal",)), (fast, inlay, ("normal",)))
    yield in_turn("all, of a flat and grey material", "mitsuba-scene, mitsuba",
                  (make_renderer("mitsuba-scene", needs=Needs()), plain, tuple(made)),
                  (fast, plain, ("diffuse",)))


def patches(pictures, chosen):  # noqa: ANN001, ANN201
    """The 7 x 7 patches around chosen pixels, M x 147."""
    windows = pictures.unfold(1, 7, 1).unfold(2, 7, 1)
    return windows[chosen[:, 3:-3, 3:-3]].flatten(1)


def distance(one, other) -> float:  # noqa: ANN001
    """Sliced Wasserstein-1 distance of two sets of as many vectors, over 256 directions."""
    import torch

    directions = torch.randn(256, one.shape[1], generator=torch.Generator().manual_seed(0))
    directions = torch.nn.functional.normalize(directions, dim=1)
    one, other = ((vectors @ directions.T).sort(dim=0).values for vectors in (one, other))
    return float((one - other).abs().mean())


def measure_detail() -> Iterator[dict]:
    """Held-out photos of each capture beside pictures of maps and detail, in display values."""
    import subprocess
    from tempfile import TemporaryDirectory

    import torch
    import torch.nn.functional as F
    from flip_evaluator import evaluate

    from mitsvbrdf import Fit, make_renderer, read_capture
    from mitsvbrdf.bench.tasks import data_folder

    renderer = make_renderer("mitsuba")
    for folder in sorted((data_folder() / "captures").iterdir()):
        capture = read_capture(folder, resolution=128)
        seen = [number for number in capture.index if number not in HELD_OUT]
        with TemporaryDirectory() as place:
            begun = time.perf_counter()
            subprocess.run([sys.executable, "-m", "mitsvbrdf", "fit", folder, "-o", f"{place}/out",
                            "--resolution", "128", "--views", ",".join(map(str, seen)), "--detail", "gan"],
                           check=True, stdout=subprocess.DEVNULL)
            seconds, fit = time.perf_counter() - begun, Fit.load(f"{place}/out")
            solved, drawn = fit.svbrdf, fit.detail
        held = capture.pick([capture.index.index(number) for number in HELD_OUT]).through(fit.transfer)
        offset = held.views.light.new_tensor([*(fit.flash_offset or (0.0, 0.0)), 0.0]) * held.views.size
        views = replace(held.views, light=held.views.light + offset,
                        intensity=held.views.intensity * fit.light_power_factor)
        matte = replace(solved, maps={**solved.maps, "specular": torch.zeros_like(solved["specular"])})
        pictures = [renderer.render(svbrdf, views) for svbrdf in (solved, drawn, matte)]
        light = [F.avg_pool2d(x.clamp(max=1).mean(dim=-1)[:, None], 7, 1, 3, count_include_pad=False)[:, 0]
                 for x in (held.linear, pictures[0], pictures[2])]
        where = torch.maximum(light[0], light[1]) > 2 * light[2]

        def row(linear, photos=held.linear, where=where) -> dict:  # noqa: ANN001
            photos, shown = (light.clamp(0, 1) ** (1 / 2.2) for light in (photos, linear))
            flips = [evaluate(a.numpy(), b.numpy(), "LDR")[1] for a, b in zip(photos, shown)]
            return {"patches": distance(patches(shown, where), patches(photos, where)),
                    "rmse": float((shown - photos).square().mean().sqrt()), "flip": sum(flips) / len(flips)}

        found = {"name": folder.name, "highlights": float(where.float().mean()), "maps": row(pictures[0]),
                 "detail": row(pictures[1]), "seconds": round(seconds, 1)}
        print(found, flush=True)
        yield found


if __name__ == "__main__":
    file = HERE / "omitted.json"
    measures = {"fits": lambda: {"fits": list(measure_fits(file.with_suffix(".jsonl")))},
                "renders": lambda: {"renders": list(measure_renders()), "guess": measure_guess()},
                "detail": lambda: {"detail": list(measure_detail())}}
    content = json.loads(file.read_text())
    for part in sys.argv[1:]:
        content |= measures[part]()
        file.write_text(json.dumps(content))
    (HERE / "omitted.md").write_text(page(content))
    (HERE / "omitted.svg").write_bytes(svg(figure(content)))
