"""Mitsuba plugins for rectified photos; the rest is Mitsuba's own.

They are an exact camera of rectified photos, a normal map and a Fresnel reflectance that lose no digits, and
an integrator that computes no more than a scene needs. Each is a class made for the variant in use, derived
from that variant's classes.
"""

from functools import cache
from typing import Any

from .bsdf import F0_RANGE, FRESNEL, NORMAL_MAP

ROUNDING = 2.0**-24
CAMERA, INTEGRATOR = "rectified_camera", "point_lit"


def shading_axes(normal: Any) -> tuple[Any, Any, Any]:
    """Tangent, bitangent and normal of a shading frame; the lobes are isotropic, so any tangents will do. The
    normals are float64 Dr.Jit 3-vectors with z > 0, of any length.
    """
    import drjit as dr

    n = dr.normalize(normal)
    # The tangent is made from the axis, x or y, that is farther from n. From an axis near n, the tangent's
    # slope in n would amplify the rounding of the plugin's results. Errors of gradients of normals at 89.9
    # degrees: 5e-6 -> 1e-6.
    axis = dr.select(dr.abs(n.x) < dr.abs(n.y), type(n)(1, 0, 0), type(n)(0, 1, 0))
    s = dr.normalize(axis - n * dr.dot(n, axis))
    return s, dr.cross(n, s), n


def to_shading(axes: tuple[Any, Any, Any], direction: Any) -> Any:
    """A direction in the frame of :func:`shading_axes`."""
    import drjit as dr

    x, y, z = (dr.dot(axis, direction) for axis in axes)
    # Mitsuba divides by z and z^2. A direction within one float32 rounding of the horizon counts as below it:
    # black, gradient 0.
    return type(axes[0])(x, y, dr.select(dr.abs(z) < ROUNDING, -ROUNDING, z))


@cache
def register(variant: str) -> None:
    """Register the plugins in this Mitsuba variant, which is the one in use."""
    import mitsuba as mi

    mi.register_sensor(CAMERA, _rectified_camera())
    mi.register_bsdf(NORMAL_MAP, _exact_normal_map())
    mi.register_bsdf(FRESNEL, _exact_fresnel())
    mi.register_integrator(INTEGRATOR, _point_lit())


def _rectified_camera() -> type:
    import drjit as dr
    import mitsuba as mi

    Vector64 = dr.float64_array_t(mi.Vector3f)

    class RectifiedCamera(mi.Sensor):
        """Sends each pixel's ray to its texel: film position (u, v) sees (u - 1/2, 1/2 - v, 0) of the patch.

        Mitsuba's ``perspective`` with a shifted principal point sees the same, but rounds the angle of view
        to float32. That moved the hits by 5e-7 of their distance from the axis. The flanks of highlights fall
        with the fourth power of the distance: their errors were 2e-6.
        """

        def __init__(self, props):
            super().__init__(props)
            self.position = Vector64(0, 0, 1)  # in patch sides; may change without a new kernel

        def sample_ray_differential(self, time, wavelength_sample, position_sample, aperture_sample,
                                    active=True):
            texel = Vector64(position_sample.x - 0.5, 0.5 - position_sample.y, 0)
            direction = mi.Vector3f(dr.normalize(texel - self.position))
            return mi.RayDifferential3f(mi.Point3f(self.position), direction, time), mi.Color3f(1)

    return RectifiedCamera


def _around() -> type:
    import mitsuba as mi

    class Around(mi.BSDF):
        """A BSDF that changes the results of another one, ``inner``."""

        def __init__(self, props):
            super().__init__(props)
            self.inner = props["inner"]
            self.m_components = [self.inner.flags(i) for i in range(self.inner.component_count())]
            self.m_flags = self.inner.flags()

        def pdf(self, context, si, wo, active=True):
            return self.inner.pdf(context, si, wo, active)

        def eval_pdf(self, context, si, wo, active=True):
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

    return Around


