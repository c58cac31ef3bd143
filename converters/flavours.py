"""Convert a scene to a file for Mitsuba 3, in one of two flavours.

*exact*: this project's own plugins compute the same picture as the tracer.  *stock*: the plugins
that come with Mitsuba compute a similar picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import atan, degrees, isqrt
from typing import NamedTuple, TypeGuard
from xml.etree.ElementTree import Comment, Element

import numpy as np

from converters.camera import Floats, bounding_box, camera_window, visible_points
from converters.mitsuba_xml import ConversionError, Document, matrix, plugin, rgb, xyz
from tracer import Phong, PointLight, Scene, Shader, Surfaces

__all__ = ["SAMPLES", "choose_normalisation", "convert", "convert_exact", "convert_stock"]
__all__ += ["reflectance_divisor", "with_square_pixels"]

SAMPLES = {"stock": 64, "exact": 1}
"""Default number of samples per pixel of each flavour."""

# Overflow is not an error where it occurs, but where a number is written.
_IGNORE_OVERFLOW = np.errstate(all="ignore")

# Size, in Mitsuba's units, to which scenes are scaled: float32 is most accurate near the origin.
_SCENE_SIZE = 10.0

# Maximum error of a hit in the exact flavour, in roundings (2^-24) of the scene's largest length.
_TOLERANCE_ROUNDINGS = 32

# A scene for Mitsuba's own plugins keeps its coordinates if the size of its visible part is between
# the first two numbers, and its distance from the origin is at most the third times that size.
_MIN_OWN_SIZE, _MAX_OWN_SIZE, _MAX_OWN_DISTANCE = 0.1, 1e6, 10.0

# Maximum radius of a sphere in a stock scene.  Hits on it have an error of 1e-7 of the radius, and
# Mitsuba starts shadow rays 1e-4 above the surface.  The scene is scaled down for larger spheres,
# but at most by _MIN_SHRINKAGE, so that shadow rays do not start above its small objects.
_MAX_RADIUS, _MIN_SHRINKAGE = 300.0, 1e-4

# Half the thickness of a flat box, relative to the largest coordinate in the scene.
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
        "exact" to reproduce the tracer's picture by this project's plugins, or "stock" to
        approximate the picture by Mitsuba's own plugins.
    samples : int, optional
        Number of samples per pixel.  By default, 1 for "exact" and 64 for "stock".

    Returns
    -------
    text : str
        XML, which begins with a comment about the conversion.

    Raises
    ------
    ConversionError
        If the scene has numbers that Mitsuba cannot represent, or needs too many square pixels.
    """
    sample_count = SAMPLES[flavour] if samples is None else samples
    return str({"stock": convert_stock, "exact": convert_exact}[flavour](scene, sample_count))


class Normalisation(NamedTuple):
    """A translation and a scaling of a scene, which maps each point p to (p - center) * scale.

    The normalisation changes no picture, but moves the coordinates into the range where float32 is
    accurate.

    Attributes
    ----------
    center : (3,) float array
        The point of the scene that becomes the origin.
    scale : float
        Length after the normalisation of a segment of length 1.
    """

    center: Floats
    scale: float

    def __call__(self, points: Floats) -> Floats:
        """Translate and scale points (..., 3); return an array of the same shape."""
        return (points - self.center) * self.scale

    def __str__(self) -> str:
        center = ", ".join(f"{x:.6g}" for x in self.center)
        return (
            "It is moved and scaled, for float32, which changes no picture:\n"
            f"the point p of the scene file is {self.scale:.6g} (p - c), c = ({center}) here.\n"
        )


