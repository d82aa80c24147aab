"""Thousands of steps in one process: does memory grow, is anything compiled again, do steps get slower?

``python -m mitsvbrdf.verify.soak`` (``./run soak``) renders small moving views with every renderer, BSDF and
kind of work, prints a table and keeps the record as JSON. A fit of an hour depends on what no short test
shows.
"""

from __future__ import annotations

import gc
import itertools
import os
import re
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.table import Table

from ..errors import ConfigError
from ..io import entry as edge
from ..io import files
from ..io.progress import print_rich, say
from ..io.timing import timed
from ..io.tool import run_tool
from ..material.corner_cases import random_material
from ..material.maps import SVBRDF, Bsdf
from ..render import Renderer, RendererName, make_renderer
from ..views import Views

SLOPE_LIMIT = 0.5  # MiB of resident memory per 100 steps
WARM_UP = 0.2  # share of the steps during which pools and caches may still fill
SAMPLES_KEPT = 100  # memory samples kept in the record of a case


@edge.entry(gradients=True)
def soak(renderers: Sequence[Renderer], bsdf: Bsdf, work: str, steps: int, resolution: int = 64) -> dict:
    """Run many steps and measure what they leave behind.

    Renderers take turns, and each draws three views that move at every step, co-located and apart in turn
    (two kernels for ``roughconductor``).

    Args:
        renderers: one, or several that share the process.
        bsdf: the material's parameter set.
        work: a key of :data:`WORK`.
        steps: how many, over all renderers together; at least 20 and 8 for each renderer.
        resolution: side of the maps in texels.

    Returns:
        What ran, and ``memory`` (MiB), ``kernels`` (new ones after each was asked for twice), ``drjit``
        (growth after warm-up; None where it is not loaded), ``step`` (milliseconds of a mean step of a turn,
        medians over the first and the last tenth) and ``failures`` (limits missed).

    Raises:
        ConfigError: too few steps, or no ``/proc`` to read the memory from.
    """
    # kernels call every BSDF that lives: scenes of before, freed on the way, would have them made again
    gc.collect()
    turn = 2 * len(renderers)  # steps until every renderer has drawn both kinds of views
    if steps < max(20, 4 * turn):
        raise ConfigError(f"{max(20, 4 * turn)} steps or more", str(steps), "give --steps 2000")
    material, rng = random_material(bsdf, resolution), torch.Generator().manual_seed(0)
    warm = max(2 * turn, int(WARM_UP * steps))
    memory, seconds, kernels = [], [], [kernels_made()]
    for step in range(steps):
        if step == warm:
            before = drjit_state()
        renderer, views = renderers[step // 2 % len(renderers)], moving_views(rng, apart=step % 2 == 1)
        seconds.append(timed(WORK[work], renderer, material, views)[1])
        memory.append(resident())
        kernels.append(kernels_made())
    growth = {name: after - before.get(name, 0) for name, after in drjit_state().items()}
    turns = [statistics.mean(seconds[k:k + turn]) for k in range(warm, steps - turn + 1, turn)]
    first, last = (statistics.median(part) * 1e3 for part in ends(turns))
    late = [step for step in range(2 * turn, steps) if kernels[step + 1] > kernels[step]]
    record = {
        "renderers": [renderer.name for renderer in renderers], "bsdf": bsdf, "work": work, "steps": steps,
        "resolution": resolution, "warm_up": warm,
        "memory": {"slope": slope(memory[warm:]) * 100, "first": memory[0], "last": memory[-1],
                   "samples": [[step, memory[step]] for step in range(0, steps, -(-steps // SAMPLES_KEPT))]},
        "kernels": {"first": kernels[2 * turn] - kernels[0], "late": kernels[-1] - kernels[2 * turn],
                    "late_steps": late[:20]},
        "drjit": growth or None,
        "step": {"first": first, "last": last, "drift": last / first - 1},
    }
    return record | {"failures": failures(record)}


def failures(record: dict) -> list[str]:
    """Which limits a record misses, in words."""
    missed = []
    if not record["memory"]["slope"] <= SLOPE_LIMIT:
        missed.append(f"memory grows by {record['memory']['slope']:.2f} MiB per 100 steps, limit "
                      f"{SLOPE_LIMIT}")
    if record["kernels"]["late"]:
        missed.append(f"{record['kernels']['late']} kernels made after the second turn, at steps "
                      f"{', '.join(map(str, record['kernels']['late_steps']))}")
    return missed


def with_gradients(renderer: Renderer, material: SVBRDF, views: Views,
                   between: Callable[[], object] = lambda: None) -> None:
    """A step of a fit: forward, backward."""
    leaves = material.map(lambda t: t.clone().requires_grad_())
    image = renderer.render(leaves, views)
    between()
    torch.autograd.grad(image.square().mean(), list(leaves.maps.values()))


def without_gradients(renderer: Renderer, material: SVBRDF, views: Views) -> None:
    """A picture alone."""
    with torch.no_grad():
        renderer.render(material, views)


def with_preview(renderer: Renderer, material: SVBRDF, views: Views) -> None:
    """A step of a fit with a preview drawn between forward and backward."""
    with_gradients(renderer, material, views, lambda: without_gradients(renderer, material, views.pick([0])))


WORK: dict[str, Callable[[Renderer, SVBRDF, Views], None]] = {
    "gradients": with_gradients, "images": without_gradients, "preview": with_preview}


def moving_views(rng: torch.Generator, apart: bool) -> Views:
    """Three views at random places two patch sides above the patch; the light at the camera or apart from
    it.
    """
    camera = torch.rand(3, 3, generator=rng, dtype=torch.float64) - 0.5 + torch.tensor([0.0, 0.0, 2.0])
    views = Views.of(camera, intensity=10.0)
    return replace(views, light=camera + torch.tensor([0.5, -0.3, 0.1])) if apart else views


def resident() -> float:
    """Resident memory of this process in MiB."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except OSError:
        raise ConfigError("Linux, whose /proc tells a process its memory", sys.platform,
                          "soak there") from None


def kernels_made() -> int:
    """Kernels this process compiled or took from Dr.Jit's cache on disk so far; a kernel met again does not
    count.
    """
    drjit = sys.modules.get("drjit")
    return sum(drjit.detail.launch_stats()[1:]) if drjit else 0


def drjit_state() -> dict[str, float]:
    """Dr.Jit's own figures: MiB of its pools at their largest, and live variables; empty where it is not
    loaded.
    """
    drjit = sys.modules.get("drjit")
    if not drjit:
        return {}
    pools = sum(drjit.detail.malloc_watermark(backend) for backend in (drjit.JitBackend.LLVM,
                                                                       drjit.JitBackend.CUDA))
    return {"pools": pools / 2**20, "variables": len(re.findall(r"^ +\d+ +(?:LLVM|CUDA) ", drjit.whos(True),
                                                                re.M))}


def slope(values: Sequence[float]) -> float:
    """Growth per step of the least-squares line through values at steps 0, 1, 2, ..."""
    return statistics.linear_regression(range(len(values)), values).slope


def ends(values: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
    """The first and the last tenth."""
    tenth = max(1, len(values) // 10)
    return values[:tenth], values[-tenth:]


def show(records: Sequence[dict]) -> None:
    """The records as a table of growth after warm-up, limits missed below it."""
    table = Table(box=None, padding=(0, 1, 0, 0))
    table.add_column("case", no_wrap=True)
    for column in ("MiB/100", "MiB", "late", "pools", "ms", "drift"):
        table.add_column(column, justify="right", no_wrap=True)
    for record in records:
        memory, step, drjit = record["memory"], record["step"], record["drjit"]
        table.add_row(label(record), f"{memory['slope']:+.3f}", f"{memory['last']:.0f}",
                      str(record["kernels"]["late"]),
                      f"{drjit['pools']:+.2f}" if drjit else "–", f"{step['last']:.1f}",
                      f"{step['drift']:+.0%}", style="red" if record["failures"] else None)
    print_rich(table)
    for record in records:
        for text in record["failures"]:
            say(f"{label(record)}: {text}")
    say("MiB/100: growth of resident memory per 100 steps; MiB: at the end; late: kernels made after each "
        "was asked for\n"
        "twice; pools: growth of Dr.Jit's memory, MiB; ms: median step of the last tenth; drift: against "
        "the first tenth")


def label(record: dict) -> str:
    """What a record is about, in one line."""
    names = record["renderers"]
    return f"{names[0] if len(names) == 1 else 'all in turn'}, {record['bsdf']}, {record['work']}"


def main(steps: Annotated[int, tyro.conf.arg(help="Steps of each case; below some 500, warm-up counts as "
                                                  "growth.")] = 2000,
         renderer: Annotated[tuple[RendererName, ...], tyro.conf.arg(
             help="Each alone, then all in turn.")] = ("mitsuba", "mitsuba-scene", "analytic"),
         bsdf: tuple[Bsdf, ...] = ("roughconductor", "principled"),
         json: Annotated[Path, tyro.conf.arg(help="Where the record goes.")] = Path("out/soak.json")) -> int:
    """Render thousands of moving views; exit code 1 where memory grows or a kernel is made late."""
    files.check_output(json)
    groups = [(name,) for name in renderer] + ([renderer] if len(renderer) > 1 else [])
    records = []
    for names, material, work in itertools.product(groups, bsdf, WORK):
        records.append(soak([make_renderer(name) for name in names], material, work, steps))
        say(f"{label(records[-1])}: {records[-1]['memory']['slope']:+.3f} MiB per 100 steps")
        files.write_json(json, {"limits": {"slope": SLOPE_LIMIT, "late": 0}, "records": records})
    show(records)
    return int(any(record["failures"] for record in records))


def entry() -> int:
    """:func:`main` with the arguments of the process; returns the exit code."""
    return run_tool(main, "./run soak", "interrupted; the JSON file has each case that was finished")


if __name__ == "__main__":
    sys.exit(entry())
