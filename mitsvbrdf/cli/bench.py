"""``mitsvbrdf bench``: error against run time, of renderers and of methods."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from tyro.conf import arg

from ..errors import ConfigError
from ..render import Renderer, RendererName
from ..system import files
from ..system.progress import progress_bar, say, say_written
from .options import Overwrite, Variant, views_of

if TYPE_CHECKING:
    from ..bench.jobs import Job

T = TypeVar("T")
Names = Annotated[str | None, arg(metavar="NAME,...")]
Suite = Literal["all", "renderers", "methods", "ablation", "capture", "gan", "schedule", "steps", "sheets", "none"]
USUAL_SUITES = "renderers", "methods"  # the others are asked for by name: they take longer than both

# What is measured where nothing else is said, and with --quick.
WHOLE = {"resolution": 256, "budgets": "10,30,100,300", "seeds": "0,1,2", "repeats": 5, "megapixels": 3.0,
         "left-out": "4,7"}
QUICK = {"resolution": 64, "budgets": "2,5", "seeds": "0", "repeats": 2, "megapixels": 0.5, "materials": "builtin:inlay",
         "captures": "none"}
WHOLE_CASES = {"sizes": (64, 128, 256, 512, 1024, 2048), "views": (1, 4, 16, 64), "samples": (1, 4, 16, 64, 256)}
QUICK_CASES = {"sizes": (32, 64, 128), "views": (1, 4), "samples": (1, 4, 16)}


def bench(
    suite: Annotated[Suite, arg(help="What to measure; all: renderers and methods; none: only make the page anew.")] = "all",
    json_file: Annotated[Path, arg(name="json", help="The file of all records; one that is there is gone on with.")]
        = Path("out/bench.json"),
    page: Annotated[Path | None, arg(help="Write a Markdown page to this file, its pictures beside it.")] = None,
    gan_page: Annotated[Path | None, arg(help="Write the paper's tables, reproduced, to this Markdown file.")] = None,
    materials: Annotated[Names, arg(help="Known materials: builtin:NAME, folders, or names in the data; none: without. Left "
                                         "out: all made ones and all in the data.")] = None,
    captures: Annotated[Names, arg(help="Real captures: folders or names in the data; none: without. Left out: all.")] = None,
    methods: Annotated[Names, arg(help="Methods; left out: all.")] = None,
    variants: Annotated[Names, arg(help="Of the suites ablation and gan, beside the whole method; left out: all.")] = None,
    budgets: Annotated[str | None, arg(metavar="SECONDS,...", help="Of the fits; left out: 10,30,100,300.")] = None,
    seeds: Annotated[str | None, arg(metavar="NUMBER,...", help="Of the fits; left out: 0,1,2.")] = None,
    resolution: Annotated[int | None, arg(help="Side of maps and photos in the fits; left out: 256.")] = None,
    views: Annotated[str | None, arg(help="Whose views the photos of known materials have: a capture or builtin:grid; left "
                                          "out: cards-blue of the data, else builtin:grid.")] = None,
    left_out: Annotated[str | None, arg(metavar="NUMBER,...", help="Photos of real captures that no fit sees; left out: "
                                                                   "4,7.")] = None,
    data: Annotated[Path | None, arg(help="Folder with captures/, materials/, peers.json; left out: MITSVBRDF_DATA.")] = None,
    repeats: Annotated[int | None, arg(help="Timed turns of the renderers; left out: 5.")] = None,
    megapixels: Annotated[float | None, arg(help="Of the simulated phone's photos; left out: 3.")] = None,
    schedule_size: Annotated[int, arg(help="Side of maps and photos in the suite schedule.")] = 64,
    schedule_width: Annotated[int, arg(help="Channels of the first convolutions there.")] = 16,
    iterations: Annotated[int | None, arg(help="Of the suite schedule; left out: all of the paper's.")] = None,
    quick: Annotated[bool, arg(help="A few minutes for everything: one made material, 64 px, 2 and 5 s, one seed.")] = False,
    renderer: Annotated[RendererName, arg(help="What the fits render with.")] = "mitsuba",
    variant: Variant = "llvm_ad_rgb",
    overwrite: Annotated[Overwrite, arg(help="Forget the records that are there.")] = False,
) -> int:
    """Measure error against run time: renderers against float64, methods against known maps and photos left out.

    The suite capture goes from raw photos of a simulated phone to maps, and takes real captures' views away; its fits have the
    longest budget and the first seed.

    Each record is kept as soon as it is there: Ctrl-C loses one fit at most, and the same command goes on. Nothing else should
    run meanwhile. docs/evaluation.md says what is measured and how.
    """
    from ..bench.jobs import duration, run
    from ..bench.store import Store, read_benchmark

    asked = {"resolution": resolution, "budgets": budgets, "seeds": seeds, "repeats": repeats, "materials": materials,
             "captures": captures, "megapixels": megapixels, "variants": variants, "left-out": left_out}
    chosen = WHOLE | (QUICK if quick else {}) | {name: value for name, value in asked.items() if value is not None}
    files.check_output(json_file, page, gan_page)
    if suite == "none":
        _show(dict(read_benchmark(json_file)), page, gan_page)
        return 0
    suites = USUAL_SUITES if suite == "all" else (suite,)
    chosen |= {"schedule": (schedule_size, schedule_width, iterations), "folder": json_file.parent}
    jobs, settings, found = _jobs(suites, chosen, methods, views, _data(data), renderer, variant, quick)
    store = Store(json_file, settings, overwrite)
    store.publish(found)
    missing = store.pending(jobs)
    say(f"{len(jobs) - len(missing)} of {len(jobs)} records are in {json_file}; "
        + (f"the other {len(missing)} take about {duration(sum(job.cost for job in missing))}" if missing else "nothing to do"))
    try:
        with progress_bar("bench") as report:
            run(jobs, store, report)
    except KeyboardInterrupt:
        say(f"interrupted: {len(jobs) - len(store.pending(jobs))} of {len(jobs)} records are kept in {json_file}; "
            "the same command goes on")
        return 130
    store.write()
    say_written(json_file)
    _show(dict(store.content), page, gan_page)
    return 0


def _jobs(suites: Sequence[str], chosen: dict, methods: str | None, views: str | None, data: Path | None,
          renderer: RendererName, variant: str, quick: bool) -> tuple[list[Job], dict, dict]:
    """All jobs, what their records share, and the numbers published for what they fit."""
    from ..bench.jobs import fit_jobs
    from ..bench.methods import method_table
    from ..bench.paper.printed import printed
    from ..bench.published import published
    from ..bench.renderers import render_jobs
    from ..fit.config import check_seed
    from ..render import make_renderer

    budgets = _numbers("--budgets", chosen["budgets"], float, lambda x: 0 < x < math.inf)
    seeds = _numbers("--seeds", chosen["seeds"], int, lambda x: x >= 0)
    chosen["left-out"] = _numbers("--left-out", chosen["left-out"], int, lambda x: x >= 0)
    for seed in seeds:
        check_seed(seed)
    if chosen["resolution"] < 8 or chosen["repeats"] < 1:
        raise ConfigError("--resolution of 8 or more and --repeats of 1 or more",
                          f"{chosen['resolution']} and {chosen['repeats']}", "try 64 and 3")
    table = method_table()
    unknown = [name for name in _split(methods) if name not in table]
    if unknown:
        raise ConfigError(f"methods of {list(table)}", ", ".join(unknown), "check --methods")
    picked = {name: table[name] for name in _split(methods)}

    engine = make_renderer(renderer, variant)
    shots = {p.name: str(p) for p in _inside(data, "captures")}
    source = shots.get("cards-blue", "builtin:grid") if views is None else shots.get(views, views)
    tasks = []
    if set(suites) & {"methods", "ablation", "gan", "sheets"}:
        tasks = _tasks(chosen, source, data, engine)
    jobs: list = []
    if "renderers" in suites:
        jobs += render_jobs(**(QUICK_CASES if quick else WHOLE_CASES), repeats=chosen["repeats"], variant=variant)
    if "methods" in suites:
        jobs += fit_jobs("methods", picked or table, tasks, budgets, seeds, engine)
    if "capture" in suites:
        from ..bench.from_phone import capture_jobs
        from ..fit import HierarchicalConfig
        from ..synth.phone import HandheldPhone

        phone = HandheldPhone(megapixels=chosen["megapixels"], seed=seeds[0])
        phone.check()
        jobs += capture_jobs(*_sources(chosen, data), phone, HierarchicalConfig(budget=max(budgets), seed=seeds[0]),
                             chosen["resolution"], engine, variant)
    for suite in suites:
        jobs += _variant_jobs(suite, chosen, table, tasks, budgets, seeds, engine) if suite in ("ablation", "gan") else []
        jobs += _paper_jobs(suite, chosen, picked, source, data, engine, tasks, max(budgets), seeds)
    settings = {"resolution": chosen["resolution"], "views": _name(source), "renderer": renderer, "variant": variant,
                "quick": quick, "left_out": chosen["left-out"]}
    found = published(data / "peers.json", tasks, chosen["resolution"]) if data else {}
    return jobs, settings, found | (printed() if "gan" in suites else {})


def _variant_jobs(suite: str, chosen: dict, table: dict, tasks: list, budgets: list[float], seeds: list[int],
                  engine: Renderer) -> list[Job]:
    """Fits of a method and of its variants; beside those of ``gan``, what the paper's tables compare them with."""
    from ..bench.jobs import fit_jobs
    from ..bench.paper.references import ReferenceJob
    from ..bench.variants import ablations, variant_table

    method, variants = ablations()[suite]
    names = _split(chosen.get("variants"))
    unknown = [name for name in names if name not in variants]
    if unknown:
        raise ConfigError(f"variants of {list(variants)}", ", ".join(unknown), "check --variants")
    wanted = {name: variants[name] for name in names or variants}
    references = [ReferenceJob(task, engine) for task in tasks] if suite == "gan" else []
    return [*references, *fit_jobs(suite, variant_table(table[method], wanted), tasks, budgets, seeds, engine)]


