"""Convert a scene to a file for Mitsuba 3, in one of two flavours.

In the *exact* flavour, this project's own plugins (`converters.plugins`) compute the same picture
as the tracer.  In the *stock* flavour, Mitsuba's built-in plugins approximate that picture.

A Mitsuba scene consists of plugins.  Each part of a scene (camera, light, shader, surface) becomes
one plugin, which is an XML element.  A shader becomes a BSDF, the plugin that says how a surface
reflects light.  Mitsuba computes with float32, so all points and lengths are first translated and
scaled by a `Normalization`.  Every function that creates an element raises `ConversionError` if
Mitsuba cannot represent a number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import atan, degrees, isqrt
from typing import Annotated as Shaped
from typing import NamedTuple, TypeGuard
from xml.etree.ElementTree import Comment, Element

import numpy as np

from converters.camera import Floats, compute_bounding_box, compute_window, sample_visible_points
from converters.mitsuba_xml import (
    ConversionError,
    Document,
    make_color,
    make_plugin,
    make_transform,
    make_vector,
)
from tracer import Phong, PointLight, Scene, Shader, Surfaces

DEFAULT_SAMPLES = {"stock": 64, "exact": 1}
"""Default number of samples per pixel of each flavour."""

# NumPy need not warn about overflows: an infinite number raises `ConversionError` when it is
# formatted (see `mitsuba_xml`).
_IGNORE_OVERFLOW = np.errstate(all="ignore")

# Size, in Mitsuba's units, to which scenes are scaled: float32 is most accurate near the origin.
_SCENE_SIZE = 10.0

# Maximum error of the position of a hit in the exact flavour.  The unit is one rounding error of
# float32 (2^-24) of the largest length in the scene.
_TOLERANCE_ROUNDINGS = 32

# A stock scene keeps its coordinates if the size of its visible part, which is the longest edge of
# the bounding box, is between these numbers of the scene's units of length.
_MIN_KEPT_SIZE = 0.1
_MAX_KEPT_SIZE = 1e6

# It keeps them only if no coordinate of the box's centre is more than this multiple of the size.
_MAX_KEPT_DISTANCE = 10.0

# A stock scene with spheres of more than this radius, in Mitsuba's units, is scaled down.  Hits on
# a sphere have an error of 1e-7 of its radius, but shadow rays start only 1e-4 above the surface.
_MAX_RADIUS = 300.0

# Minimum factor by which a scene with larger spheres is scaled.  With a smaller one, shadow rays,
# which start 1e-4 above a surface, would start above small objects.
_MIN_SHRINK_FACTOR = 1e-4

# Half the thickness that a flat box gets, relative to the largest coordinate in the scene.
_MIN_HALF_THICKNESS = 1e-6

# Distance from the stock camera to its near plane, relative to the distance of its far plane.
_NEAR_DISTANCE = 1e-6

# Maximum field of view in degrees.  Closer to 180, float32 has too few digits of it.
_MAX_FOV = 179.99

# Maximum number of pixels in a converted picture.
_MAX_PIXELS = 1 << 28


def convert(scene: Scene, flavour: str, samples: int | None = None) -> str:
    """Convert a scene to the text of a Mitsuba scene file.

    Parameters
    ----------
    scene : Scene
        The scene to convert.
    flavour : str
        "exact" to reproduce the tracer's picture with this project's plugins, or "stock" to
        approximate it with Mitsuba's built-in plugins.
    samples : int, optional
        Number of samples per pixel.  By default, 1 for "exact" and 64 for "stock".

    Returns
    -------
    text : str
        XML, starting with a comment about the conversion.

    Raises
    ------
    ConversionError
        If the scene contains numbers that Mitsuba cannot represent, or needs more than 2^28 pixels.
    KeyError
        If there is no such flavour.
    """
    make_document = {"stock": convert_to_stock, "exact": convert_to_exact}[flavour]
    return str(make_document(scene, DEFAULT_SAMPLES[flavour] if samples is None else samples))


class Normalization(NamedTuple):
    """A map of each point p of a scene to the point (p - center) * scale of the Mitsuba scene.

    The picture stays the same, and the coordinates move into the range where float32 is accurate.
    """

    center: Shaped[Floats, "3"]
    scale: float

    def __call__(self, points: Shaped[Floats, "... 3"]) -> Shaped[Floats, "... 3"]:
        """Map points of the scene to points of the Mitsuba scene."""
        return (points - self.center) * self.scale

    def __str__(self) -> str:
        center = ", ".join(f"{x:.6g}" for x in self.center)
        return (
            "The scene is moved and scaled to suit float32, which does not change the picture:\n"
            f"a point p of the scene file becomes {self.scale:.6g} (p - c), where c = ({center}).\n"
        )


def choose_normalization(scene: Scene) -> Normalization:
    """Choose the translation and the scale that fit the visible part of a scene into a cube.

    The cube is centred at the origin, and its edges are `_SCENE_SIZE` long.  If no surface is
    visible, all surfaces are fitted into the cube.  If these are only a point, or there are none,
    the scale is 1.
    """
    visible_points = sample_visible_points(scene)
    points = visible_points if len(visible_points) else compute_bounding_box(scene.surfaces)
    min_corner, max_corner = points.min(axis=0), points.max(axis=0)
    size = float((max_corner - min_corner).max())
    center = (min_corner + max_corner) / 2
    return Normalization(center=center, scale=_SCENE_SIZE / size if size > 0 else 1.0)


def _choose_stock_normalization(scene: Scene) -> Normalization:
    """Choose the translation and the scale of a scene for the stock flavour.

    The scene keeps its coordinates unless its visible part is very small, very large or far from
    the origin.  A scene with very large spheres is scaled down.
    """
    normalization = choose_normalization(scene)
    visible_size = _SCENE_SIZE / normalization.scale
    is_near_origin = np.abs(normalization.center).max() <= _MAX_KEPT_DISTANCE * visible_size
    if is_near_origin and _MIN_KEPT_SIZE <= visible_size <= _MAX_KEPT_SIZE:
        normalization = Normalization(center=np.zeros(3), scale=1.0)
    largest_radius = normalization.scale * float(scene.surfaces.radius.max(initial=0))
    if largest_radius > _MAX_RADIUS:
        shrink_factor = max(_MAX_RADIUS / largest_radius, _MIN_SHRINK_FACTOR)
        normalization = normalization._replace(scale=normalization.scale * shrink_factor)
    return normalization


def _make_film(scene: Scene) -> Element:
    """Create the film plugin, which stores the picture as linear RGB radiance in float32.

    The radiance of a pixel is the average of its own samples, because the film has a box filter.
    """
    box_filter = make_plugin("rfilter", "box")
    width, height = scene.width, scene.height
    pixel_format = {"pixel_format": "rgb", "component_format": "float32"}
    return make_plugin("film", "hdrfilm", box_filter, width=width, height=height, **pixel_format)


def _convert_surfaces(
    surfaces: Surfaces, normalization: Normalization, bsdf_names: Sequence[str]
) -> list[Element]:
    """Convert all surfaces to shape plugins, in the order of the scene file.

    `bsdf_names` contains, for each shader in `surfaces.shaders`, the name of the BSDF plugin to
    which it is converted.
    """
    # In the arrays of `surfaces`, all spheres come before all boxes.
    shapes = [*_make_spheres(surfaces, normalization), *_make_cubes(surfaces, normalization)]
    for shape, shader_index in zip(shapes, surfaces.shader_index.tolist(), strict=True):
        shape.append(Element("ref", id=bsdf_names[shader_index]))
    return [shapes[index] for index in surfaces.array_index.tolist()]


def _make_spheres(surfaces: Surfaces, normalization: Normalization) -> Iterator[Element]:
    """Yield a shape plugin, still without BSDF, for each sphere."""
    radii = (surfaces.radius * normalization.scale).tolist()
    for center, radius in zip(normalization(surfaces.center).tolist(), radii, strict=True):
        center_element = make_vector("point", "center", center)
        yield make_plugin("shape", "sphere", center_element, radius=radius)


def _make_cubes(surfaces: Surfaces, normalization: Normalization) -> Iterator[Element]:
    """Yield a shape plugin, still without BSDF, for each box.

    A flat box gets a small thickness, because Mitsuba cannot invert the transform of a flat cube.
    """
    # Mitsuba's cube extends from -1 to 1, so it is scaled by half the size of the box.
    half_sizes = (surfaces.max_pt - surfaces.min_pt) * (normalization.scale / 2)
    largest_coordinate = np.abs(normalization(compute_bounding_box(surfaces))).max()
    half_sizes[half_sizes == 0] = _MIN_HALF_THICKNESS * largest_coordinate
    centers = (normalization(surfaces.min_pt) + normalization(surfaces.max_pt)) / 2
    for half_size, center in zip(half_sizes.tolist(), centers.tolist(), strict=True):
        to_world = Element("transform", name="to_world")
        to_world.append(make_vector("scale", None, half_size))
        to_world.append(make_vector("translate", None, center))
        yield make_plugin("shape", "cube", to_world)


def _name_bsdfs(surfaces: Surfaces) -> tuple[list[str], dict[str, Shader]]:
    """Choose the name of a BSDF plugin for each shader.  Equal shaders get the same name.

    Return (1) the name for each shader in `surfaces.shaders`, and (2) the shader for each name that
    a surface uses.
    """
    distinct_shaders = dict.fromkeys(surfaces.shaders)
    name_of_shader = {shader: f"bsdf{index}" for index, shader in enumerate(distinct_shaders)}
    bsdf_names = [name_of_shader[shader] for shader in surfaces.shaders]
    used_shaders = (surfaces.shaders[index] for index in np.unique(surfaces.shader_index))
    return bsdf_names, {name_of_shader[shader]: shader for shader in used_shaders}


_EXACT_COMMENT = """
in the exact flavour.

