"""Plugins with which Mitsuba computes the same picture as the tracer.

They are (1) a sensor whose pixels need not be square, and whose rays start near the scene; (2) a
point light whose intensity does not decrease with distance; (3) the BSDF of the scene format
(Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2); and (4) an integrator that adds
the light of every emitter for each sample.

Mitsuba prescribes the arguments of the methods, some of which are ignored here.  A *hit* is
Mitsuba's `SurfaceInteraction3f`.  In vectorised variants of Mitsuba, every argument and result
stands for many rays at once, and `active` masks the rays for which a result is needed.

Importing this module registers the plugins for the current variant, and for each variant that is
set later.  If no variant is set, the fastest one that works on this machine is set.
"""

# Mitsuba's type stubs describe one variant, but these classes run in every RGB variant.
# mypy: ignore-errors

from __future__ import annotations

import importlib
import sys

import drjit as dr
import mitsuba as mi

from converters.variant import ensure_variant

ensure_variant()


def _to_vector(vector: mi.ScalarVector3d) -> mi.Vector3d:
    """Convert a vector of Python numbers to a float64 vector of the current Mitsuba variant."""
    return mi.Vector3d(vector[0], vector[1], vector[2])


class Window(mi.Sensor):
    """A Mitsuba sensor whose rays go from the eye through a rectangle, the window.

    Its parameters are vectors: `eye`, the position of the eye; `corner`, from the eye to the upper
    left corner of the window; `right` and `down`, the edges of the window; `low` and `high`,
    opposite corners of a box around the scene, on which rays start.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.eye, self.corner, self.right, self.down, self.low, self.high = (
            _to_vector(props[name]) for name in ("eye", "corner", "right", "down", "low", "high")
        )

    def sample_ray(self, time, wavelength, position, aperture, active=True):
        """Compute the ray from the eye through a point of the picture, in float64.

        `position` is (0, 0) in the upper left corner of the picture, and (1, 1) in the lower right
        corner.  The direction of the ray has length 1.  The ray starts where it enters the box
        around the scene, or at the eye if the eye is inside the box.  A ray that misses the box
        meets no shape wherever it starts: it starts where it has entered the last of the three
        slabs between opposite sides of the box, or at the eye.  The second result, the weight of
        the ray, is 1.
        """
        x = mi.Float64(position.x)
        y = mi.Float64(position.y)
        direction = dr.normalize(self.corner + x * self.right + y * self.down)
        # Intersect the box by the slab method.  The inverse of 0 must be finite, because infinity
        # times 0 is NaN.
        inverse_direction = dr.rcp(dr.select(direction == 0, 1e-300, direction))
        low_t, high_t = ((plane - self.eye) * inverse_direction for plane in (self.low, self.high))
        start_distance = dr.maximum(dr.max(dr.minimum(low_t, high_t)), 0)
        ray = mi.Ray3f(mi.Point3f(self.eye + start_distance * direction), mi.Vector3f(direction))
        return ray, mi.Spectrum(1)

    def sample_ray_differential(self, time, wavelength, position, aperture, active=True):
        """Return the ray that `sample_ray` returns, without differentials, and its weight of 1."""
        ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
        return mi.RayDifferential3f(ray), weight


class UnattenuatedPoint(mi.Emitter):
    """A Mitsuba point light whose strength does not decrease with distance.

    Its parameters are the vectors `position` and `intensity` (linear RGB).
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.position = mi.Point3f(_to_vector(props["position"]))
        self.intensity = mi.Color3f(_to_vector(props["intensity"]))

    def sample_direction(self, hit, sample, active=True):
        """Return the direction and the distance to the light from a hit, and the light's intensity.

        In the first result, `d` is the unit vector from the hit to the light, and `dist` is the
        distance.  If the hit is at the light, both are 0.  The second result, a colour, is 0 where
        `active` is False.
        """
        light_sample = mi.DirectionSample3f()
        light_sample.p = self.position
        light_sample.time = hit.time
        light_sample.delta = True
        light_sample.pdf = 1
        light_sample.uv = mi.Point2f(0)
        to_light = self.position - hit.p
        # Divide by the largest component, so that the squares cannot overflow for distant lights.
        largest_component = dr.max(dr.abs(to_light))
        to_light /= dr.select(largest_component > 0, largest_component, 1)
        scaled_length = dr.norm(to_light)
        light_sample.dist = scaled_length * largest_component
        light_sample.d = to_light / dr.select(scaled_length > 0, scaled_length, 1)
        light_sample.n = mi.Normal3f(-light_sample.d)
        return light_sample, dr.select(active, self.intensity, 0)

    def eval(self, hit, active=True):
        """Return the radiance of the light where a ray hits it: 0, because no ray hits a point."""
        return mi.Spectrum(0)


