"""Refined views against the truth, priors where nothing is seen, and differences of the cost."""

import json
from dataclasses import replace

import pytest
import torch
from helpers import ANALYTIC, GRID

from mitsvbrdf import cli
from mitsvbrdf.calibrate.refine import UNKNOWNS, Priors, Problem, refine_views
from mitsvbrdf.capture import Capture, read_capture, write_capture
from mitsvbrdf.color import CLIPPED, encode
from mitsvbrdf.errors import CaptureError, ConfigError
from mitsvbrdf.evaluate import evaluate_capture
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.map_files import load_maps, save_maps
from mitsvbrdf.material.maps import SVBRDF, flat
from mitsvbrdf.render import make_renderer
from mitsvbrdf.synth import photograph

SPREAD = torch.tensor([0.03, 0.03, 0.05, 0.03, 0.03, 0.03, 0.1], dtype=torch.float64)  # of the default priors


def moved(views, change):
    """Views off by N x 7 changes in patch sides: the camera with its flash, the flash alone, light."""
    camera, flash, light = (change[:, part] for part in (slice(0, 3), slice(3, 6), slice(6, 7)))
    return replace(views, camera=views.camera + camera * views.size, light=views.light
                   + (camera + flash) * views.size, intensity=views.intensity * light.exp())