def choose_normalisation(scene: Scene) -> Normalisation:
    """Choose the translation and scaling that fit a scene's visible part into a cube at the origin.

    The cube is centred at the origin, with edges of 10 units.  If no surface is visible, all
    surfaces together replace the visible part.

    Parameters
    ----------
    scene : Scene
        The scene, with its camera.

    Returns
    -------
    normalisation : Normalisation
        The translation and the scaling.  The scale is 1 if the visible part is a single point.
    """
    visible, surfaces = visible_points(scene), scene.surfaces
    points = visible if len(visible) else bounding_box(surfaces)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    return Normalisation((low + high) / 2, _SCENE_SIZE / size if size > 0 else 1.0)


def _stock_normalisation(scene: Scene) -> Normalisation:
    """Choose the translation and the scaling of a scene for Mitsuba's own plugins.

    Mitsuba computes with float32.  The scene keeps its coordinates if its visible part is neither
    too small, nor too large, nor too far from the origin.  A scene with very large spheres is
    scaled down.

    Parameters
    ----------
    scene : Scene
        The scene, with its camera.

    Returns
    -------
    normalisation : Normalisation
        The translation and the scaling.  If the scene keeps its coordinates, the scale is 1 and the
        centre is the origin.
    """
    normalise = choose_normalisation(scene)
    size = _SCENE_SIZE / normalise.scale
    is_near = np.abs(normalise.center).max() <= _MAX_OWN_DISTANCE * size
    if is_near and _MIN_OWN_SIZE <= size <= _MAX_OWN_SIZE:
        normalise = Normalisation(np.zeros(3), 1.0)
    largest_radius = normalise.scale * float(scene.surfaces.radius.max(initial=0))
    if largest_radius > _MAX_RADIUS:
        shrinkage = max(_MAX_RADIUS / largest_radius, _MIN_SHRINKAGE)
        normalise = normalise._replace(scale=normalise.scale * shrinkage)
    return normalise


def _film_element(scene: Scene) -> Element:
    """Create the Mitsuba film for a scene: a picture of linear radiance with a box filter.

    Parameters
    ----------
    scene : Scene
        The scene, whose width and height are those of the picture.

    Returns
    -------
    film : Element
        The plugin "hdrfilm".  Its box filter averages the samples of each pixel separately.
    """
    box_filter, width, height = plugin("rfilter", "box"), scene.width, scene.height
    pixel_type = {"pixel_format": "rgb", "component_format": "float32"}
    return plugin("film", "hdrfilm", box_filter, width=width, height=height, **pixel_type)


def _convert_surfaces(
    surfaces: Surfaces, normalise: Normalisation, bsdf_names: Sequence[str]
) -> list[Element]:
    """Convert all surfaces of a scene to Mitsuba shapes.

    A flat box becomes slightly thick, because Mitsuba cannot invert the transform of a flat cube.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces: spheres and boxes.
    normalise : Normalisation
        The translation and scaling to apply to all points and lengths.
    bsdf_names : sequence of str
        For each shader of the scene, the name of its BSDF.

    Returns
    -------
    shapes : list of Element
        One plugin "sphere" or "cube" for each surface, in the order of the scene file.
    """
    radii = (surfaces.radius * normalise.scale).tolist()
    shapes = [
        plugin("shape", "sphere", xyz("point", "center", center), radius=radius)
        for center, radius in zip(normalise(surfaces.center).tolist(), radii, strict=True)
    ]
    half_size = (surfaces.max_pt - surfaces.min_pt) * (normalise.scale / 2)
    largest_coordinate = np.abs(normalise(bounding_box(surfaces))).max()
    half_size[half_size == 0] = _MIN_HALF_THICKNESS * largest_coordinate
    # Mitsuba's cube, which extends from -1 to 1 along each axis, is scaled and moved.
    centers = (normalise(surfaces.min_pt) + normalise(surfaces.max_pt)) / 2
    for scale, center in zip(half_size.tolist(), centers.tolist(), strict=True):
        to_world = Element("transform", name="to_world")
        to_world.extend([xyz("scale", None, scale), xyz("translate", None, center)])
        shapes.append(plugin("shape", "cube", to_world))
    for shape, shader_index in zip(shapes, surfaces.shader_index.tolist(), strict=True):
        shape.append(Element("ref", id=bsdf_names[shader_index]))
    return [shapes[index] for index in surfaces.file_order.tolist()]