class BlinnPhong(mi.BSDF):
    """A two-sided Mitsuba BSDF for Blinn-Phong shading.

    The shading is kd n.l + ks (n.h)^exponent.  Here kd and ks are the diffuse and specular colours,
    n is the normal, l the direction to the light, and h the half vector: the unit vector halfway
    between l and the direction to the eye.  The parameters are the linear RGB vectors `diffuse` and
    `specular`, and the number `exponent`.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.diffuse = mi.Color3f(_to_vector(props["diffuse"]))
        self.specular = mi.Color3f(_to_vector(props["specular"]))
        self.exponent = float(props["exponent"])
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    def eval(self, context, hit, to_light, active=True):
        """Compute the shading, which is the product of the BSDF and the cosine n.l.

        `to_light` and `hit.wi` are unit vectors to the light and to the eye, in a local frame whose
        z axis is the normal.  The shading is 0 where they are on different sides of the surface,
        and where `active` is False.
        """
        half_vector = dr.normalize(hit.wi + to_light)
        # Compute the cosine n.h from the sine: in float32, a cosine close to 1 would round to 1.
        squared_cosine = 1 - mi.Float64(dr.square(half_vector.x) + dr.square(half_vector.y))
        highlight = mi.Float(dr.power(dr.maximum(squared_cosine, 0), 0.5 * self.exponent))
        shading = self.diffuse * dr.abs(to_light.z) + self.specular * highlight
        is_same_side = hit.wi.z * to_light.z > 0
        return dr.select(active & is_same_side, shading, 0)


class EveryLight(mi.SamplingIntegrator):
    """A Mitsuba integrator that adds the direct light of every emitter.

    Shadow rays go from the light to the hit.  All shapes are closed and convex, so the shape at
    the hit lies below the hit's tangent plane, and a shape that blocks the light lies above it.  A
    hit is therefore lit unless the shadow ray first meets a shape more than a tolerance above the
    plane.  No offset from the surface is needed: it would move the edges of shadows.

    Its parameter is the number `tolerance`, in the unit of length of the Mitsuba scene.  The
    constructor raises RuntimeError if the current variant of Mitsuba is not an RGB variant.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if not mi.variant().endswith(("_rgb", "_rgb_double")):
            raise RuntimeError(f"needs an RGB variant of Mitsuba, not {mi.variant()}")
        self.tolerance = props.get("tolerance", 1e-5)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Compute the radiance along a ray from the eye, and whether the ray hits a surface.

        If the ray hits nothing, the radiance is 0.  The third result, a list of additional
        channels, is empty.
        """
        hit = scene.ray_intersect(ray, active)
        is_hit = hit.is_valid()
        if is_hit is False:
            # In a scalar variant, a ray that hits nothing has no BSDF.
            return mi.Spectrum(0), False, []
        bsdf = hit.bsdf(ray)
        box = scene.bbox()
        radiance = mi.Spectrum(0)
        for emitter in scene.emitters():
            light_sample, intensity = emitter.sample_direction(hit, mi.Point2f(0), is_hit)
            to_light = hit.to_local(light_sample.d)
            reflectance = bsdf.eval(mi.BSDFContext(), hit, to_light, is_hit)
            is_frontlit = is_hit & dr.any(reflectance > 0)
            is_lit = is_frontlit & self._test_light(scene, box, hit, light_sample, is_frontlit)
            radiance += dr.select(is_lit, reflectance * intensity, 0)
        return radiance, is_hit, []

    def _test_light(self, scene, box, hit, light_sample, active):
        """Test whether no shape blocks the light, for the active rays.

        `box` is the bounding box of the scene, and `light_sample` says how the hit sees the light.
        """
        to_light = light_sample.d
        ray_length = self._choose_shadow_ray_length(box, hit, light_sample)
        shadow_ray = mi.Ray3f(hit.p + ray_length * to_light, -to_light)
        first_hit = scene.ray_intersect_preliminary(shadow_ray, active=active)
        height_above_plane = (ray_length - first_hit.t) * dr.abs(dr.dot(to_light, hit.n))
        return height_above_plane <= self.tolerance

    def _choose_shadow_ray_length(self, box, hit, light_sample):
        """Choose the distance from a hit at which the shadow ray from the light starts.

        The ray starts slightly in front of the light, which may lie on a surface.  If the light is
        outside the bounding box of the scene, the ray starts just outside the box.
        """
        direction = dr.select(dr.abs(light_sample.d) > 1e-20, light_sample.d, 1e-20)
        low_t, high_t = ((plane - hit.p) * dr.rcp(direction) for plane in (box.min, box.max))
        exit_distance = dr.min(dr.maximum(low_t, high_t))
        margin = 1e-3 * dr.max(box.max - box.min)
        return dr.minimum(light_sample.dist - self.tolerance, exit_distance + margin)


for register, plugin, name in (
    (mi.register_sensor, Window, "window"),
    (mi.register_emitter, UnattenuatedPoint, "unattenuated_point"),
    (mi.register_bsdf, BlinnPhong, "blinn_phong"),
    (mi.register_integrator, EveryLight, "every_light"),
):
    plugin.to_string = lambda self: f"{type(self).__name__}[]"  # printed by Mitsuba
    register(name, plugin)

# The base classes belong to one variant.  If another variant is set, the plugins are defined again.
if "_reload" not in globals():

    def _reload(_old: str | None, _new: str | None) -> None:
        """Execute this module again, to define its plugins for the new Mitsuba variant."""
        importlib.reload(sys.modules[__name__])

    mi.detail.add_variant_callback(_reload)
