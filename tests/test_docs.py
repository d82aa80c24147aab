"""Commands in README and docs parse; the slow suite runs them in their order, shortened, on made photos."""

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers import ROOT
from helpers.commands import parsed_only

import mitsvbrdf
from mitsvbrdf import cli
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import save_maps
from mitsvbrdf.render.exclusive import using_mitsuba

SHORTER = [(r"--budget \d+", "--iterations 3"), (r"resolution=\d+", "resolution=32"), (r"--megapixels \d+",
           "--megapixels 0.7"), (r"\(seed=0\)", "(seed=0, iterations=3)"), (r"(make_material\(\S+,) \d+",
           r"\1 32"), (r"error<\S+\b", "error<1")]
QUICK = {"crosscheck": ["--repeats", "1", "--bsdf", "roughconductor", "--resolution", "32"],
         "capture": ["--resolution", "64"], "report": ["--quick"], "stability": ["--only", "clipped",
         "--renderer", "analytic"], "relight": ["--size", "24", "--frames", "1", "--samples", "2"],
         "bench": ["--methods", "direct", "--budgets", "0.3", "--resolution", "16"]}


def shortened(text):
    for long, short in SHORTER:
        text = re.sub(long, short, text)
    return text


@pytest.fixture
def photos(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["synth", "builtin:inlay", "-o", "photos", "--resolution", "32"]) == 0


PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page):
    """What is typed on a page, in a list or not."""
    return re.findall(r"^ {4,}mitsvbrdf (.*)$", page.read_text(), re.M)


TYPED = [line for page in PAGES for line in commands(page)]
TASKS = ["docs/index.md", "docs/start-phone.md", "docs/start-capture.md", "docs/start-known.md"]


@pytest.mark.parametrize("line", dict.fromkeys(TYPED))
def test_commands_parse(line, monkeypatch):
    called, arguments = parsed_only(monkeypatch), shlex.split(line, comments=True)
    assert cli.main(arguments) == 0 and [name for name, _ in called] == arguments[:1]


def run_shortened(lines):
    """Run the commands in their order, here, on small photos and for a few steps."""
    for line in lines:
        arguments = shlex.split(shortened(line), comments=True)
        if arguments[0] == "batch":
            if find_spec("ray") is None:  # imported before the command, it would miss the command's token
                pytest.skip("Ray is not installed")
            shutil.copytree("photos", "shots/inlay")
            arguments += ["--resolution", "16", "--iterations", "3", "--tag", "wood"]
        if arguments[0] == "synth":
            arguments += ["--resolution", "32"]
        if arguments[0] == "fit" and "--iterations" not in arguments:
            arguments += ["--iterations", "3"]
        arguments += QUICK.get(arguments[0], [])
        assert cli.main(arguments) == 0, line


@pytest.mark.slow
def test_readme_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = commands(ROOT / "README.md")
    assert len(lines) >= 8
    run_shortened(lines)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_the_first_pages_lead_to_what_they_name(name, tmp_path, monkeypatch):
    """From an empty folder, every step in its order; the files named in the text are there in the end."""
    monkeypatch.chdir(tmp_path)
    lines = commands(ROOT / name)
    assert lines
    run_shortened(lines)
    named = re.findall(r"`((?:out[\w-]*|capture)/[\w./-]+)`", (ROOT / name).read_text())
    assert named or name == "docs/index.md"
    assert not [path for path in named if not Path(path).exists()]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
@pytest.mark.parametrize("name", ["README.md", *TASKS])
def test_what_the_first_pages_make_is_not_taken_for_source(name):
    page = (ROOT / name).read_text()
    made = re.findall(r"(?: -o | --html )(\S+)", "\n".join(commands(ROOT / name)))
    made += re.findall(r'(?:write_fit\(.*|save_maps\(.*|write_report\(.*)"([\w-]+)"\)', page)
    done = subprocess.run(["git", "check-ignore", "--no-index", *(
        f"{each}/" if "." not in each else each for each in made)], cwd=ROOT, capture_output=True, text=True)
    assert [each for each in made if each not in [line.rstrip("/") for line in done.stdout.split()]] == []
    assert made or name == "docs/index.md"


def test_the_first_page_leads_to_every_user_page():
    linked = re.findall(r"\]\((\w[\w-]*\.md)", (ROOT / "docs/index.md").read_text())
    assert {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"} <= set(linked)


def test_user_pages_are_short():
    assert sum(len(path.read_text().split()) for path in (ROOT / "docs").glob("*.md")) <= 22_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["docs/export.md", "docs/relight.md"])
