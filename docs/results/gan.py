"""`gan`, the paper's method and what lies between it and ours.

``python docs/results/gan.py`` makes gan.md and gan.svg from gan.json. Names of measurements behind it are
measured first: those of FITS, ``solved``, ``photo``, ``stages`` or ``detail`` (minutes to an hour each;
MITSVBRDF_DATA names the data; fits that a stopped run has done are not done again). The paper's schedule,
gradients and pictures stay as they were measured.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import pandas as pd
from matplotlib.figure import Figure

from mitsvbrdf.bench.plot import svg
from mitsvbrdf.bench.table import as_markdown, summary

HERE = Path(__file__).parent
MAPS = ["diffuse", "specular", "roughness", "normal", "mean", "novel_light"]
HEADS = [*MAPS[:-1], "new light"]
NOW, WITHOUT, UNMATCHED = "known materials", "no adversarial loss", "no feature matching"
GROWN, SHOTS, LADDER = "growing, 256 px", "captures", "ingredients"
SOLVED, ONE, STAGES = "from solved maps", "one photo", "two stages"
LARGE, DEEP = "from solved maps, 256 px", ("10_brick_uneven_stones", "20_synteticfoam", "36_leather_tiles")
BESIDE_NOTHING, BESIDE = "flash at the lens", "flash 0.1 sides beside"

# An ingredient -> the settings of GanConfig that change it.
VARIANTS = {
    "full": {}, WITHOUT: {"adversarial": 0.0, "features": 0.0}, "no diffuse loss": {"diffuse": 0.0},
    "the paper's guess": {"guess": "min"}, "no start at the guess": {"start": "untrained"},
    "two-stream generator": {"generator": "two-stream"}, "bce": {"game": "bce"}, "hinge": {"game": "hinge"},
    "not paired": {"paired": False}, UNMATCHED: {"features": 0.0}, "no growing": {"grow": False},
    "one picture a step": {"pictures": 1}, "no smoothness": {"smooth": 0.0},
    "one specular level": {"grey_specular": True}, "no flash offset": {"flash_offset": False},
}
SIX = ["brick-uneven-stones", "fake-022", "fake-030", "metal-plating", "rotten-wood-boards", "synthetic-foam"]
# A measurement -> materials, captures ("none", or None: all), pixels, seconds, seeds, and variants. The
# default has one seed.
FITS = {
    NOW: (SIX, ["none"], 128, 40, (0, 1, 2), ("full", WITHOUT, UNMATCHED)),
    LADDER: (["metal-plating", "fake-022"], ["none"], 128, 45, (0,), tuple(VARIANTS)),
    GROWN: (["metal-plating"], ["none"], 256, 120, (0,), ("full", "no growing")),
    SHOTS: (["none"], None, 128, 40, (0,), ("full",)),
}


def of(record: dict, measured: str, kind: str = "material", method: str | None = None) -> list:
    """Records of one measurement."""
    return [r for r in record["records"] if r["measured"] == measured and r["kind"] == kind
            and method in (None, r["method"])]


def versions(record: dict, *measured: str) -> str:
    """The versions of the program that some measurements were made with."""
    return " and ".join(sorted({r["version"] for r in record["records"] if r["measured"] in measured}))


def means(records: list) -> list[str]:
    """Each error: median over seeds of the mean over materials."""
    return [f"{summary(records, name)['median'].iloc[0]:.4f}" for name in MAPS]


def known(record: dict) -> pd.DataFrame:
    """Errors of the maps, mean of six known materials."""
    rows = {title: means(of(record, measured, method=method)) for title, measured, method in (
        ("`gan`, 40 s", NOW, "full"), ("without the adversarial loss", NOW, WITHOUT),
        ("without feature matching", NOW, UNMATCHED), ("`hierarchical`", NOW, "hierarchical"))}
    return pd.DataFrame.from_dict(rows, orient="index", columns=HEADS)


def solved(record: dict) -> pd.DataFrame:
    """``gan`` from solved maps beside the default: mean errors, and how far any of them is apart."""
    ours, default = ({r["name"]: r["errors"] for r in of(record, SOLVED, method=method)}
                     for method in ("gan", "hierarchical"))
    rows = {}
    for name in MAPS:
        pairs = [(errors[name], default[task][name]) for task, errors in ours.items()]
        rows[name.replace("novel_light", "new light")] = [
            *(f"{sum(column) / len(pairs):.4f}" for column in zip(*pairs)),
            f"{max(abs(a - b) for a, b in pairs):.4f}"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=[
        "`gan` from solved maps", "`hierarchical`", "furthest apart"])


def game(record: dict) -> pd.DataFrame:
    """Each material with and without the adversarial loss."""
    rows = {}
    for name in dict.fromkeys(r["name"] for r in of(record, NOW)):
        cells = []
        for error in ("mean", "novel_light"):
            pair = [median(r["errors"][error] for r in of(record, NOW, method=m) if r["name"] == name)
                    for m in ("full", WITHOUT)]
            cells += [f"{pair[0]:.4f}", f"{pair[1]:.4f}"]
        rows[name] = cells
    return pd.DataFrame.from_dict(rows, orient="index", columns=[
        "maps, with", "maps, without", "new light, with", "new light, without"])


def published(record: dict) -> pd.DataFrame:
    """Maps that others published, and ours of the same materials."""
    rows = {}
    for name, others in record["references"].items():
        for who, errors in others.items():
            rows[f"{name}: {who}, published maps"] = [f"{errors[each]:.4f}" for each in MAPS[:5]]
        for title, method in (("`gan`, 40 s", "full"), ("`hierarchical`", "hierarchical")):
            here = [r for r in of(record, NOW, method=method) if r["name"] == name]
            rows[f"{name}: {title}"] = means(here)[:5]
    return pd.DataFrame.from_dict(rows, orient="index", columns=HEADS[:5])


def captures(record: dict) -> pd.DataFrame:
    """Medians over eighteen captures."""
    rows = {}
    for title, measured, method in (("`gan`, 40 s", SHOTS, "full"),
                                    ("`hierarchical`", SHOTS, "hierarchical"),
                                    ("`gan` from solved maps", SOLVED, "gan"),
                                    ("`hierarchical` beside it", SOLVED, "hierarchical")):
        here = of(record, measured, "capture", method)
        rows[title] = [f"{median(r['errors'][name] for r in here):.4f}" for name in ("held_out", "seen")]
    return pd.DataFrame.from_dict(rows, orient="index", columns=["held-out photos", "photos seen"])


def printed(record: dict) -> pd.DataFrame:
    """What the paper prints, and its schedule run here."""
    rows = {}
    for number, whose in record["paper"].items():
        for who, errors in whose.items():
            rows[f"printed, {number}: {who}"] = [f"{errors[name]:.3f}" for name in MAPS[:4]]
    for r in record["schedule"]:
        if r["kind"] == "material":
            rows[f"`gan-two-stage`, {r['name']}, {r['seconds'] / 3600:.1f} h"] = [
                f"{r['errors'][name]:.4f}" for name in MAPS[:4]]
    return pd.DataFrame.from_dict(rows, orient="index", columns=MAPS[:4])


def ingredients(record: dict, measured: str) -> pd.DataFrame:
    """Each ingredient, two materials."""
    rows = {name: means(of(record, measured, method=name))
            for name in dict.fromkeys(r["method"] for r in of(record, measured))}
    return pd.DataFrame.from_dict(rows, orient="index", columns=HEADS)


def gradients(record: dict) -> pd.DataFrame:
    """Error of the gradient of the weights: median (largest)."""
    cells: dict[str, dict[str, str]] = {}
    for r in record["generator_gradients"]:
        cells.setdefault(r["through"],
                         {})[f"`{r['method']}`, {r['bsdf']}"] = f"{r['median']:.1e} ({r['largest']:.1e})"
    return pd.DataFrame(cells)


def one_photo(record: dict) -> pd.DataFrame:
    """Mean errors of one photo's maps, of the materials that repeat themselves."""
    found = of(record, ONE)
    taken = {r["name"] for r in found if r["method"] == BESIDE_NOTHING and r["stationary"]}
    rows = {}
    for method in dict.fromkeys(r["method"] for r in found):
        here = [r["errors"] for r in found if r["method"] == method and r["name"] in taken]
        rows[f"{method}, {len(here)} materials"] = [f"{sum(e[name] for e in here) / len(here):.4f}"
                                                    for name in MAPS[:4]]
    return pd.DataFrame.from_dict(rows, orient="index", columns=MAPS[:4])


