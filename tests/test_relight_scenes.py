"""Stages of previews: which way maps lie on shapes, what surrounds them, and what is left out, against closed forms."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mitsvbrdf.errors import ConfigError
from mitsvbrdf.export.mitsuba import SCENES
from mitsvbrdf.material.made import make_material
from mitsvbrdf.material.maps import CHANNELS, SVBRDF, flat
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.relight import PRESETS, make_stage
from mitsvbrdf.relight.environment import LUMINANCE, make_environment, read_environment, studio, white_luminance
from mitsvbrdf.relight.shapes import heights, relief, shaderball
from mitsvbrdf.render import make_renderer
from mitsvbrdf.render.llvm import mitsuba_module
from mitsvbrdf.system import images
from mitsvbrdf.testing import assert_z_test, random_material
from mitsvbrdf.verify.soak import kernels_made
from mitsvbrdf.views import Views, texel_positions

LAMP = torch.tensor([-2.6, -2.0, 3.2], dtype=torch.float64)  # of the environment "none"
LEAN = torch.tensor([0.4, 0.25], dtype=torch.float64)  # of every normal: right and up
QUARTERS = torch.tensor([[[0.9, 0.1, 0.1], [0.1, 0.9, 0.1]], [[0.1, 0.1, 0.9], [0.9, 0.9, 0.1]]], dtype=torch.float64)


@pytest.fixture(scope="module")
def mi():
    return mitsuba_module()


def drawn(mi, stage, frame=0, spp=16, seed=0):
    return torch.from_numpy(np.array(mi.render(stage.at(mi, frame), spp=spp, seed=seed)))


def unjittered(stage):
    """The stage with one ray through each pixel's middle."""
    stage.scene["sensor"]["sampler"] = {"type": "stratified", "sample_count": 1, "jitter": False}
    return stage


