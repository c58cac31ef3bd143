"""A scene as Mitsuba 3 XML, in two flavours: by stock plugins, or exactly by this project's own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import atan, degrees
from xml.sax.saxutils import quoteattr

import numpy as np

from converters.visible import bounds, visible_points
from tracer.arrays import Floats
from tracer.camera import raster_of
from tracer.scene import MAX_PIXELS, Phong, PointLight, Scene, Shader

__all__ = ["Normalisation", "exact", "normalisation", "square_height", "stock"]

# Mitsuba's float32 is best off with scenes about this large, centred on the origin.
_EXTENT = 10.0

# What a hit may err by, in units in the last place of the largest length in the scene.
_TOLERANCE_ULP = 100

# float32 ends here.
_LARGEST = float(np.finfo(np.float32).max)

# Least half thickness of a box, relative to the largest coordinate.
_THINNEST = 1e-6


@dataclass(frozen=True, slots=True)
class Normalisation:
    """Moves and scales a scene, p -> (p - center) * scale, which changes no picture."""

    center: Floats
    scale: float

    def __call__(self, points: Floats) -> Floats:
        """Normalised points (..., 3)."""
        return (points - self.center) * self.scale


def normalisation(scene: Scene) -> Normalisation:
    """What brings the part of a scene that is seen to the origin, about 10 units large."""
    points = visible_points(scene)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else bounds(scene.surfaces)
    extent = float((high - low).max())
    return Normalisation((low + high) / 2, _EXTENT / extent if extent > 0 else 1.0)


def _tag(kind: str, plugin: str, *children: str, name: str | None = None) -> str:
    """One element with a plugin type, its children indented."""
    label = "" if name is None else f" id={quoteattr(name)}"
    head = f"<{kind} type={quoteattr(plugin)}{label}"
    if not children:
        return f"{head}/>"
    body = "\n".join(children).replace("\n", "\n    ")
    return f"{head}>\n    {body}\n</{kind}>"


def _number(name: str, value: float) -> str:
    """A number as it is written; a ValueError if Mitsuba could not hold it."""
    if not abs(value) <= _LARGEST:
        raise ValueError(
            f"cannot be converted: {name} would be {value:g}, and Mitsuba's numbers end at"
            f" {_LARGEST:.2g}; keep the numbers of the scene closer to 1"
        )
    return repr(float(value))


def _value(kind: str, name: str, value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        value = str(value).lower()
    elif isinstance(value, float):
        value = _number(name, value)
    return f'<{kind} name="{name}" value="{value}"/>'


def _xyz(kind: str, name: str | None, value: Iterable[float]) -> str:
    """A point, a vector or, without a name, a part of a transform."""
    label = "" if name is None else f' name="{name}"'
    axes = " ".join(
        f'{axis}="{_number(name or kind, number)}"'
        for axis, number in zip("xyz", value, strict=True)
    )
    return f"<{kind}{label} {axes}/>"


def _numbers(name: str, values: Iterable[float]) -> str:
    return " ".join(_number(name, value) for value in values)


def _rgb(name: str, value: Iterable[float]) -> str:
    return _value("rgb", name, _numbers(name, value))


def _film(width: int, height: int) -> str:
    return _tag(
        "film",
        "hdrfilm",
        _value("integer", "width", width),
        _value("integer", "height", height),
        _value("string", "pixel_format", "rgb"),
        _value("string", "component_format", "float32"),
        _tag("rfilter", "box"),
    )


def _shapes(scene: Scene, place: Normalisation, names: Sequence[str]) -> Iterator[str]:
    """Spheres and boxes in file order, each with a reference to its BSDF."""
    surfaces = scene.surfaces
    shapes: list[str] = [""] * len(surfaces)
    for index, center, radius, shader in zip(
        surfaces.sphere_index.tolist(),
        place(surfaces.center).tolist(),
        (surfaces.radius * place.scale).tolist(),
        surfaces.sphere_shader.tolist(),
        strict=True,
    ):
        shapes[index] = _tag(
            "shape",
            "sphere",
            _xyz("point", "center", center),
            _value("float", "radius", radius),
            f"<ref id={quoteattr(names[shader])}/>",
        )
    low, high = place(surfaces.min_pt), place(surfaces.max_pt)
    # A cube of no thickness has no inverse transform.
    thinnest = _THINNEST * float(np.abs(bounds(surfaces)).max()) * place.scale
    for index, middle, half, shader in zip(
        surfaces.box_index.tolist(),
        ((low + high) / 2).tolist(),
        np.maximum((high - low) / 2, thinnest).tolist(),
        surfaces.box_shader.tolist(),
        strict=True,
    ):
        shapes[index] = _tag(
            "shape",
            "cube",
            f'<transform name="to_world">\n    {_xyz("scale", None, half)}\n'
            f"    {_xyz('translate', None, middle)}\n</transform>",
            f"<ref id={quoteattr(names[shader])}/>",
        )
    yield from shapes


def _bsdf_names(shaders: Sequence[Shader]) -> tuple[list[str], dict[str, Shader]]:
    """A name for the BSDF of each shader; equal shaders share one."""
    place: dict[Shader, str] = {}
    names = [place.setdefault(shader, f"bsdf{len(place)}") for shader in shaders]
    return names, {name: shader for shader, name in place.items()}


def _document(comment: str, parts: Sequence[str]) -> str:
    return (
        f'<!--\n{comment.strip()}\n-->\n<scene version="3.0.0">\n'
        + "\n".join(parts)
        + "\n</scene>\n"
    )


_EXACT = """
Written by converters.to_mitsuba, in the exact flavour.

