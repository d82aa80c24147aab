"""The sweeps and what they stand on: fifty digits, Jacobians, steps, verdicts; broken renderers are found out; and whatever is
valid comes out finite."""

import dataclasses
import functools
import importlib
import json
import math
from pathlib import Path
from typing import get_args

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from mitsvbrdf import cli
from mitsvbrdf.errors import CaptureError, ConfigError, MapsError, MitsvbrdfError, OutputError
from mitsvbrdf.fit.losses import photometric
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, flat
from mitsvbrdf.measure.gradients import fixed_cotangent, render_and_gradients
from mitsvbrdf.measure.tolerances import EXACT
from mitsvbrdf.render import make_renderer
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.verify.stability import SWEEPS, clamps, functions, run, stability
from mitsvbrdf.verify.stability.conditioning import condition, disturbed, jacobian, largest_step, tangents, valid
from mitsvbrdf.verify.stability.page import BEGIN, END, write_stability_markdown, write_stability_page
from mitsvbrdf.verify.stability.reference import texel_sum
from mitsvbrdf.verify.stability.sweeps import APART, GRID, Case, aimed, material, tilted
from mitsvbrdf.verify.stability.verdict import VERDICTS, verdict
from mitsvbrdf.views import BRIGHTEST, FARTHEST, NEAREST, Views

TWIN = make_renderer("analytic64")
FEW = APART.pick([0, 3])
LOW = Views.of([[3.0, 0.2, 1.0]], [[-2.0, 0.3, 0.4]], 30.0)
PAPER = dataclasses.replace(GRID.pick([0, 4]), falloff="none", size=2.0)


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("views, values", [
    (FEW, {}), (PAPER, {}), (LOW, {}), (FEW, {"roughness": 1e-3}), (FEW, {"roughness": 1.0}), (LOW, {"normal": tilted(85)}),
    (FEW, {"specular": 1e-5, "metallic": 1.0, "base_color": 0.0}), (FEW, {"specular": 0.9985, "metallic": 0.0}),
])
def test_float64_agrees_with_fifty_digits(bsdf, views, values):
    # Measured over these: 8e-14 at worst, the gradient of F0 at 0.9985, where 1 - F0 has lost three digits; else 2e-14.
    svbrdf = material(bsdf, **values)
    cotangent = fixed_cotangent(torch.Size((len(views), 16, 16, 3))).double()
    exact = render_and_gradients(TWIN, svbrdf, views, cotangent)
    for row, column in ((2, 3), (9, 14)):
        total, slopes = texel_sum(svbrdf, views, row, column, cotangent[:, row, column].tolist())
        parts = cotangent[:, row, column] * exact.image[:, row, column]
        assert abs(float(total) - float(parts.sum())) <= 1e-12 * float(parts.abs().sum())
        for name, values_ in slopes.items():
            true = torch.tensor([float(x) for x in values_], dtype=torch.float64)
            assert (exact.gradients[name][row, column] - true).norm() <= 1e-12 * true.norm(), name


def test_fifty_digits_know_the_closed_form():
    # A white diffuse texel below the light: I / (pi d^2), and the same as the slope in albedo.
    svbrdf = flat(1, diffuse=1.0, specular=0.0)
    total, slopes = texel_sum(svbrdf, Views.of([[0, 0, 2.5]], intensity=7.0), 0, 0, [[0.0, 1.0, 0.0]])
    assert float(total) == pytest.approx(7 / (math.pi * 2.5**2), rel=1e-15)
    assert [float(x) for x in slopes["diffuse"]] == pytest.approx([0, 7 / (math.pi * 2.5**2), 0], rel=1e-15)