def leaning_quarters(size=64):
    """A matt material: a colour in each quarter, and normals that lean to the right and a little up."""
    colours = QUARTERS.repeat_interleave(size // 2, 0).repeat_interleave(size // 2, 1).float()
    normal = torch.cat((LEAN, (1 - LEAN.square().sum()).sqrt()[None])).float().expand(size, size, 3)
    maps = {"diffuse": colours, "specular": torch.zeros(size, size, 3), "roughness": torch.full((size, size, 1), 0.5),
            "normal": normal}
    return SVBRDF("roughconductor", maps)


def camera_rays(stage):
    """Origin, and unit directions through the pixels' middles, from the camera's matrix: x left, y up, z ahead."""
    sensor = stage.scene["sensor"]
    matrix = torch.from_numpy(np.array(sensor["to_world"].matrix)).double()
    size = sensor["film"]["width"]
    at = (torch.arange(size, dtype=torch.float64) + 0.5) / size * 2 - 1
    y, x = torch.meshgrid(-at, at, indexing="ij")
    tan = math.tan(math.radians(sensor["fov"] / 2))
    ahead = torch.stack((-x * tan, y * tan, torch.ones_like(x)), dim=-1)
    return matrix[:3, 3], F.normalize(ahead @ matrix[:3, :3].T, dim=-1)


def matt(position, normal, right, u, v, ray, intensity, light):
    """Closed form: Lambert's law with the leaning normal and the quarter's colour; and where no edge of a quarter is near.

    Edges are also those where the leaning normal, or the shape's own, begins to face away from camera or light.
    """
    up = torch.linalg.cross(normal, right)
    leaning = LEAN[0] * right + LEAN[1] * up + (1 - LEAN.square().sum()).sqrt() * normal
    to_light = light - position
    ahead = F.normalize(to_light, dim=-1)
    cos = (leaning * ahead).sum(-1).clamp_min(0)
    facing = torch.stack([(n * d).sum(-1) for n in (leaning, normal) for d in (ahead, -ray)])
    colour = QUARTERS[(v.remainder(1) < 0.5).long(), (u.remainder(1) >= 0.5).long()]
    clear = ((2 * u).remainder(1) - 0.5).abs().maximum(((2 * v).remainder(1) - 0.5).abs()) < 0.45
    clear &= facing.amin(dim=0) > 0.02
    return colour * (cos * intensity / math.pi / to_light.square().sum(-1))[..., None], clear


def assert_matches(image, truth, where, limit=5e-6):
    assert where.double().mean() > 0.1
    image, truth = image.double()[where], truth[where]
    assert truth.max() > 0.1 and truth.std() > 0.02
    # Measured in float32: 3e-7 on the patch, 7e-7 on the sphere. A mirrored map, or a normal leaning another way: 0.1 and more.
    assert (image - truth).abs().max() < limit


def test_maps_on_the_patch_are_not_mirrored_and_normals_lean_along_them(mi):
    stage = unjittered(make_stage(mi, leaning_quarters(), "sweep", size=(48, 48), tiling=2))
    light = torch.tensor(np.array(stage.place(0)["light.position"]).ravel(), dtype=torch.float64)
    origin, ray = camera_rays(stage)
    position = origin - ray * (origin[2] / ray[..., 2:])
    z, x = torch.tensor([0.0, 0.0, 1.0]).double(), torch.tensor([1.0, 0.0, 0.0]).double()
    truth, clear = matt(position, z.expand_as(ray), x.expand_as(ray), 2 * (position[..., 0] + 0.5),
                        2 * (position[..., 1] + 0.5), ray, 0.8 * math.pi * light.square().sum(), light)
    assert_matches(drawn(mi, stage, spp=1), truth, clear & (position[..., :2].abs().amax(-1) < 0.49))


def test_maps_on_the_sphere_are_not_mirrored_and_normals_lean_along_them(mi):
    stage = unjittered(make_stage(mi, leaning_quarters(), "sphere", environment="none", size=(48, 48)))
    origin, ray = camera_rays(stage)
    along = (ray @ origin)
    root = along.square() - origin.square().sum() + 1
    normal = origin + ray * (-along - root.clamp_min(0).sqrt())[..., None]
    tilt = math.radians(10)
    pole = torch.tensor([0.0, math.sin(tilt), math.cos(tilt)]).double()
    front = torch.tensor([0.0, -math.cos(tilt), math.sin(tilt)]).double()
    right = F.normalize(torch.linalg.cross(pole.expand_as(normal), normal), dim=-1)
    u = torch.atan2(normal[..., 0], normal @ front) / math.pi + 0.5
    v = 1 - torch.acos((normal @ pole).clamp(-1, 1)) / math.pi
    truth, clear = matt(normal, normal, right, u, v, ray, 0.8 * math.pi * LAMP.square().sum(), LAMP)
    assert_matches(drawn(mi, stage, spp=1), truth, clear & (root > 0))


def test_maps_on_the_shader_ball_are_not_mirrored_and_normals_lean_along_them(mi):
    stage = unjittered(make_stage(mi, leaning_quarters(), "shaderball", environment="none", size=(48, 48)))
    stage.scene["integrator"]["max_depth"] = 2
    origin, ray = camera_rays(stage)
    scene = stage.at(mi)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*ray.reshape(-1, 3).T.float().numpy())))
    position, normal = (torch.from_numpy(np.array(value)).T.reshape(48, 48, 3).double() for value in (hit.p, hit.sh_frame.n))
    right = F.normalize(torch.stack((-position[..., 1], position[..., 0], torch.zeros(48, 48)), dim=-1), dim=-1)
    u = torch.atan2(position[..., 0], -position[..., 1]) / math.pi + 0.5
    v = torch.where(position[..., 2] > 1.1, 0.75, 0.25)  # the widest place is the middle of the map
    truth, clear = matt(position, normal, right, u, v, ray, 0.8 * math.pi * LAMP.square().sum(), LAMP)
    belly = (position[..., 2] > 0.6) & (position[..., 2] < 1.6) & ((position[..., 2] - 1.1).abs() > 0.1)
    outside = position[..., :2].norm(dim=-1) > 0.8
    # Tangents are those of flat triangles, up to half of 360 / 96 degrees off: measured 0.0085.
    assert_matches(drawn(mi, stage, spp=1), truth, clear & belly & outside, limit=0.02)


