"""A scene as Mitsuba 3 XML: similar, by stock plugins, or exactly, by this project's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import atan, degrees, isqrt
from typing import NamedTuple, TypeGuard

import numpy as np

from converters.camera import Floats, Window, bounds, visible_points, window_of
from converters.mitsuba_xml import document, element, matrix, plugin, rgb, xyz
from tracer import Phong, PointLight, Scene, Shader, Surfaces

__all__ = ["SAMPLES", "convert", "exact", "gain", "normalisation", "squared", "stock"]

SAMPLES = {"stock": 64, "exact": 1}
"""The flavours, a similar picture and the same: samples a pixel, if not given."""

# What overflows is an error when it is written.
_QUIET = np.errstate(all="ignore")

# Mitsuba's float32 is best off with scenes about this large, centred on the origin.
_EXTENT = 10.0

# Largest error of a hit point, in roundings (2^-24) of the largest length in the scene.
_TOLERANCE_ROUNDINGS = 32

# A stock scene of which so much is seen, no farther from the origin than so many times that, keeps
# the file's coordinates.
_OWN_EXTENT, _OWN_OFFSET = (0.1, 1e6), 10.0

# Largest sphere of a stock scene, whose hit points err by 1e-7 of its radius, and the least share
# of its size that a scene is given for that: shadow rays start 1e-4 above what may be small.
_LARGEST_RADIUS, _SMALLER = 300.0, 1e-4

# Half thickness of flat boxes, relative to the largest coordinate; where the stock camera begins to
# see, relative to the farthest point of all surfaces.
_THINNEST = _NEAREST = 1e-6


def convert(scene: Scene, flavour: str, samples: int | None = None) -> str:
    """Convert a scene to Mitsuba XML, in a flavour, a key of `SAMPLES`.

    Raises ValueError for numbers beyond those of float32, and for too many square pixels.
    """
    count = SAMPLES[flavour] if samples is None else samples
    return {"stock": stock, "exact": exact}[flavour](scene, count)


class Normalisation(NamedTuple):
    """Moves and scales a scene, p -> (p - center) * scale, which changes no picture."""

    center: Floats
    scale: float

    def __call__(self, points: Floats) -> Floats:
        """Normalised points (..., 3)."""
        return (points - self.center) * self.scale

    def __str__(self) -> str:
        center = ", ".join(f"{x:.6g}" for x in self.center)
        here = f"where the scene file has p, this has {self.scale:.6g} (p - c), c = ({center}).\n"
        return "It is moved and scaled, for float32, which changes no picture:\n" + here


def normalisation(scene: Scene) -> Normalisation:
    """Moves the part of a scene that is seen to the origin, and scales it to 10 units."""
    points = visible_points(scene)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else bounds(scene.surfaces)
    extent = float((high - low).max())
    return Normalisation((low + high) / 2, _EXTENT / extent if extent > 0 else 1.0)


def _stock_place(scene: Scene) -> Normalisation:
    """Keep the file's own coordinates, unless float32 would spoil the picture."""
    place = normalisation(scene)
    least, most = _OWN_EXTENT
    near = np.abs(place.center).max() * place.scale <= _OWN_OFFSET * _EXTENT
    if near and least <= _EXTENT / place.scale <= most:
        place = Normalisation(np.zeros(3), 1.0)
    largest = place.scale * float(scene.surfaces.radius.max(initial=0))
    if largest > _LARGEST_RADIUS:
        place = place._replace(scale=place.scale * max(_LARGEST_RADIUS / largest, _SMALLER))
    return place


def _film(scene: Scene) -> str:
    """A linear picture, each sample counted in its own pixel only."""
    return plugin(
        "film",
        "hdrfilm",
        plugin("rfilter", "box"),
        width=scene.width,
        height=scene.height,
        pixel_format="rgb",
        component_format="float32",
    )


def _shapes(scene: Scene, place: Normalisation, names: Sequence[str]) -> list[str]:
    """Write all surfaces in file order; `names`: of the shaders' BSDFs."""
    surfaces = scene.surfaces
    half = (surfaces.max_pt - surfaces.min_pt) * (place.scale / 2)
    # A cube of no thickness has no inverse transform.
    half[half == 0] = _THINNEST * np.abs(place(bounds(surfaces))).max()
    balls = place(surfaces.center).tolist(), (surfaces.radius * place.scale).tolist()
    # Mitsuba's cube, from -1 to 1 along each axis, is scaled and moved.
    cubes = half.tolist(), ((place(surfaces.min_pt) + place(surfaces.max_pt)) / 2).tolist()
    bsdfs = [element(f'ref id="{names[k]}"') for k in surfaces.shader_index.tolist()]
    shapes = [
        plugin("shape", "sphere", xyz("point", "center", center), bsdf, radius=radius)
        for center, radius, bsdf in zip(*balls, bsdfs[: len(balls[0])], strict=True)
    ]
    for scale, middle, bsdf in zip(*cubes, bsdfs[len(shapes) :], strict=True):
        steps = xyz("scale", None, scale), xyz("translate", None, middle)
        to_world = element('transform name="to_world"', *steps)
        shapes.append(plugin("shape", "cube", to_world, bsdf))
    return [shapes[index] for index in np.argsort(surfaces.file_index).tolist()]