def one_photo_detail(record: dict) -> pd.DataFrame:
    """Patches, new light and mean error of the maps of one photo, without and with plausible detail."""
    seeds: dict[str, list] = {}
    for r in record["one_photo_detail"]:
        seeds.setdefault(r["name"], []).append(r)
    rows = {name: [" → ".join(f"{median(r[which][of_it] for r in found):.{digits}f}"
                              for which in ("maps", "detail"))
                   for of_it, digits in (("patches", 4), ("novel_light", 3), ("mean", 3))]
            for name, found in seeds.items()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["patches", "new light", "maps"])


def two_stages(record: dict) -> pd.DataFrame:
    """Mean errors of one photo's maps: looks, and the paper's game from a trained start and from none."""
    found = of(record, STAGES)
    rows = {method: [f"{sum(r['errors'][name] for r in here) / len(here):.4f}" for name in MAPS[:4]]
            for method in dict.fromkeys(r["method"] for r in found)
            if (here := [r for r in found if r["method"] == method])}
    return pd.DataFrame.from_dict(rows, orient="index", columns=MAPS[:4])


def page(record: dict) -> str:
    """The text of gan.md."""
    bamboo = next(r for r in record["schedule"] if r["kind"] == "capture")
    fits = of(record, SOLVED, method="gan")

    def changed_maps(measured: str) -> int:
        default = {r["name"]: r["errors"] for r in of(record, measured, method="hierarchical")}
        return sum(abs(r["errors"][name] - default[r["name"]][name]) > 1e-5
                   for r in of(record, measured, method="gan") for name in MAPS[:4])

    seen = [{r["name"]: r["errors"]["seen"] for r in of(record, SOLVED, "capture", method)}
            for method in ("gan", "hierarchical")]
    stages = of(record, STAGES)
    played = " and ".join(dict.fromkeys(r["name"] for r in stages))
    changed = [name for name in seen[0] if abs(seen[0][name] - seen[1][name]) > 1e-5]
    grown = [means(of(record, GROWN, method=m))[4] for m in ("full", "no growing")]
    return f"""# `gan`, beside the paper

## Known materials

{as_markdown(known(record))}

RMSE of maps encoded to 0 to 1 and of pictures under new light: mean of six materials, median of three seeds \
(`hierarchical`: one). Maps have 128 px where nothing else is said. On this page `gan` is \
`--start guess` where *from solved maps* is not said. The adversarial loss with feature matching improves \
diffuse, roughness and normals, and makes specular worse. Where no version is stated, it is \
{versions(record, NOW, LADDER, GROWN, SHOTS)}.

{as_markdown(game(record))}

Each material after 40 s with the adversarial loss and feature matching, and without both: mean RMSE of the \
maps, and RMSE under new light; median of three seeds.

![With and without the adversarial loss](gan.svg)

## From solved maps

{as_markdown(solved(record))}

Mean RMSE of {len(fits)} known materials (two are the same), 64 px, 200 steps, one seed. *Furthest apart*: \
the largest difference of any material. The change of the adversarial game was kept in \
{changed_maps(SOLVED)} of {4 * len(fits)} maps: it predicts held-out patches of the photos no better. At 256 \
px and 300 s it was kept in {changed_maps(LARGE)} of {4 * len(DEEP)} maps of the three materials of deepest \
relief ({", ".join(DEEP)}). Versions {versions(record, SOLVED, LARGE)}.

## Maps that others published

{as_markdown(published(record))}

RMSE of maps of two known materials: those that others published, and those of `gan` and `hierarchical` in \
the first table.

## One photo, beside the ancestors

{as_markdown(one_photo(record))}

Mean RMSE of maps from one photo each (256 px, stated view, 1.2 patch sides above). The published maps were \
recovered from the publishers' own photos. Two of ten materials are missing: their photos fail the test of \
repetition. Version {versions(record, ONE, STAGES)}, as in the tables below.

| one flash photo of a stationary material | what it does | here |
| --- | --- | --- |
| Aittala 2015 | matches patches to a master tile, guided by a second photo without flash | \
rings of equal half angle instead of patches; one photo |
| Aittala 2016 | matches features of a trained network between crops of photo and renderings | \
lightness in these rings; no network |
| Zhao 2020 | a GAN on crops of the photo, and a guessed diffuse map | a likelihood of few looks; the \
game on crops in `--detail gan` |

{as_markdown(one_photo_detail(record))}

Errors of the default's maps from one photo (looks) → of the maps of `fit --detail gan` (128 px, median of \
three seeds). Pictures of both under three new lights are compared with those of the true maps: *patches* by \
the sliced Wasserstein distance of their patches, *new light* by RMSE. *Maps* is the mean map RMSE. The \
discriminator compares crops of the photo with renderings under the same flash at other places. Detail is \
for pictures; the maps of a fit stay those of the looks.

{as_markdown(two_stages(record))}

RMSE of maps from one photo, 64 px, mean of {played}. *Trained start*: the paper's first stage (Wen) was \
trained once, 2,000 iterations on one photo of {stages[0]["trained_on"]}. The second stage, or the game \
*untrained*, then had 400 iterations a photo (width 16, learning rate 0.001, light that falls off). The \
trained start gives better diffuse and specular maps; both stay far behind looks.

## Captures

{as_markdown(captures(record))}

Median RMSE of 18 captures at 128 px; photos 4 and 7 are held out. From solved maps (200 steps, one seed) \
the game's change was kept in {len(changed)} capture. In the last two rows photos seen are rendered with the \
stated views, in the others with those of the fit.

## The paper's tables and its schedule

{as_markdown(printed(record))}

RMSE of maps. The paper's sets 4 and 5 are not published, so the printed rows tell only the order of \
magnitude. `gan-two-stage` ran the paper's 25,000 iterations at 64 px and width 16 (version 0.1.0), and \
reaches that order. \
On the capture {bamboo["name"]} (32 px) its RMSE of photos seen is {bamboo["errors"]["seen"]:.4f}, of \
held-out ones {bamboo["errors"]["held_out"]:.4f}.

## Each ingredient

{as_markdown(ingredients(record, LADDER))}

Mean of metal-plating and fake-022, 128 px, 45 s, one seed. Growing at full size: after 120 s at 256 px, \
metal-plating has a mean of {grown[0]} with it, {grown[1]} without.

## Gradients of the generator's weights

{as_markdown(gradients(record))}

Relative L2 error against gradients through the float64 twin: median (largest) over five states of the \
training, `inlay` at 64 px. For the last two columns one thing is wrong in the twin itself, as named.

## Pictures

From left to right: input photo, diffuse, specular, roughness, normal, guessed diffuse, the photo's view, \
lit from the side.

![Maps and renderings of inlay](gan-inlay.jpg)

![Maps and renderings of leather](gan-leather.jpg)
"""


