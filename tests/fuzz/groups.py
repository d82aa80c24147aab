"""What is drawn: for each group of cases a strategy, and how many of them a run of the tests takes."""

import itertools
import json
from collections.abc import Callable

from fuzz.case import Case
from fuzz.words import DIRECT, FIT, LINES, NAMES, RELIT, SIZES, TEXTS, TOKENS, WORDS, XML
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

Drawn = st.SearchStrategy

whole, places = st.integers(0, 60), st.one_of(st.integers(-64, 64), st.integers(0, 10**6))
steps = st.lists(whole, max_size=6)
names, lines = st.sampled_from(NAMES), st.sampled_from(LINES)
tokens = st.one_of(st.sampled_from(TOKENS), st.floats().map(json.dumps), st.integers().map(str),
                   st.text(max_size=9).map(json.dumps))
EXPLAINED = "fit ../in/{} -o out --explain " + FIT


def change(do: str, **options: object) -> Drawn[dict]:
    """Changes of a kind; options that are no strategies are the same in all."""
    drawn = {name: value if isinstance(value, st.SearchStrategy) else st.just(value)
             for name, value in options.items()}
    return st.fixed_dictionaries({"do": st.just(do)} | drawn)


def spoiled(under: str) -> Drawn[dict]:
    """A file with other bytes."""
    return st.one_of(change("flip", under=under, nth=whole, at=places, bit=st.integers(0, 7)),
                     change("cut", under=under, nth=whole, at=places))


def stated(path: str) -> Drawn[dict]:
    """A JSON file that says something else, or is none."""
    other = change("state", path=path, steps=steps, raw=tokens)
    return st.one_of(other, other, change("state", path=path, steps=steps, raw=None), spoiled(path),
                     change("state", path=path, steps=steps, raw="[", again=st.sampled_from((300, 100_000))),
                     change("put", path=path, text=st.sampled_from(TEXTS)), change("put", path=path,
                     text="{}", code="utf-16"), change("put", path=path, text="[", again=100_000))


def replaced(*paths: str) -> Drawn[dict]:
    """Something else in the place of a file or folder."""
    path, to = st.sampled_from(paths), st.sampled_from(("outside", "outside/secret.txt", "outside/folder"))
    return st.one_of(change("link", path=path, to=to), change("pipe", path=path), change("folder", path=path),
                     change("absent", path=path))


def pictures(under: str, path: str, *sources: str) -> Drawn[dict]:
    """Image files that are damaged, of another kind, or of a size that they are not."""
    sizes = [change("sized", under=under, nth=whole, width=width, height=height) for width, height in SIZES]
    texts = st.sampled_from(("", "no picture", "\x89PNG\r\n", "\udcff\udcd8\udcff"))
    return st.one_of(spoiled(under), spoiled(under), st.one_of(sizes), change("put", path=path, text=texts),
                     replaced(path), change("copy", source=st.sampled_from(sources), nth=whole, path=path))


def cases(group: str, parts: str, changes: Drawn[dict], *calls: str, out: str = "work/out",
          most: int = 3) -> Drawn[Case]:
    """Cases of a group: one to ``most`` changes, and one of the calls."""
    return st.builds(Case, group=st.just(group), parts=st.just(tuple(parts.split())), out=st.just(out),
                     changes=st.lists(changes, min_size=1, max_size=most).map(tuple),
                     arguments=st.sampled_from([tuple(call.split()) for call in calls]))


def captures() -> Drawn[Case]:
    """``capture.json``."""
    path = "in/capture/capture.json"
    return cases("capture", "capture jpeg maps", st.one_of(stated(path), stated(path),
                                                           replaced(path, "in/capture/target")),
                 *["guess ../in/capture -o out --resolution 16"] * 3, "guess ../in/capture/capture.json -o "
                                                                      "out",
                 EXPLAINED.format("capture"), "fit ../in/capture -o out " + DIRECT,
                 "evaluate ../in/maps --capture ../in/capture --renderer analytic",
                 "synth ../in/maps -o out --views ../in/capture --renderer analytic --resolution 16")


