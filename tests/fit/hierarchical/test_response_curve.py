"""The response curve of real photos: a joint step against float64, and fits of photos through a known one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from helpers import ANALYTIC, GRID, MITSUBA, TWIN, photos_of
from helpers.hierarchical_fits import method_of, reached
from matplotlib.image import imread

from mitsvbrdf import color
from mitsvbrdf.color import Curve, of_torch
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.evaluate.placement import placed
from mitsvbrdf.fit import Fit, FitTask, GanConfig, HierarchicalConfig, fit_svbrdf, make_method
from mitsvbrdf.fit.hierarchical import response_curve, stages
from mitsvbrdf.fit.hierarchical.scales import Scale
from mitsvbrdf.fit.hierarchical.solver import Observations, TexelSolver
from mitsvbrdf.fit.hierarchical.stages import Stage
from mitsvbrdf.fit.hierarchical.texel_prior import TexelEstimate
from mitsvbrdf.material.made import make_material
from mitsvbrdf.measure.rerender import rerender_errors
from mitsvbrdf.report.folder import write_fit

SIDE, TRUE = 48, Curve(2.0, 0.5)  # at 32 px, photos hardly tell: one CPU finds the curve, another does not


def test_a_curve_and_its_inverse():
    curve, do = Curve(2.0, 1.0), of_torch()
    assert curve.bent(torch.tensor(0.5), do) == pytest.approx(2 * 0.25 / 1.25)
    display = torch.linspace(0, 20, 20_001, dtype=torch.float64)  # of a highlight, too
    for curve in (Curve(2.0, 1.0), Curve(0.5, -0.6), Curve(3.3, 5.0)):
        bent = curve.bent(display, do)
        assert bent[0] == 0 and bent[1000] == pytest.approx(1, abs=1e-15) and (bent.diff() > 0).all()
        # near 0 a power of 3.3 leaves few digits
        torch.testing.assert_close(curve.straight(bent, do), display, rtol=1e-9, atol=1e-9)


def test_transfer_functions_with_a_curve():
    bent = TRUE.behind("srgb")
    assert color.parts(bent) == ("srgb", TRUE) and TRUE.behind(bent) == bent
    linear = torch.linspace(0.001, 1, 100, dtype=torch.float64)
    torch.testing.assert_close(color.decode(color.encode(linear, bent), bent), linear, rtol=1e-9, atol=1e-9)
    for wrong in ("srgb, gamma 1.5", "srgb, gamma -1.5000, shoulder 0.8000", "film, gamma 1.5, shoulder 0.8",
                  "srgb,", "srgb, gamma nan, shoulder 0.8"):
        with pytest.raises(ConfigError, match="transfer function"):
            color.encode(linear, wrong)


def test_a_step_is_that_of_all_numbers_at_once():
    """The dense system of the curve and all texels, by autograd in float64."""
    curve, noise, robust = Curve(1.3, 0.4), 0.02, 0.06
    solver, views = TexelSolver("roughconductor"), GRID.pick([0, 4, 8])
    random = torch.Generator().manual_seed(5)
    truth = photos_of(make_material("leather", 9), views).photos[:, ::3, ::3].contiguous()
    x = solver.numbers(make_material("leather", 9))[:, ::3, ::3].contiguous()
    x = (x + 0.05 * torch.rand(x.shape, generator=random)).clamp(0.1, 0.9)
    mean, precision = x + 0.02, 20 + 100 * torch.rand(x.shape, generator=random)
    photos = Observations(truth, views, curve.behind("gamma2.2"), noise, robust)
    scale = SimpleNamespace(solver=solver)
    answer = TexelEstimate(x, mean, precision, torch.zeros(0))
    found = response_curve._step(curve, scale, answer, photos, MITSUBA)

    def shown(at, numbers):
        images = TWIN.render(solver.svbrdf(numbers.reshape(x.shape)), views)
        return Curve(at[0], at[1]).bent(color.encode(images), of_torch())

    at, numbers = torch.tensor(curve, dtype=torch.float64), x.double().flatten()
    error = shown(at, numbers) - truth
    weight = torch.where((truth >= color.CLIPPED) & (error > 0), 0.0, (1 + (error / robust)**2)**-0.5)
    weight = (weight.amin(dim=-1, keepdim=True).expand_as(error) / noise**2).flatten()
    rows = torch.cat([j.reshape(error.numel(), -1) for j in
                      torch.autograd.functional.jacobian(shown, (at, numbers))], dim=1)
    prior = torch.cat((torch.full((2,), response_curve.VAGUE), precision.flatten())).double()
    pull = torch.cat((torch.zeros(2), (precision * (x - mean)).flatten()))
    step = torch.linalg.solve(rows.T @ (weight[:, None] * rows) + torch.diag(prior),
                              -(rows.T @ (weight * error.flatten()) + pull))[:2]
    assert step.abs().min() > 0.01 and step.abs().max() < response_curve.LONGEST
    # measured: 2e-5, by LEAST_PRECISION and float32
    torch.testing.assert_close(found, step, rtol=0, atol=1e-3)


def through(curve: Curve | None):
    """Photos of a material by a phone with this curve."""
    shots = photos_of(make_material("inlay", SIDE), noise=0.003)
    if curve is None:
        return shots
    stored = color.to_display(ANALYTIC.render(make_material("inlay", SIDE), GRID), curve.behind("gamma2.2"))
    grain = 0.003 * torch.randn(stored.shape, generator=torch.Generator().manual_seed(4))
    return replace(shots, photos=((stored + grain).clamp(0, 1) * 255).round() / 255)


@pytest.fixture(scope="module")
def bent():
    shots = through(TRUE)
    return shots, fit_svbrdf(shots, MITSUBA, HierarchicalConfig(exact=False, budget=600))


def test_a_curve_is_found_told_and_used(bent):
    shots, fit = bent
    _, found = color.parts(fit.transfer)
    display = torch.linspace(0.05, 1, 100)
    off = found.bent(display, of_torch()) - TRUE.bent(display, of_torch())
    plain = display - TRUE.bent(display, of_torch())
    assert off.abs().max() < plain.abs().max() / 3  # .27 of it with AVX-512 and AVX2; other grain: .26 to .59
    assert any("response curve" in told for told in fit.warnings)
    assert fit.transfer == fit.record["capture"]["transfer"] == placed(shots, fit).transfer
    images = TWIN.render(fit.svbrdf, fit.views)
    error = color.to_display(images, fit.transfer) - shots.photos
    assert error.square().mean().sqrt() == pytest.approx(fit.rerender_rmse, rel=1e-4)


def test_pictures_and_predictions_have_the_curve(bent, tmp_path):
    """Of the folder as another program reads it: its pictures err as the fit says."""
    shots, fit = bent
    write_fit(fit, shots, tmp_path / "out")
    drawn = torch.stack([torch.tensor(imread(tmp_path / f"out/rerendered/{name}.png"))[..., :3]
                         for name in shots.names])
    # the pictures have 8 bits
    assert (drawn - shots.photos).square().mean().sqrt() == pytest.approx(fit.rerender_rmse, rel=0.02)
    found = Fit.load(tmp_path / "out")
    error, _ = rerender_errors(MITSUBA, found.svbrdf, found.views, placed(shots, found))
    assert error == pytest.approx(fit.rerender_rmse, rel=1e-3)


def test_only_photos_of_the_same_response_have_its_curve():
    shots = photos_of(make_material("inlay", 8))
    assert shots.through(TRUE.behind("gamma2.2")).transfer == TRUE.behind("gamma2.2")
    assert shots.through(TRUE.behind("srgb")) is shots is shots.through(None)


def test_a_curve_counts_by_the_round_that_saves_most(monkeypatch):
    costs, steps = iter([9.0, 9.0, 4.0, 9.5, 8.9]), iter([0.3, 0.01])  # priors learned through it are narrow
    monkeypatch.setattr(response_curve, "stepped", lambda *_: SimpleNamespace(
        x=torch.zeros(0), data=torch.tensor(next(costs)), prior=torch.zeros(1)))
    monkeypatch.setattr(response_curve, "_step", lambda *_: torch.full((2,), next(steps)))
    start = Scale(through(None), None, None, None, 0.0), TexelEstimate(*[torch.zeros(0)] * 4)
    assert response_curve.curved(*start, lambda *_: None, None, lambda scale, photos, answer: answer, None)


@pytest.mark.slow
def test_photos_without_a_curve_get_none():
    fit = fit_svbrdf(through(None), MITSUBA, HierarchicalConfig(exact=False, budget=600))
    assert fit.transfer == "gamma2.2" and not any("response curve" in told for told in fit.warnings)


@pytest.mark.slow
def test_a_curve_by_which_photos_predict_each_other_worse_is_refused(monkeypatch):
    method = method_of(through(None), exact=False)
    while method.stages.stage != Stage.TOGETHER or not method.stages.finished:
        method.step(0.0)
    wrong = Curve(0.6, 0.0).behind("gamma2.2")
    monkeypatch.setattr(response_curve, "curved", lambda scale, answer, *_: (
        replace(scale, capture=scale.capture.but(transfer=wrong)), answer))
    method.step(0.0)
    assert method.stages.stage == Stage.FINE
    assert method.real.curve is None and method.scale.capture.transfer == "gamma2.2"


@pytest.mark.slow
def test_the_game_of_gan_sees_through_the_curve_of_its_first_solver(bent, monkeypatch):
    monkeypatch.setattr(stages, "EXACT", 0.0)
    method = make_method(FitTask(bent[0], MITSUBA, GanConfig()))
    while not method.stage:
        method.step(0.0)
    assert method.stage == 1 and color.parts(method.capture.transfer)[1] is not None
    assert method.solvers[1].capture.transfer == method.without.capture.transfer == method.capture.transfer
    again = make_method(FitTask(bent[0], MITSUBA, GanConfig()))
    again.load_state(method.state())
    assert again.solvers[1].capture.transfer == again.without.capture.transfer == method.capture.transfer


@pytest.mark.slow
def test_a_resumed_fit_has_the_curve(bent):
    method, again = reached(Stage.FINE, method_of(bent[0], exact=False)), method_of(bent[0], exact=False)
    assert method.capture.transfer == bent[1].transfer
    again.load_state(method.state())
    assert again.capture.transfer == again.scale.capture.transfer == method.capture.transfer
    for each in (method, again):
        each.step(0.0)
    assert torch.equal(again.answer.x, method.answer.x)