def test_no_normal_turns_a_rim_black(mi, tmp_path):
    images.write_exr(tmp_path / "white.exr", torch.ones(4, 8, 3))
    stage = make_stage(mi, leaning_quarters(), "sphere", environment=str(tmp_path / "white.exr"), size=(48, 48))
    origin, ray = camera_rays(stage)
    inside = (ray @ origin).square() - origin.square().sum() + 1 > 0.05
    picture = drawn(mi, stage, spp=256).amax(dim=-1)[inside]
    # A matt surface in even light is as bright as its colour, less what leaning normals see of the sphere itself.
    assert picture.min() > 0.35 and picture.max() < 0.8  # measured 0.50 and 0.72; 0 where normals face away


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_novel_is_what_the_float64_twin_draws(mi, bsdf):
    material = random_material(bsdf, 16)
    views = Views.of([[0.3, -0.2, 1.8]], intensity=[[8.0, 10.0, 9.0]])
    stage = make_stage(mi, material, "novel", size=(16, 16), frames=3, views=views)
    assert not stage.views.co_located and torch.equal(stage.views.camera[1], views.camera[0])
    truth = make_renderer("analytic64").render(material, stage.views)
    middle = torch.stack([drawn(mi, unjittered(stage), frame, spp=1) for frame in range(3)])
    error = image_error(middle, truth)
    assert error["mean"] < 1e-6 and error["p99.9"] < 1e-5  # measured 1.8e-7 and 2.6e-6


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_novel_differs_from_pixel_averages_by_noise_alone(mi, bsdf):
    material, fine = random_material(bsdf, 12), 12
    stage = make_stage(mi, material, "novel", size=(12, 12))
    scene = stage.at(mi)
    passes = torch.stack([torch.from_numpy(np.array(mi.render(scene, spp=64, seed=seed))) for seed in range(16)])
    near = material.map(lambda t: t.repeat_interleave(fine, 0).repeat_interleave(fine, 1))
    truth = make_renderer("analytic64").render(near, stage.views)[0]
    truth = truth.reshape(12, fine, 12, fine, 3).mean(dim=(1, 3))
    assert_z_test(passes.mean(dim=0), passes, truth)


@pytest.mark.parametrize("suffix", ["studio", "sunsky", ".exr", ".hdr"])
def test_white_that_faces_up_has_luminance_0_8(mi, suffix, tmp_path):
    name = suffix
    if suffix.startswith("."):
        name = str(tmp_path / f"sky{suffix}")
        image = 5 * torch.rand(9, 24, 3, generator=torch.Generator().manual_seed(1))
        image[2, 5] = 300
        write_picture(image, name)
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "direct"}, **make_environment(mi, name).emitters,
        "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
                   "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}},
        "plane": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}})
    white = torch.from_numpy(np.array(mi.render(scene, spp=16384)))[..., :3].mean(dim=(0, 1))
    # 262,144 samples: noise below 0.2 %; the sunsky file's scale has four digits.
    assert float(white.double() @ LUMINANCE) == pytest.approx(0.8, rel=0.01)


def write_picture(image, name):
    if name.endswith(".exr"):
        images.write_exr(tmp := type(SCENES)(name), image)
        assert tmp.is_file()
    else:
        import cv2
        cv2.imwrite(name, np.ascontiguousarray(image.numpy()[..., ::-1]))


def test_a_radiance_file_is_read_in_the_order_red_green_blue(tmp_path):
    # RGBE (Ward 1991): mantissa / 256 * 2 ** (exponent - 128), top row first.
    pixels = [(128, 64, 32, 129), (0, 0, 200, 128)] * 3 + [(64, 0, 0, 131)] * 2
    path = tmp_path / "sky.hdr"
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 2\n" + bytes(v for pixel in pixels for v in pixel))
    image = read_environment(path)
    assert image[0].tolist() == [[1, 0.5, 0.25], [0, 0, 200 / 256]] and image[3].tolist() == [[2, 0, 0]] * 2