def texts() -> Drawn[Case]:
    """A calibration in text files."""
    paths = [f"in/text/{name}.txt" for name in ("camera_pos", "light_pos", "light_power", "image_size")]
    path = st.sampled_from(paths)
    ways = st.one_of(change("line", path=path, nth=whole, text=lines), path.flatmap(spoiled),
                     replaced(*paths), change("put", path=path, text=lines, again=st.sampled_from((1, 100))))
    return cases("text", "text", ways, "guess ../in/text -o out --resolution 16", EXPLAINED.format("text"))


def photos() -> Drawn[Case]:
    """Photos in three kinds of folders."""
    sources = "in/jpeg/target", "in/plain", "in/exr", "in/capture"
    ways = [pictures(f"in/{path.rpartition('/')[0]}", f"in/{path}", *sources)
            for path in ("capture/target/03.png", "jpeg/target/03.jpg", "plain/IMG_0.jpg")]
    return cases("photos", "capture jpeg plain exr", st.one_of(ways), "capture ../in/plain -o out",
                 EXPLAINED.format("jpeg"),
                 *(f"guess ../in/{name} -o out --resolution 16" for name in ("capture", "jpeg", "plain")))


def maps() -> Drawn[Case]:
    """Folders of maps, and maps held fixed."""
    ways = st.one_of(pictures("in/exr", "in/exr/roughness.exr", "in/maps", "in/capture"), pictures("in/maps",
                     "in/maps/normal.png", "in/exr", "in/capture"), stated("in/maps/material.json"))
    return cases("maps", "maps exr capture", ways, "evaluate ../in/exr --reference ../in/maps",
                 "evaluate ../in/maps --reference ../in/exr", "render ../in/exr -o out --renderer analytic",
                 "render ../in/maps -o out --renderer analytic", "export ../in/maps -o out --to maps "
                                                                 "--no-preview",
                 EXPLAINED.format("capture") + " --fix roughness=../in/exr/roughness.exr",
                 EXPLAINED.format("capture") + " --fix normal=../in/maps/normal.png")


def documents() -> Drawn[Case]:
    """Materials in one document: glTF's, MaterialX's."""
    gltf, mtlx = "in/documents/gltf/m.gltf", "in/documents/materialx/material.mtlx"
    ways = st.one_of(stated(gltf), spoiled("in/documents/gltf"), spoiled(mtlx),
                     change("line", path=mtlx, nth=whole, text=st.sampled_from(XML)),
                     replaced(gltf, mtlx, "in/documents/materialx/textures"),
                     change("put", path=mtlx, text="<a>", again=100_000))
    return cases("document", "documents", ways, *(
        f"render ../in/documents/{path} -o out --renderer analytic" for path in (
            "gltf/m.gltf", "gltf/material.glb", "materialx", "materialx/material.mtlx")))


def checkpoints() -> Drawn[Case]:
    """What a fit goes on from."""
    def of(fit: str, again: str) -> Drawn[Case]:
        path = f"in/{fit}/checkpoint.safetensors"
        noted = change("note", path=path, steps=steps, raw=st.one_of(tokens, st.none()), inside=st.booleans())
        return cases("checkpoint", f"capture {fit}", st.one_of(spoiled(path), spoiled(path), noted,
                                                               replaced(path)),
                     f"fit ../in/capture -o ../in/{fit} --resume {again} --iterations 3", out=f"in/{fit}",
                     most=2)

    return st.one_of(of("fit", FIT), of("direct", DIRECT))


