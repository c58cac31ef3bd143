"""The small Mitsuba plugins that the exact flavour of a converted scene names.

Importing this module registers them, for the current variant (the fastest that works here, if none
is set) and for every other that is set later.  They are a sensor whose pixels need not be square
and whose rays start near the scene, a point light that does not fall off, the BSDF of the scene
format (Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2), and an integrator that
asks each light once a sample.
"""

# Mitsuba's stubs describe one variant; these classes run in every one.
# mypy: ignore-errors

from __future__ import annotations

import importlib
import sys

import drjit as dr
import mitsuba as mi

from converters.variant import ensure

ensure()

# Film coordinates are float32: across 1000 pixels, a centre comes back off by up to 1e-4 pixels.
_CENTER_SLACK = 1e-3


def _vector(value: mi.ScalarVector3d) -> mi.Vector3d:
    return mi.Vector3d(value[0], value[1], value[2])


class Window(mi.Sensor):
    """Rays from `eye` through a rectangle, started on a box around the scene, `low` to `high`.

    `corner` leads from the eye to the window's upper left; `right` and `down` are its edges.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.eye, self.corner, self.right, self.down, self.low, self.high = (
            _vector(props[name]) for name in ("eye", "corner", "right", "down", "low", "high")
        )

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A ray through a point of the film, in float64 until it is done."""
        size = self.film().crop_size()
        across = self._centered(sample2.x, size[0])
        down = self._centered(sample2.y, size[1])
        d = dr.normalize(self.corner + across * self.right + down * self.down)
        # The slab method; a zero component gets a huge inverse, as infinity times 0 is no number.
        inverse = dr.rcp(dr.select(d == 0, 1e-300, d))
        a, b = (self.low - self.eye) * inverse, (self.high - self.eye) * inverse
        start = dr.maximum(dr.max(dr.minimum(a, b)), 0)
        ray = mi.Ray3f(mi.Point3f(self.eye + start * d), mi.Vector3f(d))
        return ray, mi.Spectrum(1)

    def sample_ray_differential(self, time, sample1, sample2, sample3, active=True):
        """The same ray; no plugin here needs differentials."""
        ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
        return mi.RayDifferential3f(ray), weight

    @staticmethod
    def _centered(x: mi.Float, size: int) -> mi.Float64:
        """A film coordinate in float64, put back on the pixel's centre where it is meant to be."""
        pixel = mi.Float64(x) * size
        center = dr.floor(pixel) + 0.5
        return dr.select(dr.abs(pixel - center) < _CENTER_SLACK, center, pixel) / size


class UnattenuatedPoint(mi.Emitter):
    """A point light whose `intensity` arrives undiminished at any distance."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.position = mi.Point3f(_vector(props["position"]))
        self.intensity = mi.Color3f(_vector(props["intensity"]))

    def sample_direction(self, it, sample, active=True):
        """The one direction to the light."""
        ds = mi.DirectionSample3f()
        ds.p = self.position
        ds.time = it.time
        ds.delta = True
        ds.pdf = 1
        ds.uv = mi.Point2f(0)
        to_light = self.position - it.p
        # Divided by its largest component, so that no square overflows: a sun is far away.
        largest = dr.max(dr.abs(to_light))
        to_light /= dr.select(largest > 0, largest, 1)
        length = dr.norm(to_light)
        ds.dist = length * largest
        ds.d = to_light / dr.select(length > 0, length, 1)
        ds.n = mi.Normal3f(-ds.d)
        return ds, dr.select(active, self.intensity, 0)

    def eval(self, si, active=True):
        """No ray meets a point."""
        return mi.Spectrum(0)


class BlinnPhong(mi.BSDF):
    """kd n.l + ks (n.h)^exponent on both sides (`diffuse`, `specular`, `exponent`)."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.diffuse = mi.Color3f(_vector(props["diffuse"]))
        self.specular = mi.Color3f(_vector(props["specular"]))
        self.exponent = float(props["exponent"])
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    def eval(self, ctx, si, wo, active=True):
        """The diffuse term with its cosine, and the highlight, which has none."""
        # Both sides: only whether the two directions lie on the same side matters.
        h = dr.normalize(si.wi + wo)
        # (n.h)^p by the sine, which float32 still knows where the cosine has become 1.
        cosine2 = 1 - mi.Float64(dr.square(h.x) + dr.square(h.y))
        power = mi.Float(dr.power(dr.maximum(cosine2, 0), 0.5 * self.exponent))
        value = self.diffuse * dr.abs(wo.z) + self.specular * power
        return dr.select(active & (si.wi.z * wo.z > 0), value, 0)


class EveryLight(mi.SamplingIntegrator):
    """Light that comes straight from every emitter.

    A shadow ray runs from the light to the point.  All shapes here are closed and convex, so
    what such a ray meets before the point lies above the tangent plane there, and the point's own
    object never does: the point is lit unless the first hit lies more than `tolerance` above
    that plane.  This needs no offset from the surface, which would move the edges of shadows.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if not mi.variant().endswith(("_rgb", "_rgb_double")):
            raise RuntimeError(f"needs an RGB variant of Mitsuba, not {mi.variant()}")
        self.tolerance = props.get("tolerance", 1e-5)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along a ray."""
        si = scene.ray_intersect(ray, active)
        valid = si.is_valid()
        if valid is False:
            # In a scalar variant, where a ray that hits nothing has no BSDF.
            return mi.Spectrum(0), False, []
        bsdf, box = si.bsdf(ray), scene.bbox()
        total = mi.Spectrum(0)
        for emitter in scene.emitters():
            ds, intensity = emitter.sample_direction(si, mi.Point2f(0), valid)
            value = bsdf.eval(mi.BSDFContext(), si, si.to_local(ds.d), valid)
            facing = valid & dr.any(value > 0)
            # It starts a little before the light, which may lie on a surface, or beyond the scene.
            inverse = dr.rcp(dr.select(dr.abs(ds.d) > 1e-20, ds.d, 1e-20))
            far = dr.min(dr.maximum((box.min - si.p) * inverse, (box.max - si.p) * inverse))
            reach = dr.minimum(ds.dist - self.tolerance, far + 1e-3 * dr.max(box.max - box.min))
            shadow_ray = mi.Ray3f(si.p + reach * ds.d, -ds.d)
            first = scene.ray_intersect_preliminary(shadow_ray, active=facing)
            height = (reach - first.t) * dr.abs(dr.dot(ds.d, si.n))
            lit = facing & (height <= self.tolerance)
            total += dr.select(lit, value * intensity, 0)
        return total, valid, []


for register, plugin, name in (
    (mi.register_sensor, Window, "window"),
    (mi.register_emitter, UnattenuatedPoint, "unattenuated_point"),
    (mi.register_bsdf, BlinnPhong, "blinn_phong"),
    (mi.register_integrator, EveryLight, "every_light"),
):
    plugin.to_string = lambda self: f"{type(self).__name__}[]"  # what Mitsuba prints of it
    register(name, plugin)

# The base classes belong to a variant: when another one is set, define everything again.
if "_define_again" not in globals():

    def _define_again(_old: str | None, _new: str | None) -> None:
        importlib.reload(sys.modules[__name__])

    mi.detail.add_variant_callback(_define_again)