def test_singular_values_in_closed_form():
    # Co-located straight above an upright texel: D = 1 / (pi r^4), so radiance is E (rho / pi + F0 / (4 pi r^4)), with E the
    # irradiance of each view. Per channel the row E (1 / pi, 1 / (4 pi r^4), -F0 / (pi r^5)); tilting changes nothing to
    # first order in n.h, and 1 - cos is flat. So J J^T is a multiple of the identity plus an outer product.
    r, f0, heights = 0.5, (0.1, 0.3, 0.7), (1.0, 2.0, 4.0)
    maps = dict(flat(1, roughness=r).maps) | {"specular": torch.tensor(f0).expand(1, 1, 3)}
    views = Views.of([[0, 0, z] for z in heights])
    j = jacobian(TWIN, SVBRDF("roughconductor", maps), views, display=lambda radiance: radiance)
    power = sum(z**-4 for z in heights)
    base = (1 / math.pi) ** 2 + (1 / (4 * math.pi * r**4)) ** 2
    u2 = sum((torch.tensor(f0).double() / (math.pi * r**5)) ** 2).item()
    expected = [math.sqrt(power * x) for x in (base + u2, base, base)]
    assert j.shape == (1, 9, 9)
    assert torch.linalg.svdvals(j)[0, :3].tolist() == pytest.approx(expected, rel=1e-6)  # the maps are float32
    found = condition(j)
    assert found["rank"] == 3 and found["unknowns"] == 9 and found["median"] is None and found["worst"] is None


def test_condition_of_known_matrices():
    # Orthogonal matrices around a diagonal: the condition number is the diagonal's.
    q = torch.linalg.qr(torch.randn(3, 6, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)).Q
    diagonals = torch.tensor([[8.0, 4, 2], [100, 10, 1], [5, 5, 5]], dtype=torch.float64)
    found = condition(q[..., :3] @ torch.diag_embed(diagonals) @ q[:, :3, :3].mT)
    assert found["rank"] == 3
    # The middle of 1, 4 and 100 up to the angle between the random blocks: recompute it the slow way.
    slow = sorted(float(torch.linalg.cond(m)) for m in q[..., :3] @ torch.diag_embed(diagonals) @ q[:, :3, :3].mT)
    assert found["median"] == pytest.approx(slow[1], rel=1e-9) and found["worst"] == pytest.approx(slow[2], rel=1e-9)


def test_tangents_are_an_orthonormal_frame():
    n = F.normalize(torch.cat((tilted(89.9), tilted(0), tilted(90, 0))), dim=-1)
    frame = torch.cat((tangents(n), n[..., None, :]), dim=-2)
    assert torch.allclose(frame @ frame.mT, torch.eye(3, dtype=torch.float64), atol=1e-12)


@pytest.mark.parametrize("transfer", ["gamma2.2", "linear"])
def test_the_largest_step_descends_and_twice_as_much_does_not(transfer):
    svbrdf, views = material(side=4), FEW
    photos = TWIN.render(svbrdf.to(torch.float64), views).detach()
    photos = (photos if transfer == "linear" else photos ** (1 / 2.2)).clamp(0, 1)
    start = disturbed(svbrdf).to(torch.float64).map(lambda t: t.requires_grad_())
    loss = photometric(TWIN.render(start, views), photos, transfer) * 16
    slopes = dict(zip(start.maps, torch.autograd.grad(loss, list(start.maps.values()))))

    def after(step):
        moved = valid(SVBRDF("roughconductor", {k: v.detach() - step * slopes[k] for k, v in start.maps.items()}))
        return photometric(TWIN.render(moved, views), photos, transfer) * 16

    step = largest_step(TWIN, svbrdf, views, transfer)
    assert after(step) < loss <= after(2 * step)
    assert largest_step(TWIN, svbrdf, views, transfer, first=64 * step) <= 64 * step  # found from above as well


def test_no_step_where_nothing_is_seen():
    away = material(normal=tilted(85, 160))
    assert largest_step(make_renderer("analytic"), away, Views.of([[3.0, 0.2, 0.4]])) == 0


IMAGE, GRADIENT = EXACT["image"], EXACT["gradient"]
GOOD = {"errors": {"image": IMAGE / 3, "roughness": GRADIENT / 3}, "not_finite": {"image": 0}, "silenced": {"roughness": 0}}


def changed(**errors):
    return GOOD | {"errors": GOOD["errors"] | errors}