def _paper_jobs(suite: str, chosen: dict, picked: dict, source: str, data: Path | None, engine: Renderer, tasks: list,
                budget: float, seeds: list[int]) -> list[Job]:
    """What the paper's tables need besides fits at equal time: its schedule, seconds of an iteration, sheets of pictures."""
    from dataclasses import replace

    from ..bench.methods import method_table
    from ..bench.paper.schedule import ScheduleJob
    from ..bench.paper.sheets import SheetJob
    from ..bench.paper.steps import StepJob
    from ..fit import GanConfig

    if suite == "steps":
        return [StepJob(GanConfig(preset=preset), chosen["resolution"], engine, chosen["repeats"])
                for preset in ("paper-two-stage", "minutes")]
    if suite == "sheets":
        shown = picked or {name: method_table()[name] for name in ("gan", "hierarchical")}
        return [SheetJob(shown, task, budget, seeds[0], engine, chosen["folder"]) for task in tasks if task.kind == "material"]
    if suite != "schedule":
        return []
    side, width, iterations = chosen["schedule"]
    runs = picked or {"gan-two-stage": GanConfig(preset="paper-two-stage")}
    wrong = [name for name, config in runs.items() if not isinstance(config, GanConfig)]
    if wrong:
        raise ConfigError("gan, gan-one-stage or gan-two-stage in the suite schedule", ", ".join(wrong), "check --methods")
    endless = [name for name, config in runs.items() if iterations is None and not config.of_paper]
    if endless:
        raise ConfigError("--iterations for a method without a schedule of its own", ", ".join(endless), "give --iterations")
    sized = {name: replace(config, width=width, iterations=iterations) for name, config in runs.items()}
    for config in sized.values():
        config.check()
    return [ScheduleJob(name, config, task, seed, engine)
            for task in _tasks(chosen | {"resolution": side}, source, data, engine)
            for seed in seeds for name, config in sized.items()]


