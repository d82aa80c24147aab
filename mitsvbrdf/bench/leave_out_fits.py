"""What each part of a fit saves and costs where it is left out, on scenes that need it and on scenes that do not.

Every scene is fitted as the program decides, and once for each part with it taken away; a part that the program leaves out by
itself is put in instead. All fits of a scene take turns, so that a ratio of seconds is fair where seconds are not.
"""

from __future__ import annotations

import contextlib
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from ..capture import Capture
from ..errors import ConfigError
from ..fit import FitConfig, GanConfig, HierarchicalConfig, HybridConfig
from ..fit.hierarchical import skipped
from ..fit.hierarchical.moved_views import REFINED
from ..fit.hierarchical.stages import ROUNDS, Stage
from ..material.made import make_material
from ..material.maps import SVBRDF
from ..render import make_renderer
from ..synth import photograph
from ..system.entry import entry
from ..system.profile import profiling
from ..system.timing import in_turns, spread
from ..views import nine_view_grid
from .methods import fit
from .plan import data_folder
from .tasks import KnownMaterial, Task, known_material, real_capture

EXACT, MATTE, NOISY, OFF, REAL = "exact", "exact, matte", "exact, noisy", "cameras off", "real photos"
FOLLOWING, OTHERS = (EXACT, MATTE, NOISY), (OFF, REAL)  # what the model does and does not explain
TRAINED = EXACT, REAL  # on which networks are trained: they make no difference between kinds
SHOWN = {"mean": "maps", "novel_light": "new light", "left_out": "left out", "photos": "seen", "seen": "seen"}
UNSEEN = ("maps", "new light", "left out")  # what decides: photos seen are explained better by whatever burns in
FLOOR = 0.001  # of errors that are compared: a quarter of a step of 8 bits, below which none shows
METHOD = {HierarchicalConfig: "hierarchical", HybridConfig: "hybrid", GanConfig: "gan"}
UNLIMITED = 3600.0  # seconds: a fit ends by itself
SAVES, COSTS = 1.05, 1.02  # from which ratio on of seconds (median) and of errors (worst) a part counts as saved and as needed


@dataclass(frozen=True)
class Part:
    """A part of a fit.

    Args:
        what: its name; where ``fit`` may leave it out by itself, the name that ``fit.json`` gives it.
        config: settings of the fit that has it, or of the one without where the program leaves it out by itself.
        other: the settings that take it away, or put it in.
        put_in: whether ``other`` puts it in.
        kinds: of scenes.
        says: further names by which ``fit --explain`` says that it is left out.
        photos: what takes it away from the photos, instead of settings.
        rounds: a table of rounds by stage, and what changes in it to take the part away, instead of settings.
    """

    what: str
    config: FitConfig
    other: FitConfig
    put_in: bool = False
    kinds: Sequence[str] = (*FOLLOWING, *OTHERS)
    says: tuple[str, ...] = ()
    photos: Callable[[Capture], Capture] | None = None
    rounds: tuple[dict, Mapping] | None = None


class Scene(NamedTuple):
    """What is fitted, and of which kind it is."""

    kind: str
    task: Task


@dataclass
class Runs:
    """The fits of a scene with the same settings: seconds of each, and errors and seconds by part of the first."""

    seconds: list[float] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    spent: dict[str, float] = field(default_factory=dict)


