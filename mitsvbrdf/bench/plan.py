"""What a benchmark measures: from what was asked for to the list of its jobs, the same in every process."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ..errors import ConfigError
from ..evaluate.placement import named_views
from ..fit import GanConfig, HierarchicalConfig
from ..fit.config import check_seed
from ..fit.methods import METHODS
from ..material.made import MATERIALS
from ..render import Renderer, RendererName, make_renderer
from ..synth.phone import HandheldPhone
from .from_phone import capture_jobs
from .jobs import Job, fit_jobs
from .methods import method_table
from .paper.printed import printed
from .paper.references import ReferenceJob
from .paper.schedule import ScheduleJob
from .paper.sheets import SheetJob
from .paper.steps import StepJob
from .published import PEERS_LEFT_OUT, predicted_by_peers, published
from .renderers import render_jobs
from .start import StartJob
from .tasks import known_material, real_capture
from .variants import ablations, variant_table

T = TypeVar("T")

# What is measured where nothing else is said, and with --quick.
WHOLE = {"resolution": 256, "budgets": "10,30,100,300", "seeds": "0,1,2", "repeats": 5, "megapixels": 3.0,
         "left-out": "4,7"}
QUICK = {"resolution": 64, "budgets": "2,5", "seeds": "0", "repeats": 2, "megapixels": 0.5,
         "materials": "builtin:inlay",
         "captures": "none"}
WHOLE_CASES = {"sizes": (64, 128, 256, 512, 1024, 2048), "views": (1, 4, 16, 64),
               "samples": (1, 4, 16, 64, 256)}
QUICK_CASES = {"sizes": (32, 64, 128), "views": (1, 4), "samples": (1, 4, 16)}


@dataclass(frozen=True)
class Plan:
    """What was asked for; plain values, so that another process can be told.

    Args:
        suites: what to measure.
        chosen: resolution, budgets, seeds, repeats, megapixels, left-out, schedule, folder, and where given
            materials, captures and variants; :data:`WHOLE` and :data:`QUICK` are its defaults.
        methods: names, separated by commas; None is all.
        views: whose views the photos of known materials have; None is cards-blue of the data, else
            builtin:grid.
        data: folder of real captures and known materials, as text.
        renderer: what the fits render with.
        variant: Mitsuba's.
        quick: whether the small cases of the renderers are measured.
    """

    suites: Sequence[str]
    chosen: dict
    methods: str | None
    views: str | None
    data: str | None
    renderer: RendererName
    variant: str
    quick: bool

    def jobs(self) -> tuple[list[Job], dict, dict]:
        """All jobs, what their records share, and the numbers published for what they fit.

        Raises:
            ConfigError: something that was asked for does not exist or is out of range.
        """
        return _jobs(self.suites, dict(self.chosen), self.methods, self.views, Path(self.data) if self.data
                     else None, self.renderer, self.variant, self.quick)


def _jobs(suites: Sequence[str], chosen: dict, methods: str | None, views: str | None, data: Path | None,
          renderer: RendererName, variant: str, quick: bool) -> tuple[list[Job], dict, dict]:
    """All jobs, what their records share, and the numbers published for what they fit."""
    budgets = _numbers("--budgets", chosen["budgets"], float, lambda x: 0 < x < math.inf)
    seeds = _numbers("--seeds", chosen["seeds"], int, lambda x: x >= 0)
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
    protocols(chosen["left-out"], data)  # a mistake is one, whatever is measured
    tasks = []
    if set(suites) & {"methods", "ablation", "gan", "sheets"}:
        tasks = _tasks(chosen, source, data, engine)
    jobs: list = []
    if "renderers" in suites:
        jobs += render_jobs(**(QUICK_CASES if quick else WHOLE_CASES), repeats=chosen["repeats"],
                            variant=variant)
    if "methods" in suites:
        jobs += fit_jobs("methods", picked or table, tasks, budgets, seeds, engine)
    if "start" in suites:
        jobs += _start_jobs(_sources(chosen, data)[1], picked, chosen["resolution"], min(budgets),
                            chosen["repeats"], renderer, variant)
    if "capture" in suites:
        phone = HandheldPhone(megapixels=chosen["megapixels"], seed=seeds[0])
        phone.check()
        jobs += capture_jobs(*_sources(chosen, data), phone, HierarchicalConfig(budget=max(budgets),
                                                                                seed=seeds[0]),
                             chosen["resolution"], engine, variant)
    for suite in suites:
        jobs += (_variant_jobs(suite, chosen, table, tasks, budgets, seeds, engine)
                 if suite in ("ablation", "gan") else [])
        jobs += _paper_jobs(suite, chosen, picked, source, data, engine, tasks, max(budgets), seeds)
    settings = {"resolution": chosen["resolution"], "views": _name(source), "renderer": renderer,
                "variant": variant,
                "quick": quick}
    found = published(data / "peers.json", tasks, chosen["resolution"]) if data else {}
    return jobs, settings, found | (printed() if "gan" in suites else {})


def _start_jobs(captures: list[str], picked: dict, resolution: int, budget: float, repeats: int,
                renderer: RendererName, variant: str) -> list[StartJob]:
    """The command `fit` on the first capture, by each method that it has."""
    unknown = [name for name in picked if name not in METHODS]
    if unknown or not captures:
        raise ConfigError(f"a capture, and methods of {list(METHODS)}, in the suite start", ", ".join(unknown)
                          or "no capture",
                          "check --methods and --captures")
    return [StartJob(captures[0], method, resolution, budget, repeats, renderer, variant) for method in picked
            or METHODS]


def _variant_jobs(suite: str, chosen: dict, table: dict, tasks: list, budgets: list[float], seeds: list[int],
                  engine: Renderer) -> list[Job]:
    """Fits of a method and of its variants; beside those of ``gan``, what the paper's tables compare them
    with.
    """
    method, variants = ablations()[suite]
    names = _split(chosen.get("variants"))
    unknown = [name for name in names if name not in variants]
    if unknown:
        raise ConfigError(f"variants of {list(variants)}", ", ".join(unknown), "check --variants")
    wanted = {name: variants[name] for name in names or variants}
    references = [ReferenceJob(task, engine) for task in tasks] if suite == "gan" else []
    return [*references, *fit_jobs(suite, variant_table(table[method], wanted), tasks, budgets, seeds,
                                   engine)]


def _paper_jobs(suite: str, chosen: dict, picked: dict, source: str, data: Path | None, engine: Renderer,
                tasks: list, budget: float, seeds: list[int]) -> list[Job]:
    """What the paper's tables need besides fits at equal time: its schedule, seconds of an iteration, sheets
    of pictures.
    """
    if suite == "steps":
        return [StepJob(GanConfig(preset=preset), chosen["resolution"], engine, chosen["repeats"])
                for preset in ("paper-two-stage", "minutes")]
    if suite == "sheets":
        shown = picked or {name: method_table()[name] for name in ("gan", "hierarchical")}
        folder = Path(chosen["folder"])
        return [SheetJob(shown, task, budget, seeds[0], engine, folder) for task in tasks
                if task.kind == "material"]
    if suite != "schedule":
        return []
    side, width, iterations = chosen["schedule"]
    runs = picked or {"gan-two-stage": GanConfig(preset="paper-two-stage")}
    wrong = [name for name, config in runs.items() if not isinstance(config, GanConfig)]
    if wrong:
        raise ConfigError("gan, gan-one-stage or gan-two-stage in the suite schedule", ", ".join(wrong),
                          "check --methods")
    endless = [name for name, config in runs.items() if iterations is None and not config.of_paper]
    if endless:
        raise ConfigError("--iterations for a method without a schedule of its own", ", ".join(endless),
                          "give --iterations")
    sized = {name: replace(config, width=width, iterations=iterations) for name, config in runs.items()}
    for config in sized.values():
        config.check()
    return [ScheduleJob(name, config, task, seed, engine)
            for task in _tasks(chosen | {"resolution": side}, source, data, engine)
            for seed in seeds for name, config in sized.items()]


def _tasks(chosen: dict, source: str, data: Path | None, engine: Renderer) -> list:
    materials, captures = _sources(chosen, data)
    lit = named_views(source, "inverse-square")[1]
    tasks: list = [known_material(name, chosen["resolution"], lit, engine) for name in materials]
    for numbers, only in protocols(chosen["left-out"], data):
        tasks += [real_capture(Path(name), chosen["resolution"], numbers) for name in captures
                  if only is None or Path(name).name in only]
    return tasks


def protocols(text: str, data: Path | None) -> list[tuple[list[int], list[str] | None]]:
    """Numbers of photos to leave out, each with the names of the captures that it is for; None is for all.

    Args:
        text: numbers separated by commas, one protocol behind the other separated by slashes; ``peers`` is
            the one of published predictions, of the captures that have them.
        data: folder of real captures, with ``peers.json``.

    Raises:
        ConfigError: no such numbers, or nothing published.
    """
    found: list[tuple[list[int], list[str] | None]] = []
    for part in text.split("/"):
        if part.strip() == "peers":
            found.append((list(PEERS_LEFT_OUT), predicted_by_peers((data or Path()) / "peers.json")))
        else:
            found.append((sorted(_numbers("--left-out", part, int, lambda x: x >= 0)), None))
    twice = len({tuple(numbers) for numbers, _ in found}) < len(found)
    if twice:
        raise ConfigError("each way to leave photos out once in --left-out", repr(text), "take one away")
    return found


def _sources(chosen: dict, data: Path | None) -> tuple[list[str], list[str]]:
    """The known materials, builtin:NAME or folders, and the folders of real captures, each once."""
    everything = [*(f"builtin:{name}" for name in MATERIALS), *map(str, _inside(data, "materials"))]
    names = _folders(chosen.get("materials"), everything, data, "materials")
    names = [f"builtin:{name}" if name in MATERIALS and not Path(name).is_dir() else name for name in names]
    shots = _folders(chosen.get("captures"), list(map(str, _inside(data, "captures"))), data, "captures")
    if not names and not shots:
        raise ConfigError("a material or capture to fit", "none", "give --materials or --captures, or "
                                                                  "--suite renderers")
    missing = [name for name in (*names, *shots) if not name.startswith("builtin:")
               and not Path(name).exists()]
    if missing:
        raise ConfigError("materials and captures that are there", f"none called {missing[0]}",
                          "name folders, or those in --data; leave the option out for all")
    for found in (names, shots):
        labels = [Path(name.removeprefix("builtin:")).name for name in found]
        twice = [label for label in labels if labels.count(label) > 1]
        if twice:
            raise ConfigError("each material and capture once, by a name of its own", f"{twice[0]} twice",
                              "rename a folder")
    return names, shots


def data_folder(folder: Path | None) -> Path | None:
    """The folder of real captures and known materials, if there is one."""
    named = folder or (Path(os.environ["MITSVBRDF_DATA"]) if os.environ.get("MITSVBRDF_DATA") else None)
    if named is not None and not ((named / "captures").is_dir() or (named / "materials").is_dir()):
        raise ConfigError("a folder with captures/ or materials/", str(named),
                          "check --data and MITSVBRDF_DATA")
    return named


def _inside(data: Path | None, what: str) -> list[Path]:
    folder = data / what if data else None
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder and folder.is_dir() else []


def _folders(asked: str | None, everything: list[str], data: Path | None, what: str) -> list[str]:
    """Names on the command line as builtin:NAME or folders; a bare name may be one in the data."""
    if asked is None:
        return everything
    there = {p.name: str(p) for p in _inside(data, what)}
    return [name if name.startswith("builtin:") else there.get(name, name) for name in _split(asked)
            if name != "none"]


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