def _name_bsdfs(surfaces: Surfaces) -> tuple[list[str], dict[str, Shader]]:
    """Choose the name of a BSDF for each shader; equal shaders get the same name.

    Parameters
    ----------
    surfaces : Surfaces
        All surfaces of a scene, with their shaders.

    Returns
    -------
    names : list of str
        For each shader, the name of its BSDF.
    shader_of_name : dict of str to Shader
        The shader for each name, without shaders that no surface uses.
    """
    name_of_shader: dict[Shader, str] = {}
    for shader in surfaces.shaders:
        name_of_shader.setdefault(shader, f"bsdf{len(name_of_shader)}")
    names = [name_of_shader[shader] for shader in surfaces.shaders]
    used_shaders = (surfaces.shaders[index] for index in np.unique(surfaces.shader_index))
    return names, {name_of_shader[shader]: shader for shader in used_shaders}


_EXACT = """
in the exact flavour.

Shading, lights and camera are exactly those of the scene format, by this project's small Mitsuba
plugins. Where it is installed, Python's mitsuba.load_file reads it after mitsuba.set_variant of a
variant that ends in _rgb, and "import converters.plugins".
{moved}"""


@_IGNORE_OVERFLOW
def convert_exact(scene: Scene, samples: int = 1) -> Document:
    """Convert a scene to a Mitsuba scene that reproduces the tracer's picture.

    This is the "exact" flavour.  It needs this project's Mitsuba plugins (`converters.plugins`).

    Parameters
    ----------
    scene : Scene
        The scene to convert.
    samples : int
        Number of samples per pixel.  A single sample is at the pixel's centre.

    Returns
    -------
    document : Document
        The converted scene; its `str` is the text of the file.

    Raises
    ------
    ConversionError
        If the scene has numbers that Mitsuba cannot represent.
    """
    normalise = choose_normalisation(scene)
    bsdf_names, shader_of_name = _name_bsdfs(scene.surfaces)
    largest_radius = float(scene.surfaces.radius.max(initial=0)) * normalise.scale
    tolerance = _TOLERANCE_ROUNDINGS * max(_SCENE_SIZE, largest_radius) * 2.0**-24
    elements = [
        plugin("integrator", "every_light", tolerance=tolerance),
        _exact_sensor(scene, normalise, samples),
    ]
    for light in scene.lights:
        position = xyz("point", "position", normalise(np.array(light.position)))
        intensity = xyz("vector", "intensity", light.intensity)
        elements.append(plugin("emitter", "unattenuated_point", position, intensity))
    for name, shader in shader_of_name.items():
        phong = shader if isinstance(shader, Phong) else Phong(diffuse=shader.diffuse)
        colors = xyz("vector", "diffuse", phong.diffuse), xyz("vector", "specular", phong.specular)
        elements.append(plugin("bsdf", "blinn_phong", *colors, name=name, exponent=phong.exponent))
    elements += _convert_surfaces(scene.surfaces, normalise, bsdf_names)
    return Document(_EXACT.format(moved=normalise), elements)


def _exact_sensor(scene: Scene, normalise: Normalisation, samples: int) -> Element:
    """Convert the camera of a scene to this project's Mitsuba sensor "window".

    Parameters
    ----------
    scene : Scene
        The scene, with its camera.
    normalise : Normalisation
        The translation and scaling to apply to all points and lengths.
    samples : int
        Number of samples per pixel.

    Returns
    -------
    sensor : Element
        The sensor.  Its rays start on a box around the scene, where float32 is accurate.
    """
    window = camera_window(scene.camera)
    right, down, _ = window.axes
    # The box is slightly larger than the scene, so that no ray starts on a surface.
    (low, high), margin = normalise(bounding_box(scene.surfaces)), 1e-3 * _SCENE_SIZE
    return plugin(
        "sensor",
        "window",
        xyz("point", "eye", normalise(window.eye)),
        xyz("vector", "corner", window.points(0, 0) * normalise.scale),
        xyz("vector", "right", right * (window.width * normalise.scale)),
        xyz("vector", "down", down * (window.height * normalise.scale)),
        xyz("point", "low", low - margin),
        xyz("point", "high", high + margin),
        _film_element(scene),
        plugin("sampler", "stratified", sample_count=samples, jitter=samples > 1),
    )