def fits() -> Drawn[Case]:
    """``fit.json`` and what lies beside it."""
    paths = "in/fit/fit.json", "in/fit/report.json", "in/fit/maps/material.json"
    ways = st.one_of(*map(stated, paths[:1] * 4 + paths[1:]), replaced(*paths, "in/fit/maps", "in/fit/photos",
                                                                       "in/fit/guess"))
    reading = cases("fit", "fit capture", ways, "evaluate ../in/fit --capture ../in/capture --renderer "
                                                "analytic", "render ../in/fit -o out --renderer analytic",
                    "export ../in/fit -o out --to maps --no-preview",
                    "compare ../in/fit --capture ../in/capture -o out --renderer analytic --resolution 16",
                    most=2)
    return st.one_of(reading, reading, cases("fit", "fit capture", ways, "report ../in/fit --quick",
                                             "report ../in/fit --quick --capture ../in/capture", out="in/fit",
                                             most=2))


def folders() -> Drawn[Case]:
    """What lies where a result is to be written: links, pipes, manifests that name files of others."""
    def of(out: str, parts: str, files: str, *calls: str) -> Drawn[Case]:
        hidden = (".partial .partial/.lock .partial/.mitsvbrdf .partial/.earlier .mitsvbrdf "
                  ".partial/checkpoint.safetensors to ")
        places = replaced(*(f"{out}/{name}" for name in (hidden + files).split()))
        listed = st.lists(names, max_size=5).map(json.dumps)
        manifest = change("put", path=f"{out}/.mitsvbrdf", text=listed)
        ways = st.one_of(places, places, manifest, manifest, stated(f"{out}/.mitsvbrdf"),
                         change("put", path=f"{out}/.partial/.mitsvbrdf", text=listed),
                         change("copy", source=out, nth=whole, path=f"{out}/.partial/checkpoint.safetensors"))
        return cases("folder", parts, ways, *calls, out=out, most=4)

    made = of("in/guessed", "capture guessed", "diffuse.exr diffuse.png",
              "guess ../in/capture -o ../in/guessed --resolution 16 --overwrite",
              "guess ../in/capture -o ../in/guessed --resolution 16")
    fresh = of("work/out", "capture maps", "00.png 00.exr", "render ../in/maps -o out --renderer analytic "
               "--overwrite", "guess ../in/capture -o out --resolution 16")
    written = "fit.json report.html report.json photos photos/00.png maps maps/diffuse.exr sheet.png"
    fitted = of("in/fit", "capture fit", written, f"fit ../in/capture -o ../in/fit --overwrite {FIT}",
                "report ../in/fit --quick", "report ../in/fit --quick --capture ../in/capture")
    return st.one_of(made, made, fresh, fitted)


def relights() -> Drawn[Case]:
    """What `relight` goes on from, and the light of its scenes."""
    path = "in/relit/relight.json"
    ways = st.one_of(stated(path), stated(path), replaced(path, *(
        f"in/relit/{name}" for name in ("sphere.exr", ".partial", ".mitsvbrdf"))), change(
            "state", path=path, steps=st.just([2, 0, 1, 0, 1]), raw=names.map(json.dumps)))
    light = st.sampled_from(("in/exr/diffuse.exr", "in/exr/light.hdr"))
    lit = f"relight ../in/fit -o out --explain {RELIT} --environment ../"
    return st.one_of(cases("relight", "fit relit", ways, f"relight ../in/fit -o ../in/relit --resume {RELIT}",
              out="in/relit", most=2),
        light.flatmap(lambda path: cases("relight", "fit exr maps", pictures(path, path, "in/maps", "in/exr"),
                                         lit + path, most=2)))


def libraries() -> Drawn[Case]:
    """The records of a library's results, and what it writes beside them."""
    index = "in/library/library.json"
    ways = st.one_of(spoiled("in/library"), stated(index), stated("in/library/wood-*/batch.json"),
                     stated("in/library/stone-*/batch.json"), replaced(index, "in/library/.lock",
                                                                       "in/library/.token"))
    quick = [f"library ../in/library{words}" for words in ("", " --json", " --search wood", " --verify")]
    looking = cases("library", "library", ways, *quick, *quick, "library ../in/library --state replaced")
    return st.one_of(looking, looking, cases("library", "library capture", ways,
                                             f"batch ../in/capture -o ../in/library {FIT}", out="in/library"))


