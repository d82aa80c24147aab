"""``mitsvbrdf bench``: error against run time, of renderers and of methods."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from tyro.conf import arg

from ..io import files
from ..io.progress import say_written
from ..render import RendererName
from .measuring import measure
from .options import Overwrite, Variant, check_new_files

if TYPE_CHECKING:
    pass

T = TypeVar("T")
Names = Annotated[str | None, arg(metavar="NAME,...")]
Suite = Literal["all", "renderers", "methods", "start", "ablation", "capture", "gan", "schedule", "steps",
                "sheets", "none"]
USUAL_SUITES = "renderers", "methods"  # the others are asked for by name: they take longer than both


def bench(
    suite: Annotated[Suite, arg(help="What to measure; all: renderers and methods; none: only make the page "
                                     "anew.")] = "all",
    json_file: Annotated[Path, arg(name="json", help="The file of all records; one that is there is gone on "
                                                     "with.")]
        = Path("out/bench.json"),
    page: Annotated[Path | None,
                    arg(help="Write a Markdown page to this file, its pictures beside it.")] = None,
    gan_page: Annotated[Path | None,
                        arg(help="Write the paper's tables, reproduced, to this Markdown file.")] = None,
    readme: Annotated[Path | None, arg(help="Put short tables between the markers of this README.")] = None,
    materials: Annotated[Names, arg(help="Known materials: builtin:NAME, folders, or names in the data; "
                                         "none: without. Left "
                                         "out: all made ones and all in the data.")] = None,
    captures: Annotated[Names, arg(help="Real captures: folders or names in the data; none: without. Left "
                                        "out: all.")] = None,
    methods: Annotated[Names, arg(help="Methods; left out: all.")] = None,
    variants: Annotated[Names, arg(help="Of the suites ablation and gan, beside the whole method; left out: "
                                        "all.")] = None,
    budgets: Annotated[str | None,
                       arg(metavar="SECONDS,...", help="Of the fits; left out: 10,30,100,300.")] = None,
    seeds: Annotated[str | None, arg(metavar="NUMBER,...", help="Of the fits; left out: 0,1,2.")] = None,
    resolution: Annotated[int | None, arg(help="Side of maps and photos in the fits; left out: 256.")] = None,
    views: Annotated[str | None, arg(help="Whose views the photos of known materials have: a capture or "
                                          "builtin:grid; left "
                                          "out: cards-blue of the data, else builtin:grid.")] = None,
    left_out: Annotated[str | None, arg(metavar="NUMBER,...", help="Photos of real captures that no fit "
                                                                   "sees; left out: 4,7. "
                                                                   "4,7/peers also does what peers.json has.")] = None,
    data: Annotated[Path | None, arg(help="Folder with captures/, materials/, peers.json; left out: "
                                          "MITSVBRDF_DATA.")] = None,
    repeats: Annotated[int | None, arg(help="Timed turns of renderers and starts; left out: 5.")] = None,
    megapixels: Annotated[float | None, arg(help="Of the simulated phone's photos; left out: 3.")] = None,
    schedule_size: Annotated[int, arg(help="Side of maps and photos in the suite schedule.")] = 64,
    schedule_width: Annotated[int, arg(help="Channels of the first convolutions there.")] = 16,
    iterations: Annotated[int | None,
                          arg(help="Of the suite schedule; left out: all of the paper's.")] = None,
    quick: Annotated[bool, arg(help="A few minutes for everything: one made material, 64 px, 2 and 5 s, one "
                                    "seed.")] = False,
    renderer: Annotated[RendererName, arg(help="What the fits render with.")] = "mitsuba",
    variant: Variant = "llvm_ad_rgb",
    workers: Annotated[int | None, arg(help="Do so many jobs at a time, on the workers of `mitsvbrdf "
                                            "batch`, which survive "
                                            "crashes; their times are then those of a shared machine. Needs "
                                            "Ray.")] = None,
    address: Annotated[str | None,
                       arg(help="The same on a Ray cluster; see `mitsvbrdf batch --help`.")] = None,
    anew: Annotated[bool, arg(help="Forget the records that are there.")] = False,
    overwrite: Annotated[Overwrite,
                         arg(help="Replace pages and pictures that are there; records stay.")] = False,
) -> int:
    """Measure error against run time: renderers against float64, methods against known maps and photos left
    out.

    The suite capture goes from raw photos of a simulated phone to maps, and takes real captures' views away;
    its fits have the longest budget and the first seed.

    Each record is kept as soon as it is there: Ctrl-C loses one fit at most, and the same command goes on.
    Nothing else should run meanwhile. docs/evaluation.md says what is measured and how.
    """
    from ..bench.jobs import new_pictures
    from ..bench.page import page_files
    from ..bench.paper.page import gan_page_files
    from ..bench.plan import QUICK, WHOLE, Plan, data_folder
    from ..bench.readme import around_results
    from ..bench.store import Store, read_benchmark

    asked = {"resolution": resolution, "budgets": budgets, "seeds": seeds, "repeats": repeats,
             "materials": materials,
             "captures": captures, "megapixels": megapixels, "variants": variants, "left-out": left_out}
    chosen = (WHOLE | (QUICK if quick else {})
              | {name: value for name, value in asked.items() if value is not None})
    pages = [*page_files(page), *gan_page_files(gan_page)]
    check_new_files(*pages, overwrite=overwrite, read=[json_file])
    files.check_output(json_file)
    if readme:
        around_results(readme)
    if suite == "none":
        _show(dict(read_benchmark(json_file)), page, gan_page, readme)
        return 0
    suites = USUAL_SUITES if suite == "all" else (suite,)
    chosen |= {"schedule": (schedule_size, schedule_width, iterations), "folder": str(json_file.parent)}
    inside = data_folder(data)
    plan = Plan(suites, chosen, methods, views, str(inside) if inside else None, renderer, variant, quick)
    jobs, settings, found = plan.jobs()
    store = Store(json_file, settings, anew)
    store.publish(found)
    check_new_files(*pages, *new_pictures(store.pending(jobs), store), overwrite=overwrite, read=[json_file])
    failed = measure(plan, jobs, store, workers, address, less=", less where fits end by themselves")
    if failed is None:
        return 130
    _show(dict(store.content), page, gan_page, readme)
    return int(bool(failed))


def _show(record: dict, page: Path | None, gan_page: Path | None, readme: Path | None) -> None:
    """The tables on the terminal and, where they were asked for, the pages."""
    from ..bench.page import print_benchmark, write_benchmark_page
    from ..bench.paper.page import print_gan, write_gan_page
    from ..bench.readme import write_readme

    print_benchmark(record)
    if gan_page or any(r["suite"] in ("gan", "steps") for r in record["records"]):
        print_gan(record)
    if page:
        say_written(*write_benchmark_page(page, record))
    if gan_page:
        say_written(*write_gan_page(gan_page, record))
    if readme:
        say_written(write_readme(readme, record))