def _tasks(chosen: dict, source: str, data: Path | None, engine: Renderer) -> list:
    from ..bench.tasks import known_material, real_capture

    materials, captures = _sources(chosen, data)
    lit = views_of(source, "inverse-square")[1]
    tasks: list = [known_material(name, chosen["resolution"], lit, engine) for name in materials]
    return tasks + [real_capture(Path(name), chosen["resolution"], chosen["left-out"]) for name in captures]


def _sources(chosen: dict, data: Path | None) -> tuple[list[str], list[str]]:
    """The known materials, builtin:NAME or folders, and the folders of real captures, each once."""
    from ..material.made import MATERIALS

    everything = [*(f"builtin:{name}" for name in MATERIALS), *map(str, _inside(data, "materials"))]
    names = _folders(chosen.get("materials"), everything, data, "materials")
    names = [f"builtin:{name}" if name in MATERIALS and not Path(name).is_dir() else name for name in names]
    shots = _folders(chosen.get("captures"), list(map(str, _inside(data, "captures"))), data, "captures")
    if not names and not shots:
        raise ConfigError("a material or capture to fit", "none", "give --materials or --captures, or --suite renderers")
    missing = [name for name in (*names, *shots) if not name.startswith("builtin:") and not Path(name).exists()]
    if missing:
        raise ConfigError("materials and captures that are there", f"none called {missing[0]}",
                          "name folders, or those in --data; leave the option out for all")
    for found in (names, shots):
        labels = [Path(name.removeprefix("builtin:")).name for name in found]
        twice = [label for label in labels if labels.count(label) > 1]
        if twice:
            raise ConfigError("each material and capture once, by a name of its own", f"{twice[0]} twice", "rename a folder")
    return names, shots