def parts(steps: int = 150) -> list[Part]:
    """What is left out, in the order of the table.

    Args:
        steps: of the methods that train networks.
    """
    usual = HierarchicalConfig(budget=UNLIMITED)
    hybrid, gan = HybridConfig(iterations=steps), GanConfig(iterations=steps)
    first = partial(replace, usual)
    return [
        Part(skipped.TIED, usual, first(exact=False), True, FOLLOWING),
        Part(skipped.RIVALS, usual, first(exact=True), True, OTHERS),
        Part(skipped.RIVALS, usual, first(rivals=False), kinds=FOLLOWING),
        Part(skipped.VIEWS, usual, first(calibrate=True), True, FOLLOWING),
        Part(skipped.VIEWS, usual, first(calibrate=False), kinds=OTHERS),
        Part("flash offset", usual, first(flash_offset=False), kinds=OTHERS),
        Part(skipped.IN_TURN, usual, first(noise=0.03), kinds=OTHERS),
        Part("other starts of texels", usual, first(neighbours=False)),
        Part("look-alikes", usual, first(materials=1)),
        Part("freedom at full size", usual, first(own=0.0), kinds=OTHERS),
        Part("weights of pixels", usual, first(tails=0.0), kinds=OTHERS),
        Part("removal of burn-in", usual, first(independent=False), kinds=OTHERS),
        Part("view refinement at full size", usual, usual, kinds=OTHERS, rounds=(REFINED, {Stage.FINE: ()})),
        Part("view refinements but one", usual, usual, kinds=OTHERS, rounds=(REFINED, {Stage.TOGETHER: (3,), Stage.FINE: ()})),
        Part("second half of the rounds at full size", usual, usual, kinds=FOLLOWING, rounds=(ROUNDS, {Stage.FINE: 7})),
        Part("search for a specular lobe", usual, first(fix=("specular=0", "roughness=1")), kinds=(MATTE,)),
        Part("every other photo", usual, usual, photos=lambda shots: shots.pick(shots.index[::2])),
        Part("generator", usual, hybrid, True, TRAINED),
        Part("discriminator", hybrid, replace(hybrid, adversarial=0.0), kinds=TRAINED, says=("adversarial loss",)),
        Part("diffuse loss", hybrid, replace(hybrid, diffuse=0.0), kinds=TRAINED),
        Part("smoothness of specular and roughness", hybrid, replace(hybrid, smooth=0.0), kinds=TRAINED),
        Part("price on tilted normals", hybrid, replace(hybrid, flat=0.0), kinds=TRAINED),
        Part("photometric loss", hybrid, replace(hybrid, photometric=0.0), kinds=TRAINED),
        Part("feature matching", gan, replace(gan, features=0.0), kinds=TRAINED),
        Part("discriminator", gan, replace(gan, adversarial=0.0, features=0.0), kinds=TRAINED),
    ]


def scenes(resolution: int, captures: Sequence[Path] = (), materials: Sequence[str] = ("inlay", "tiles")) -> Iterator[Scene]:
    """Made photos of every kind, and real ones.

    Args:
        resolution: of the fits.
        captures: folders of real photos; 4 and 7 are left out and predicted.
        materials: made ones.
    """
    renderer, views = make_renderer("mitsuba"), nine_view_grid()
    for name in materials:
        yield Scene(EXACT, known_material(f"builtin:{name}", resolution, views, renderer))
    leather = make_material("leather", resolution)
    matte = SVBRDF(leather.bsdf, dict(leather.maps) | {"specular": torch.zeros_like(leather["specular"])})
    yield Scene(MATTE, KnownMaterial("matte leather", matte, None, photograph(matte, views, renderer)))
    plates = make_material("plates", resolution)
    yield Scene(NOISY, KnownMaterial("noisy plates", plates, None, photograph(plates, views, renderer, noise=0.003)))
    turns = torch.tensor([1.0, -1.0, 0.0] * 3, dtype=views.camera.dtype)[:, None]
    moved = replace(views, camera=views.camera * (1 + 0.03 * turns), light=views.light * (1 + 0.03 * turns),
                    intensity=views.intensity * (1 - 0.1 * turns))
    for name in materials:
        truth = make_material(name, resolution)
        shots = replace(photograph(truth, moved, renderer), views=views)
        yield Scene(OFF, KnownMaterial(f"{name}, cameras off", truth, None, shots))
    for folder in captures:
        yield Scene(REAL, real_capture(folder, resolution))


def capture_folders(names: str | None, data: Path | None) -> list[Path]:
    """Folders of real captures.

    Args:
        names: separated by commas; None for all.
        data: the folder with ``captures/``; None for the one that MITSVBRDF_DATA names, if any.

    Raises:
        ConfigError: one is not there.
    """
    root = data_folder(data)
    inside = {path.name: path for path in sorted((root / "captures").glob("*")) if path.is_dir()} if root else {}
    asked = inside if names is None else [name.strip() for name in names.split(",") if name.strip()]
    missing = [name for name in asked if name not in inside]
    if missing:
        raise ConfigError("captures that are there", f"none called {missing[0]}", "check --captures, --data and MITSVBRDF_DATA")
    return [inside[name] for name in asked]