def test_white_luminance_of_a_half_lit_sky():
    # Closed form: the upper hemisphere at 1 gives 1; the cap within 60 degrees of the zenith gives sin^2 60 = 3/4.
    assert white_luminance(torch.ones(5, 4, 3)) == pytest.approx(1, rel=1e-5)
    theta = torch.linspace(0, math.pi, 1801)
    cap = (theta < math.pi / 3).double()[:, None, None].expand(-1, 2, 3)
    assert white_luminance(cap) == pytest.approx(0.75, rel=2e-3)  # one row of 1800 is the edge
    assert white_luminance(torch.full((5, 4, 3), 1e38)) == pytest.approx(1e38, rel=1e-5)  # a row's sum is no float32


def test_the_middle_of_an_environment_is_ahead_and_its_right_is_right(mi, tmp_path):
    image = torch.full((64, 128, 3), 0.1)
    image[:32, 64:, 0], image[:32, :64, 1], image[32:, :, 2] = 1.0, 1.0, 1.0  # red right, green left, blue below
    images.write_exr(tmp_path / "sky.exr", image)
    around = make_environment(mi, str(tmp_path / "sky.exr"))
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path"}, **around.emitters,
        "sensor": {"type": "perspective", "fov": 80,
                   "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 1, 0], [0, 0, 1]),
                   "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}}})

    def colours():
        picture = np.array(mi.render(scene, spp=16))[..., :3]
        return [int(picture[row, column].argmax()) for row, column in ((1, 1), (1, 6), (6, 1), (6, 6))]

    assert colours() == [1, 0, 2, 2]
    held = mi.traverse(scene)
    for key, value in around.turned(180).items():
        held[key] = value
    held.update()
    assert colours() == [0, 1, 2, 2]


@pytest.mark.parametrize("what, change", [
    ("no file", None), ("NaN", lambda i: i.index_fill_(0, torch.tensor([2]), math.nan)), ("negative", lambda i: i.sub_(1.5)),
    ("2 x 3 pixels", lambda i: i.resize_(2, 2, 3)), ("black there", lambda i: i[:5].zero_())])
def test_environments_that_cannot_be_used_are_refused(mi, what, change, tmp_path):
    path = tmp_path / "sky.exr"
    if change:
        image = torch.ones(8, 16, 3)
        change(image)
        images.write_exr(path, image)
    with pytest.raises(ConfigError, match=what):
        make_environment(mi, str(path))


def test_files_that_are_no_environment_are_refused(mi, tmp_path):
    for name in ("sky.exr", "sky.hdr"):
        (tmp_path / name).write_bytes(b"no picture")
        with pytest.raises(ConfigError, match="readable"):
            make_environment(mi, str(tmp_path / name))
    for name in ("sky.png", "stuido"):
        with pytest.raises(ConfigError, match="studio"):
            make_environment(mi, name)


def test_the_studio_is_lit_from_three_sides():
    image = studio(64)
    assert image.shape == (64, 128, 3) and bool((image > 0).all())
    bright = (image.amax(dim=-1) > 2).long()
    assert int(bright.sum()) < 0.1 * bright.numel()
    columns = bright.any(dim=0).long()
    assert int((columns.diff(append=columns[:1]) == 1).sum()) == 3


@pytest.mark.parametrize("bsdf", CHANNELS)
@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_draws_and_moves_without_new_kernels(mi, preset, bsdf):
    stage = make_stage(mi, random_material(bsdf, 16), preset, size=(24, 24), frames=4, tiling=2)
    for none in (-1, 4):
        with pytest.raises(ConfigError, match="a frame below 4"):
            stage.at(mi, none)
    assert stage.name == preset and stage.frames == 4 and stage.scene["integrator"]["type"] == "path"
    scene = mi.load_dict(stage.scene)
    held = mi.traverse(scene)
    pictures, kernels = [], []
    for frame in range(3):
        stage.move(held, frame)
        pictures.append(torch.from_numpy(np.array(mi.render(scene, spp=16, seed=0))))
        kernels.append(kernels_made())
    assert kernels[0] > 0 and kernels[1:] == kernels[:1] * 2
    for picture in pictures:
        assert picture.shape == (24, 24, 3) and bool(torch.isfinite(picture).all()) and 0.02 < float(picture.mean()) < 2
    assert float((pictures[1] - pictures[0]).abs().mean()) > 0.01


@pytest.mark.parametrize("environment", ["none", "sunsky"])
@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_goes_with_every_environment(mi, preset, environment):
    stage = make_stage(mi, make_material("tiles", 16), preset, environment=environment, size=(16, 16))
    picture = drawn(mi, stage)
    assert bool(torch.isfinite(picture).all()) and float(picture.mean()) > 0.02
    assert ("environment" in stage.scene) == (environment != "none")
    assert ("environment" in dict(stage.left_out)) == (environment == "none")


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
    assert torch.allclose(still, turned, rtol=0.01)  # the same samples: 0.04 %; left behind, it is half as bright


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
    assert {"specular lobe", "normal map", "displacement", "light after 1 reflection"} <= dict(stage.left_out).keys()
    full = make_stage(mi, make_material("inlay", 8), "turntable")
    assert full.scene["material"]["type"] == "normalmap" and "specular lobe" not in dict(full.left_out)
    lobe = full.scene["material"]["bsdf"]["specular"]
    assert lobe["type"] == "roughconductor" and lobe["eta"]["type"] == "bitmap"  # its real Fresnel curve


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
    assert dict(ball.left_out)[f"light after {depth - 1} reflections"]
    ball.scene["integrator"]["max_depth"] = 2
    assert float(drawn(mi, ball, spp=64).mean()) < 0.97 * float(enough.mean())
    ball.scene["integrator"]["max_depth"] = 3 * depth
    assert float(drawn(mi, ball, spp=64).mean()) == pytest.approx(float(enough.mean()), rel=1e-3)


@pytest.mark.parametrize("options, what", [
    ({"preset": "spere"}, "preset of"), ({"preset": "sphere", "displacement": 1.0}, "--preset sweep,turntable,novel"),
    ({"preset": "sweep", "displacement": -1.0}, "displacement from 0"), ({"preset": "sweep", "tiling": 0}, "tiling"),
    ({"preset": "sweep", "displacement": 1.0, "tiling": 65}, "tiling"),
    ({"preset": "sweep", "frames": 0}, "1 frame"), ({"preset": "novel", "size": (8, 9)}, "square picture")])
def test_options_that_do_not_go_together_are_refused(mi, options, what):
    with pytest.raises(ConfigError, match=what):
        make_stage(mi, flat(2), **options)


def test_what_is_left_out_is_said_as_it_is(mi):
    floor = [dict(make_stage(mi, flat(2), "sphere", environment=name).left_out).get("floor") for name in ("studio", "none")]
    assert "goes on below" in floor[0] and "nothing surrounds" in floor[1]
    for share, said in ((0.0, "0%"), (0.9, "180%")):  # of what arrives, diffuse and specular
        left_out = make_stage(mi, flat(2, diffuse=share, specular=share), "shaderball").left_out
        assert any(why == f"the material reflects {said} on average" for _, why in left_out)


def bump(size):
    """A Gaussian bump beside the middle: its height less the mean, and its normals."""
    x, y, _ = texel_positions(size).unbind(-1)
    height = 0.05 * torch.exp(-((x - 0.1) ** 2 + (y + 0.2) ** 2) / 0.02)
    right, up = -height * (x - 0.1) / 0.01, -height * (y + 0.2) / 0.01
    return height - height.mean(), F.normalize(torch.stack((-right, -up, torch.ones_like(x)), dim=-1), dim=-1)


def test_heights_of_a_bump_and_of_a_slope():
    height, normal = bump(128)
    assert (heights(normal) - height).abs().max() < 1e-3 * 0.05  # measured 7.7e-4: slopes are averaged between texels
    coarse, normal = bump(64)
    assert (heights(normal) - coarse).abs().max() < 4e-3 * 0.05  # and 3.1e-3: of second order
    tilted = F.normalize(torch.tensor([0.1, -0.3, 1.0], dtype=torch.float64), dim=0).expand(16, 16, 3)
    x, y, _ = texel_positions(16).unbind(-1)
    assert (heights(tilted) - (-0.1 * x + 0.3 * y)).abs().max() < 1e-12  # exact for a plane


def test_a_normal_that_lies_down_is_no_tower():
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).repeat(64, 64, 1)
    normal[20, 30] = F.normalize(torch.tensor([1.0, 0.0, 1e-5]).double(), dim=0)  # the lowest that maps may have
    # As high as a slope of 10: measured 0.028 patch sides, and 285 without an end to slopes.
    assert 0.01 < heights(normal).abs().max() < 0.05