def with_square_pixels(scene: Scene) -> Scene:
    """Give a scene's picture square pixels, by changing its number of rows.

    The new number of rows fits the camera's window to within half a pixel.  The height of the
    window is then adjusted to the new number of rows.

    Parameters
    ----------
    scene : Scene
        The scene, with pixels of any shape.

    Returns
    -------
    square : Scene
        A copy of the scene with square pixels; `scene` itself if its pixels are square already.

    Raises
    ------
    ConversionError
        If there would be more than 2^28 pixels.
    """
    camera = scene.camera
    rows = scene.width * camera.view_height / camera.view_width
    if not scene.width * rows <= _MAX_PIXELS:
        raise ConversionError(
            f"Mitsuba's pixels are square, and {rows:.3g} rows of {scene.width} are too many;"
            " make viewWidth larger or viewHeight smaller"
        )
    height = max(1, round(rows))
    if height == rows == scene.height:
        return scene
    square_camera = replace(camera, view_height=height * camera.view_width / scene.width)
    return replace(scene, height=height, camera=square_camera)


_STOCK = """
with stock plugins only: it opens in the plain mitsuba command.

The geometry and the camera are exact. Approximate are
- the lights: Mitsuba's fall off with the square of the distance, those of the scene format do
  not fall off at all. The strength of each is right at one distance, which is given beside it;
- highlights: a Beckmann lobe of the same height and width takes the place of Blinn-Phong's
  (n.h)^p; it brightens towards the silhouettes.
{notes}"""

_SQUARE_PIXELS = """Its pixels are square: {0} x {1} of them show the window, to within half
a pixel, not {0} x {2}.
"""

_GAIN = """Mitsuba allows no reflectance above 1, and where there are highlights above 1/2: all are
divided by {:g}, lights multiplied.
"""


@_IGNORE_OVERFLOW
def convert_stock(scene: Scene, samples: int = 64) -> Document:
    """Convert a scene to a similar Mitsuba scene that needs only Mitsuba's own plugins.

    This is the "stock" flavour.  Its pixels are square, its lights fall off with distance, and its
    highlights have another shape.

    Parameters
    ----------
    scene : Scene
        The scene to convert.
    samples : int
        Number of samples per pixel.  It may be rounded up, so that each light gets the same number
        of samples.

    Returns
    -------
    document : Document
        The converted scene; its `str` is the text of the file.

    Raises
    ------
    ConversionError
        If the scene has numbers that Mitsuba cannot represent, or too many square pixels.
    """
    normalise, square_scene = _stock_normalisation(scene), with_square_pixels(scene)
    divisor = reflectance_divisor(scene.surfaces)
    bsdf_names, shader_of_name = _name_bsdfs(scene.surfaces)
    points = visible_points(scene)
    if not len(points):
        points = bounding_box(scene.surfaces).mean(axis=0, keepdims=True)
    sample_count = _round_up_samples(samples, len(scene.lights))
    elements = [
        # Only light that comes directly from lights, one of which is chosen for each sample.
        plugin("integrator", "direct", emitter_samples=1, bsdf_samples=0),
        _stock_sensor(square_scene, normalise, sample_count),
        *(_stock_light(light, normalise, divisor, normalise(points)) for light in scene.lights),
        *(_stock_bsdf(shader, name, divisor) for name, shader in shader_of_name.items()),
        *_convert_surfaces(scene.surfaces, normalise, bsdf_names),
    ]
    notes = ""
    if square_scene.height != scene.height:
        notes += _SQUARE_PIXELS.format(scene.width, square_scene.height, scene.height)
    if divisor != 1:
        notes += _GAIN.format(divisor)
    if normalise.scale != 1 or normalise.center.any():
        notes += str(normalise)
    return Document(_STOCK.format(notes=notes), elements)