def figure(record: dict) -> Figure:
    """Error of the maps of each material with and without the adversarial loss."""
    found = game(record).astype(float)
    drawing = Figure(figsize=(6, 2.8), layout="constrained")
    axes = drawing.subplots()
    for name, marker in (("maps, with", "o"), ("maps, without", "x")):
        axes.plot(found[name], found.index, marker, label=name)
    axes.set_xlabel("RMSE of the maps")
    axes.legend(fontsize=8)
    return drawing


def from_solved(data: Path, renderer) -> Iterator[dict]:
    """``gan`` from solved maps beside the default, so many steps each: captures, then known materials."""
    from mitsvbrdf import GanConfig, HierarchicalConfig, read_capture
    from mitsvbrdf.bench.run import run
    from mitsvbrdf.bench.tasks import find_tasks, known_material

    views = read_capture(data / "captures/cards-blue", resolution=64).views
    strips = [replace(known_material(str(folder / "strip.png"), 64, views, renderer, "cards-blue"),
                      name=folder.name) for folder in sorted((data / "one-photo/known").iterdir())]
    tasks = [*find_tasks(["none"], None, data, 128, (4, 7), None, renderer),
             *find_tasks(None, ["none"], data, 64, (), None, renderer), *strips]
    methods = {"gan": GanConfig(iterations=200), "hierarchical": HierarchicalConfig(iterations=200)}
    for r in run(methods, tasks, [1200], [0], renderer, HERE / "gan.jsonl", tell):
        yield {**r, "measured": SOLVED}
    views = read_capture(data / "captures/cards-blue", resolution=256).views
    deep = [replace(known_material(str(data / "one-photo/known" / name / "strip.png"), 256, views, renderer,
                                   "cards-blue"), name=name) for name in DEEP]
    for r in run({"gan": GanConfig(), "hierarchical": HierarchicalConfig()}, deep, [300], [0], renderer,
                 HERE / "gan.jsonl", tell):
        yield {**r, "measured": LARGE}