@entry(gradients=True)
def measure_fits(listed: Sequence[Part], chosen: Sequence[Scene], repeats: int = 3,
                 report: Callable[[str], None] = lambda what: None) -> dict:
    """Measure every part on every scene of its kinds.

    Args:
        listed: parts to leave out.
        chosen: scenes to fit.
        repeats: turns.
        report: told the name of each scene before it is fitted.

    Returns:
        ``scenes``: of each ``name``, ``kind``, ``photos``, ``seconds`` (:func:`~mitsvbrdf.system.timing.spread`) of the default
        fit, and ``spent``, its seconds by part. ``items``: of each part and kind of scenes ``what``, ``says``, ``kind``,
        ``method``, ``put_in``, ``ratio`` (median, low and high, over scenes and turns, of the seconds with it over those
        without), ``errors`` (by name ``median`` and ``worst`` of the errors without it over those with it), ``verdict`` and the
        ``scenes`` behind it. And ``resolution``, ``steps`` of
        networks, ``repeats`` and the rule: ``saves`` and ``costs``, shares, and ``floor``.
    """
    about, rows = [], dict[tuple[int, str], list[dict]]()
    for scene in chosen:
        report(scene.task.name)
        here = [(number, part) for number, part in enumerate(listed) if scene.kind in part.kinds]
        found = _fits(scene, [part for _, part in here], repeats)
        usual = found[_key(HierarchicalConfig(budget=UNLIMITED), None)]
        about.append({"name": scene.task.name, "kind": scene.kind, "photos": len(scene.task.photos),
                      "seconds": spread(usual.seconds), "spent": usual.spent})
        for number, part in here:
            pair = found[_key(part.config, None)], found[_key(part.other, part)]
            full, lean = reversed(pair) if part.put_in else pair
            rows.setdefault((number, scene.kind), []).append(_compared(scene.task.name, full, lean))
    items = [_item(listed[number], kind, of) for (number, kind), of in sorted(rows.items(), key=lambda row: row[0][0])]
    steps = max(part.other.iterations or 0 for part in listed)
    return {"resolution": chosen[0].task.photos.resolution, "steps": steps, "repeats": repeats, "saves": 1 - 1 / SAVES,
            "costs": COSTS - 1, "floor": FLOOR, "scenes": about, "items": items}


def _key(config: FitConfig, part: Part | None) -> str:
    return f"{config} {part.what if part and part.config is part.other else ''}"


def _fits(scene: Scene, listed: Sequence[Part], repeats: int) -> dict[str, Runs]:
    """Every fit that these parts ask for, each once a turn, after a step of each that warms up."""
    usual = HierarchicalConfig(budget=UNLIMITED)
    wanted: dict[str, tuple[FitConfig, Capture, Part | None]] = {_key(usual, None): (usual, scene.task.photos, None)}
    for part in listed:
        wanted[_key(part.config, None)] = part.config, scene.task.photos, None
        wanted[_key(part.other, part)] = part.other, part.photos(scene.task.photos) if part.photos else scene.task.photos, part
    found = {key: Runs() for key in wanted}
    renderer = make_renderer("mitsuba")

    def run(key: str) -> None:
        config, photos, part = wanted[key]
        with profiling() as profile, changed(*part.rounds) if part and part.rounds else contextlib.nullcontext():
            fitted = fit(photos, renderer, config)
        runs = found[key]
        runs.seconds.append(fitted.wall)
        if not runs.errors:
            errors = scene.task.errors(fitted)
            runs.errors = {SHOWN[name]: max(error, FLOOR) for name, error in errors.items() if name in SHOWN}
            runs.spent = profile.totals()

    for config, photos, _ in wanted.values():
        fit(photos, renderer, replace(config, budget=None, iterations=1))
    in_turns({key: partial(run, key) for key in wanted}, repeats, unmeasured=0)
    return found


@contextlib.contextmanager
def changed(table: dict, changes: Mapping) -> Iterator[None]:
    """A table with other entries for a while."""
    before = dict(table)
    table.update(changes)
    try:
        yield
    finally:
        table.update(before)


def _compared(name: str, full: Runs, lean: Runs) -> dict:
    """The figures of a scene: ratios of seconds, turn by turn, and errors of both."""
    return {"name": name, "ratios": [a / b for a, b in zip(full.seconds, lean.seconds)],
            "full": full.errors, "lean": lean.errors}


def _item(part: Part, kind: str, of: Sequence[Mapping]) -> dict:
    """A row of the table: what leaving a part out saves and costs on scenes of a kind."""
    errors = {}
    for name in of[0]["full"]:
        if (kind, name) != (MATTE, "maps"):  # the roughness of a lobe that is black shows nowhere
            ratios = [one["lean"][name] / one["full"][name] for one in of]
            errors[name] = {"median": statistics.median(ratios), "worst": max(ratios)}
    ratio = spread([value for one in of for value in one["ratios"]])
    return {"what": part.what, "says": [part.what, *part.says], "kind": kind, "method": METHOD[type(part.config)],
            "put_in": part.put_in, "ratio": ratio, "errors": errors, "verdict": verdict(ratio["median"], errors),
            "scenes": list(of)}


def verdict(ratio: float, errors: Mapping[str, Mapping[str, float]]) -> str:
    """``needed`` where leaving it out costs errors; else ``not needed``, or ``no time saved`` where it saves less than 5 %."""
    worst = max((errors[name]["worst"] for name in UNSEEN if name in errors), default=1.0)
    if worst > COSTS:
        return "needed"
    return "not needed" if ratio >= SAVES else "no time saved"