Shading, lights and camera are exactly those of the scene format, thanks to Mitsuba plugins of this
project. To load the file in Python, set a Mitsuba variant that ends in _rgb, import
converters.plugins, and call mitsuba.load_file.
{normalization}"""


@_IGNORE_OVERFLOW
def convert_to_exact(scene: Scene, samples: int = 1) -> Document:
    """Convert a scene to a Mitsuba scene that reproduces the tracer's picture.

    `samples` is the number of samples per pixel.  A single one is at the pixel's centre.
    """
    normalization = choose_normalization(scene)
    bsdf_names, shader_of_name = _name_bsdfs(scene.surfaces)
    largest_radius = float(scene.surfaces.radius.max(initial=0)) * normalization.scale
    tolerance = _TOLERANCE_ROUNDINGS * max(_SCENE_SIZE, largest_radius) * 2.0**-24
    elements = [
        make_plugin("integrator", "every_light", tolerance=tolerance),
        _make_exact_sensor(scene, normalization, samples),
        *(_convert_light_exactly(light, normalization) for light in scene.lights),
        *(_convert_shader_exactly(shader, name) for name, shader in shader_of_name.items()),
        *_convert_surfaces(scene.surfaces, normalization, bsdf_names),
    ]
    return Document(_EXACT_COMMENT.format(normalization=normalization), elements)


def _convert_light_exactly(light: PointLight, normalization: Normalization) -> Element:
    """Convert a light to this project's plugin `converters.plugins.UnattenuatedPoint`."""
    position = make_vector("point", "position", normalization(np.array(light.position)))
    intensity = make_vector("vector", "intensity", light.intensity)
    return make_plugin("emitter", "unattenuated_point", position, intensity)