def _bsdf_names(surfaces: Surfaces) -> tuple[list[str], dict[str, Shader]]:
    """Name each shader's BSDF, equal ones alike; also return the shader of each name in use."""
    named: dict[Shader, str] = {}
    names = [named.setdefault(shader, f"bsdf{len(named)}") for shader in surfaces.shaders]
    used = {names[shader] for shader in np.unique(surfaces.shader_index).tolist()}
    return names, {name: shader for shader, name in named.items() if name in used}


_EXACT = """
in the exact flavour.

Shading, lights and camera are exactly those of the scene format, by this project's small Mitsuba
plugins. Where it is installed, Python's mitsuba.load_file reads it after mitsuba.set_variant of a
variant that ends in _rgb, and "import converters.plugins".
{moved}"""


@_QUIET
def exact(scene: Scene, samples: int = 1) -> str:
    """By this project's plugins, the same picture: one sample takes the pixel's centre."""
    place = normalisation(scene)
    names, bsdfs = _bsdf_names(scene.surfaces)
    largest = max(_EXTENT, float(scene.surfaces.radius.max(initial=0)) * place.scale)
    parts = [
        plugin("integrator", "every_light", tolerance=_TOLERANCE_ROUNDINGS * largest * 2.0**-24),
        _exact_sensor(scene, place, samples),
    ]
    for light in scene.lights:
        position = xyz("point", "position", place(np.array(light.position)))
        intensity = xyz("vector", "intensity", light.intensity)
        parts.append(plugin("emitter", "unattenuated_point", position, intensity))
    for name, shader in bsdfs.items():
        phong = shader if isinstance(shader, Phong) else Phong(diffuse=shader.diffuse)
        lobes = xyz("vector", "diffuse", phong.diffuse), xyz("vector", "specular", phong.specular)
        parts.append(plugin("bsdf", "blinn_phong", *lobes, name=name, exponent=phong.exponent))
    return document(_EXACT.format(moved=place), [*parts, *_shapes(scene, place, names)])


def _exact_sensor(scene: Scene, place: Normalisation, samples: int) -> str:
    """The camera by its eye and its window; its rays start on a box around the scene."""
    window = window_of(scene.camera)
    right, down, _ = window.axes
    # A little wider than the scene, so that no ray starts on a surface.
    (low, high), margin = place(bounds(scene.surfaces)), 1e-3 * _EXTENT
    return plugin(
        "sensor",
        "window",
        xyz("point", "eye", place(window.eye)),
        xyz("vector", "corner", window.points(0, 0) * place.scale),
        xyz("vector", "right", right * (window.width * place.scale)),
        xyz("vector", "down", down * (window.height * place.scale)),
        xyz("point", "low", low - margin),
        xyz("point", "high", high + margin),
        _film(scene),
        plugin("sampler", "stratified", sample_count=samples, jitter=samples > 1),
    )


def squared(scene: Scene) -> Scene:
    """A scene with as many columns, in square pixels, and a window of as many rows as fit best."""
    camera = scene.camera
    rows = scene.width * camera.view_height / camera.view_width
    if not scene.width * rows <= 1 << 28:
        raise ValueError(
            f"cannot be converted: Mitsuba's pixels are square, and {rows:.3g} rows of"
            f" {scene.width} are too many; make viewWidth larger or viewHeight smaller"
        )
    height = max(1, round(rows))
    if height == rows == scene.height:
        return scene
    window = replace(camera, view_height=height * camera.view_width / scene.width)
    return replace(scene, height=height, camera=window)


_STOCK = """
with stock plugins only: it opens in the plain mitsuba command.

The geometry and the camera are exact. Approximate are
- the lights: Mitsuba's fall off with the square of the distance, those of the scene format do
  not fall off at all. The strength of each is right at one distance, which is given beside it;
- highlights: Blinn-Phong's (n.h)^p is stood in for by a Beckmann lobe of the same height and
  width, which brightens towards the silhouettes.
{notes}"""

_SQUARE = """Its pixels are square: {width} x {height} of them show the window, to within half
a pixel, not {width} x {given}.
"""

_GAIN = """Mitsuba allows no reflectance above 1, and where there are highlights above 1/2: all are
divided by {gain:g}, lights multiplied.
"""