def _round_up_samples(samples: int, light_count: int) -> int:
    """Round the number of samples per pixel up, so that each light gets the same number.

    Mitsuba's sampler "multijitter" chooses all lights equally often if the number of samples (1) is
    a multiple of the number of lights, and (2) fills whole rows of a grid.

    Parameters
    ----------
    samples : int
        Requested number of samples per pixel.
    light_count : int
        Number of lights.

    Returns
    -------
    count : int
        The smallest suitable number that is at least `samples`; `samples` itself if there are no
        lights, or fewer samples than lights.
    """
    count = samples
    while light_count and samples >= light_count and (count % light_count or count % isqrt(count)):
        count += 1
    return count


def _stock_sensor(scene: Scene, normalise: Normalisation, samples: int) -> Element:
    """Convert the camera of a scene to Mitsuba's sensor "perspective".

    Parameters
    ----------
    scene : Scene
        A scene with square pixels.
    normalise : Normalisation
        The translation and scaling to apply to all points and lengths.
    samples : int
        Number of samples per pixel.

    Returns
    -------
    sensor : Element
        The sensor, which is defined by its transform, field of view and principal point.

    Raises
    ------
    ConversionError
        If the field of view is 0 or close to 180 degrees in float32.
    """
    window = camera_window(scene.camera)
    right, down, ahead = window.axes
    # Mitsuba's camera looks along +z, with +x to the left and +y up.
    transform = np.column_stack([-right, -down, ahead, normalise(window.eye)])
    offset_right, offset_down, distance = window.center
    fov = degrees(2 * atan(window.width / 2 / distance))
    if not 0 < np.float32(fov) <= _MAX_FOV:
        raise ConversionError(
            f"its field of view would be {fov:g} degrees, and Mitsuba needs more than 0 and at most"
            f" {_MAX_FOV}; choose a viewWidth closer to projDistance"
        )
    farthest_offset = np.abs(bounding_box(scene.surfaces) - window.eye).max(axis=0)
    far_distance = normalise.scale * float(np.linalg.norm(farthest_offset)) or 1.0
    return plugin(
        "sensor",
        "perspective",
        matrix("to_world", [*transform, (0, 0, 0, 1)]),
        _film_element(scene),
        plugin("sampler", "multijitter", sample_count=samples),
        fov_axis="x",
        fov=fov,
        # Rounding errors of 0 become 0.
        principal_point_offset_x=round(float(offset_right / window.width), 12),
        principal_point_offset_y=round(float(offset_down / window.height), 12),
        # The window hides nothing, regardless of its distance.
        near_clip=_NEAR_DISTANCE * far_distance,
        far_clip=2 * far_distance,
    )


def _stock_light(
    light: PointLight, normalise: Normalisation, divisor: float, points: Floats
) -> Element:
    """Convert a light to a Mitsuba light, which falls off with the square of the distance.

    At one distance, the Mitsuba light is as strong as the light of the scene.  That distance
    minimises the sum of the squared errors of the irradiance at the given points.

    Parameters
    ----------
    light : PointLight
        The light to convert.
    normalise : Normalisation
        The translation and scaling to apply to the light's position.
    divisor : float
        Number by which all reflectances are divided; intensities are multiplied by it.
    points : (n, 3) float array
        Points of visible surfaces, already translated and scaled.

    Returns
    -------
    emitter : Element
        The plugin "point", with a comment that gives the distance.
    """
    position = normalise(np.array(light.position))
    distance2 = ((points - position) ** 2).sum(axis=1)
    # Distances relative to the largest do not overflow.  The minimum avoids a division by 0.
    largest2 = float(distance2.max()) or 1.0
    falloff = 1 / np.maximum(distance2 / largest2, 1e-12)
    best_distance2 = largest2 * float(falloff.sum() / (falloff * falloff).sum())
    # A diffuse surface reflects 1 / pi of its reflectance.
    intensity = np.array(light.intensity) * (np.pi * divisor * best_distance2)
    comment = Comment(f" right at a distance of {best_distance2**0.5:.4g} ")
    point = xyz("point", "position", position)
    return plugin("emitter", "point", comment, point, rgb("intensity", intensity))