def _convert_shader_exactly(shader: Shader, name: str) -> Element:
    """Convert a shader to this project's plugin `converters.plugins.BlinnPhong`, with a name."""
    phong = shader if isinstance(shader, Phong) else Phong(diffuse=shader.diffuse)
    diffuse = make_vector("vector", "diffuse", phong.diffuse)
    specular = make_vector("vector", "specular", phong.specular)
    return make_plugin("bsdf", "blinn_phong", diffuse, specular, name=name, exponent=phong.exponent)


def _make_exact_sensor(scene: Scene, normalization: Normalization, samples: int) -> Element:
    """Create the sensor of the exact flavour: this project's plugin `converters.plugins.Window`.

    Its rays start on a box around all surfaces, because positions there are accurate in float32.
    """
    window = compute_window(scene.camera)
    corner_vector = window.compute_vectors_from_eye(0, 0)
    right, down, _ = window.axes
    min_corner, max_corner = normalization(compute_bounding_box(scene.surfaces))
    margin = 1e-3 * _SCENE_SIZE  # so that no ray starts on a surface
    return make_plugin(
        "sensor",
        "window",
        make_vector("point", "eye", normalization(window.eye)),
        make_vector("vector", "corner", corner_vector * normalization.scale),
        make_vector("vector", "right", right * (window.width * normalization.scale)),
        make_vector("vector", "down", down * (window.height * normalization.scale)),
        make_vector("point", "low", min_corner - margin),
        make_vector("point", "high", max_corner + margin),
        _make_film(scene),
        make_plugin("sampler", "stratified", sample_count=samples, jitter=samples > 1),
    )