def test_a_displaced_patch_is_as_high_as_its_normals_say(mi):
    height, normal = bump(64)
    material = SVBRDF("roughconductor", {**flat(64).maps, "normal": normal.float()})
    stage = make_stage(mi, material, "sweep", displacement=0.5, tiling=2)
    scene = stage.at(mi)
    tile = texel_positions(64)[..., :2].reshape(-1, 2) / 2
    for left, low in ((-0.25, -0.25), (0.25, 0.25)):
        x, y = (tile + torch.tensor([left, low])).float().T.numpy()
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 1), mi.Vector3f(0, 0, -1)))
        found = torch.from_numpy(np.array(hit.p.z)).double().reshape(64, 64)
        assert (found - height / 4).abs().max() < 4e-3 * 0.05 / 4  # the error of the heights themselves, see above
        assert np.allclose(np.array(hit.sh_frame.n), [[0], [0], [1]], atol=1e-6)  # the normal map is not applied twice
        assert np.allclose(np.array(hit.sh_frame.s), [[1], [0], [0]], atol=1e-6)


def test_a_relief_reaches_the_edges_of_the_patch():
    mesh = relief(torch.zeros(5, 5))
    assert mesh.positions.min(axis=0).tolist() == [-0.5, -0.5, 0] and mesh.positions.max(axis=0).tolist() == [0.5, 0.5, 0]
    corners = mesh.positions[mesh.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    assert area.min() > 0 and area.sum() == pytest.approx(1, rel=1e-12)


def test_the_shader_balls_file_is_its_recipe_and_its_maps_keep_their_angles(mi):
    mesh = shaderball()
    kept = mi.traverse(mi.load_dict({"type": "ply", "filename": str(SCENES / "shaderball.ply")}))
    for key, value in (("vertex_positions", mesh.positions), ("vertex_normals", mesh.normals), ("vertex_texcoords", mesh.uv)):
        assert np.allclose(np.array(kept[key]), value.ravel(), atol=1e-6)
    assert np.array_equal(np.array(kept["faces"]), mesh.faces.ravel())
    corners, uv = mesh.positions[mesh.faces], mesh.uv[mesh.faces]
    edges, steps = corners[:, 1:] - corners[:, :1], uv[:, 1:] - uv[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    assert corners[..., 2].min() > -0.01 and corners[..., 2].max() < 2
    whole = area > 1e-6  # at the axis every second triangle is a line
    frame = np.linalg.qr(edges[whole].transpose(0, 2, 1))
    jacobian = steps[whole].transpose(0, 2, 1) @ np.linalg.inv(frame[1])
    largest, smallest = np.linalg.svd(jacobian, compute_uv=False).T
    # The dish seen from above: 1.36 at worst. A tile's side is 2.1 to 3.4, of the ball's 2.1 across.
    assert (largest / smallest).max() < 1.5
    assert 1.9 < 1 / largest.max() and 1 / smallest.min() < 3.5


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.xml")), ids=lambda path: path.name)
def test_scene_files_open_in_plain_mitsuba(mi, path):
    scene = mi.load_file(str(path))
    assert scene.emitters()
    if path.name != "sunsky.xml":
        assert float(np.array(mi.render(scene, spp=1)).mean()) > 0.02