@_QUIET
def stock(scene: Scene, samples: int = 64) -> str:
    """By stock plugins, a similar picture: point lights that fall off."""
    place, square, strength = _stock_place(scene), squared(scene), gain(scene.surfaces)
    names, bsdfs = _bsdf_names(scene.surfaces)
    seen = visible_points(scene)
    if not len(seen):
        seen = bounds(scene.surfaces).mean(axis=0, keepdims=True)
    parts = [
        # Light straight from the lights, of which one is picked at random for each sample.
        plugin("integrator", "direct", emitter_samples=1, bsdf_samples=0),
        _stock_sensor(square, place, _evenly(samples, len(scene.lights))),
        *(_point(light, place, strength, place(seen)) for light in scene.lights),
        *(_stock_bsdf(shader, name, strength) for name, shader in bsdfs.items()),
        *_shapes(scene, place, names),
    ]
    notes = ""
    if square.height != scene.height:
        notes += _SQUARE.format(width=scene.width, height=square.height, given=scene.height)
    if strength != 1:
        notes += _GAIN.format(gain=strength)
    if place.scale != 1 or place.center.any():
        notes += str(place)
    return document(_STOCK.format(notes=notes), parts)


def _evenly(samples: int, lights: int) -> int:
    """Round samples up until Mitsuba's `multijitter` gives each light equally many."""
    count = samples
    while lights and samples >= lights and (count % lights or count % isqrt(count)):
        count += 1
    return count


def _to_world(window: Window, place: Normalisation) -> str:
    """Mitsuba's cameras look along +z with +x to the left and +y up."""
    right, down, ahead = window.axes
    rows = np.column_stack([-right, -down, ahead, place(window.eye)])
    return matrix("to_world", [*rows, (0, 0, 0, 1)])


def _stock_sensor(scene: Scene, place: Normalisation, samples: int) -> str:
    """The camera by its field of view and principal point."""
    window = window_of(scene.camera)
    across, below, depth = window.center
    farthest = np.abs(bounds(scene.surfaces) - window.eye).max(axis=0)
    far = place.scale * float(np.linalg.norm(farthest)) or 1.0
    return plugin(
        "sensor",
        "perspective",
        _to_world(window, place),
        _film(scene),
        plugin("sampler", "multijitter", sample_count=samples),
        fov_axis="x",
        fov=degrees(2 * atan(window.width / 2 / depth)),
        # What rounding leaves of zero is zero.
        principal_point_offset_x=round(float(across / window.width), 12),
        principal_point_offset_y=round(float(below / window.height), 12),
        # The window may be anywhere: it only says what is in the picture.
        near_clip=_NEAREST * far,
        far_clip=2 * far,
    )


def _point(light: PointLight, place: Normalisation, strength: float, seen: Floats) -> str:
    """A light that is right at one distance: that of least squares over points (n, 3)."""
    position = place(np.array(light.position))
    square = ((seen - position) ** 2).sum(axis=1)
    # In units of the largest, whatever the scene's; in the light itself nothing is divided by zero.
    largest = float(square.max()) or 1.0
    inverse = 1 / np.maximum(square / largest, 1e-12)
    distance2 = largest * float(inverse.sum() / (inverse * inverse).sum())
    # A diffuse surface reflects 1 / pi of its reflectance.
    intensity = np.array(light.intensity) * (np.pi * strength * distance2)
    note = f"<!-- right at a distance of {distance2**0.5:.4g} -->"
    at = xyz("point", "position", position)
    return plugin("emitter", "point", note, at, rgb("intensity", intensity))


def gain(surfaces: Surfaces) -> float:
    """Factor that reflectances are divided by: 1, or the largest; those of blends count twice."""
    used = [surfaces.shaders[k] for k in np.unique(surfaces.shader_index).tolist()]
    needed = [(2 if _is_blend(shader) else 1) * np.array(_lobes(shader)) for shader in used]
    return float(np.max(needed, initial=1))


def _is_blend(shader: Shader) -> TypeGuard[Phong]:
    """Whether two BSDFs are blended, half and half: a diffuse one and a highlight."""
    return isinstance(shader, Phong) and any(shader.specular)


def _lobes(shader: Shader) -> tuple[Floats, Floats]:
    """Diffuse and specular reflectance (3,), as Mitsuba measures them."""
    diffuse = np.array(shader.diffuse)
    if not isinstance(shader, Phong):
        return diffuse, np.zeros(3)
    # The stock lobe's height is its reflectance times (exponent + 2) / 8.
    return diffuse, np.array(shader.specular) * 8 / (shader.exponent + 2)


def _stock_bsdf(shader: Shader, name: str, strength: float) -> str:
    diffuse, specular = _lobes(shader)
    if _is_blend(shader):
        # A Beckmann lobe as wide as the highlight; a blend of weight 0.5 halves both.
        lobe = plugin(
            "bsdf",
            "roughconductor",
            rgb("specular_reflectance", 2 * specular / strength),
            material="none",
            distribution="beckmann",
            alpha=(2 / (shader.exponent + 2)) ** 0.5,
        )
        matte = plugin("bsdf", "diffuse", rgb("reflectance", 2 * diffuse / strength))
        bsdf = plugin("bsdf", "blendbsdf", matte, lobe, weight=0.5)
    else:
        bsdf = plugin("bsdf", "diffuse", rgb("reflectance", diffuse / strength))
    return plugin("bsdf", "twosided", bsdf, name=name)
