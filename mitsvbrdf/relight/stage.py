"""Stages of previews: a scene of ``scenes/`` with the material, and how camera and light move."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from ..errors import ConfigError
from ..export.mitsuba import read_scene, view_parameters
from ..io.entry import entry
from ..material.maps import SVBRDF
from ..render.bsdf import needed_maps, plugin, slot_values
from ..render.exclusive import using_mitsuba
from ..render.needs import Needs, material_needs
from ..views import Views, nine_view_grid
from .environment import WHITE_LUMINANCE, Environment, make_environment
from .passes import shown

Place = Callable[[int], dict[str, Any]]

# Default environment, frames and samples a pixel of each preset (docs/relight.md shows the presets). These
# samples give an estimated error of about 0.01 (a turntable of shiny material: 0.0125).
PRESETS = {"sweep": ("none", 48, 16), "turntable": ("studio", 72, 128), "sphere": ("studio", 1, 128),
           "shaderball": ("studio", 1, 128), "novel": ("none", 1, 16)}
OWN_LIGHT = ("sweep", "novel")
ROUND = ("sphere", "shaderball")
SAMPLES = 16  # of the sphere on a page; low-discrepancy (a power of 4): 1.3 times the noise of 64 independent
DIMMEST = 1e-3  # reflections are followed until less than this share of the light is left
OFF_LENS = 0.5  # radius of the circle of lights around the lens, as a share of the camera's height
MOST_TILES = 64  # along a side


@dataclass(frozen=True)
class Stage:
    """A scene to be rendered, frame by frame."""

    name: str  # the preset
    scene: dict[str, Any]  # for mi.load_dict: one sensor (hdrfilm, rgb, float32, box), integrator path
    frames: int  # 1 for a still
    samples: int  # a pixel
    place: Place  # frame number -> values by key of mi.traverse(scene); none of them needs another kernel
    omitted: tuple[tuple[str, str], ...]  # (what, why) of each thing that this preview omits
    views: Views | None = None  # for novel: camera and light of each frame

    def move(self, held: Any, frame: int) -> None:
        """Set the scene to a frame; ``held`` is ``mi.traverse(scene)``."""
        for key, value in self.place(frame).items():
            held[key] = value
        held.update()

    def at(self, mi: ModuleType, frame: int = 0) -> Any:
        """Load the scene, set to a frame."""
        scene = mi.load_dict(self.scene)
        self.move(mi.traverse(scene), frame)
        return scene


@entry()
def make_stage(mi: ModuleType, svbrdf: SVBRDF, preset: str, *, environment: str | None = None,
               size: tuple[int, int] = (512, 512), frames: int | None = None,
               samples: int | None = None, tiling: int = 1, views: Views | None = None) -> Stage:
    """The stage of a preview.

    Args:
        mi: the Mitsuba module, with an RGB variant set.
        preset: a key of :data:`PRESETS`, which has the default of environment, frames and samples.
        environment: a name of :data:`ENVIRONMENTS`, or an .exr or .hdr file.
        size: width and height of the film in pixels.
        tiling: how often the maps are repeated along a side.
        views: for ``novel``, which shows the first; default: :func:`mitsvbrdf.views.nine_view_grid`.

    Raises:
        ConfigError: an option that is unknown, out of range, or does not go with the preset.
    """
    if preset not in PRESETS:
        raise ConfigError(f"a preset of {', '.join(PRESETS)}", repr(preset), "choose one of these")
    usual_environment, usual_frames, usual_samples = PRESETS[preset]
    name = usual_environment if environment is None else environment
    frames = usual_frames if frames is None else frames
    samples = usual_samples if samples is None else samples
    _check(preset, size, frames, samples, tiling)
    around = None if name == "none" and preset in OWN_LIGHT else make_environment(mi, name)
    if preset == "novel":
        scene, place, shown = _novel(mi, size[0], frames, views)
    else:
        scene, shown = read_scene(mi, f"{preset}.xml"), None
        place = _sweep(mi, scene, frames) if around is None or preset == "sweep" else (
            _turntable if preset == "turntable" else _turned)(mi, scene, frames, around)
    scene.pop("environment", None)
    scene |= around.emitters if around else {}

    svbrdf = svbrdf.detach().to(torch.float32)
    needs = material_needs(svbrdf)
    scene["material"] = _material(mi, svbrdf, needs, tiling, preset)
    omitted: list[tuple[str, str]] = [*needs.omitted]
    if name == "none":
        omitted.append(("environment", "a single light is asked for" if around
                        else "the preset has a light of its own"))
    if preset not in ROUND:
        omitted.append(("displacement", "normals shade, the surface is flat"))
    if preset == "sphere" and name != "sunsky":  # sunsky is dark below the horizon: it keeps the floor
        del scene["floor"]
        omitted.append(("floor", "nothing surrounds the sphere" if name == "none" else
                         "what surrounds the sphere goes on below the horizon"))
    reflections, why = (1, "a convex shape does not see itself")
    if "floor" in scene:
        reflections, why = _reflections(svbrdf)
    omitted.append((f"light after {reflections} reflection{'s' * (reflections > 1)}", why))
    scene["integrator"] = {"type": "path", "max_depth": reflections + 1}
    scene["sensor"]["film"] |= {"width": int(size[0]), "height": int(size[1])}
    return Stage(preset, scene, frames, samples, place, tuple(omitted), shown)


def _check(preset: str, size: tuple[int, int], frames: int, samples: int, tiling: int) -> None:
    """Raise ConfigError for numbers out of range, and for a size that does not go with the preset."""
    if frames < 1:
        raise ConfigError("1 frame or more", str(frames), "give --frames 1 for a still")
    if samples < 1:
        raise ConfigError("1 sample a pixel or more", str(samples), "try 64")
    if not 1 <= tiling <= MOST_TILES:
        raise ConfigError(f"a tiling of 1 to {MOST_TILES}", str(tiling), "give --tiling 2")
    if preset == "novel" and size[0] != size[1]:
        raise ConfigError("a square picture of the preset novel", f"{size[0]} x {size[1]}",
                          "give one number, or leave novel out")


def _material(mi: ModuleType, svbrdf: SVBRDF, needs: Needs, tiling: int, preset: str) -> dict[str, Any]:
    """The material with its maps as float bitmaps; row 0 of a bitmap is v = 0, the bottom of the patch."""
    slots = slot_values(svbrdf.bsdf, needed_maps(svbrdf, needs), needs, stock=True)
    # A sphere's u goes once around it, half of which is seen, and its v grows downward.
    scale = [2 * tiling, -tiling, 1] if preset == "sphere" else [tiling, tiling, 1]

    def texture(slot: str) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(slots[slot].flip(0).contiguous().numpy()), "raw": True,
                "filter_type": "nearest" if preset == "novel" else "bilinear",
                # opposite edges do not blend
                "wrap_mode": "clamp" if tiling == 1 and preset not in ROUND else "repeat",
                "to_uv": mi.ScalarTransform4f().scale(scale)}

    material = plugin(svbrdf.bsdf, needs, texture, stock=True)
    if needs.normal_map and preset != "novel":
        # Near a shape's outline, texels whose normals point away from the camera would be black; on a real
        # relief such texels are hidden.
        material["flip_invalid_normals"] = True
    return material


def _reflections(svbrdf: SVBRDF) -> tuple[int, str]:
    """How many reflections matter on a shape that sees itself, and the reason as text."""
    flat = svbrdf.as_roughconductor()
    albedo = float((flat["diffuse"] + flat["specular"]).amax(dim=-1).mean())
    left = min(max(albedo, 0.05), 0.9)
    return math.ceil(math.log(DIMMEST) / math.log(left)), f"the material reflects {albedo:.0%} on average"


def _sweep(mi: ModuleType, scene: dict[str, Any], frames: int) -> Place:
    x, behind, z = scene["light"]["position"]
    radius = math.hypot(x, z)
    scene["light"]["intensity"] = {"type": "rgb",
                                   "value": WHITE_LUMINANCE * math.pi * math.hypot(x, behind, z) ** 2}

    def place(frame: int) -> dict[str, Any]:
        angle = math.radians(90 + 42 * math.sin(2 * math.pi * frame / frames + math.pi / 6))
        return {"light.position": mi.Point3f(radius * math.cos(angle), behind, radius * math.sin(angle))}

    return place


def _turntable(mi: ModuleType, scene: dict[str, Any], frames: int, around: Environment) -> Place:
    camera = mi.Transform4f(scene["sensor"]["to_world"])

    def place(frame: int) -> dict[str, Any]:
        angle = -360 * frame / frames  # the patch turns one way: camera and environment turn the other
        return {"sensor.to_world": mi.Transform4f().rotate([0, 0, 1], angle) @ camera} | around.turned(angle)

    return place


def _turned(mi: ModuleType, scene: dict[str, Any], frames: int, around: Environment) -> Place:
    return lambda frame: around.turned(360 * frame / frames)


def _novel(mi: ModuleType, side: int, frames: int,
           views: Views | None) -> tuple[dict[str, Any], Place, Views]:
    seen = (views or nine_view_grid()).pick([0]).in_patch_sides().to(torch.float64)
    scene = read_scene(mi, "patch.xml", **view_parameters(seen, side))
    scene["sensor"]["sampler"] = {"type": "independent"}
    angle = torch.arange(frames, dtype=torch.float64) / frames * 2 * math.pi + 0.75 * math.pi
    circle = (torch.stack((angle.cos(), angle.sin(), torch.zeros_like(angle)), dim=1) * seen.camera[:, 2:]
              * OFF_LENS)
    shown = Views(seen.camera.expand(frames, 3), seen.camera + circle, seen.intensity.expand(frames, 3))
    return scene, lambda frame: {"light.position": mi.Point3f(*shown.light[frame].tolist())}, shown


def mirrored(svbrdf: SVBRDF) -> SVBRDF:
    """The material beside its mirror images: 2 R x 2 R maps that repeat without a seam."""
    def both(name: str, value: Tensor, axis: int, turned: int) -> Tensor:
        image = value.flip(axis)
        if name == "normal":
            image = image * (1 - 2 * torch.eye(3, dtype=value.dtype)[turned])
        return torch.cat((value, image), dim=axis)

    return SVBRDF(svbrdf.bsdf, {name: both(name, both(name, value, 1, 0), 0, 1)
                                for name, value in svbrdf.maps.items()})


@entry()
def sphere(svbrdf: SVBRDF, size: int) -> Tensor:
    """The material on a sphere, display values size x size x 3; mirrored maps cover it without a seam."""
    svbrdf = svbrdf.resized(min(svbrdf.resolution, 2 * size))
    half = svbrdf.resolution // 2  # a whole patch faces the camera
    covering = mirrored(svbrdf).map(lambda value: value.roll((half, half), (0, 1)))
    with using_mitsuba() as mi:
        return shown(_picture(mi, covering, size), 0.0)


def _picture(mi: ModuleType, covering: SVBRDF, size: int) -> Tensor:
    """Linear radiance, size x size x 3; no object of Mitsuba outlives the call."""
    stage = make_stage(mi, covering, "sphere", size=(size, size), samples=SAMPLES)
    stage.scene["sensor"]["sampler"] = {"type": "ldsampler", "sample_count": SAMPLES}
    return torch.tensor(mi.render(stage.at(mi), spp=SAMPLES, seed=0).numpy())
