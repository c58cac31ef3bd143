"""A scene as Mitsuba 3 XML, in two flavours: by stock plugins, or exactly by this project's own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import atan, degrees
from xml.sax.saxutils import quoteattr

import numpy as np

from converters.visible import bounds, visible_points, window_point
from tracer.arrays import Floats
from tracer.scene.model import Phong, PointLight, Scene, Shader, Surfaces
from tracer.scene.schema import MAX_PIXELS
from tracer.view.camera import raster_of

__all__ = ["WRITTEN", "Normalisation", "exact", "normalisation", "square_height", "stock"]

WRITTEN = "<!--\nWritten by converters.to_mitsuba"
"""How every converted scene begins."""

# Mitsuba's float32 is best off with scenes about this large, centred on the origin.
_EXTENT = 10.0

# Largest error of a hit point, in roundings (2^-24) of the largest length in the scene.
_TOLERANCE_ROUNDINGS = 100

# With what is seen of this size, and no farther from the origin than so many times that, float32
# is accurate enough for a stock scene in the file's own coordinates.
_OWN_EXTENT, _OWN_OFFSET = (0.1, 1e6), 10.0

# Largest sphere of a stock scene, and least share of its size that a scene is given on its account.
# Hit points err by some 1e-7 of a radius; Mitsuba starts shadow rays 1e-4 above a surface, even if
# all is small.
_LARGEST_RADIUS, _SMALLER = 300.0, 1e-4

# The largest float32.
_LARGEST = float(np.finfo(np.float32).max)

# Half thickness of flat boxes, relative to the largest coordinate.
_THINNEST = 1e-6

# Where the stock camera begins to see, relative to the farthest point of all surfaces.
_NEAREST = 1e-6


@dataclass(frozen=True, slots=True)
class Normalisation:
    """Moves and scales a scene, p -> (p - center) * scale, which changes no picture."""

    center: Floats
    scale: float

    def __call__(self, points: Floats) -> Floats:
        """Normalised points (..., 3)."""
        return (points - self.center) * self.scale


def normalisation(scene: Scene) -> Normalisation:
    """Moves the part of a scene that is seen to the origin, and scales it to 10 units."""
    points = visible_points(scene)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else bounds(scene.surfaces)
    extent = float((high - low).max())
    return Normalisation((low + high) / 2, _EXTENT / extent if extent > 0 else 1.0)


def _stock_place(scene: Scene) -> Normalisation:
    """The file's own coordinates, unless float32 would spoil the picture in them."""
    place = normalisation(scene)
    least, most = _OWN_EXTENT
    near = np.abs(place.center).max() * place.scale <= _OWN_OFFSET * _EXTENT
    if near and least <= _EXTENT / place.scale <= most:
        place = Normalisation(np.zeros(3), 1.0)
    largest = place.scale * float(scene.surfaces.radius.max(initial=0))
    if largest > _LARGEST_RADIUS:
        place = replace(place, scale=place.scale * max(_LARGEST_RADIUS / largest, _SMALLER))
    return place


def _element(head: str, *children: str) -> str:
    """An element that begins with a kind and attributes, its children indented."""
    if not children:
        return f"<{head}/>"
    body = "\n".join(children).replace("\n", "\n    ")
    return f"<{head}>\n    {body}\n</{head.split()[0]}>"


def _plugin(kind: str, plugin: str, *children: str, name: str | None = None) -> str:
    """A plugin with its parameters; `name` is the id for references to it."""
    label = "" if name is None else f" id={quoteattr(name)}"
    return _element(f"{kind} type={quoteattr(plugin)}{label}", *children)


def _to_world(*steps: str) -> str:
    """A transform, its steps in the order of application."""
    return _element('transform name="to_world"', *steps)


