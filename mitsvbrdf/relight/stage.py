"""Stages of previews: a scene of ``scenes/`` with the material, an environment and a film filled in, and what moves in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from ..errors import ConfigError
from ..export.mitsuba import view_parameters
from ..maps import SVBRDF
from ..render.bsdf import needed_maps, plugin, slot_values
from ..render.needs import Needs, material_needs
from ..views import Views, nine_view_grid
from .environment import WHITE, Environment, make_environment
from .scene_file import read_scene

PRESETS = {
    "sweep": "a light on an arc over the patch; a movie",
    "turntable": "the patch turning under an environment; a movie",
    "sphere": "a sphere under an environment; with more frames the environment turns",
    "novel": "the first photo's camera, with the light moved off the lens; with more frames it circles the lens",
}
DEFAULTS = {"sweep": ("none", 48), "turntable": ("studio", 72), "sphere": ("studio", 1), "novel": ("none", 1)}
FPS = 24.0
DIMMEST = 1e-3  # light that was reflected so often that less is left of it is left out


@dataclass(frozen=True)
class Stage:
    """A scene to be rendered, frame by frame.

    Args:
        name: the preset.
        scene: for ``mi.load_dict``; one sensor (hdrfilm rgb float32, box filter) and the integrator ``path``.
        frames: 1 for a still.
        fps: frames a second.
        place: frame number -> values by key of ``mi.traverse(scene)``; none of them needs another kernel.
        left_out: (what, why) of each thing that this preview does without.
        views: of ``novel``: camera and light of each frame.
    """

    name: str
    scene: dict[str, Any]
    frames: int
    fps: float
    place: Callable[[int], dict[str, Any]]
    left_out: tuple[tuple[str, str], ...]
    views: Views | None = None


def make_stage(mi, svbrdf: SVBRDF, preset: str, *, environment: str | None = None, size: tuple[int, int] = (512, 512),
               frames: int | None = None, tiling: int = 1, displacement: float = 0.0, views: Views | None = None) -> Stage:
    """The stage of a preview.

    Args:
        mi: the Mitsuba module, an RGB variant set.
        svbrdf: the material.
        preset: a key of :data:`PRESETS`.
        environment: a key of :data:`ENVIRONMENTS`, or an .exr or .hdr file; left out: what suits the preset.
        size: width and height of the film in pixels.
        frames: how many; left out: what suits the preset.
        tiling: how often the maps are repeated along a side.
        displacement: height of the relief; 0: flat, 1: as high as the normals say.
        views: of ``novel``: the first one is shown; left out: the first of :func:`mitsvbrdf.views.nine_view_grid`.

    Raises:
        ConfigError: an option that is unknown, out of range, or does not go with the preset.
    """
    if preset not in PRESETS:
        raise ConfigError(f"a preset of {list(PRESETS)}", repr(preset), "choose one of these")
    usual_environment, usual_frames = DEFAULTS[preset]
    name, frames = environment or usual_environment, usual_frames if frames is None else frames
    if frames < 1:
        raise ConfigError("1 frame or more", str(frames), "give --frames 1 for a still")
    if tiling < 1:
        raise ConfigError("a tiling of 1 or more", str(tiling), "give --tiling 2")
    if displacement:
        raise ConfigError("no displacement", str(displacement), "leave it out")
    surroundings = None if name == "none" else make_environment(mi, name)
    svbrdf = svbrdf.detach().to(torch.float32)
    needs = material_needs(svbrdf)
    build = {"sweep": _sweep, "turntable": _turntable, "sphere": _sphere, "novel": _novel}[preset]
    stage = build(mi, svbrdf, frames, surroundings, size, views)
    scene = stage.scene
    scene["material"] = _material(mi, svbrdf, needs, tiling, preset)
    _surround(scene, surroundings)
    film = scene["sensor"]["film"]
    film["width"], film["height"] = map(int, size)
    scene["sensor"]["sampler"] = {"type": "independent", "sample_count": 16}
    scene["integrator"] = {"type": "path", "max_depth": 2}
    return replace(stage, left_out=(*needs.left_out, *stage.left_out))


def _material(mi, svbrdf: SVBRDF, needs: Needs, tiling: int, preset: str) -> dict[str, Any]:
    """The material with its maps as float bitmaps; row 0 of a bitmap is v = 0, the bottom of the patch."""
    slots = slot_values(svbrdf.bsdf, needed_maps(svbrdf, needs), needs, stock=True)
    transform = mi.ScalarTransform4f()
    if preset == "sphere":  # u goes once around, half of which is seen; v grows downward
        transform = transform.scale([2 * tiling, -tiling, 1])
    else:
        transform = transform.scale([tiling, tiling, 1])
    wrap = "clamp" if tiling == 1 and preset != "sphere" else "repeat"

    def texture(slot: str) -> dict[str, Any]:
        return {"type": "bitmap", "data": mi.TensorXf(slots[slot].flip(0).contiguous().numpy()), "raw": True,
                "filter_type": "nearest" if preset == "novel" else "bilinear", "wrap_mode": wrap, "to_uv": transform}

    return plugin(svbrdf.bsdf, needs, texture, stock=True)


def _surround(scene: dict[str, Any], surroundings: Environment | None) -> None:
    scene.pop("environment", None)
    if surroundings:
        scene["environment"] = surroundings.emitter


def _sweep(mi, svbrdf, frames, surroundings, size, views) -> Stage:
    scene = read_scene(mi, "sweep.xml")
    radius, behind = 1.5, 0.45
    scene["light"]["intensity"] = {"type": "rgb", "value": WHITE * math.pi * radius**2}

    def place(frame: int) -> dict[str, Any]:
        angle = math.radians(90 + 60 * math.sin(2 * math.pi * frame / frames + math.pi / 6))
        across = math.sqrt(radius**2 - behind**2)
        return {"light.position": mi.Point3f(across * math.cos(angle), behind, across * math.sin(angle))}

    return Stage("sweep", scene, frames, FPS, place, ())


def _turntable(mi, svbrdf, frames, surroundings, size, views) -> Stage:
    scene = read_scene(mi, "turntable.xml")
    camera = mi.Transform4f(scene["sensor"]["to_world"])

    def place(frame: int) -> dict[str, Any]:
        angle = -360 * frame / frames  # the table turns one way: camera and environment turn the other
        turned = {"sensor.to_world": mi.Transform4f().rotate([0, 0, 1], angle) @ camera}
        return turned | (surroundings.turned(angle) if surroundings else {})

    return Stage("turntable", scene, frames, FPS, place, ())


def _sphere(mi, svbrdf, frames, surroundings, size, views) -> Stage:
    scene = read_scene(mi, "sphere.xml")

    def place(frame: int) -> dict[str, Any]:
        return surroundings.turned(360 * frame / frames) if surroundings and frames > 1 else {}

    return Stage("sphere", scene, frames, FPS, place, ())


def _novel(mi, svbrdf, frames, surroundings, size, views) -> Stage:
    if size[0] != size[1]:
        raise ConfigError("a square picture for novel", f"{size[0]} x {size[1]}", "give --size with one number")
    seen = (views or nine_view_grid()).pick([0]).in_patch_sides().to(torch.float64)
    scene = read_scene(mi, "patch.xml", **view_parameters(seen, size[0]))
    angle = torch.arange(frames, dtype=torch.float64) / frames * 2 * math.pi + 0.75 * math.pi
    circle = torch.stack((angle.cos(), angle.sin(), torch.zeros_like(angle)), dim=1) * seen.camera[:, 2:] * 0.5
    shown = Views(seen.camera.expand(frames, 3), seen.camera + circle, seen.intensity.expand(frames, 3))

    def place(frame: int) -> dict[str, Any]:
        return {"light.position": mi.Point3f(*shown.light[frame].tolist())}

    return Stage("novel", scene, frames, FPS, place, (), shown)