Shading, lights and camera are exactly those of the scene format, by this project's small Mitsuba
plugins. Load it after "import converters.plugins"; the mitsuba command does not know them.
The scene is moved and scaled so that float32 hurts least, which changes no picture: where the
scene file has p, this one has {scale:.6g} (p - c), c = ({center}).
"""


# What overflows is told where it is written.
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
    names, bsdfs = _bsdf_names(scene.surfaces.shaders)
    raster = raster_of(scene.camera, scene.width, scene.height)
    u, v, _ = raster.axes
    # Around everything, a little wider, so that no ray starts on a surface.
    low, high = place(bounds(scene.surfaces))
    margin = 1e-3 * _EXTENT
    corner = np.array(
        [
            raster.shift_u - raster.step_u * raster.width / 2,
            raster.shift_v - raster.step_v * raster.height / 2,
            raster.depth,
        ]
    )
    largest = max(_EXTENT, *(scene.surfaces.radius * place.scale), 0)
    parts = [
        _tag(
            "integrator",
            "every_light",
            _value("float", "tolerance", _TOLERANCE_ULP * largest * 2.0**-24),
        ),
        _tag(
            "sensor",
            "window",
            _xyz("point", "eye", place(raster.eye)),
            _xyz("vector", "corner", corner @ raster.axes * place.scale),
            _xyz("vector", "right", u * (raster.step_u * raster.width * place.scale)),
            _xyz("vector", "down", v * (raster.step_v * raster.height * place.scale)),
            _xyz("point", "low", low - margin),
            _xyz("point", "high", high + margin),
            _film(scene.width, scene.height),
            _tag(
                "sampler",
                "stratified",
                _value("integer", "sample_count", samples),
                _value("boolean", "jitter", samples > 1),
            ),
        ),
        *(
            _tag(
                "emitter",
                "unattenuated_point",
                _xyz("point", "position", place(np.array(light.position))),
                _xyz("vector", "intensity", light.intensity),
            )
            for light in scene.lights
        ),
        *(
            _tag(
                "bsdf",
                "blinn_phong",
                _xyz("vector", "diffuse", shader.diffuse),
                _xyz("vector", "specular", getattr(shader, "specular", (0, 0, 0))),
                _value("float", "exponent", getattr(shader, "exponent", 1.0)),
                name=name,
            )
            for name, shader in bsdfs.items()
        ),
        *_shapes(scene, place, names),
    ]
    center = ", ".join(f"{x:.6g}" for x in place.center)
    return _document(_EXACT.format(center=center, scale=place.scale), parts)


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
Written by converters.to_mitsuba, with stock plugins only: it opens in the plain mitsuba command.

The geometry and the camera are exact. Approximate are
- the lights: Mitsuba's fall off with the square of the distance, those of the scene format do
  not fall off at all. Their strength is right at the distances that matter most;
- highlights: Blinn-Phong's (n.h)^p is stood in for by a Beckmann lobe of the same height and
  width, which brightens towards the silhouettes;
- several lights: of each sample Mitsuba picks one at random, which leaves some noise.
{film}Mitsuba allows no reflectance above 1: all are divided by {gain:g}, lights multiplied.
"""