@pytest.mark.parametrize("expected, why, figures, options", [
    ("exact", "", GOOD, {}),
    ("clamped", "alpha", GOOD, {"clamps": ["alpha"]}),
    ("degraded", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 6 * GRADIENT}}),
    ("degraded", "image", changed(image=5 * IMAGE), {"limit": {"image": 6 * IMAGE}, "clamps": ["alpha"]}),
    ("wrong", "roughness", changed(roughness=5 * GRADIENT), {"limit": {"roughness": 4 * GRADIENT}}),
    ("wrong", "image", changed(image=2 * IMAGE), {}),
    ("wrong", "inf", changed(image=None), {"known": (1.0, "cause")}),
    ("limited", "cause", changed(image=2 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "image", changed(image=4 * IMAGE), {"known": (3 * IMAGE, "cause")}),
    ("wrong", "7 of roughness come back as 0", GOOD | {"silenced": {"roughness": 7}}, {}),
    ("not finite", "2 of image", GOOD | {"not_finite": {"image": 2}}, {"known": (1.0, "cause")}),
    ("refused", "no", {"refused": "no"}, {}),
])
def test_verdicts(expected, why, figures, options):
    kind, reason = verdict(figures, options.pop("limit", {}), **options)
    assert kind == expected and kind in VERDICTS and why in reason


class Broken(AnalyticRenderer):
    """Float32, with one thing spoilt."""

    def __init__(self, how):
        super().__init__()
        self.how = how

    def render(self, svbrdf, views):
        image = super().render(svbrdf, views)
        if self.how == "nan at grazing":
            return torch.where(svbrdf["normal"][..., 2:] < 0.2, torch.nan, image)
        if self.how == "refuses":
            raise ConfigError("something else", "this", "try again")
        keeps = {"silent": {"roughness": 0.0}, "wrong slope": {"diffuse": 1.001}}[self.how]
        maps = {n: v.detach() + keeps.get(n, 1.0) * (v - v.detach()) for n, v in svbrdf.maps.items()}
        return super().render(SVBRDF(svbrdf.bsdf, maps), views)


@pytest.fixture
def one_case(monkeypatch):
    grazing = material(normal=tilted(85))
    monkeypatch.setitem(SWEEPS, "tilt", ("One case", lambda: [Case("tilt", "85 degrees", 85, grazing, FEW)]))


@pytest.mark.parametrize("how, expected", [("nan at grazing", "not finite: 1536 of image"), ("refuses", "refused: expected"),
                                           ("silent", "wrong: "), ("wrong slope", "wrong: diffuse 0.001")])
def test_a_broken_renderer_is_found_out(one_case, monkeypatch, tmp_path, how, expected):
    command = importlib.import_module("mitsvbrdf.cli.stability")
    monkeypatch.setattr(command, "make_renderer", lambda name, variant: Broken(how))
    out = [f"--{kind}={tmp_path / kind}" for kind in ("json", "html")]
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt", *out]) == 1
    record = json.loads((tmp_path / "json").read_text())
    (violation,) = record["violations"]
    assert violation["renderer"] == "analytic" and violation["what"].startswith(expected)
    assert violation["what"] in (tmp_path / "html").read_text().replace("&#39;", "'")
    write_stability_markdown(tmp_path / "md", record)
    assert expected.split(":")[0] in (tmp_path / "md").read_text()


def test_part_of_the_sweeps_does_not_replace_the_page_of_all(tmp_path):
    assert cli.main(["stability", "--only", "tilt", "--md", str(tmp_path / "md")]) == 2
    assert cli.main(["stability", "--renderer", "analytic", "--md", str(tmp_path / "md")]) == 2


def test_an_unbroken_renderer_passes(one_case):
    assert cli.main(["stability", "--renderer", "analytic", "--only", "tilt"]) == 0


def test_what_is_invalid_and_not_refused_is_found_out(monkeypatch):
    monkeypatch.setattr(SVBRDF, "check", lambda self: self)
    case = Case("tilt", "normals of length 2", None, material(normal=2 * tilted(0)), FEW, refused=True)
    (found,) = run.violations([run.measured(case, [make_renderer("analytic")])])
    assert found["what"].endswith("not refused")


def test_a_function_that_lets_out_nan_is_found_out(one_case, monkeypatch):
    monkeypatch.setattr(functions, "map_rmse", lambda *_: {"mean": math.nan})
    (found,) = stability([make_renderer("analytic")], ["tilt"])["violations"]
    assert found["renderer"] is None and found["what"] == "1 values of map_rmse are not finite"