def from_one_photo(folders: list[Path], renderer) -> Iterator[dict]:
    """Maps of one photo of each strip of maps, and those that a learned system found, if they are there."""
    import math

    from mitsvbrdf import HierarchicalConfig, Views, load_maps
    from mitsvbrdf.bench.run import fit, version
    from mitsvbrdf.bench.tasks import known_material

    for folder in folders:
        for method, beside in ((BESIDE_NOTHING, 0.0), (BESIDE, 0.1)):
            view = Views.of([[0.0, 0.0, 1.2]], [[beside, 0.0, 1.2]], math.pi * 1.44)
            task = known_material(str(folder / "strip.png"), 256, view, renderer, "one view")
            result, predict = fit(task.photos, renderer, HierarchicalConfig(budget=600), lambda share: None)
            row = {"measured": ONE, "kind": "material", "name": folder.name, "version": version()}
            yield row | {"method": method, "errors": task.errors(result.svbrdf, predict),
                         "stationary": result.record["repeats"]["stationary"],
                         "seconds": result.record["seconds"]}
        if (folder / "peer").is_dir():
            maps = load_maps(folder / "peer", encoding="roughness=linear")
            errors = task.errors(maps, lambda photos: 0.0)
            yield row | {"method": "a learned system, published maps",
                         "errors": {name: errors[name] for name in MAPS}}


