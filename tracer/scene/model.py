"""The scene: frozen dataclasses that validate their fields, and the arrays of its surfaces.

All numbers are finite.  The magnitude of all but directions is at most 1e75.  Lengths and
coordinates other than 0 have a magnitude of at least 1e-75.  Colours, intensities and exponents are
not negative.  `SceneError` lists every error, not only the first.

The metadata of the fields define the elements of scene files: see `schema.xml_field`.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.scene import schema
from tracer.scene.schema import Columns, Floats, RowError, Validated, number_text, xml_field

VectorLike: TypeAlias = Sequence[float] | NDArray[Any]
"""Three numbers.  Scenes accept any sequence or array, and store a tuple of float."""

_ORIGIN, _WHITE, _BLACK = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_MINUS_Z, _PLUS_Y = (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)

_PROJ_NORMAL = xml_field(schema.DIRECTION, "projNormal")
# The specification says color, the published scenes say intensity.
_INTENSITY = xml_field(schema.COLOR, "intensity", "color")

# Minimum sine of the angle between view_up and the window's normal, and minimum cosine of the angle
# between view_dir and the normal: below, too few digits of the camera's axes are correct.
_MIN_SINE = _MIN_COSINE = 1e-10


@np.errstate(under="ignore")
def unit(vector: ArrayLike) -> Floats:
    """Return the unit vector (3,) in the direction of a vector (3,) other than 0."""
    array = np.asarray(vector, dtype=np.float64)
    # Scale the vector so that no square that matters overflows or underflows.  A power of two is
    # exact, so that pictures of scaled scenes stay bit-identical.
    array = np.ldexp(array, -int(np.frexp(np.abs(array).max())[1]))
    return array / np.sqrt(array @ array)


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera(Validated):
    """A perspective camera with a window that may be shifted or oblique.

    Parameters
    ----------
    view_point : (3,)
        Centre of projection.
    view_dir : (3,)
        Direction from `view_point` to the window's centre; its length is not used.
    view_up : (3,)
        Direction that is up in the picture.
    proj_normal : (3,), optional
        Normal of the window; its length and sign are not used.  The default is `view_dir`.
    proj_distance : float
        Distance from `view_point` to the window's centre along `view_dir`.
    view_width, view_height : float
        Size of the window.

    Raises
    ------
    SceneError
        For invalid numbers, a zero vector, `view_up` parallel to `proj_normal`, or
        `proj_normal` perpendicular to `view_dir`.
    """

    view_point: VectorLike = field(default=_ORIGIN, metadata=xml_field(schema.POINT, "viewPoint"))
    view_dir: VectorLike = field(default=_MINUS_Z, metadata=xml_field(schema.DIRECTION, "viewDir"))
    view_up: VectorLike = field(default=_PLUS_Y, metadata=xml_field(schema.DIRECTION, "viewUp"))
    proj_normal: VectorLike | None = field(default=None, metadata=_PROJ_NORMAL)
    proj_distance: float = field(default=1.0, metadata=xml_field(schema.LENGTH, "projDistance"))
    view_width: float = field(default=1.0, metadata=xml_field(schema.LENGTH, "viewWidth"))
    view_height: float = field(default=1.0, metadata=xml_field(schema.LENGTH, "viewHeight"))

    @classmethod
    def conflicts(cls, columns: Columns) -> Iterator[RowError]:
        """Yield errors for vectors that are parallel or perpendicular but must not be."""
        vectors = (columns[name] for name in ("view_up", "view_dir", "proj_normal"))
        for i, (up, ahead, normal) in enumerate(zip(*vectors, strict=True)):
            name = "proj_normal"
            if np.isnan(normal).all():
                name, normal = "view_dir", ahead
            with np.errstate(all="ignore"):  # vectors may be zero, or not finite
                up, ahead, normal = map(unit, (up, ahead, normal))
                sine, cosine = np.linalg.norm(np.cross(up, normal)), abs(normal @ ahead)
            if sine < _MIN_SINE:
                yield i, "view_up", f"must not be parallel to {name}; choose another view_up"
            if cosine < _MIN_COSINE:
                message = "must not be perpendicular to view_dir: no ray would meet it"
                yield i, "proj_normal", message

    @property
    def normal(self) -> VectorLike:
        """The window's normal: `proj_normal` if it is given, otherwise `view_dir`."""
        return self.view_dir if self.proj_normal is None else self.proj_normal


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight(Validated):
    """A point light, whose intensity does not decrease with distance.

    Parameters
    ----------
    position : (3,)
    intensity : (3,)
        Linear RGB.
    line : int, optional
        Line number in the source file; ignored by ==.
    """

    position: VectorLike = field(metadata=xml_field(schema.POINT, "position"))
    intensity: VectorLike = field(default=_WHITE, metadata=_INTENSITY)
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lambertian(Validated):
    """A matte surface: its radiance is I kd n.l for each visible light of intensity I.

    See Shirley, Fundamentals of Computer Graphics, 2nd edition, 9.1.

    Parameters
    ----------
    diffuse : (3,)
        The colour kd: linear RGB, where 1 reflects all light.
    line : int, optional
        Line number in the source file; ignored by ==.
    """

    diffuse: VectorLike = field(default=_WHITE, metadata=xml_field(schema.COLOR, "diffuseColor"))
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Phong(Validated):
    """A shiny surface (Blinn 1977): I (kd n.l + ks (n.h)^exponent) for each visible light.

    I is the light's intensity.  A light behind the surface (n.l <= 0) is not visible, and so causes
    no highlight either.

    Parameters
    ----------
    diffuse, specular : (3,)
        The colours kd and ks: linear RGB, where 1 reflects all light.
    exponent : float
        Size of the highlight: the larger the exponent, the smaller the highlight.
    line : int, optional
        Line number in the source file; ignored by ==.
    """

    diffuse: VectorLike = field(default=_WHITE, metadata=xml_field(schema.COLOR, "diffuseColor"))
    specular: VectorLike = field(default=_BLACK, metadata=xml_field(schema.COLOR, "specularColor"))
    exponent: float = field(default=1.0, metadata=xml_field(schema.EXPONENT, "exponent"))
    line: int | None = field(default=None, compare=False, repr=False)