def _exact_normal_map() -> type:
    import drjit as dr
    import mitsuba as mi

    Vector64 = dr.float64_array_t(mi.Vector3f)

    class ExactNormalMap(_around()):  # type: ignore[misc]
        """Mitsuba's ``normalmap`` with an unencoded normal and directions rotated in float64.

        ``normalmap`` reads (n + 1) / 2: a small x or y loses digits when 1 is added. It multiplies in
        float32, and near the highlight the result is a small difference of larger numbers. Errors of
        gradients fall from 2.4e-6 to 1.0e-6 (roughness 0.1, waves of normals; camera and hits in float64
        too).
        """

        def __init__(self, props):
            super().__init__(props)
            self.normals = props["normals"]

        def _turned(self, si, active):
            axes = shading_axes(Vector64(self.normals.eval_3(si, active)))
            turned = mi.SurfaceInteraction3f(si)
            turned.wi = mi.Vector3f(to_shading(axes, Vector64(si.wi)))
            return turned, axes

        def eval(self, context, si, wo, active=True):
            turned, axes = self._turned(si, active)
            return self.inner.eval(context, turned, mi.Vector3f(to_shading(axes, Vector64(wo))), active)

        def pdf(self, context, si, wo, active=True):
            turned, axes = self._turned(si, active)
            return self.inner.pdf(context, turned, mi.Vector3f(to_shading(axes, Vector64(wo))), active)

        def sample(self, context, si, sample1, sample2, active=True):
            turned, (s, t, n) = self._turned(si, active)
            sampled, weight = self.inner.sample(context, turned, sample1, sample2, active)
            wo = Vector64(sampled.wo)
            sampled.wo = mi.Vector3f(s * wo.x + t * wo.y + n * wo.z)
            return sampled, weight

    return ExactNormalMap


def _exact_fresnel() -> type:
    import drjit as dr

    class ExactFresnel(_around()):  # type: ignore[misc]
        """A specular lobe times the Fresnel reflectance whose value at normal incidence is F0.

        Mitsuba's ``roughconductor`` takes the refractive index, and subtracts nearly equal numbers as F0 goes
        to 0 or 1. Its error is 8e-8 / F0: on maps fitted to photos (F0 down to 1e-3), images differed by
        5e-5. Here the common factor of both amplitudes is taken out by algebra, as in
        :func:`mitsvbrdf.render.analytic._fresnel`.
        """

        def __init__(self, props):
            super().__init__(props)
            self.f0 = props["f0"]

        def _reflectance(self, si, wo, active):
            f0, cosine = self.f0.eval(si, active), dr.dot(dr.normalize(si.wi + wo), wo)
            cut = dr.clip(f0, *F0_RANGE)
            s = dr.sqrt(cut)
            a, b2 = (1 - cut) / (1 + s), dr.square(1 + s)
            g = dr.sqrt(4 * s + dr.square(a * cosine))
            s_wave = 1 / dr.square(a * cosine + g)
            p_wave = (2 * dr.square(cosine) * (1 + cut) - dr.square(a)) / dr.square(b2 * cosine + a * g)
            return 8 * f0 * (dr.square(s_wave) + dr.square(p_wave))

        def eval(self, context, si, wo, active=True):
            return self.inner.eval(context, si, wo, active) * self._reflectance(si, wo, active)

        def sample(self, context, si, sample1, sample2, active=True):
            sampled, weight = self.inner.sample(context, si, sample1, sample2, active)
            return sampled, weight * self._reflectance(si, sampled.wo, active)

    return ExactFresnel


def _point_lit() -> type:
    import drjit as dr
    import mitsuba as mi

    Vector64 = dr.float64_array_t(mi.Vector3f)

    def hit(ray, si):
        """The hit in float64: where the ray meets the tangent plane at the rounded hit."""
        origin, direction, normal = Vector64(ray.o), Vector64(ray.d), Vector64(si.n)
        return origin + direction * (dr.dot(normal, Vector64(si.p) - origin) / dr.dot(normal, direction))

    class PointLit(mi.SamplingIntegrator):
        """Direct light, and light after one bounce; without a loop, so differentiable.

        ``shadow_rays``: test whether the light is visible. ``bounces``: 0 or 1. ``environment``: add its
        radiance for rays that leave the scene. With all, images equal those of Mitsuba's ``path`` (tested).
        """

        def __init__(self, props):
            super().__init__(props)
            self.shadow_rays = props.get("shadow_rays", True)
            self.bounces = props.get("bounces", 0)
            self.environment = props.get("environment", False)

        def sample(self, scene, sampler, ray, medium=None, active=True):
            radiance, weight, active = mi.Color3f(0), mi.Color3f(1), mi.Bool(active)
            context, seen = mi.BSDFContext(), None
            for depth in range(self.bounces + 1):
                si = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
                if self.environment:
                    around = weight * scene.environment().eval(si, active)
                    radiance += dr.select(active & ~si.is_valid(), around, 0)
                active &= si.is_valid()
                seen = active if seen is None else seen
                bsdf = si.bsdf(ray)
                towards, power = scene.sample_emitter_direction(si, sampler.next_2d(active), self.shadow_rays,
                                                                active)
                to_light = mi.Vector3f(dr.normalize(Vector64(towards.p) - hit(ray, si)))
                value = bsdf.eval(context, si, si.to_local(to_light), active)
                radiance += dr.select(active, weight * value * power, 0)
                if depth < self.bounces:
                    sample, value = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active),
                                                active)
                    ray, weight = si.spawn_ray(si.to_world(sample.wo)), weight * value
            return radiance, seen, []

    return PointLit