def reflectance_divisor(surfaces: Surfaces) -> float:
    """Compute a number by which to divide all reflectances so that none exceeds 1.

    Mitsuba allows no reflectance above 1.  The reflectances of a shader with a highlight are
    doubled first, because the shader becomes a blend of two BSDFs, which halves both.

    Parameters
    ----------
    surfaces : Surfaces
        All surfaces of a scene, with their shaders.

    Returns
    -------
    divisor : float
        The largest reflectance of all shaders that a surface uses, but at least 1.
    """
    used = [surfaces.shaders[index] for index in np.unique(surfaces.shader_index).tolist()]
    largest = [float(np.max(_reflectances(s))) * (2 if _has_highlight(s) else 1) for s in used]
    return max([1.0, *largest])


def _has_highlight(shader: Shader) -> TypeGuard[Phong]:
    """Test whether a shader has a highlight.

    Parameters
    ----------
    shader : Lambertian or Phong
        The shader.

    Returns
    -------
    has_highlight : bool
        True for a `Phong` shader with a specular colour other than black.
    """
    return isinstance(shader, Phong) and any(shader.specular)


def _reflectances(shader: Shader) -> tuple[Floats, Floats]:
    """Convert the colours of a shader to reflectances of Mitsuba's own BSDFs.

    Parameters
    ----------
    shader : Lambertian or Phong
        The shader.

    Returns
    -------
    diffuse, specular : (3,) float arrays
        Linear RGB reflectances of the diffuse BSDF, and of the Beckmann lobe that replaces the
        highlight (black if there is no highlight).  They may exceed 1.
    """
    diffuse = np.array(shader.diffuse)
    if not isinstance(shader, Phong):
        return diffuse, np.zeros(3)
    # The height of the stock lobe is its reflectance times (exponent + 2) / 8.
    return diffuse, np.array(shader.specular) * 8 / (shader.exponent + 2)


def _stock_bsdf(shader: Shader, name: str, divisor: float) -> Element:
    """Convert a shader to a two-sided Mitsuba BSDF.

    Parameters
    ----------
    shader : Lambertian or Phong
        The shader to convert.
    name : str
        Name by which shapes refer to the BSDF.
    divisor : float
        Number by which all reflectances are divided.

    Returns
    -------
    bsdf : Element
        A diffuse BSDF; for a shader with a highlight, a blend of diffuse and Beckmann BSDFs.
    """
    diffuse, specular = _reflectances(shader)
    if _has_highlight(shader):
        # The Beckmann lobe is as wide as the highlight.  A blend of weight 0.5 halves both BSDFs.
        roughness = (2 / (shader.exponent + 2)) ** 0.5
        color = rgb("specular_reflectance", 2 * specular / divisor)
        material = {"material": "none", "distribution": "beckmann"}
        lobe = plugin("bsdf", "roughconductor", color, **material, alpha=roughness)
        matte = plugin("bsdf", "diffuse", rgb("reflectance", 2 * diffuse / divisor))
        bsdf = plugin("bsdf", "blendbsdf", matte, lobe, weight=0.5)
    else:
        bsdf = plugin("bsdf", "diffuse", rgb("reflectance", diffuse / divisor))
    return plugin("bsdf", "twosided", bsdf, name=name)