def make_pixels_square(scene: Scene) -> Scene:
    """Return a scene like this one, but with another number of rows, so that pixels are square.

    The number of rows is rounded to an integer of at least 1, and the height of the camera's window
    is changed to match.  If the pixels are square already, the result is `scene` itself.  Raise
    `ConversionError` if the picture would have more than `_MAX_PIXELS` pixels.
    """
    camera = scene.camera
    row_count = scene.width * camera.view_height / camera.view_width
    if not scene.width * row_count <= _MAX_PIXELS:  # also if it is NaN
        raise ConversionError(
            f"Mitsuba's pixels are square, but {scene.width} x {row_count:.3g} are too many;"
            " make viewWidth larger or viewHeight smaller"
        )
    height = max(1, round(row_count))
    if height == row_count == scene.height:
        return scene
    square_camera = replace(camera, view_height=height * camera.view_width / scene.width)
    return replace(scene, height=height, camera=square_camera)


_STOCK_COMMENT = """
in the stock flavour: the plain mitsuba command can render it.

The geometry and the camera are exact, but these are approximations:
- Lights: Mitsuba's lights fall off with the square of the distance; those of the scene format do
  not. Each light is exact at one distance, which a comment beside it states.
- Highlights: a Beckmann lobe of the same height and width replaces the Blinn-Phong highlight
  (n.h)^p. It is brighter near silhouettes.
{notes}"""

_SQUARE_PIXELS_NOTE = """The picture has {0} x {1} pixels instead of {0} x {2}, so that they are
square. It shows the window to within half a pixel.
"""

_DIVISOR_NOTE = """\
Mitsuba allows no reflectance above 1, or above 1/2 if there is a highlight. So all are
divided by {:g}, and the intensities of the lights are multiplied by it.
"""