def test_float64_that_is_off_is_found_out(one_case, monkeypatch):
    from mitsvbrdf.render import analytic

    right = analytic._smith
    monkeypatch.setattr(analytic, "_smith", lambda a2, cosine: right(a2, cosine) * (1 + 1e-5))
    (found,) = stability([], ["tilt"])["violations"]
    assert found["what"].startswith("float64 itself is off by")


def test_configurations_are_valid_but_those_to_be_refused():
    for key in SWEEPS.keys() - {"resolution"}:
        for case in SWEEPS[key][1]():
            assert case.sweep == key
            if case.refused:
                with pytest.raises(MitsvbrdfError):
                    case.svbrdf.check()
                    case.views.check()
            else:
                case.svbrdf.check()
                case.views.check()
    labels = [(key, case.label) for key in SWEEPS.keys() - {"resolution"} for case in SWEEPS[key][1]()]
    assert len(labels) == len(set(labels))


def test_clamps_act_where_they_say():
    acting = {c.name: c.acts for c in clamps.CLAMPS if c.acts}
    for name, svbrdf in {"alpha >= 0.0001": aimed("roughconductor", GRID, 0.01),
                         "alpha >= 0.001": aimed("principled", GRID, 0.03)}.items():
        case = Case("roughness", "", None, svbrdf, GRID)
        assert [n for n, acts in acting.items() if acts(case, torch.ones(1))] == [name]
        found = render_and_gradients(TWIN, svbrdf, GRID)
        smoother = SVBRDF(svbrdf.bsdf, dict(svbrdf.maps) | {"roughness": 0.5 * svbrdf["roughness"]})
        same = render_and_gradients(TWIN, smoother, GRID)
        if svbrdf.bsdf == "roughconductor":  # principled's diffuse lobe still answers
            assert torch.equal(found.image, same.image) and found.gradients["roughness"].abs().max() == 0
    rough = Case("roughness", "", None, material(), GRID)
    assert not any(acts(rough, torch.ones(1)) for acts in acting.values())


@pytest.mark.parametrize("camera, light, intensity, size, expected", [
    ((0, 0, 0.9 * NEAREST), None, 1, 1, "patch sides away"), ((0, 0, 2), (0, 1.1 * FARTHEST, 2), 1, 1, "patch sides away"),
    ((0, 0, 2), None, 1, 1e-30, "patch sides away"), ((0, 0, 20), None, 3000, 1e6, "patch sides away"),
    ((0, 0, 2), None, 4.1 * BRIGHTEST, 1, "squared distance"), ((3, 0, 0.01), (0.2, 0, 0.01), 2e-4 * BRIGHTEST, 1, "squared"),
])
def test_lengths_that_do_not_go_together_are_refused(camera, light, intensity, size, expected):
    with pytest.raises(CaptureError, match=expected):
        Views.of([camera], None if light is None else [light], intensity, size)


def test_lengths_at_the_ends_are_taken():
    for place in ((0, 0, NEAREST), (FARTHEST, -FARTHEST, FARTHEST)):
        Views.of([place])
        Views.of([[100 * x for x in place]], size=100.0)  # the unit does not matter
    Views.of([[0, 0, 2.0]], intensity=4 * BRIGHTEST)


@pytest.mark.parametrize("normal, expected", [((0, 0, 1e-9), "unit normals"), ((0, 0.5, 0.5), "unit normals"),
                                              ((1, 0, 5e-6), "z >= 1e-05"), ((1, 0, 0), "z > 0")])
def test_normals_that_no_renderer_can_use_are_refused(normal, expected):
    maps = dict(flat(2).maps) | {"normal": torch.tensor(normal, dtype=torch.float32).expand(2, 2, 3)}
    with pytest.raises(MapsError, match=expected):
        SVBRDF("roughconductor", maps).check()


def some(*values):
    return st.sampled_from(values)