def drawn(count, seed, spread=SPREAD):
    return torch.randn(count, 7, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * spread


def photos_from(material, views, change, seed=0, noise=0.01):
    """8-bit noisy photos from moved views, with the views they claim."""
    return replace(photograph(material, moved(views, change), ANALYTIC, noise, seed), views=views)


@pytest.mark.parametrize("name, seed", [
    ("inlay", 0), *(pytest.param(*row, marks=pytest.mark.slow) for row in (("leather", 1), ("tiles", 2)))])
def test_perturbed_calibration_is_found_within_the_stated_errors(name, seed):
    material, views, truth = make_material(name, 64), GRID, drawn(9, seed)
    shots = photos_from(material, views, truth, seed)
    found = refine_views(material, views, shots)
    # 63 numbers, normal where the model is linear: 1 +- 0.09 and about 2.5 at worst, the three of a photo's
    # camera and flash hanging together. Measured: 1.04, 0.84, 1.38 and 2.2, 2.0, 3.0.
    z = (found.change - truth) / found.deviation
    assert 0.6 < float(z.square().mean().sqrt()) < 1.6 and float(z.abs().max()) < 4
    # The middle between camera and flash moves the highlight: priors leave 0.034, measured 0.0002 to 0.002.
    middle = (found.change - truth)[:, :2] + (found.change - truth)[:, 3:5] / 2
    assert float(middle.square().mean().sqrt()) < 0.005
    # The photos are then met as well as with the true views: measured 0.9997 to 0.9999 of their error.
    before, after, with_truth = (evaluate_capture(material, replace(shots, views=each),
                                                  ANALYTIC)["per_photo"].values()
                                 for each in (views, found.views, moved(views, truth)))
    assert all(error < 1.005 * best for error, best in zip(after, with_truth))
    assert sum(before) > 1.1 * sum(after)
    assert torch.allclose(found.views.camera, moved(views, found.change).camera, atol=1e-14)
    assert torch.allclose(found.views.light, moved(views, found.change).light, atol=1e-14)
    assert torch.allclose(found.views.intensity, moved(views, found.change).intensity, rtol=1e-14)
    # From there the search is where it ends, and from the truth it ends there too, by the deviations that it
    # states.
    again, other = (refine_views(material, views, shots, start=start) for start in (found.change, truth))
    assert again.iterations <= 2 < found.iterations
    assert all(((there.change - found.change) / found.deviation).abs().max() < 0.05
               for there in (again, other))


def test_photos_do_not_depend_on_each_other_nor_on_the_unit():
    material, views, truth = make_material("inlay", 48), GRID, drawn(9, 3)
    shots = photos_from(material, views, truth)
    both = refine_views(material, views.pick([3, 7]), shots.pick([3, 7]))
    alone = refine_views(material, views.pick([7]), shots.pick([7]))
    # One damping for all, and steps end at 0.01 prior deviations; measured 2e-10.
    assert float(((both.change[1] - alone.change[0]) / SPREAD).abs().max()) < 0.02
    inches = replace(views, camera=views.camera * 7, light=views.light * 7, intensity=views.intensity * 49,
                     size=7.0)
    scaled = refine_views(material, inches.pick([7]), shots.pick([7]))
    assert torch.allclose(scaled.change, alone.change, atol=1e-6)
    assert torch.allclose(scaled.views.light / 7, alone.views.light, atol=1e-6)


def test_wrong_maps_make_it_less_sure():
    # Specks that are in no map hang together over blocks of pixels: they must not count as evidence, pixel by
    # pixel.
    material, views = make_material("inlay", 64), GRID.pick([0, 3])
    shots = photos_from(material, views, drawn(2, 0))
    specks = torch.nn.functional.interpolate(0.1 * torch.randn(
        2, 3, 8, 8, generator=torch.Generator().manual_seed(0)), 64)
    spoilt = replace(shots, photos=(shots.photos + specks.permute(0, 2, 3, 1)).clamp(0, 1))
    right, wrong = (refine_views(material, views, s) for s in (shots, spoilt))
    assert bool((wrong.deviation > right.deviation).all())
    assert bool((wrong.deviation[:, :2] > 2 * right.deviation[:, :2]).all())  # measured 3.0 to 5.1
    assert bool((wrong.deviation <= SPREAD).all())


def test_priors_hold_where_nothing_is_seen():
    black, views = flat(16, diffuse=0.0, specular=0.0), GRID.pick([1, 2])
    shots = Capture(torch.full((2, 16, 16, 3), 0.3), views)
    found = refine_views(black, views, shots, Priors(common_flash=(0.15, 0.2)))
    assert found.change.abs().max() < 1e-12
    wide = SPREAD.clone()
    wide[3:5] = (wide[3:5].square() + torch.tensor([0.15, 0.2]).square()).sqrt()
    assert torch.allclose(found.deviation, wide.expand(2, 7), rtol=1e-12)
    assert torch.allclose(found.common_covariance, torch.diag(torch.tensor([0.15, 0.2]).double() ** 2),
                          rtol=1e-6)


def test_what_is_held_does_not_move():
    material, views = make_material("inlay", 32), GRID.pick([0, 5])
    shots = photos_from(material, views,
                        torch.tensor([[0, 0, 0, 0, 0.02, 0, 0], [0, 0, 0, 0, -0.03, 0, 0]]).double())
    found = refine_views(material, views, shots, Priors(camera=(0, 0, 0), flash=(0, 0.03, 0), exposure=0))
    held = [i for i, name in enumerate(UNKNOWNS) if name != "flash_y"]
    assert torch.equal(found.change[:, held], torch.zeros(2, 6, dtype=torch.float64))
    assert torch.equal(found.deviation[:, held], torch.zeros(2, 6, dtype=torch.float64))
    # measured 6e-4: the noise
    assert torch.allclose(found.change[:, 4], torch.tensor([0.02, -0.03]).double(), atol=2e-3)


def test_one_flash_offset_for_all_photos():
    # Lit from (-0.1, 0.04) beside the lens, +-0.005: far beyond the default prior of a photo, little for an
    # offset of all.
    material, views = make_material("leather", 48), GRID
    own = torch.tensor([0, 0, 0, 0.005, 0.005, 0, 0], dtype=torch.float64)
    truth = drawn(9, 0, own)
    truth[:, 3:5] += torch.tensor([-0.1, 0.04])
    priors = Priors(camera=(0, 0, 0), flash=(0.005, 0.005, 0), exposure=0, common_flash=(0.15, 0.15))
    found = refine_views(material, views, photos_from(material, views, truth), priors)
    mean = truth[:, 3:5].mean(dim=0)
    assert torch.allclose(found.change[:, 3:5].mean(dim=0), mean, atol=2e-3)  # measured 7e-4
    # It is known as well as nine draws of 0.005 tell their centre, at best.
    deviation = found.common_covariance.diagonal().sqrt()
    assert bool(((deviation > 0.005 / 3) & (deviation < 2 * 0.005 / 3)).all())
    assert bool(((found.common_flash - torch.tensor([-0.1, 0.04])).abs() < 3 * deviation).all())
    assert float((found.change - truth)[:, 3:5].abs().max()) < 0.01


def problem_of(material, views, change, exact=False):
    shots = photos_from(material, views, change)
    if exact:  # not clipped, no noise, no rounding
        photos = encode(make_renderer("analytic64").render(material, moved(views, change)))
        shots = Capture(photos, views)
    return Problem(material, views, shots, Priors(common_flash=(0.1, 0.1)))


def test_gradient_is_that_of_the_cost():
    # A bright material: clipped highlights, robust residuals. Against central differences of the cost itself,
    # in u; the cost's second derivative jumps where a residual passes from one branch to the other. Measured
    # 3e-10.
    material = flat(24, diffuse=0.5, specular=0.3, roughness=0.4)
    problem = problem_of(material, GRID.pick([0, 3]), drawn(2, 0))
    assert 0.01 < float((problem.photos >= CLIPPED).double().mean()) < 0.5
    u = torch.randn(16, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    here = problem.linear(u)
    wanted = torch.zeros(16, dtype=torch.float64)
    for i in range(16):
        step = 1e-4 * torch.eye(16, dtype=torch.float64)[i]
        wanted[i] = (problem.cost(u + step, here.evidence) - problem.cost(u - step, here.evidence)) / 2e-4
    assert here.cost == pytest.approx(problem.cost(u, here.evidence), rel=1e-12)
    assert float((here.gradient - wanted).norm() / wanted.norm()) < 1e-7


def test_matrix_is_the_curvature_where_the_model_is_right():
    # Residuals of 0, so that what Gauss-Newton leaves out of the second derivative is 0 too; differences of
    # the gradient, with the evidence held. Measured 6e-11.
    problem = problem_of(make_material("leather", 24), GRID.pick([0, 3]), torch.zeros(2, 7), exact=True)
    here = problem.linear(torch.zeros(16, dtype=torch.float64))
    columns = []
    for step in 1e-4 * torch.eye(16, dtype=torch.float64):
        after, before = (problem.linear(s, here.evidence).gradient for s in (step, -step))
        columns.append((after - before) / 2e-4)
    assert float((here.matrix - torch.stack(columns, dim=1)).norm() / here.matrix.norm()) < 1e-7


def test_a_clipped_pixel_only_asks_for_enough():
    views = GRID.pick([0])
    bright = flat(8, diffuse=0.9, specular=0.5, roughness=0.3)
    shots = Capture(torch.ones(1, 8, 8, 3), views)
    brighter = refine_views(bright, replace(views, intensity=views.intensity * 9), shots)
    assert float(brighter.change.abs().max()) < 1e-9
    darker = refine_views(bright, replace(views, intensity=views.intensity * 0.9), shots)
    assert float(darker.change[0, 6]) > 0.05


def test_mistakes_are_refused():
    material, views = flat(8), GRID
    shots = Capture(torch.rand(9, 8, 8, 3), views)
    with pytest.raises(CaptureError, match="9 photos"):
        refine_views(material, views.pick([1, 2]), shots)
    for wrong, words in (({"exposure": -1.0}, "0 and more"), ({"camera": ("a",) * 3}, "0 and more"),
                         ({"exposure": "a"}, "exposure")):
        with pytest.raises(ConfigError, match=words):
            Priors(**wrong)


def test_evaluate_prints_and_writes_both(tmp_path, capsys):
    shots, folder, figures = tmp_path / "shots", tmp_path / "maps", tmp_path / "e.json"
    material, views = make_material("inlay", 32), GRID
    write_capture(photos_from(material, views, drawn(9, 0)), shots)
    save_maps(material, folder)
    arguments = ["evaluate", str(folder), "--capture", str(shots), "--views", "4,7", "--renderer", "analytic"]
    arguments += ["--json", str(figures)]
    assert cli.main(arguments) == 0
    plain = json.loads(figures.read_text())
    assert "refined" not in plain
    capsys.readouterr()
    assert cli.main([*arguments, "--refine-views", "--overwrite"]) == 0
    said, found = capsys.readouterr().out, json.loads(figures.read_text())
    assert {k: v for k, v in found.items() if k != "refined"} == plain
    assert set(found["refined"]["per_photo"]) == set(found["refined"]["views"]) == {"04", "07"}
    assert found["refined"]["rerender_rmse"] < 0.7 * found["rerender_rmse"]  # measured 0.39
    assert f"{found['rerender_rmse']:.4f}" in said and f"{found['refined']['rerender_rmse']:.4f}" in said
    capture = read_capture(shots, resolution=32, index=[4, 7])
    direct = refine_views(load_maps(folder), capture.views, capture)
    changes = [list(view["change"].values()) for view in found["refined"]["views"].values()]
    assert changes == direct.change.tolist() and "photo 07: camera (" in said
    assert cli.main(["evaluate", str(folder), "--reference", str(folder), "--refine-views"]) == 2


def test_principled_materials_too():
    material, views, truth = make_material("inlay", 32), GRID.pick([0, 3]), drawn(2, 5)
    metal = SVBRDF("principled", dict(flat(32, "principled", metallic=0.3, roughness=0.35).maps)
                   | {"base_color": material["diffuse"], "normal": material["normal"]})
    found = refine_views(metal, views, photos_from(metal, views, truth))
    assert float(((found.change - truth) / found.deviation).abs().max()) < 4