@_IGNORE_OVERFLOW
def convert_to_stock(scene: Scene, samples: int = 64) -> Document:
    """Approximate a scene by a Mitsuba scene that needs only Mitsuba's built-in plugins.

    The pixels become square, the lights fall off with distance, and the highlights have a different
    shape.  `samples` is the number of samples per pixel.  It may be rounded up, so that all lights
    get the same number.
    """
    normalization = _choose_stock_normalization(scene)
    square_scene = make_pixels_square(scene)
    divisor = choose_reflectance_divisor(scene.surfaces)
    bsdf_names, shader_of_name = _name_bsdfs(scene.surfaces)
    visible_points = sample_visible_points(scene)
    if not len(visible_points):
        visible_points = compute_bounding_box(scene.surfaces).mean(axis=0, keepdims=True)
    sample_count = _round_up_samples(samples, len(scene.lights))
    elements = [
        # Direct light only.  Mitsuba chooses one light for each sample.
        make_plugin("integrator", "direct", emitter_samples=1, bsdf_samples=0),
        _make_stock_sensor(square_scene, normalization, sample_count),
        *(_convert_light(light, normalization, divisor, visible_points) for light in scene.lights),
        *(_convert_shader(shader, name, divisor) for name, shader in shader_of_name.items()),
        *_convert_surfaces(scene.surfaces, normalization, bsdf_names),
    ]
    # What the comment of the file says depends on the scene.
    notes = ""
    if square_scene.height != scene.height:
        notes += _SQUARE_PIXELS_NOTE.format(scene.width, square_scene.height, scene.height)
    if divisor != 1:
        notes += _DIVISOR_NOTE.format(divisor)
    if normalization.scale != 1 or normalization.center.any():
        notes += str(normalization)
    return Document(_STOCK_COMMENT.format(notes=notes), elements)


def _round_up_samples(min_samples: int, light_count: int) -> int:
    """Round the number of samples per pixel up, so that each light can get the same number of them.

    The result is a multiple of the number of lights.  It is also a multiple of its own square root,
    rounded down, because Mitsuba's sampler "multijitter" requires that.  If there are no lights, or
    more lights than samples, the result is `min_samples`.
    """
    samples = min_samples
    while 0 < light_count <= min_samples and (samples % light_count or samples % isqrt(samples)):
        samples += 1
    return samples


def _make_stock_sensor(scene: Scene, normalization: Normalization, samples: int) -> Element:
    """Create the sensor of the stock flavour, Mitsuba's "perspective", for square pixels.

    Raise `ConversionError` if the field of view, in float32, is 0 or close to 180 degrees.
    """
    window = compute_window(scene.camera)
    right, down, forward = window.axes
    # In Mitsuba's camera axes, x points to the left, y up, and z along the direction of view.
    to_world = np.column_stack([-right, -down, forward, normalization(window.eye)])
    # The field of view is that of a window of this size whose centre is straight ahead.  The offset
    # of the principal point then shifts the window to the right place.
    offset_right, offset_down, distance = window.offset
    fov = degrees(2 * atan(window.width / 2 / distance))
    if not 0 < np.float32(fov) <= _MAX_FOV:
        raise ConversionError(
            f"its field of view would be {fov:g} degrees, but Mitsuba needs more than 0 and at most"
            f" {_MAX_FOV}; choose a viewWidth closer to projDistance"
        )
    farthest_offset = np.abs(compute_bounding_box(scene.surfaces) - window.eye).max(axis=0)
    # The distance is 0 if the only surface is a point at the eye, but Mitsuba needs a positive one.
    far_distance = normalization.scale * float(np.linalg.norm(farthest_offset)) or 1.0
    return make_plugin(
        "sensor",
        "perspective",
        make_transform("to_world", [*to_world, (0, 0, 0, 1)]),
        _make_film(scene),
        make_plugin("sampler", "multijitter", sample_count=samples),
        fov_axis="x",
        fov=fov,
        # Round to 12 digits, so that an offset of 0 stays 0 despite rounding errors.
        principal_point_offset_x=round(float(offset_right / window.width), 12),
        principal_point_offset_y=round(float(offset_down / window.height), 12),
        # Objects between the eye and the window are visible, too.
        near_clip=_NEAR_DISTANCE * far_distance,
        # Twice the distance, so that rounding never clips the farthest surface.
        far_clip=2 * far_distance,
    )