def _number(name: str, value: float) -> str:
    """The text of a number; raises ValueError if it is beyond float32."""
    if not abs(value) <= _LARGEST:
        raise ValueError(
            f"cannot be converted: {name} would be {value:g}, and Mitsuba's numbers end at"
            f" {_LARGEST:.2g}; keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _value(kind: str, name: str, value: bool | int | float | str) -> str:
    """A parameter of one value."""
    if isinstance(value, bool):
        value = str(value).lower()
    elif isinstance(value, float):
        value = _number(name, value)
    return f'<{kind} name="{name}" value="{value}"/>'


def _xyz(kind: str, name: str | None, value: Iterable[float]) -> str:
    """A point, a vector or, without a name, a part of a transform."""
    label = "" if name is None else f' name="{name}"'
    x, y, z = (_number(name or kind, number) for number in value)
    return f'<{kind}{label} x="{x}" y="{y}" z="{z}"/>'


def _numbers(name: str, values: Iterable[float]) -> str:
    return " ".join(_number(name, value) for value in values)


def _rgb(name: str, value: Iterable[float]) -> str:
    return _value("rgb", name, _numbers(name, value))


def _film(width: int, height: int) -> str:
    """A linear picture, each sample counted in its own pixel only."""
    return _plugin(
        "film",
        "hdrfilm",
        _value("integer", "width", width),
        _value("integer", "height", height),
        _value("string", "pixel_format", "rgb"),
        _value("string", "component_format", "float32"),
        _plugin("rfilter", "box"),
    )


def _shapes(scene: Scene, place: Normalisation, names: Sequence[str]) -> list[str]:
    """All surfaces in file order; `names` are those of the shaders' BSDFs."""
    refs = [_element(f"ref id={quoteattr(name)}") for name in names]
    shapes = [*_spheres(scene, place, refs), *_cubes(scene, place, refs)]
    order = np.argsort(scene.surfaces.file_index)
    return [shapes[index] for index in order.tolist()]


def _spheres(scene: Scene, place: Normalisation, refs: Sequence[str]) -> Iterator[str]:
    surfaces = scene.surfaces
    for center, radius, shader in zip(
        place(surfaces.center).tolist(),
        (surfaces.radius * place.scale).tolist(),
        surfaces.sphere_shader.tolist(),
        strict=True,
    ):
        yield _plugin(
            "shape",
            "sphere",
            _xyz("point", "center", center),
            _value("float", "radius", radius),
            refs[shader],
        )


def _cubes(scene: Scene, place: Normalisation, refs: Sequence[str]) -> Iterator[str]:
    """Boxes: Mitsuba's cube, from -1 to 1 along each axis, is scaled and moved."""
    surfaces = scene.surfaces
    middles = (place(surfaces.min_pt) + place(surfaces.max_pt)) / 2
    halves = (surfaces.max_pt - surfaces.min_pt) * (place.scale / 2)
    # A cube of no thickness has no inverse transform.
    thinnest = _THINNEST * np.abs(place(bounds(surfaces))).max()
    for middle, half, shader in zip(
        middles.tolist(),
        np.where(halves > 0, halves, thinnest).tolist(),
        surfaces.box_shader.tolist(),
        strict=True,
    ):
        to_world = _to_world(_xyz("scale", None, half), _xyz("translate", None, middle))
        yield _plugin("shape", "cube", to_world, refs[shader])


def _bsdf_names(surfaces: Surfaces) -> tuple[list[str], dict[str, Shader]]:
    """The name of each shader's BSDF, and what each name in use stands for; equals share one."""
    named: dict[Shader, str] = {}
    names = [named.setdefault(shader, f"bsdf{len(named)}") for shader in surfaces.shaders]
    used = {names[shader] for shader in np.unique(surfaces.shader_index).tolist()}
    return names, {name: shader for shader, name in named.items() if name in used}


def _document(comment: str, parts: Sequence[str]) -> str:
    body = "\n".join(parts)
    return f'{WRITTEN}, {comment.strip()}\n-->\n<scene version="3.0.0">\n{body}\n</scene>\n'


_EXACT = """
in the exact flavour.

Shading, lights and camera are exactly those of the scene format, by this project's small Mitsuba
plugins. The mitsuba command does not know them; load it in Python, where the project is installed:
    import mitsuba
    mitsuba.set_variant("scalar_rgb")  # or another that ends in _rgb
    import converters.plugins
    scene = mitsuba.load_file("NAME.mitsuba.xml")
{moved}"""

_MOVED = """\
The scene is moved and scaled so that float32 hurts least, which changes no picture: where the
scene file has p, this one has {scale:.6g} (p - c), c = ({center}).
"""


def _moved(place: Normalisation) -> str:
    center = ", ".join(f"{x:.6g}" for x in place.center)
    return _MOVED.format(center=center, scale=place.scale)


# `_number` raises for what overflows.
@np.errstate(all="ignore")
def exact(scene: Scene, samples: int = 1) -> str:
    """A scene as Mitsuba XML, exact, by this project's plugins.

    Parameters
    ----------
    scene : Scene
    samples : int
        Samples a pixel: 1 takes the pixel's centre, more are stratified.

    Raises
    ------
    ValueError
        If a number is beyond those of float32.
    """
    place = normalisation(scene)
    names, bsdfs = _bsdf_names(scene.surfaces)
    parts = [
        _exact_integrator(scene, place),
        _exact_sensor(scene, place, samples),
        *(_exact_emitter(light, place) for light in scene.lights),
        *(_exact_bsdf(shader, name) for name, shader in bsdfs.items()),
        *_shapes(scene, place, names),
    ]
    return _document(_EXACT.format(moved=_moved(place)), parts)


def _exact_integrator(scene: Scene, place: Normalisation) -> str:
    largest = max([_EXTENT, *(scene.surfaces.radius * place.scale)])
    tolerance = _TOLERANCE_ROUNDINGS * largest * 2.0**-24
    return _plugin("integrator", "every_light", _value("float", "tolerance", tolerance))


def _exact_sensor(scene: Scene, place: Normalisation, samples: int) -> str:
    """The camera by its eye and its window; its rays start on a box around the scene."""
    raster = raster_of(scene.camera, scene.width, scene.height)
    right, down, _ = raster.axes
    # A little wider than the scene, so that no ray starts on a surface.
    low, high = place(bounds(scene.surfaces))
    margin = 1e-3 * _EXTENT
    return _plugin(
        "sensor",
        "window",
        _xyz("point", "eye", place(raster.eye)),
        _xyz("vector", "corner", window_point(raster, 0, 0) * place.scale),
        _xyz("vector", "right", right * (raster.step_u * raster.width * place.scale)),
        _xyz("vector", "down", down * (raster.step_v * raster.height * place.scale)),
        _xyz("point", "low", low - margin),
        _xyz("point", "high", high + margin),
        _film(scene.width, scene.height),
        _plugin(
            "sampler",
            "stratified",
            _value("integer", "sample_count", samples),
            _value("boolean", "jitter", samples > 1),
        ),
    )


def _exact_emitter(light: PointLight, place: Normalisation) -> str:
    return _plugin(
        "emitter",
        "unattenuated_point",
        _xyz("point", "position", place(np.array(light.position))),
        _xyz("vector", "intensity", light.intensity),
    )


def _exact_bsdf(shader: Shader, name: str) -> str:
    phong = shader if isinstance(shader, Phong) else Phong(diffuse=shader.diffuse)
    return _plugin(
        "bsdf",
        "blinn_phong",
        _xyz("vector", "diffuse", phong.diffuse),
        _xyz("vector", "specular", phong.specular),
        _value("float", "exponent", phong.exponent),
        name=name,
    )


def square_height(scene: Scene) -> int:
    """How many rows show a scene's window if its columns stay and its pixels are square.

    Raises
    ------
    ValueError
        If they are too many for a picture.
    """
    camera = scene.camera
    rows = scene.width * camera.view_height / camera.view_width
    if not scene.width * rows <= MAX_PIXELS:
        raise ValueError(
            f"cannot be converted: Mitsuba's pixels are square, and {rows:.3g} rows of"
            f" {scene.width} are too many; make viewWidth larger or viewHeight smaller"
        )
    return max(1, round(rows))


_STOCK = """
with stock plugins only: it opens in the plain mitsuba command.

The geometry and the camera are exact. Approximate are
- the lights: Mitsuba's fall off with the square of the distance, those of the scene format do
  not fall off at all. The strength of each is right at one distance, which is told beside it;
- highlights: Blinn-Phong's (n.h)^p is stood in for by a Beckmann lobe of the same height and
  width, which brightens towards the silhouettes;
- several lights: of each sample Mitsuba picks one at random, which leaves some noise.
{film}Mitsuba allows no reflectance above 1: all are divided by {gain:g}, lights multiplied.
{moved}"""

_SQUARE = """- the film: pixels must be square, so {width} x {height} of them show the window, to
  within half a pixel, not {width} x {given}.
"""


# `_number` raises for what overflows.
@np.errstate(all="ignore")
def stock(scene: Scene, samples: int = 64) -> str:
    """A scene as Mitsuba XML, approximate, by stock plugins.

    Parameters
    ----------
    scene : Scene
    samples : int
        Samples a pixel.

    Raises
    ------
    ValueError
        If a number is beyond those of float32, or the picture is too large.
    """
    names, bsdfs = _bsdf_names(scene.surfaces)
    height = square_height(scene)
    gain = _gain(bsdfs.values())
    seen = visible_points(scene)
    if not len(seen):
        seen = bounds(scene.surfaces).mean(axis=0, keepdims=True)
    place = _stock_place(scene)
    parts = [
        _stock_integrator(),
        _stock_sensor(scene, place, height, samples),
        *(_stock_emitter(light, place, gain, place(seen)) for light in scene.lights),
        *(_stock_bsdf(shader, name, gain) for name, shader in bsdfs.items()),
        *_shapes(scene, place, names),
    ]
    film = _SQUARE.format(width=scene.width, height=height, given=scene.height)
    comment = _STOCK.format(
        film=film if height != scene.height else "",
        gain=gain,
        moved="" if place.scale == 1 and not place.center.any() else _moved(place),
    )
    return _document(comment, parts)


def _stock_integrator() -> str:
    """Light straight from the lights, of which one is picked at random for each sample."""
    return _plugin(
        "integrator",
        "direct",
        _value("integer", "emitter_samples", 1),
        _value("integer", "bsdf_samples", 0),
    )


def _stock_sensor(scene: Scene, place: Normalisation, height: int, samples: int) -> str:
    """The camera by its field of view and principal point; the film has `height` rows."""
    camera = scene.camera
    raster = raster_of(camera, scene.width, scene.height)
    right, down, ahead = raster.axes
    # Mitsuba's camera looks along +z with +x to the left.
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([-right, -down, ahead, place(raster.eye)])
    corners = np.stack(np.meshgrid(*bounds(scene.surfaces).T)).reshape(3, -1).T
    far = place.scale * float(np.linalg.norm(corners - raster.eye, axis=1).max()) or 1.0
    return _plugin(
        "sensor",
        "perspective",
        _to_world(f'<matrix value="{_numbers("to_world", matrix.ravel())}"/>'),
        _value("string", "fov_axis", "x"),
        _value("float", "fov", degrees(2 * atan(camera.view_width / 2 / raster.depth))),
        _value("float", "principal_point_offset_x", _offset(raster.shift_u / camera.view_width)),
        _value("float", "principal_point_offset_y", _offset(raster.shift_v / camera.view_height)),
        # The window may be anywhere: it only says what is in the picture.
        _value("float", "near_clip", _NEAREST * far),
        _value("float", "far_clip", 2 * far),
        _film(scene.width, height),
        _plugin("sampler", "multijitter", _value("integer", "sample_count", samples)),
    )


def _offset(share: float) -> float:
    """Where the window's centre lies: what is left of zero after rounding is zero."""
    return share if abs(share) > 1e-12 else 0.0


def _stock_emitter(light: PointLight, place: Normalisation, gain: float, seen: Floats) -> str:
    position = place(np.array(light.position))
    distance2 = _distance2(position, seen)
    # A diffuse surface reflects 1 / pi of its reflectance.
    intensity = np.array(light.intensity) * (np.pi * gain * distance2)
    return _plugin(
        "emitter",
        "point",
        f"<!-- right at a distance of {distance2**0.5:.4g} -->",
        _xyz("point", "position", position),
        _rgb("intensity", intensity),
    )


def _distance2(position: Floats, seen: Floats) -> float:
    """Squared distance at which a light's strength is right: least squares over points (n, 3)."""
    square = ((seen - position) ** 2).sum(axis=1)
    # In units of the largest, whatever the scene's; in the light itself nothing is divided by zero.
    largest = float(square.max()) or 1.0
    inverse = 1 / np.maximum(square / largest, 1e-12)
    return largest * float(inverse.sum() / (inverse * inverse).sum())


def _gain(shaders: Iterable[Shader]) -> float:
    """What reflectances are divided by: 1, or twice the largest, as blends need them doubled."""
    return float(np.max([2 * np.array(_lobes(shader)) for shader in shaders], initial=1))


def _lobes(shader: Shader) -> tuple[Floats, Floats]:
    """Diffuse and specular reflectance (3,), as Mitsuba measures them."""
    diffuse = np.array(shader.diffuse)
    if not isinstance(shader, Phong):
        return diffuse, np.zeros(3)
    # The stock lobe's height is its reflectance times (exponent + 2) / 8.
    return diffuse, np.array(shader.specular) * 8 / (shader.exponent + 2)


def _stock_bsdf(shader: Shader, name: str, gain: float) -> str:
    diffuse, specular = _lobes(shader)
    if isinstance(shader, Phong) and specular.any():
        alpha = (2 / (shader.exponent + 2)) ** 0.5
        # A blend of weight 0.5 halves both.
        bsdf = _plugin(
            "bsdf",
            "blendbsdf",
            _value("float", "weight", 0.5),
            _diffuse(2 * diffuse / gain),
            _highlight(2 * specular / gain, alpha),
        )
    else:
        bsdf = _diffuse(diffuse / gain)
    return _plugin("bsdf", "twosided", bsdf, name=name)


def _diffuse(reflectance: Floats) -> str:
    return _plugin("bsdf", "diffuse", _rgb("reflectance", reflectance))


def _highlight(reflectance: Floats, alpha: float) -> str:
    """A Beckmann lobe of roughness `alpha`."""
    return _plugin(
        "bsdf",
        "roughconductor",
        _value("string", "material", "none"),
        _value("string", "distribution", "beckmann"),
        _value("float", "alpha", alpha),
        _rgb("specular_reflectance", reflectance),
    )