Shader: TypeAlias = Lambertian | Phong

_SHADER = xml_field(schema.one_of(Lambertian, Phong), "shader")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(Validated):
    """A sphere; by default white and Lambertian.

    Parameters
    ----------
    center : (3,)
    radius : float
    shader : Lambertian or Phong
    line : int, optional
        Line number in the source file; ignored by ==.
    """

    center: VectorLike = field(default=_ORIGIN, metadata=xml_field(schema.POINT, "center"))
    radius: float = field(default=1.0, metadata=xml_field(schema.LENGTH, "radius"))
    shader: Shader = field(default_factory=Lambertian, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(Validated):
    """An axis-aligned box, which may be flat; by default white and Lambertian.

    Parameters
    ----------
    min_pt, max_pt : (3,)
        Opposite corners, with the minimum and the maximum coordinates.
    shader : Lambertian or Phong
    line : int, optional
        Line number in the source file; ignored by ==.

    Raises
    ------
    SceneError
        For invalid values, or `min_pt` beyond `max_pt` along any axis.
    """

    min_pt: VectorLike = field(metadata=xml_field(schema.POINT, "minPt"))
    max_pt: VectorLike = field(metadata=xml_field(schema.POINT, "maxPt"))
    shader: Shader = field(default_factory=Lambertian, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)

    @classmethod
    def conflicts(cls, columns: Columns) -> Iterator[RowError]:
        """Yield an error for each box whose corners are in the wrong order."""
        low, high = columns["min_pt"], columns["max_pt"]
        for i in np.flatnonzero((low > high).any(axis=1)).tolist():
            has = " and ".join(
                f"{axis} has {number_text(a)} > {number_text(b)}"
                for axis, a, b in zip("xyz", low[i].tolist(), high[i].tolist(), strict=True)
                if a > b
            )
            yield i, "min_pt", f"must not exceed max_pt, but {has}; swap these"


class Surfaces(Sequence[Sphere | Box]):
    """All surfaces of a scene: arrays, and a sequence of `Sphere` and `Box` in the file's order.

    The arrays are read-only copies.  In arrays of all surfaces, the spheres come first.  Two
    objects are equal if they are equal as sequences.

    Parameters
    ----------
    center : (S, 3)
        Centres of the spheres.
    radius : (S,)
        Radii of the spheres.
    min_pt, max_pt : (B, 3)
        Opposite corners of the boxes.
    shader_index : (S + B,)
        For each surface, the index of its shader in `shaders`.
    file_index : (S + B,), optional
        For each surface, its position in the file: a permutation of 0 ... S + B - 1.  If two
        surfaces are at the same distance, the one with the lower position is visible.
    shaders : tuple of Lambertian or Phong
    line : (S + B,), optional
        For each surface, its line number in the source file; 0 if it is not from a file.

    Raises
    ------
    SceneError
        For arrays whose lengths do not match, or invalid numbers.
    """

    def __init__(
        self,
        *,
        center: ArrayLike = (),
        radius: ArrayLike = (),
        min_pt: ArrayLike = (),
        max_pt: ArrayLike = (),
        shader_index: ArrayLike = (),
        file_index: ArrayLike | None = None,
        shaders: tuple[Shader, ...] = (),
        line: ArrayLike | None = None,
    ) -> None:
        self.center = schema.POINT.rows(center, "center")
        self.radius = schema.LENGTH.rows(radius, "radius")
        self.min_pt = schema.POINT.rows(min_pt, "min_pt")
        self.max_pt = schema.POINT.rows(max_pt, "max_pt")
        self.shader_index = schema.integer_array(shader_index, "shader_index")
        every = np.arange(len(self))
        self.file_index = schema.integer_array(
            every if file_index is None else file_index, "file_index"
        )
        self.shaders: tuple[Shader, ...] = schema.list_of(Lambertian, Phong)(shaders, "shaders")
        lines = schema.integer_array(0 * every if line is None else line, "line")
        self.line = lines.astype(np.int32)
        schema.raise_if_any(self._conflicts())
        errors = sorted(self._errors(), key=lambda error: error[0])
        schema.raise_if_any(f"surface {index}: {message}" for index, message in errors)
        self.__setstate__(vars(self))

    def _conflicts(self) -> Iterator[str]:
        """Yield errors for arrays whose lengths or indices do not match.

        After such an error, the numbers cannot be validated.
        """
        reason = "one for each surface"
        for name, needed, why in (
            ("radius", len(self.center), "as many as center"),
            ("max_pt", len(self.min_pt), "as many as min_pt"),
            *((name, len(self), reason) for name in ("shader_index", "file_index", "line")),
        ):
            if (count := len(getattr(self, name))) != needed:
                yield f"{name}: needs {needed}, {why}; has {count}"
        index, count = self.shader_index, len(self.shaders)
        for outside in index[(index < 0) | (index >= count)].tolist()[:1]:
            yield f"shader_index: must be indices of {count} shaders, has {outside}"
        count = len(self.file_index)
        if not np.array_equal(np.sort(self.file_index), np.arange(count)):
            yield f"file_index: must be a permutation of 0 ... {count - 1}"

    def _errors(self) -> Iterator[tuple[int, str]]:
        """Yield the position in the file and the message of each invalid number."""
        sphere_positions, box_positions = np.split(self.file_index, [self.sphere_count])
        sphere_columns = {"center": self.center, "radius": self.radius[:, None]}
        box_columns = {"min_pt": self.min_pt, "max_pt": self.max_pt}
        for i, name, message in schema.errors(Sphere, sphere_columns):
            yield sphere_positions.item(i), f"{name}: {message}"
        for i, name, message in schema.errors(Box, box_columns):
            yield box_positions.item(i), f"{name}: {message}"

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Unpickled arrays have copies of NumPy's built-in dtypes.  With a copy, `ufunc.at` takes
        # 20 times as long, and every array that is computed from these arrays inherits the copy.
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value = value.view(value.dtype.type)
                value.setflags(write=False)
            setattr(self, name, value)

    @classmethod
    def of(cls, surfaces: Iterable[Sphere | Box]) -> Surfaces:
        """Copy Sphere and Box objects into arrays, in order; return `Surfaces` unchanged."""
        if isinstance(surfaces, Surfaces):
            return surfaces
        items: tuple[Any, ...] = schema.list_of(Sphere, Box)(surfaces, "surfaces")
        # Shaders are identified by id(), which is fast.  Surfaces that share one continue to do so.
        shaders = {id(item.shader): item.shader for item in items}
        shader_index = {key: i for i, key in enumerate(shaders)}
        spheres = [i for i, item in enumerate(items) if isinstance(item, Sphere)]
        boxes = [i for i, item in enumerate(items) if isinstance(item, Box)]
        order = spheres + boxes
        return cls(
            center=[items[i].center for i in spheres],
            radius=[items[i].radius for i in spheres],
            min_pt=[items[i].min_pt for i in boxes],
            max_pt=[items[i].max_pt for i in boxes],
            shader_index=[shader_index[id(items[i].shader)] for i in order],
            file_index=order,
            shaders=tuple(shaders.values()),
            line=[items[i].line or 0 for i in order],
        )

    def __len__(self) -> int:
        return len(self.radius) + len(self.min_pt)

    @property
    def sphere_count(self) -> int:
        """Number of spheres."""
        return len(self.radius)

    @cached_property
    def file_order(self) -> NDArray[np.intp]:
        """Indices (S + B,) into the arrays, in the file's order: the inverse of `file_index`."""
        order = np.argsort(self.file_index)
        order.setflags(write=False)
        return order

    @overload
    def __getitem__(self, index: int) -> Sphere | Box: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Sphere | Box, ...]: ...
    def __getitem__(self, index: int | slice) -> Sphere | Box | tuple[Sphere | Box, ...]:
        selected = self.file_order[index].tolist()
        if isinstance(index, slice):
            return tuple(map(self._surface, selected))
        return self._surface(selected)

    def __iter__(self) -> Iterator[Sphere | Box]:
        return iter(self[:])

    def _surface(self, i: int) -> Sphere | Box:
        """Return the surface at index `i` of the arrays."""
        shader, line = self.shaders[self.shader_index[i]], self.line.item(i) or None
        if i < self.sphere_count:
            numbers = {"center": tuple(self.center[i].tolist()), "radius": self.radius.item(i)}
            return schema.construct_unchecked(Sphere, **numbers, shader=shader, line=line)
        low, high = (a[i - self.sphere_count].tolist() for a in (self.min_pt, self.max_pt))
        corners = {"min_pt": tuple(low), "max_pt": tuple(high)}
        return schema.construct_unchecked(Box, **corners, shader=shader, line=line)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surfaces):
            return NotImplemented
        return len(self) == len(other) and all(map(operator.eq, self, other))

    def __hash__(self) -> int:
        # To hash all the arrays would take too long.
        return hash((len(self), self[0] if len(self) else None))

    def __repr__(self) -> str:
        return f"<Surfaces: {len(self.radius)} spheres, {len(self.min_pt)} boxes>"


