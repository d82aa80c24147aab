"""Stages of previews: presets, what they load and how they move."""

import gc

import numpy as np
import pytest
import torch
from helpers.soaking import kernels_made
from helpers.stages import drawn, unjittered
from helpers.variants import mostly_slow

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.export.mitsuba import SCENES
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, flat
from mitsvbrdf.relight.environment import make_environment
from mitsvbrdf.relight.stage import PRESETS, make_stage, mirrored
from mitsvbrdf.render.analytic import AnalyticRenderer
from mitsvbrdf.testing import random_material
from mitsvbrdf.views import Views


def each_with(every, choices):
    """Each preset with each choice; quick: all of preset ``every``."""
    return mostly_slow([(preset, choice) for preset in PRESETS for choice in choices], every)


@pytest.mark.parametrize("preset, bsdf", each_with("sphere", CHANNELS))
def test_every_preset_draws_and_moves_without_new_kernels(mi, preset, bsdf):
    stage = make_stage(mi, random_material(bsdf, 16), preset, size=(24, 24), frames=4, tiling=2)
    assert stage.name == preset and stage.frames == 4 and stage.scene["integrator"]["type"] == "path"
    scene = mi.load_dict(stage.scene)
    held = mi.traverse(scene)
    pictures, kernels = [], []
    # a kernel calls every BSDF that lives: scenes of before, freed on the way, would have it made again
    gc.collect()
    for frame in range(3):
        stage.move(held, frame)
        pictures.append(torch.from_numpy(np.array(mi.render(scene, spp=16, seed=0))))
        kernels.append(kernels_made())
    assert kernels[0] > 0 and kernels[1:] == kernels[:1] * 2
    for picture in pictures:
        assert picture.shape == (24, 24, 3) and bool(torch.isfinite(picture).all()) and 0.02 < float(
            picture.mean()) < 2
    assert float((pictures[1] - pictures[0]).abs().mean()) > 0.01


@pytest.mark.parametrize("preset, environment", each_with("sphere", ["none", "sunsky"]))
def test_every_preset_goes_with_every_environment(mi, preset, environment):
    stage = make_stage(mi, make_material("tiles", 16), preset, environment=environment, size=(16, 16))
    picture = drawn(mi, stage)
    assert bool(torch.isfinite(picture).all()) and float(picture.mean()) > 0.02
    assert ("environment" in stage.scene) == (environment != "none")
    assert ("environment" in dict(stage.omitted)) == (environment == "none")


def test_the_turntable_turns_the_patch_counter_clockwise_and_nothing_else(mi):
    material = random_material("roughconductor", 8)
    turned = material.map(lambda t: torch.rot90(t, 1, (0, 1)).contiguous())
    x, y, z = turned["normal"].unbind(-1)
    turned.maps["normal"] = torch.stack((-y, x, z), dim=-1)
    frame = [unjittered(make_stage(mi, each, "turntable", environment="none", size=(32, 32), frames=4))
             for each in (material, turned)]
    after, instead = drawn(mi, frame[0], 1, spp=1), drawn(mi, frame[1], 0, spp=1)
    assert float((drawn(mi, frame[0], 0, spp=1) - instead).abs().mean()) > 0.02
    # Measured 5e-7; rays that meet the other side of an edge may differ by more.
    assert float((after - instead).abs().double().quantile(0.99)) < 1e-5


def test_the_studio_stays_with_the_camera_of_the_turntable(mi):
    stage = make_stage(mi, flat(2, specular=0.2, roughness=0.3), "turntable", size=(16, 16), frames=6)
    still, turned = (drawn(mi, stage, frame, spp=64)[5:11, 5:11].mean(dim=(0, 1)) for frame in (0, 2))
    # the same samples: 0.04 %; left behind, it is half as bright
    assert torch.allclose(still, turned, rtol=0.01)


def test_the_sun_turns_counter_clockwise(mi):
    around = make_environment(mi, "sunsky")
    x, y, z = around.emitters["environment"]["sun_direction"]
    scene = mi.load_dict({"type": "scene", **around.emitters, "floor": {"type": "rectangle"}})
    held = mi.traverse(scene)

    def radiance(direction):
        seen = scene.ray_intersect(mi.Ray3f([0, 0, 1], mi.Vector3f(*direction)))
        return float(np.array(scene.environment().eval(seen)).max())

    assert radiance((x, y, z)) > 100 * radiance((-y, x, z))
    for key, value in around.turned(90).items():
        held[key] = value
    held.update()
    assert radiance((-y, x, z)) > 100 * radiance((x, y, z))