def test_commands_for_a_fit(name, photos):
    """Pages that begin where a fit is there; each command as if it were the first."""
    if "mp4" in (ROOT / name).read_text():
        pytest.importorskip("av")
    run_shortened(["fit photos -o out --method direct --renderer analytic"])
    for line in commands(ROOT / name):
        before = set(Path("out").iterdir())
        run_shortened([line])
        for made in set(Path("out").iterdir()) - before:
            shutil.rmtree(made)


@pytest.mark.slow
def test_batch_page_commands(photos):
    run_shortened(commands(ROOT / "docs/batch.md"))
    (loop,) = re.findall(r"^    (for .*)", (ROOT / "docs/batch.md").read_text(), re.M)
    command = f'mitsvbrdf() {{ {sys.executable} -m mitsvbrdf "$@"; }}; {loop.replace("wood-", "")}'
    subprocess.run(["bash", "-c", command], check=True)
    assert list(Path("exported").rglob("material.glb"))


@pytest.mark.slow
def test_evaluation_page_commands(photos):
    for folder in ("published", "known"):
        save_maps(make_material("inlay", 32), folder)
    run_shortened(commands(ROOT / "docs/evaluation.md"))


def test_python_of_the_export_page(photos, two_threads):
    """It loads the exported material into Mitsuba."""
    import mitsuba as mi

    assert cli.main(["export", "builtin:inlay", "--to", "mitsuba", "-o", "out/export", "--no-preview"]) == 0
    (line,) = re.findall(r"^    (bsdf = mi\.load_file.*\n)", (ROOT / "docs/export.md").read_text(), re.M)
    with using_mitsuba("llvm_ad_rgb"):
        names = {"mi": mi}
        exec(line, names)  # noqa: S102  (our own text)
        assert isinstance(names["bsdf"], mi.BSDF)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["README.md", "docs/start-known.md", "docs/python.md"])
def test_python_of_a_page(name, photos):
    shutil.copytree("photos", "known-photos")
    (block,) = re.findall(r"^```python\n(.+?)^```", (ROOT / name).read_text(), re.M | re.S)
    exec(shortened(block), {})  # noqa: S102  (our own text)


def test_the_page_of_python_names_what_is_public():
    lines = re.findall(r"^(?:`\w+` ?)+$", (ROOT / "docs/python.md").read_text(), re.M)
    assert sorted(name for line in lines for name in re.findall(r"\w+", line)) == mitsvbrdf.__all__


def test_what_to_cite_is_this_version():
    assert f"\nversion: {mitsvbrdf.__version__}\n" in (ROOT / "CITATION.cff").read_text()


@pytest.mark.slow
def test_capture_page_commands(tmp_path, monkeypatch):
    """In the order in which they can be typed: photos come from the simulated phone."""
    monkeypatch.chdir(tmp_path)
    lines = commands(ROOT / "docs/capture.md")
    assert [line.split()[0] for line in lines] == ["synth", "sheet", "capture", "fit"]
    short = {"synth": ["--megapixels", "0.7", "--photos", "4", "--resolution", "256"],
             "capture": ["--resolution", "64"], "fit": ["--iterations", "3", "--resolution", "32"]}
    for line in lines:
        arguments = shlex.split(re.sub(r" --spoil .*", "", line))
        assert cli.main([*arguments, *short.get(arguments[0], [])]) == 0, line
    written = re.findall(r"^    photos/(\S+) ", (ROOT / "docs/capture.md").read_text(), re.M)
    assert len(written) == 3 and all((tmp_path / "photos" / name).is_file() for name in written)


def test_links_lead_somewhere():
    for page in [*PAGES, ROOT / "docs/tutorial.ipynb"]:
        for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_architecture_shows_the_law_and_files_that_are_there():
    page = (ROOT / "ARCHITECTURE.md").read_text()
    law = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0][
        "layers"]
    picture = re.search(r"\n\n((?:    .*\n)+)", page)[1]
    drawn = [line[4:].split("  ")[0].rstrip() for line in picture.splitlines() if line[4] not in " |"]
    assert drawn == law
    for name in re.findall(r"`([\w/]+(?:/|\.py))`", page):
        assert any((root / name).exists() for root in (ROOT, *(ROOT / "mitsvbrdf").glob("**"))), name
