"""Which way maps lie on shapes, and reliefs, against closed forms."""

import math
import runpy
import tomllib

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from helpers import ROOT
from helpers.stages import drawn, unjittered
from packaging.requirements import Requirement

from mitsvbrdf.export.mitsuba import SCENES
from mitsvbrdf.io import images
from mitsvbrdf.material.maps import CHANNELS, SVBRDF
from mitsvbrdf.material.relief import occlusion
from mitsvbrdf.measure.metrics import image_error
from mitsvbrdf.relight.stage import make_stage
from mitsvbrdf.render import make_renderer
from mitsvbrdf.testing import random_material, z_test
from mitsvbrdf.views import Views, texel_positions

LAMP = torch.tensor([-2.6, -2.0, 3.2], dtype=torch.float64)  # of the environment "none"
LEAN = torch.tensor([0.4, 0.25], dtype=torch.float64)  # of every normal: right and up
QUARTERS = torch.tensor([[[0.9, 0.1, 0.1], [0.1, 0.9, 0.1]], [[0.1, 0.1, 0.9], [0.9, 0.9, 0.1]]],
                        dtype=torch.float64)


def leaning_quarters(size=64):
    """A matt material: a colour in each quarter, and normals that lean to the right and a little up."""
    colours = QUARTERS.repeat_interleave(size // 2, 0).repeat_interleave(size // 2, 1).float()
    normal = torch.cat((LEAN, (1 - LEAN.square().sum()).sqrt()[None])).float().expand(size, size, 3)
    maps = {"diffuse": colours, "specular": torch.zeros(size, size, 3),
            "roughness": torch.full((size, size, 1), 0.5), "normal": normal}
    return SVBRDF("roughconductor", maps)


def camera_rays(stage):
    """Origin, and unit directions through the pixels' middles, from the camera's matrix."""
    sensor = stage.scene["sensor"]
    matrix = torch.from_numpy(np.array(sensor["to_world"].matrix)).double()
    size = sensor["film"]["width"]
    at = (torch.arange(size, dtype=torch.float64) + 0.5) / size * 2 - 1
    y, x = torch.meshgrid(-at, at, indexing="ij")
    tan = math.tan(math.radians(sensor["fov"] / 2))
    ahead = torch.stack((-x * tan, y * tan, torch.ones_like(x)), dim=-1)
    return matrix[:3, 3], F.normalize(ahead @ matrix[:3, :3].T, dim=-1)


def matt(position, normal, right, u, v, ray, intensity, light):
    """Lambert's law with the leaning normal and the quarter's colour; where no edge is near.

    Edges are also those where the leaning normal, or the shape's own, begins to face away from either.
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
    # Measured in float32: 3e-7 on the patch, 7e-7 on the sphere. A mirrored map, or a normal leaning another
    # way: 0.1 and more.
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
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*origin.tolist()),
                                       mi.Vector3f(*ray.reshape(-1, 3).T.float().numpy())))
    position, normal = (torch.from_numpy(np.array(value)).T.reshape(48, 48, 3).double()
                        for value in (hit.p, hit.sh_frame.n))
    right = F.normalize(torch.stack((-position[..., 1], position[..., 0], torch.zeros(48, 48)), dim=-1),
                        dim=-1)
    u = torch.atan2(position[..., 0], -position[..., 1]) / math.pi + 0.5
    v = torch.where(position[..., 2] > 1.1, 0.75, 0.25)  # the widest place is the middle of the map
    truth, clear = matt(position, normal, right, u, v, ray, 0.8 * math.pi * LAMP.square().sum(), LAMP)
    belly = (position[..., 2] > 0.6) & (position[..., 2] < 1.6) & ((position[..., 2] - 1.1).abs() > 0.1)
    outside = position[..., :2].norm(dim=-1) > 0.8
    # Tangents are those of flat triangles, up to half of 360 / 96 degrees off: measured 0.0085.
    assert_matches(drawn(mi, stage, spp=1), truth, clear & belly & outside, limit=0.02)


def test_no_normal_turns_a_rim_black(mi, tmp_path):
    images.write_exr(tmp_path / "white.exr", torch.ones(4, 8, 3))
    stage = make_stage(mi, leaning_quarters(), "sphere", environment=str(tmp_path / "white.exr"),
                       size=(48, 48))
    origin, ray = camera_rays(stage)
    inside = (ray @ origin).square() - origin.square().sum() + 1 > 0.05
    picture = drawn(mi, stage, spp=256).amax(dim=-1)[inside]
    # A matt surface in even light is as bright as its colour, less what leaning normals see of the sphere
    # itself.
    assert picture.min() > 0.35 and picture.max() < 0.8  # measured 0.50 and 0.72; 0 where normals face away


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_novel_is_what_the_float64_twin_draws(mi, bsdf):
    material = random_material(bsdf, 16)
    views = Views.of([[0.3, -0.2, 1.8]], intensity=[[8.0, 10.0, 9.0]])
    stage = make_stage(mi, material, "novel", size=(16, 16), frames=3, views=views)
    assert not torch.equal(stage.views.camera, stage.views.light)
    assert torch.equal(stage.views.camera[1], views.camera[0])
    truth = make_renderer("analytic64").render(material, stage.views)
    middle = torch.stack([drawn(mi, unjittered(stage), frame, spp=1) for frame in range(3)])
    error = image_error(middle, truth)
    assert error["mean"] < 1e-6 and error["p99.9"] < 1e-5  # measured 1.8e-7 and 2.6e-6


@pytest.mark.parametrize("bsdf", CHANNELS)
def test_novel_differs_from_pixel_averages_by_noise_alone(mi, bsdf):
    material, fine = random_material(bsdf, 12), 12
    stage = make_stage(mi, material, "novel", size=(12, 12))
    scene = stage.at(mi)
    passes = torch.stack([torch.from_numpy(np.array(mi.render(scene, spp=64, seed=seed)))
                          for seed in range(16)])
    near = material.map(lambda t: t.repeat_interleave(fine, 0).repeat_interleave(fine, 1))
    truth = make_renderer("analytic64").render(near, stage.views)[0]
    truth = truth.reshape(12, fine, 12, fine, 3).mean(dim=(1, 3))
    assert z_test(passes.mean(dim=0), passes, truth).passed


def bump(size):
    """The height of a Gaussian bump beside the middle, less its mean."""
    x, y, _ = texel_positions(size).unbind(-1)
    height = 0.05 * torch.exp(-((x - 0.1) ** 2 + (y + 0.2) ** 2) / 0.02)
    return height - height.mean()


def test_the_shader_balls_file_is_its_recipe_and_its_maps_keep_their_angles(mi):
    mesh = runpy.run_path(str(SCENES / "shaderball.py"))["shaderball"]()
    kept = mi.traverse(mi.load_dict({"type": "ply", "filename": str(SCENES / "shaderball.ply")}))
    for key, value in (("vertex_positions", mesh.positions), ("vertex_normals", mesh.normals),
                       ("vertex_texcoords", mesh.uv)):
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


def test_rays_see_as_much_sky(mi):
    """Radiance of white ground with this relief under an even sky, one bounce: the share of the sky."""
    height, ball = 4 * bump(64), runpy.run_path(str(SCENES / "shaderball.py"))
    positions = texel_positions(64).numpy().copy()
    positions[..., 2] = height.numpy()
    upward = np.broadcast_to([0.0, 0.0, 1.0], positions.shape)
    relief = ball["sheet"](positions[::-1], upward, positions[::-1, :, :2])
    white = mi.load_dict({"type": "diffuse", "reflectance": 1.0})
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "direct"},
                          "sky": {"type": "constant", "radiance": 1.0},
                          "patch": ball["mitsuba_mesh"](mi, relief, "patch", white),
                          "sensor": {"type": "orthographic", "to_world": mi.ScalarTransform4f().look_at(
                              [0, 0, 2], [0, 0, 0], [0, 1, 0]) @ mi.ScalarTransform4f().scale([0.5, 0.5, 1]),
                                     "film": {"type": "hdrfilm", "width": 64, "height": 64,
                                              "rfilter": {"type": "box"}, "pixel_format": "rgb"}}})
    seen = torch.tensor(mi.render(scene, spp=256, seed=0).numpy())[..., 0]
    found = occlusion(height)
    # Rays weigh by the slope's own normal, ours by the plane's, and they leave the patch at its border:
    # measured 0.94.
    inner = slice(8, 56)
    assert torch.corrcoef(torch.stack((seen[inner, inner].flatten().double(),
                                       found[inner, inner].flatten())))[0, 1] > 0.8


def test_the_ceiling_of_mitsuba():
    # 3.10 rewrites Mesh, which mitsuba_mesh makes: raise the ceiling when the tests above pass with it.
    asked = map(Requirement, tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"])
    mitsuba = next(each for each in asked if each.name == "mitsuba")
    assert [version for version in ("3.8.0", "3.9.0", "3.9.9", "3.10.0") if version in mitsuba.specifier] == [
        "3.9.0", "3.9.9"]
