"""The digits of code: all that shapes records changes them, one method's code its own alone, and words
none.
"""

import functools
import inspect
import shutil
from pathlib import Path
from typing import get_args

import pytest

from mitsvbrdf.bench import code, jobs
from mitsvbrdf.bench.code import (
    OWN,
    PACKAGE,
    SAID,
    SHARED,
    method_module,
    own_code,
    own_files,
    shared_code,
    syntax_of,
)
from mitsvbrdf.bench.leave_out import fits, plan, renders
from mitsvbrdf.bench.methods import method_table, settings_of
from mitsvbrdf.bench.stiff.fits import SHAPING, StiffFit
from mitsvbrdf.fit.methods import METHODS


def test_the_digits_of_the_code_change_with_what_it_does_and_not_with_its_words():
    source = '"""Words."""\nclass A:\n    """Words."""\n    width: int = 3\n    """More."""\n\ndef f(x):\n    return x + 1\n'
    other = '# a comment\nclass A:\n    width: int = (\n        3)\n\n\ndef f(x):\n    """Others."""\n    return x + 1  # so\n'
    assert syntax_of(source) == syntax_of(other)
    for one, another in (("= 3", "= 4"), ("x + 1", "x + 2"), ("return x", "return '' or x")):
        assert syntax_of(source.replace(one, another)) != syntax_of(source)


# What the modules of jobs import and what shapes no record: words, drawings, how files are read and written.
SHAPELESS = {"__init__.py", "bench/__init__.py", "errors.py", "io/__init__.py",
             *(f"pages/{name}.py" for name in ("canvas", "colours", "notebook", "page", "pictures")),
             *(f"system/{name}.py" for name in ("files", "interrupts", "journal", "json_files", "lock",
                                                "profile", "progress",
                                                "provenance", "result_folder", "shared_file")),
             *(f"bench/{name}.py" for name in ("code", "earlier", "published", "records", "store"))}
# What all records share and what imports code of one method or suite nevertheless: jobs in their union, the
# baseline as a method, what follows deadlines or a warning of `hierarchical`, and of its records alone.
REGISTRIES = {
    "bench/methods.py": {"bench/peers_baseline.py"},
    "bench/behaviour.py": {"bench/peers_baseline.py", "fit/hierarchical/stages.py"},
    "fit/warnings.py": {"fit/hierarchical/moved_views.py", "fit/hierarchical/skipped.py"}}


def named(paths):
    return {path.relative_to(PACKAGE).as_posix() for path in paths}


def there(patterns):
    return named(path for pattern in patterns for path in PACKAGE.glob(pattern))


def of_jobs():
    """The files that a kind of job has for itself."""
    return named(Path(inspect.getfile(kind)) for kind in get_args(jobs.Job)) - {"bench/jobs.py"}


@pytest.mark.parametrize("kinds, more", [(get_args(jobs.Job), ()), ((StiffFit,), SHAPING),
                                         ((fits.PairJob, renders.Case), plan.SHAPING)])
def test_all_code_that_shapes_records_changes_the_digits(kinds, more):
    todo = [Path(inspect.getfile(kind)) for kind in kinds] + [PACKAGE / "bench/start_child.py"]
    seen = set()
    while todo:
        path = todo.pop()
        todo += () if path in seen else code.imported(path)
        seen.add(path)
    assert all(there([pattern]) for pattern in (*SHARED, *OWN, *SAID, *more))  # each finds something
    assert named(seen) - there((*SHARED, *OWN, *more)) == SHAPELESS


def test_what_all_share_knows_no_code_of_one_method_but_by_name():
    own = there(OWN)
    assert {method_module(name).removeprefix("mitsvbrdf.").replace(".", "/") + ".py"
            for name in METHODS} | of_jobs() <= own
    shared = there(SHARED) - own - set(SAID)
    found = {name: own & named(code.imported(PACKAGE / name)) for name in shared}
    assert {name: files for name, files in found.items()
            if files} == REGISTRIES | {"bench/jobs.py": of_jobs()}


def test_methods_know_no_code_of_each_other_but_the_two_by_a_generator():
    of = {name: named(own_files([method_module(name)])) for name in METHODS}
    assert of["hierarchical"] == there(["fit/hierarchical/*.py"]) and of["direct"] == {"fit/direct.py"}
    assert of["gan"] | of["hybrid"] < there(["fit/generator/*.py"])  # `finish` belongs to neither
    assert of["gan"] - of["hybrid"] and of["hybrid"] - of["gan"] == {"fit/generator/hybrid.py"}


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(code, "syntax_of", functools.cache(syntax_of))  # of each file once
        yield shutil.copytree(PACKAGE, tmp_path_factory.mktemp("copy") / PACKAGE.name,
                              ignore=lambda folder, names: [n for n in names if "." in n
                                                            and not n.endswith(".py")])


def digits(package):
    """Of what all share, of each method and of a suite."""
    names = {name: method_module(name) for name in METHODS} | {
        name: f"mitsvbrdf.bench.{name}" for name in ("peers_baseline", "renderers", "paper.steps")}
    return {"shared": shared_code.__wrapped__(package=package)} | {
        name: own_code.__wrapped__(module, package=package) for name, module in names.items()}


@pytest.mark.parametrize("file, void", [
    ("fit/hierarchical/sharing.py", {"hierarchical"}), ("fit/generator/hybrid.py", {"hybrid"}),
    ("fit/direct.py", {"direct"}),
    ("fit/generator/networks.py", {"hybrid", "gan", "paper.steps"}),
    ("bench/peers_baseline.py", {"peers_baseline"}),
    ("bench/renderers.py", {"renderers"}), ("fit/loop.py", {"shared"}),
    ("capture/align/pairs.py", {"shared"}),
    ("fit/generator/finish.py", set()), ("fit/result.py", set()), ("report/sheet.py", set())])
def test_a_change_voids_the_records_that_it_shapes_and_no_others(file, void, copied):
    before, source = digits(copied), (copied / file).read_text(encoding="utf-8")
    assert before == digits(PACKAGE)
    (copied / file).write_text(source + "\n_CHANGED = 1\n", encoding="utf-8")
    after = digits(copied)
    (copied / file).write_text(source, encoding="utf-8")
    assert {name for name in before if before[name] != after[name]} == void


def test_settings_state_the_code_of_their_method_and_of_more():
    stated = {name: settings_of(config)["code"] for name, config in method_table().items()}
    assert stated["gan"] == stated["gan-two-stage"] == own_code(method_module("gan"))
    assert len(set(stated.values())) == len(METHODS) + 1
    config = method_table()["gan"]
    assert settings_of(config, "mitsvbrdf.bench.paper.schedule")["code"] not in stated.values()
