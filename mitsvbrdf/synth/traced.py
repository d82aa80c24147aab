"""A phone's photos of a flat material on a table, traced by Mitsuba through the lens model."""

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..capture.align.sheet import Sheet
from ..capture.lens import Lens, Pose
from ..material.maps import SVBRDF
from ..render.bsdf import needed_maps, plugin, slot_values
from ..render.exclusive import Kept, using_mitsuba
from ..render.needs import material_needs
from ..render.plugins import INTEGRATOR, register

CAMERA = "lens_camera"
NEWTON = 8  # steps that undistort a ray; for phones, five reach float32's precision
MOST_RAYS = 2**22  # at once: about 1 GB
TABLE, TABLE_ALBEDO = 200.0, 0.2  # side in cm
BELOW = 0.3  # distance of the table below the sample, cm
PICTURE = 3040  # pixels a side of the sheet's picture, 40 for each cell of its tags
PAPER, INK = 0.8, 0.04  # albedo
AMBIENT_SAMPLES = 16  # samples a pixel if light comes from everywhere


class HandheldRenderer:
    """Photos of a square sample of ``side`` cm in z = 0 on a grey table, lit by a flash or from everywhere.

    The maps are read bilinearly. Light arrives straight from the flash, with shadows; light reflected twice
    is left out. A :class:`mitsvbrdf.capture.align.sheet.Sheet` may lie on the sample, ``depth`` cm above it.
    ``samples``: rays a pixel, 1, 4, 16, ...; more than one are stratified and jittered.
    """

    def __init__(self, svbrdf: SVBRDF, side: float, sheet: Sheet | None = None, depth: float = 0.0,
                 samples: int = 4, variant: str = "llvm_ad_rgb") -> None:
        self.variant, self.samples = variant, samples
        with using_mitsuba(variant) as mi:
            register(variant)
            _register(mi.variant())
            self._shapes = Kept(_shapes(mi, svbrdf, side, sheet, depth))
        self._scenes: dict[tuple, Kept[tuple[Any, Any]]] = {}

    def render(self, lens: Lens, pose: Pose, intensity: float = 0.0, ambient: float = 0.0,
               seed: int = 0) -> NDArray[np.float32]:
        """Linear radiance H x W x 3 at the lens, before its vignetting; pixels are area averages.

        Lengths are in cm. Under a flash of radiant ``intensity`` I, a white diffuse texel has radiance I cos
        / (pi d^2). If ``ambient`` is not 0, surroundings of this radiance replace the flash.
        """
        import drjit as dr

        samples = max(self.samples, AMBIENT_SAMPLES) if ambient else self.samples
        width, height = lens.size
        rows = min(height, max(1, MOST_RAYS // (width * samples)))
        out = np.empty((height, width, 3), dtype=np.float32)
        with using_mitsuba(self.variant) as mi:
            scene, held = self._scene(mi, width, rows, bool(ambient), samples)
            sensor = scene.sensors()[0]

            def opaque(value: float) -> Any:  # a number that is not compiled into the kernel
                return dr.opaque(mi.Float, float(value))

            sensor.set(lens, pose, opaque)
            if ambient:
                held["ambient.radiance.value"] = dr.opaque(mi.Color3f, ambient)
            else:
                held["flash.position"] = mi.Point3f(*(opaque(x) for x in pose.flash(lens)))
                held["flash.intensity.value"] = dr.opaque(mi.Color3f, intensity)
            held.update()
            for block, first in enumerate(range(0, height, rows)):
                first = min(first, height - rows)  # the last block overlaps: all share one size and kernel
                sensor.first = opaque(first)
                image = scene.integrator().render(scene, sensor, seed=seed * 65536 + block, spp=samples)
                out[first : first + rows] = np.array(image)
        return out

    def _scene(self, mi: ModuleType, width: int, rows: int, ambient: bool, samples: int) -> tuple[Any, Any]:
        key = (width, rows, ambient, samples)
        if key not in self._scenes:
            rgb = {"type": "rgb", "value": 1.0}
            light = ({"ambient": {"type": "constant", "radiance": rgb}} if ambient else
                     {"flash": {"type": "point", "position": [0.0, 0.0, 1.0], "intensity": rgb}})
            # Sampling the BSDF of a diffuse texel measures constant surroundings without noise.
            integrator = ({"type": "direct", "emitter_samples": 0, "bsdf_samples": 1} if ambient else
                          {"type": INTEGRATOR, "shadow_rays": True, "bounces": 0, "environment": False})
            scene = mi.load_dict({
                "type": "scene", "integrator": integrator, **light, **self._shapes.content,
                "sensor": {"type": CAMERA,
                           "film": {"type": "hdrfilm", "width": width, "height": rows, "pixel_format": "rgb",
                                    "component_format": "float32", "rfilter": {"type": "box"}},
                           "sampler": {"type": "stratified", "sample_count": samples,
                                       "jitter": samples > 1}}})
            self._scenes[key] = Kept((scene, mi.traverse(scene)))
        return self._scenes[key].content


def _shapes(mi: ModuleType, svbrdf: SVBRDF, side: float, sheet: Sheet | None, depth: float) -> dict[str, Any]:
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": TABLE_ALBEDO}}
    wide = max(TABLE, 4 * side)
    shapes = {"sample": _rectangle(mi, (0, 0, 0.0), (side / 2, side / 2), _material(mi, svbrdf)),
              "table": _rectangle(mi, (0, 0, -BELOW), (wide / 2, wide / 2), grey)} | (
                  _paper(mi, sheet, depth) if sheet else {})
    return {name: mi.load_dict(shape) for name, shape in shapes.items()}


def _texture(mi: ModuleType, value: NDArray) -> Any:
    """A float bitmap, read bilinearly; row 0 of ``value`` (H x W x C) is the top."""
    pixels = np.ascontiguousarray(np.asarray(value, dtype=np.float32)[::-1])  # texture row 0 is v = 0
    return mi.load_dict({"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True,
                         "filter_type": "bilinear", "wrap_mode": "clamp"})


def _rectangle(mi: ModuleType, middle: tuple, reach: tuple, bsdf: dict) -> dict:
    to_world = mi.ScalarTransform4f().translate([*middle]).scale([*reach, 1])
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def _material(mi: ModuleType, svbrdf: SVBRDF) -> dict:
    svbrdf = svbrdf.detach()
    needs = material_needs(svbrdf)
    slots = slot_values(svbrdf.bsdf, needed_maps(svbrdf, needs), needs)
    return plugin(svbrdf.bsdf, needs, lambda slot: _texture(mi, slots[slot].numpy()))


def _paper(mi: ModuleType, sheet: Sheet, depth: float) -> dict:
    """Four rectangles around the hole with their parts of the picture; a mask would cast a shadow."""
    picture, _ = sheet.picture(PICTURE / sheet.outer)
    albedo = INK + (PAPER - INK) * picture.astype(np.float32)[..., None] / 255
    n, edge = len(albedo), round(len(albedo) * (1 - sheet.hole / sheet.outer) / 2)
    shapes = {}
    for name, (left, top, right, bottom) in {"top": (0, 0, n, edge), "bottom": (0, n - edge, n, n),
                                             "left": (0, edge, edge, n - edge),
                                             "right": (n - edge, edge, n, n - edge)}.items():
        x, y = (np.array([left + right, -top - bottom]) / n + (-1, 1)) * sheet.outer / 2
        across, up = (np.array([right - left, bottom - top]) / n) * sheet.outer / 2
        shapes[f"paper_{name}"] = _rectangle(mi, (x, y, depth), (across, up), {
            "type": "diffuse", "reflectance": _texture(mi, albedo[top:bottom, left:right])})
    return shapes


@cache
def _register(variant: str) -> None:
    import drjit as dr
    import mitsuba as mi

    class LensCamera(mi.Sensor):
        """A lens at a pose: it maps film positions of a block of rows to the rays of ``lens.rays``."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.first = mi.Float(0)  # row of the photo in the film's first row
            size = self.film().size()
            self.columns, self.rows = int(size[0]), int(size[1])

        def set(self, lens: Lens, pose: Pose, opaque: Any) -> None:
            """Set lens and pose; ``opaque`` makes numbers that are not compiled into the kernel."""
            self.focal, self.k = opaque(lens.focal), [opaque(k) for k in lens.distortion]
            self.middle = [opaque(x) for x in lens.middle]
            self.origin = mi.Point3f(*(opaque(x) for x in pose.position))
            self.axes = [mi.Vector3f(*(opaque(x) for x in row)) for row in pose.rotation]

        def sample_ray_differential(self, time: Any, wavelength_sample: Any, position_sample: Any,
                                    aperture_sample: Any, active: Any = True) -> tuple[Any, Any]:
            x = (position_sample.x * self.columns - 0.5 - self.middle[0]) / self.focal
            y = (position_sample.y * self.rows - 0.5 + self.first - self.middle[1]) / self.focal
            bent = dr.sqrt(x * x + y * y)
            straight = bent
            for _ in range(NEWTON):
                r2 = straight * straight
                error = straight * (1 + r2 * (self.k[0] + r2 * self.k[1])) - bent
                straight = straight - error / (1 + r2 * (3 * self.k[0] + 5 * r2 * self.k[1]))
            scale = dr.select(bent > 0, straight / bent, 1)
            right, down, forward = self.axes
            direction = dr.normalize(right * (x * scale) + down * (y * scale) + forward)
            return mi.RayDifferential3f(self.origin, direction, time), mi.Color3f(1)

    mi.register_sensor(CAMERA, LensCamera)