def patch_distance(one, other) -> float:  # noqa: ANN001
    """Sliced Wasserstein distance of the 7 x 7 patches of pictures, N x R x R x 3, over 512 directions."""
    import torch
    import torch.nn.functional as F

    directions = F.normalize(torch.randn(147, 512, generator=torch.Generator().manual_seed(0)), dim=0)
    kernel = directions.T.reshape(512, 3, 7, 7)
    one, other = (F.conv2d(x.movedim(-1, 1), kernel, stride=3).flatten(2).sort().values for x in (one, other))
    return float((one - other).abs().mean())


def detail_of_one_photo(folders: list[Path], renderer, seed: int) -> Iterator[dict]:
    """Pictures and maps of those that repeat themselves, before and after the game."""
    import math
    import subprocess
    from tempfile import TemporaryDirectory

    from mitsvbrdf import Fit, Views, load_maps, write_capture
    from mitsvbrdf.bench.run import version
    from mitsvbrdf.bench.tasks import known_material

    power, places = math.pi * 1.44, [[0.25, 0.2, 1.2], [-0.3, 0.1, 1.2], [0.1, -0.3, 1.2]]
    new, view = Views.of(places, places, power), Views.of([[0.0, 0.0, 1.2]], [[0.0, 0.0, 1.2]], power)
    for folder in folders:
        task = known_material(str(folder / "strip.png"), 128, view, renderer, "one view")
        with TemporaryDirectory() as place:
            out = Path(place, "out")
            write_capture(task.photos, Path(place, "photo"))
            subprocess.run(["mitsvbrdf", "fit", Path(place, "photo"), "-o", out, "--budget", "600",
                            "--detail", "gan", "--seed", str(seed)], check=True)
            if not Fit.load(out).record["repeats"]["stationary"]:
                continue
            found = {"maps": load_maps(out / "maps"), "detail": load_maps(out / "detail")}
        truth, *shown = (renderer.render(maps, new).clamp(0, 1) ** (1 / 2.2)
                         for maps in (task.truth.resized(128), *found.values()))
        yield {"name": folder.name, "seed": seed, "version": version(), **{
            name: {"patches": patch_distance(pictures, truth),
                   "novel_light": float((pictures - truth).square().mean().sqrt()),
                   "mean": task.errors(maps, lambda photos: 0.0)["mean"]}
            for (name, maps), pictures in zip(found.items(), shown)}}


