"""The cases of the renderers and their truth."""

import pytest
import torch
from helpers.bench_records import benchmark

from mitsvbrdf.bench import renderers
from mitsvbrdf.bench.schema import check_benchmark
from mitsvbrdf.errors import ConfigError
from mitsvbrdf.material.made import make_material
from mitsvbrdf.render import make_renderer
from mitsvbrdf.render.scene import SceneRenderer


def test_the_truth_of_whole_pixels_is_their_average():
    svbrdf, views = make_material("inlay", 8), renderers.spread_views(2)
    image, gradients = renderers.exact(svbrdf, views, renderers.POINTS_A_SIDE)
    twin, k = make_renderer("analytic64"), 48
    fine = svbrdf.map(lambda t: t.repeat_interleave(k, 0).repeat_interleave(k, 1))
    brute = twin.render(fine, views).reshape(2, 8, k, 8, k, 3).mean(dim=(2, 4))
    centres = twin.render(svbrdf, views)
    off = float(((image - brute) / brute).abs().mean())
    # Measured: texel centres 9.5e-3 off, so 48 x 48 points, of second order, 9.5e-3 / 48^2 = 4.1e-6
    # themselves; found 4.2e-6.
    assert off < 1e-5 and float(((centres - brute) / brute).abs().mean()) > 1000 * off
    assert gradients["roughness"].shape == (8, 8, 1) and float(gradients["roughness"].abs().max()) > 0


def test_texel_centres_are_those_of_all_views_at_once():
    svbrdf, views = make_material("tiles", 8), renderers.spread_views(3)
    image, gradients = renderers.exact(svbrdf, views, (1,))
    from mitsvbrdf.measure.gradients import render_and_gradients
    whole = render_and_gradients(make_renderer("analytic64"), svbrdf, views)
    assert torch.equal(image, whole.image)
    for name, value in gradients.items():  # float64 sums in another order; measured 4e-16
        assert torch.allclose(value, whole.gradients[name], rtol=1e-12, atol=1e-12)


def test_jittered_rays_come_closer_to_whole_pixels():
    svbrdf, views = make_material("inlay", 16), renderers.spread_views(2)
    image, _ = renderers.exact(svbrdf, views, renderers.POINTS_A_SIDE)
    drawn = [SceneRenderer(samples=n).render(svbrdf, views) for n in (1, 4, 64)]
    one, few, many = (float(((picture - image) / image).abs().mean()) for picture in drawn)
    # stratified: the error goes down as the number of rays goes up, 16 times; measured 18
    assert many < few / 8
    # noise: four rays in a grid would be four times better than the centre alone; measured 4 times worse
    assert few > one
    with pytest.raises(ConfigError, match="samples"):
        SceneRenderer(samples=10)


def test_a_case_has_every_renderer_and_says_who_sat_out(monkeypatch):
    job = renderers.RenderJob("roughconductor", 16, 2, (1, 4), repeats=1)
    found = job.key | {"config": job.settings} | job.run()
    check_benchmark(benchmark([found]), "here")
    names = [(row["renderer"], row["samples"]) for row in found["rows"]]
    assert names == [("analytic64", 1), ("analytic", 1), ("mitsuba", 1), ("mitsuba-scene", 1),
                     ("mitsuba-scene", 4)]
    centres = {row["image"] for row in found["rows"] if row["samples"] == 1}
    assert max(centres) / min(centres) < 1.01  # against whole pixels all centres are off alike
    job = renderers.RenderJob("principled", 16, 2, repeats=1)
    rows = {row["renderer"]: row for row in job.run()["rows"]}
    # The twin is itself but for the order of its sums; float32 within the tolerances of the cross-check.
    assert rows["analytic64"]["image"] == 0 and rows["analytic64"]["gradient"] < 1e-14
    assert all(0 < rows[name]["image"] < 5e-7 and rows[name]["gradient"] < 2e-6 for name in rows
               if name != "analytic64")
    monkeypatch.setattr(renderers, "memory_available", lambda: 150 * 16 * 16 * 2)
    assert [s["renderer"] for s in job.run()["skipped"]] == ["analytic64", "analytic", "mitsuba-scene"]


def test_the_cases_cover_sizes_views_and_samples():
    jobs = renderers.render_jobs((64, 256, 512), (1, 9, 16), (1, 4), 3)
    seen = {(j.bsdf, j.resolution, j.views, j.samples) for j in jobs}
    assert len(jobs) == len(seen) == 2 * (3 + 2 + 1)
    assert {(64, 9), (256, 9), (512, 9), (256, 1), (256, 16)} == {(r, v) for _, r, v, s in seen if not s}
    assert {(64, 9, (1, 4))} == {(r, v, s) for _, r, v, s in seen if s}