def test_defaults_of_presets(mi):
    frames = {preset: make_stage(mi, flat(2), preset, size=(8, 8)).frames for preset in PRESETS}
    assert [preset for preset, count in frames.items() if count > 1] == ["sweep", "turntable"]


def test_only_what_a_material_needs_is_loaded(mi):
    stage = make_stage(mi, flat(4, specular=0.0), "turntable")
    assert stage.scene["material"]["type"] == "diffuse"
    assert {"specular lobe", "normal map", "displacement",
            "light after 1 reflection"} <= dict(stage.omitted).keys()
    full = make_stage(mi, make_material("inlay", 8), "turntable")
    assert full.scene["material"]["type"] == "normalmap" and "specular lobe" not in dict(full.omitted)
    lobe = full.scene["material"]["bsdf"]["specular"]
    assert lobe["type"] == "roughconductor" and lobe["eta"]["type"] == "bitmap"  # its real Fresnel curve


@pytest.mark.slow
def test_a_sphere_needs_one_reflection_and_a_shader_ball_more(mi):
    material = make_material("tiles", 32)
    sphere = make_stage(mi, material, "sphere", size=(24, 24))
    once = drawn(mi, sphere)
    assert sphere.scene["integrator"]["max_depth"] == 2
    sphere.scene["integrator"]["max_depth"] = 8
    assert torch.equal(drawn(mi, sphere), once)  # the same samples, and no ray meets the sphere again
    ball = make_stage(mi, material, "shaderball", size=(24, 24))
    enough = drawn(mi, ball, spp=64)
    depth = ball.scene["integrator"]["max_depth"]
    assert dict(ball.omitted)[f"light after {depth - 1} reflections"]
    ball.scene["integrator"]["max_depth"] = 2
    assert float(drawn(mi, ball, spp=64).mean()) < 0.97 * float(enough.mean())
    ball.scene["integrator"]["max_depth"] = 3 * depth
    assert float(drawn(mi, ball, spp=64).mean()) == pytest.approx(float(enough.mean()), rel=1e-3)


@pytest.mark.parametrize("options, what", [
    ({"preset": "spere"}, "preset of"), ({"preset": "sweep", "tiling": 0}, "tiling"),
    ({"preset": "sweep", "tiling": 65}, "tiling"), ({"preset": "sweep", "frames": 0}, "1 frame"),
    ({"preset": "novel", "size": (8, 9)}, "square picture")])
def test_options_that_do_not_go_together_are_refused(mi, options, what):
    with pytest.raises(ConfigError, match=what):
        make_stage(mi, flat(2), **options)


def test_what_is_omitted_is_said_as_it_is(mi):
    floor = [dict(make_stage(mi, flat(2), "sphere", environment=name).omitted).get("floor")
             for name in ("studio", "none")]
    assert "goes on below" in floor[0] and "nothing surrounds" in floor[1]
    for share, said in ((0.0, "0%"), (0.9, "180%")):  # of what arrives, diffuse and specular
        omitted = make_stage(mi, flat(2, diffuse=share, specular=share), "shaderball").omitted
        assert any(why == f"the material reflects {said} on average" for _, why in omitted)


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.xml")), ids=lambda path: path.name)
def test_scene_files_open_in_plain_mitsuba(mi, path, two_threads):
    scene = mi.load_file(str(path))
    assert scene.emitters()
    if path.name != "sunsky.xml":
        assert float(np.array(mi.render(scene, spp=1)).mean()) > 0.02


def test_mirror_images_look_as_in_a_mirror():
    side = 8
    material = random_material("roughconductor", side).to(torch.float64)
    four, renderer = mirrored(material), AnalyticRenderer(torch.float64)
    camera, light = [0.3, -0.2, 1.5], [-0.5, 0.4, 1.0]
    truth = renderer.render(material, Views.of([camera], [light]))[0]
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        rows, columns = slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)
        part = SVBRDF(material.bsdf,
                      {name: value[rows, columns].contiguous() for name, value in four.maps.items()})
        turned = torch.tensor([1.0 - 2 * column, 1.0 - 2 * row, 1.0])
        views = Views.of(*((torch.tensor([place]) * turned).tolist() for place in (camera, light)))
        found = renderer.render(part, views)[0]
        flipped = found.flip([axis for axis, on in ((0, row), (1, column)) if on])
        assert truth.max() > 0.05 and torch.allclose(flipped, truth, rtol=1e-6, atol=1e-9)