def _data(folder: Path | None) -> Path | None:
    """The folder of real captures and known materials, if there is one."""
    named = folder or (Path(os.environ["MITSVBRDF_DATA"]) if os.environ.get("MITSVBRDF_DATA") else None)
    if named is not None and not ((named / "captures").is_dir() or (named / "materials").is_dir()):
        raise ConfigError("a folder with captures/ or materials/", str(named), "check --data and MITSVBRDF_DATA")
    return named


def _inside(data: Path | None, what: str) -> list[Path]:
    folder = data / what if data else None
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder and folder.is_dir() else []


def _folders(asked: str | None, everything: list[str], data: Path | None, what: str) -> list[str]:
    """Names on the command line as builtin:NAME or folders; a bare name may be one in the data."""
    if asked is None:
        return everything
    there = {p.name: str(p) for p in _inside(data, what)}
    return [name if name.startswith("builtin:") else there.get(name, name) for name in _split(asked) if name != "none"]


def _split(text: str | None) -> list[str]:
    return [part.strip() for part in (text or "").split(",") if part.strip()]


def _numbers(option: str, text: str, kind: Callable[[str], T], valid: Callable[[T], bool]) -> list[T]:
    try:
        numbers = list(dict.fromkeys(map(kind, _split(text))))
    except ValueError:
        numbers = []
    if not numbers or not all(map(valid, numbers)):
        raise ConfigError(f"{option} like {WHOLE[option[2:]]}", repr(text), "separate numbers by commas")
    return numbers


def _name(source: str) -> str:
    return source if source.startswith("builtin:") else Path(os.path.abspath(source)).name


def _show(record: dict, page: Path | None, gan_page: Path | None) -> None:
    """The tables on the terminal and, where they were asked for, the pages."""
    from ..bench.page import print_benchmark, write_benchmark_page
    from ..bench.paper.page import print_gan, write_gan_page

    print_benchmark(record)
    if gan_page or any(r["suite"] in ("gan", "steps") for r in record["records"]):
        print_gan(record)
    if page:
        say_written(*write_benchmark_page(page, record))
    if gan_page:
        say_written(*write_gan_page(gan_page, record))