UNIT_VALUES = st.one_of(some(0.0, 1e-30, 1e-6, 0.5, 0.9999999, 1.0), st.floats(0, 1, width=32))
ROUGHNESS = st.one_of(some(1e-30, 1e-4, 0.01, 1.0), st.floats(2**-60, 1, width=32))
HEIGHTS = st.one_of(some(NEAREST, 1.0, FARTHEST), st.floats(NEAREST, 100))
# Every other one straight above a texel, whose normal may well be upright: there a mirror's D is what overflows.
PLACES = st.one_of(st.tuples(st.just(0.25), st.just(0.25), HEIGHTS),
                   st.tuples(some(0.0, -0.25, 3.0, 1e3, -FARTHEST), some(0.0, -2.0, 1e4), HEIGHTS))
TILTED = st.tuples(some(1.0, 45.0, 80.0, 89.0, 89.9, 89.999), some(0.0, 30.0, 90.0, 180.0, 271.0))
NORMALS = st.one_of(st.just((0.0, 0.0)), TILTED)


@st.composite
def scenes(draw):
    bsdf, maps = draw(some(*CHANNELS)), {}
    for name, channels in CHANNELS[bsdf].items():
        if name == "normal":
            turns = [[math.radians(x) for x in draw(NORMALS)] for _ in range(4)]
            values = [[math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)] for t, a in turns]
        else:
            number = ROUGHNESS if name == "roughness" else UNIT_VALUES
            values = draw(st.lists(st.lists(number, min_size=channels, max_size=channels), min_size=4, max_size=4))
        maps[name] = torch.tensor(values, dtype=torch.float32).reshape(2, 2, channels)
    cameras = [draw(PLACES) for _ in range(2)]
    lights = [draw(PLACES) for _ in range(2)] if draw(st.booleans()) else cameras
    brightest = 0.999 * BRIGHTEST * min(light[2] ** 2 for light in lights)
    views = Views.of(cameras, lights, min(draw(some(1e-8, 1.0, 1e8, brightest)), brightest),
                     falloff=draw(some("inverse-square", "none")))
    return SVBRDF(bsdf, maps).check(), views


renderer = functools.cache(make_renderer)


@given(scenes())
@settings(max_examples=120, deadline=None, derandomize=True, database=None)
def test_whatever_is_valid_comes_out_finite(scene):
    for name in ("analytic64", "analytic", "mitsuba"):
        found = render_and_gradients(renderer(name), *scene)
        for what, tensor in {"image": found.image, **found.gradients}.items():
            assert torch.isfinite(tensor).all(), (name, what)


def test_record_page_and_markdown(one_case, tmp_path):
    record = stability([make_renderer("analytic")], ["tilt"])
    json.dumps(record, allow_nan=False)
    assert record["violations"] == []
    (row,) = record["rows"]
    assert row["renderers"]["analytic"]["verdict"] == "exact" and max(row["fifty_digits"].values()) < 1e-12
    write_stability_page(tmp_path / "page.html", record)
    assert "85 degrees" in (tmp_path / "page.html").read_text()
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}old{END}\nafter\n")
    for _ in range(2):
        write_stability_markdown(page, record)
    text = page.read_text()
    assert text.startswith(f"before\n{BEGIN}") and text.endswith(f"{END}\nafter\n") and "old" not in text
    assert text.count("| 85 degrees | ") == 1 and all(f"| {clamp.name} |" in text for clamp in clamps.CLAMPS)
    page.write_text("no marks")
    with pytest.raises(OutputError, match="marks"):
        write_stability_markdown(page, record)
    assert page.read_text() == "no marks"


def test_the_page_in_docs_has_every_sweep_and_clamp():
    text = (Path(__file__).parents[1] / "docs/stability.md").read_text()
    text = text[text.index(BEGIN):text.index(END)]
    for key, (title, cases) in SWEEPS.items():
        assert f"### {title}\n" in text
        if key != "resolution":
            assert all(f"\n| {case.label} | " in text for case in cases())
    assert all(f"| {clamp.name} | {clamp.where} | {clamp.why} |" in text for clamp in clamps.CLAMPS)
    assert "wrong," not in text and "not finite," not in text


def test_command_knows_every_sweep(tmp_path, capsys):
    from mitsvbrdf.cli.stability import VERDICT_COLOURS, Sweep

    assert get_args(Sweep) == tuple(SWEEPS) and set(VERDICT_COLOURS) == set(VERDICTS)
    assert cli.main(["stability", "--only", "flat", "--json", str(tmp_path)]) == 2
    assert "a file to write" in capsys.readouterr().err