_DEFAULT_CAMERA, _NO_SURFACES = Camera(), Surfaces()


@dataclass(frozen=True, slots=True, init=False)
class Scene(Validated):
    """Surfaces, lights, a camera, and the size of the picture.

    Parameters
    ----------
    width, height : int
        Size of the picture in pixels; their product is at most `schema.MAX_PIXELS`, 2^28.
    camera : Camera
    lights : iterable of PointLight
    surfaces : iterable of Sphere and Box, or Surfaces

    Raises
    ------
    SceneError
        For a picture without pixels or with too many, or values of the wrong type.
    """

    camera: Camera = field(metadata=xml_field(schema.one_of(Camera)))
    lights: tuple[PointLight, ...] = field(metadata=xml_field(schema.list_of(PointLight)))
    surfaces: Surfaces = field(metadata=xml_field(lambda value, _: Surfaces.of(value)))
    width: int = field(metadata=xml_field(schema.pixel_count))
    height: int = field(metadata=xml_field(schema.pixel_count))

    # Not generated, because the parameters accept more types than the fields have.
    def __init__(
        self,
        *,
        width: int,
        height: int,
        camera: Camera = _DEFAULT_CAMERA,
        lights: Iterable[PointLight] = (),
        surfaces: Iterable[Sphere | Box] = _NO_SURFACES,
    ) -> None:
        sized = {"width": width, "height": height, "camera": camera}
        for name, value in (sized | {"lights": lights, "surfaces": surfaces}).items():
            object.__setattr__(self, name, value)
        self.__post_init__()
        if (count := self.width * self.height) > schema.MAX_PIXELS:
            size = f"{self.width} x {self.height} pixels are too many: the picture would take"
            memory = f"{count * 24 / 2**30:.3g} GiB of memory"
            limit = f"at most {schema.MAX_PIXELS} are allowed"
            raise schema.SceneError([f"width, height: {size} {memory}; {limit}"])

    def _repr_png_(self) -> bytes:
        """Show the scene as a picture, in a notebook."""
        # The only import from a higher layer: Jupyter calls this method of the scene itself.
        from tracer.picture.render import to_png

        return to_png(self)