def lists() -> Drawn[Case]:
    """Lists of captures for `batch`."""
    path = "in/list/list.txt"
    ways = st.one_of(change("line", path=path, nth=whole, text=lines), spoiled(path), replaced(path),
                     change("line", path=path, nth=whole, text=st.text(max_size=30)),
                     change("put", path=path, text=lines, again=st.sampled_from((1, 100))),
                     change("put", path=path, text="../capture", code="utf-16"),
                     stated("in/capture/capture.json"),
                     replaced("in/jpeg/target", "in/capture", "in/text/camera_pos.txt"))
    return cases("list", "list capture jpeg text", ways, f"batch ../in/list/list.txt -o out {FIT}",
                 "batch ../in/list/list.txt -o out --workers 1")


def records() -> Drawn[Case]:
    """Records of a benchmark."""
    path = "in/bench/bench.json"
    call = f"bench --json ../{path} {BENCH}"
    return cases("bench", "bench", st.one_of(stated(path), stated(path), replaced(path)), call,
                 call + " --page page.md", out="work")


BENCH = ("--materials inlay --captures none --methods direct --budgets 0.1 --seeds 0 --resolution 16 "
         "--renderer analytic")

# A call of each command that works and is quick, behind which options are put.
CALLS = tuple(call.strip() for call in f"""
    fit ../in/capture -o out {FIT}
    guess ../in/capture -o out --resolution 16
    capture ../in/plain -o out
    render ../in/maps -o out --renderer analytic
    evaluate ../in/maps --reference ../in/exr
    synth ../in/maps -o out --renderer analytic --resolution 16
    compare ../in/maps --capture ../in/capture -o out --renderer analytic
    export ../in/maps -o out --to maps --no-preview
    relight ../in/maps -o out --explain {RELIT}
    report ../in/fit --quick
    sheet -o out.svg
    library ../in/library
    batch ../in/capture -o out {FIT}
    bench --json ../in/bench/bench.json {BENCH}
    crosscheck ../in/maps --renderer analytic --resolution 8 --repeats 1
    pretrain ../in/capture -o out --resolution 16 --renderer analytic --iterations 1
    doctor
""".strip().splitlines())


def options(known: dict[str, tuple[str, ...]]) -> Drawn[Case]:
    """Options of every command, ``known`` from its ``--help``, with values that no one should give."""
    text = st.text(st.characters(exclude_characters="/~.\0", exclude_categories=["Cs"]), max_size=9)

    value = st.one_of(st.sampled_from(WORDS), st.sampled_from(WORDS), text)

    def of(call: str) -> Drawn[Case]:
        option = st.sampled_from(known[call.split()[0]])  # its OUT is the library
        pair = st.tuples(option, value)
        several = st.lists(st.one_of(pair, pair, st.tuples(option)), min_size=1, max_size=2)
        return st.builds(Case, group=st.just("option"), parts=st.just(tuple(parts.split())),
                         changes=st.just(()), lasting=st.just(True),
                         arguments=several.map(lambda each: (*call.split(), *itertools.chain(*each))),
                         out=st.just("in/fit" if call.startswith("report") else "work"))

    parts = "capture plain maps exr fit library bench"
    return st.sampled_from(CALLS).flatmap(of)


GROUPS: dict[str, tuple[int, Callable[..., Drawn[Case]]]] = {"capture": (500, captures), "text": (250, texts),
    "photos": (500, photos), "maps": (350, maps), "checkpoint": (250, checkpoints), "fit": (400, fits),
    "folder": (300, folders), "list": (200, lists), "library": (300, libraries), "document": (250, documents),
    "bench": (150, records), "relight": (120, relights), "option": (700, options)}


def drawn(strategy: Drawn[Case], count: int, number: int = 0) -> list[Case]:
    """The same cases for the same number, each once."""
    found: dict[str, Case] = {}

    @seed(number)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))
    @given(strategy)
    def collect(case: Case) -> None:
        found.setdefault(repr(case), case)

    collect()
    return list(found.values())