def _convert_light(
    light: PointLight,
    normalization: Normalization,
    divisor: float,
    visible_points: Shaped[Floats, "n 3"],
) -> Element:
    """Convert a light to a Mitsuba point light, which falls off with the square of the distance.

    The Mitsuba light is as strong as the original at one distance only, which a comment states.
    This distance minimises the sum of the squared errors of the irradiance at `visible_points`.
    The intensity is multiplied by `divisor`, by which all reflectances are divided.
    """
    # If the light is exact at the distance b, its strength at the distance d is b^2 f, with the
    # falloff f = 1 / d^2, and should be 1.  The sum of (b^2 f - 1)^2 over all points is least for
    # b^2 = sum(f) / sum(f^2).
    position = normalization(np.array(light.position))
    squared_distances = ((normalization(visible_points) - position) ** 2).sum(axis=1)
    # Divide by the largest square, unless it is 0, so that nothing overflows.  The minimum of 1e-12
    # avoids division by 0.
    largest_square = float(squared_distances.max()) or 1.0
    falloff = 1 / np.maximum(squared_distances / largest_square, 1e-12)
    best_squared_distance = largest_square * float(falloff.sum() / (falloff * falloff).sum())
    # Mitsuba's diffuse BSDF is the reflectance divided by pi.
    intensity = np.array(light.intensity) * (np.pi * divisor * best_squared_distance)
    comment = Comment(f" exact at a distance of {best_squared_distance**0.5:.4g} ")
    children = make_vector("point", "position", position), make_color("intensity", intensity)
    return make_plugin("emitter", "point", comment, *children)


def choose_reflectance_divisor(surfaces: Surfaces) -> float:
    """Choose the number by which all reflectances are divided, because Mitsuba allows none above 1.

    It is the smallest such number, but at least 1.  Shaders that no surface uses do not count.
    """
    used_shaders = [surfaces.shaders[index] for index in np.unique(surfaces.shader_index).tolist()]
    return max([1.0, *(float(np.max(_compute_reflectances(shader))) for shader in used_shaders)])


def _has_highlight(shader: Shader) -> TypeGuard[Phong]:
    return isinstance(shader, Phong) and any(shader.specular)


class _Reflectances(NamedTuple):
    """RGB reflectances of the two BSDFs that represent a shader in the stock flavour."""

    diffuse: Shaped[Floats, "3"]
    beckmann: Shaped[Floats, "3"]


def _compute_reflectances(shader: Shader) -> _Reflectances:
    """Compute the reflectances of the diffuse and the Beckmann BSDF that represent a shader.

    A shader with a highlight becomes a blend of the two.  Their reflectances are doubled, because
    the blend halves both, so they may exceed 1.  Without a highlight, the Beckmann BSDF is black.
    """
    diffuse = np.array(shader.diffuse)
    if not _has_highlight(shader):
        return _Reflectances(diffuse=diffuse, beckmann=np.zeros(3))
    # The maximum of the Beckmann BSDF is its reflectance times (exponent + 2) / 8.
    beckmann = np.array(shader.specular) * 8 / (shader.exponent + 2)
    return _Reflectances(diffuse=2 * diffuse, beckmann=2 * beckmann)


def _convert_shader(shader: Shader, name: str, divisor: float) -> Element:
    """Convert a shader to a two-sided BSDF plugin with a name.

    The BSDF is diffuse, or a blend of a diffuse and a Beckmann BSDF if the shader has a highlight.
    All reflectances are divided by `divisor`.
    """
    reflectances = _compute_reflectances(shader)
    diffuse_color = make_color("reflectance", reflectances.diffuse / divisor)
    bsdf = make_plugin("bsdf", "diffuse", diffuse_color)
    if _has_highlight(shader):
        # With this roughness, the Beckmann lobe is as wide as the highlight.
        roughness = (2 / (shader.exponent + 2)) ** 0.5
        specular_color = make_color("specular_reflectance", reflectances.beckmann / divisor)
        options = {"material": "none", "distribution": "beckmann"}
        lobe = make_plugin("bsdf", "roughconductor", specular_color, **options, alpha=roughness)
        bsdf = make_plugin("bsdf", "blendbsdf", bsdf, lobe, weight=0.5)
    return make_plugin("bsdf", "twosided", bsdf, name=name)