_SQUARE = """- the film: pixels must be square, so {width} x {height} of them show the same window,
  not {width} x {given}.
"""


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
    here = Normalisation(np.zeros(3), 1.0)
    names, bsdfs = _bsdf_names(scene.surfaces.shaders)
    raster = raster_of(scene.camera, scene.width, scene.height)
    u, down, ahead = raster.axes
    camera = scene.camera
    height = square_height(scene)
    corners = np.stack(np.meshgrid(*bounds(scene.surfaces).T)).reshape(3, -1).T
    far = float(np.linalg.norm(corners - raster.eye, axis=1).max())
    # Mitsuba's camera looks along +z with +x to the left.
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([-u, -down, ahead, raster.eye])
    place = _numbers("to_world", matrix.ravel())
    gain = max([1.0, *(max(*(2 * np.array(lobe)).tolist()) for lobe in _lobes(bsdfs.values()))])
    seen = visible_points(scene)
    parts = [
        _tag(
            "integrator",
            "direct",
            _value("integer", "emitter_samples", 1),
            _value("integer", "bsdf_samples", 0),
        ),
        _tag(
            "sensor",
            "perspective",
            f'<transform name="to_world">\n    <matrix value="{place}"/>\n</transform>',
            _value("string", "fov_axis", "x"),
            _value("float", "fov", degrees(2 * atan(camera.view_width / 2 / raster.depth))),
            _value("float", "principal_point_offset_x", raster.shift_u / camera.view_width),
            _value("float", "principal_point_offset_y", raster.shift_v / camera.view_height),
            _value("float", "near_clip", 1e-3 * camera.proj_distance),
            _value("float", "far_clip", max(2 * far, camera.proj_distance)),
            _film(scene.width, height),
            _tag("sampler", "multijitter", _value("integer", "sample_count", samples)),
        ),
        *(
            _tag(
                "emitter",
                "point",
                _xyz("point", "position", light.position),
                _rgb(
                    "intensity", np.array(light.intensity) * (np.pi * gain * _reach2(light, seen))
                ),
            )
            for light in scene.lights
        ),
        *(_stock_bsdf(shader, name, gain) for name, shader in bsdfs.items()),
        *_shapes(scene, here, names),
    ]
    film = _SQUARE.format(width=scene.width, height=height, given=scene.height)
    comment = _STOCK.format(film=film if height != scene.height else "", gain=gain)
    return _document(comment, parts)


def _lobes(shaders: Iterable[Shader]) -> Iterator[Floats]:
    """Diffuse and specular reflectance of each shader, as Mitsuba measures them."""
    for shader in shaders:
        yield np.array(shader.diffuse)
        if isinstance(shader, Phong):
            yield np.array(shader.specular) * 8 / (shader.exponent + 2)


def _stock_bsdf(shader: Shader, name: str, gain: float) -> str:
    diffuse, *specular = _lobes([shader])
    if not np.any(specular):
        matte = _tag("bsdf", "diffuse", _rgb("reflectance", diffuse / gain))
        return _tag("bsdf", "twosided", matte, name=name)
    # A blend halves both, and at most gives the lobe the height (p + 2) / 8.
    assert isinstance(shader, Phong)
    blend = _tag(
        "bsdf",
        "blendbsdf",
        _value("float", "weight", 0.5),
        _tag("bsdf", "diffuse", _rgb("reflectance", 2 * diffuse / gain)),
        _tag(
            "bsdf",
            "roughconductor",
            _value("string", "material", "none"),
            _value("string", "distribution", "beckmann"),
            _value("float", "alpha", (2 / (shader.exponent + 2)) ** 0.5),
            _rgb("specular_reflectance", 2 * specular[0] / gain),
        ),
    )
    return _tag("bsdf", "twosided", blend, name=name)


def _reach2(light: PointLight, seen: Floats) -> float:
    """The squared distance at which the light is right: least squares over what is seen."""
    if not len(seen):
        return 1.0
    inverse = 1 / np.maximum(((seen - light.position) ** 2).sum(axis=1), 1e-12)
    return float(inverse.sum() / (inverse * inverse).sum())