def in_two_stages(folders: list[Path], renderer) -> Iterator[dict]:
    """Maps of one photo by looks, and by the paper's game that began at one other picture, or at none."""
    import math
    import subprocess
    from tempfile import TemporaryDirectory

    from mitsvbrdf import Fit, Views, load_maps, write_capture
    from mitsvbrdf.bench.run import version
    from mitsvbrdf.bench.tasks import known_material

    view = Views.of([[0.0, 0.0, 1.2]], [[0.0, 0.0, 1.2]], math.pi * 1.44)
    game = ["--method", "gan", "--width", "16", "--learning-rate", "0.001", "--falloff", "inverse-square",
            "--preset"]
    with TemporaryDirectory() as place:
        trained, (picture, *others) = Path(place, "trained"), folders

        def fitted(folder: Path, out: Path, *options: object) -> None:
            if not (photo := Path(place, folder.name)).is_dir():
                write_capture(known_material(str(folder / "strip.png"), 64, view, renderer,
                                             "one view").photos, photo)
            subprocess.run(["mitsvbrdf", "fit", photo, "-o", out, "--overwrite", *map(str, options)],
                           check=True)

        fitted(picture, trained, *game, "paper-two-stage", "--pretrain", "--iterations", 2000)
        methods = {"looks": ["--budget", 600],
                   "the paper's game, trained start": [*game, "paper-two-stage", "--pretrained", trained,
                                                       "--iterations", 400],
                   "the paper's game, untrained": [*game, "paper-one-stage", "--iterations", 400]}
        for folder in others:
            for method, options in methods.items():
                fitted(folder, out := Path(place, "out"), *options)
                if method == "looks" and not Fit.load(out).record["repeats"]["stationary"]:
                    break
                task = known_material(str(folder / "strip.png"), 64, view, renderer, "one view")
                errors = task.errors(load_maps(out / "maps"), lambda photos: 0.0)
                yield {"measured": STAGES, "kind": "material", "name": folder.name, "method": method,
                       "errors": errors, "trained_on": picture.name, "version": version()}


def fits(measured: str, data: Path, renderer) -> Iterator[dict]:
    """The fits of one measurement, and the default of its tasks at 128 px."""
    from mitsvbrdf import GanConfig, HierarchicalConfig
    from mitsvbrdf.bench.run import run
    from mitsvbrdf.bench.tasks import find_tasks

    names, shots, side, budget, seeds, variants = FITS[measured]
    tasks = find_tasks(names, shots, data, side, (4, 7), None, renderer)
    groups = [({name: replace(GanConfig(start="guess"), **VARIANTS[name]) for name in variants}, seeds)]
    if measured in (NOW, SHOTS):
        groups.append(({"hierarchical": HierarchicalConfig()}, seeds[:1]))
    for methods, taken in groups:
        for r in run(methods, tasks, [budget], taken, renderer, HERE / "gan.jsonl", tell):
            yield {**r, "measured": measured}


def tell(text: str, share: float) -> None:
    """Print how far a measurement is."""
    print(f"{share:4.0%} {text}", flush=True)


def measure(record: dict, name: str) -> dict:
    """The record with one measurement made anew."""
    from mitsvbrdf import make_renderer
    from mitsvbrdf.bench.tasks import data_folder

    renderer, data = make_renderer("mitsuba"), data_folder()
    strips = sorted((data / "one-photo/known").iterdir())
    if name == "detail":
        return {**record, "one_photo_detail": [row for seed in range(3)
                                               for row in detail_of_one_photo(strips, renderer, seed)]}
    others = {"solved": lambda: from_solved(data, renderer),
              "photo": lambda: from_one_photo(strips, renderer),
              "stages": lambda: in_two_stages(strips[:4], renderer)}
    found = list(others[name]() if name in others else fits(name, data, renderer))
    made = {r["measured"] for r in found}
    return {**record, "records": [*(r for r in record["records"] if r["measured"] not in made), *found]}


if __name__ == "__main__":
    content = json.loads((HERE / "gan.json").read_text())
    for name in sys.argv[1:]:
        content = measure(content, name)
        (HERE / "gan.json").write_text(json.dumps(content))
    (HERE / "gan.md").write_text(page(content))
    (HERE / "gan.svg").write_bytes(svg(figure(content)))
