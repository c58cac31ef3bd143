"""The scene: frozen dataclasses that validate their fields, and the arrays of its surfaces.

All numbers are finite.  The magnitude of numbers is at most 1e75, except in directions.  Lengths
and coordinates other than 0 have a magnitude of at least 1e-75.  Colours, intensities and exponents
are not negative.  If values are invalid, one `SceneError` lists all of them.

The metadata of the fields define the elements of scene files: see `schema.tag_field`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, SupportsFloat, SupportsIndex, TypeAlias, overload
from typing import Annotated as Shaped

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats, Ints
from tracer.scene import display, schema
from tracer.scene.schema import FieldError, Validated, format_number, tag_field

VectorLike: TypeAlias = Sequence[float] | NDArray[Any]
"""Three numbers.  Scenes accept any sequence or array, and store a tuple of float."""

_ORIGIN = (0.0, 0.0, 0.0)
_MINUS_Z = (0.0, 0.0, -1.0)
_PLUS_Y = (0.0, 1.0, 0.0)
_WHITE = (1.0, 1.0, 1.0)
_BLACK = (0.0, 0.0, 0.0)

_PROJ_NORMAL = tag_field(schema.DIRECTION, "projNormal")
# The tag is color in the specification, and intensity in the published scenes.
_INTENSITY = tag_field(schema.COLOR, "intensity", "color")

# Minimum sine of the angle between view_up and the window's normal.  For smaller values, too few
# digits of the camera's axes would be correct.
_MIN_SINE = 1e-10
# Minimum cosine of the angle between view_dir and the normal, for the same reason.
_MIN_COSINE = 1e-10


@np.errstate(under="ignore")
def normalize(vector: ArrayLike) -> Shaped[Floats, "3"]:
    """Scale a vector to length 1.  It must be finite, and not the zero vector."""
    components = np.asarray(vector, dtype=np.float64)
    # Scale the vector so that the squares of its large components neither overflow nor underflow.
    # Scaling by a power of two is exact, so that pictures of scaled scenes stay bit-identical.
    _, exponent = np.frexp(np.abs(components).max())
    components = np.ldexp(components, -int(exponent))
    return components / np.sqrt(components @ components)


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera(Validated):
    """A perspective camera: an eye, and a window through which it views the scene.

    The window is the rectangle in space that the picture fills.  It need not be perpendicular to
    the direction of view.

    Parameters
    ----------
    view_point : (float, float, float)
        Position of the eye, the centre of projection.
    view_dir : (float, float, float)
        Direction from the eye to the window's centre; its length is not used.
    view_up : (float, float, float)
        Direction that is up in the picture; its length is not used.
    proj_normal : (float, float, float), optional
        Normal of the window; its length and sign are not used.  The default is `view_dir`.
    proj_distance : float
        Distance from the eye to the window's centre.
    view_width, view_height : float
        Size of the window, in the units of the scene.

    Raises
    ------
    SceneError
        For invalid numbers, a zero vector, `view_up` parallel to `proj_normal`, or
        `proj_normal` perpendicular to `view_dir`.
    """

    view_point: VectorLike = field(default=_ORIGIN, metadata=tag_field(schema.POINT, "viewPoint"))
    view_dir: VectorLike = field(default=_MINUS_Z, metadata=tag_field(schema.DIRECTION, "viewDir"))
    view_up: VectorLike = field(default=_PLUS_Y, metadata=tag_field(schema.DIRECTION, "viewUp"))
    proj_normal: VectorLike | None = field(default=None, metadata=_PROJ_NORMAL)
    proj_distance: float = field(default=1.0, metadata=tag_field(schema.LENGTH, "projDistance"))
    view_width: float = field(default=1.0, metadata=tag_field(schema.LENGTH, "viewWidth"))
    view_height: float = field(default=1.0, metadata=tag_field(schema.LENGTH, "viewHeight"))

    if TYPE_CHECKING:  # the parameters accept more types than the fields have

        def __init__(
            self,
            *,
            view_point: VectorLike = ...,
            view_dir: VectorLike = ...,
            view_up: VectorLike = ...,
            proj_normal: VectorLike | None = ...,
            proj_distance: SupportsFloat = ...,
            view_width: SupportsFloat = ...,
            view_height: SupportsFloat = ...,
        ) -> None: ...

    @classmethod
    def find_conflicts(cls, get_rows: Callable[[str], Floats]) -> Iterator[FieldError]:
        """Yield an error for each camera with impossible axes.

        The normal of its window is parallel to `view_up`, or perpendicular to `view_dir`.
        `get_rows` returns the values of a field, one row a camera; a `proj_normal` that is not
        given is a row of NaN.
        """
        arrays = map(get_rows, ("view_up", "view_dir", "proj_normal"))
        for index, (view_up, view_dir, normal) in enumerate(zip(*arrays, strict=True)):
            normal_name = "proj_normal"
            if np.isnan(normal).all():
                normal_name = "view_dir"
                normal = view_dir
            with np.errstate(all="ignore"):  # vectors may be zero or not finite
                view_up, view_dir, normal = map(normalize, (view_up, view_dir, normal))
                sine = np.linalg.norm(np.cross(view_up, normal))
                cosine = abs(normal @ view_dir)
            if sine < _MIN_SINE:
                message = f"must not be parallel to {normal_name}; choose another view_up"
                yield FieldError(row=index, name="view_up", message=message)
            if cosine < _MIN_COSINE:
                message = "must not be perpendicular to view_dir: no ray would meet the window"
                yield FieldError(row=index, name="proj_normal", message=message)

    @property
    def normal(self) -> VectorLike:
        """The window's normal: `proj_normal` if it is given, otherwise `view_dir`."""
        return self.view_dir if self.proj_normal is None else self.proj_normal


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight(Validated):
    """A point light whose intensity is the same at any distance.

    Parameters
    ----------
    position : (float, float, float)
        Position of the light.
    intensity : (float, float, float)
        Linear RGB intensity.  The default is white, 1 1 1.
    line : int, optional
        Line of the file where the light begins; ignored by ==.

    Raises
    ------
    SceneError
        For invalid numbers.
    """

    position: VectorLike = field(metadata=tag_field(schema.POINT, "position"))
    intensity: VectorLike = field(default=_WHITE, metadata=_INTENSITY)
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lambertian(Validated):
    """The shader of a matte surface.

    Each light that is visible from a point of the surface adds I kd n.l to the radiance there.  I
    is the intensity of the light, n the unit normal, and l the unit vector to the light (Shirley,
    Fundamentals of Computer Graphics, 2nd edition, 9.1).

    Parameters
    ----------
    diffuse : (float, float, float)
        The colour kd: linear RGB, where 1 reflects all light.  The default is white.
    line : int, optional
        Line of the file where the shader begins; ignored by ==.

    Raises
    ------
    SceneError
        For invalid numbers.
    """

    diffuse: VectorLike = field(default=_WHITE, metadata=tag_field(schema.COLOR, "diffuseColor"))
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Phong(Validated):
    """The shader of a shiny surface: a matte surface with highlights (Blinn 1977).

    Each light that is visible from a point of the surface adds I (kd n.l + ks (n.h)^exponent) to
    the radiance there.  I is the intensity of the light, n the unit normal, l the unit vector to
    the light, and h the unit vector halfway between l and the direction to the eye.  A light behind
    the surface (n.l <= 0) is not visible, so it causes no highlight.

    Parameters
    ----------
    diffuse, specular : (float, float, float)
        The colours kd and ks: linear RGB, where 1 reflects all light.  The defaults are white and
        black.
    exponent : float
        Exponent of the highlights: the larger it is, the smaller they are.
    line : int, optional
        Line of the file where the shader begins; ignored by ==.

    Raises
    ------
    SceneError
        For invalid numbers.
    """

    diffuse: VectorLike = field(default=_WHITE, metadata=tag_field(schema.COLOR, "diffuseColor"))
    specular: VectorLike = field(default=_BLACK, metadata=tag_field(schema.COLOR, "specularColor"))
    exponent: float = field(default=1.0, metadata=tag_field(schema.EXPONENT, "exponent"))
    line: int | None = field(default=None, compare=False, repr=False)

    if TYPE_CHECKING:  # the parameters accept more types than the fields have

        def __init__(
            self,
            *,
            diffuse: VectorLike = ...,
            specular: VectorLike = ...,
            exponent: SupportsFloat = ...,
            line: int | None = ...,
        ) -> None: ...


Shader: TypeAlias = Lambertian | Phong

_MATTE_WHITE = Lambertian()

_SHADER = tag_field(schema.require_type(Lambertian, Phong), "shader")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(Validated):
    """A sphere; by default the unit sphere around the origin.

    Parameters
    ----------
    center : (float, float, float)
        Centre of the sphere.
    radius : float
        Radius of the sphere; positive.
    shader : Lambertian or Phong
        The colours of the surface.  The default is white and matte.
    line : int, optional
        Line of the file where the sphere begins; ignored by ==.

    Raises
    ------
    SceneError
        For invalid values.
    """

    center: VectorLike = field(default=_ORIGIN, metadata=tag_field(schema.POINT, "center"))
    radius: float = field(default=1.0, metadata=tag_field(schema.LENGTH, "radius"))
    shader: Shader = field(default=_MATTE_WHITE, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)

    if TYPE_CHECKING:  # the parameters accept more types than the fields have

        def __init__(
            self,
            *,
            center: VectorLike = ...,
            radius: SupportsFloat = ...,
            shader: Shader = ...,
            line: int | None = ...,
        ) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(Validated):
    """An axis-aligned box.  Its thickness along an axis can be 0.

    Parameters
    ----------
    min_pt, max_pt : (float, float, float)
        The corner with the minimum coordinates, and the corner with the maximum coordinates.
    shader : Lambertian or Phong
        The colours of the surface.  The default is white and matte.
    line : int, optional
        Line of the file where the box begins; ignored by ==.

    Raises
    ------
    SceneError
        For invalid values, or if `min_pt` exceeds `max_pt` in any coordinate.
    """

    min_pt: VectorLike = field(metadata=tag_field(schema.POINT, "minPt"))
    max_pt: VectorLike = field(metadata=tag_field(schema.POINT, "maxPt"))
    shader: Shader = field(default=_MATTE_WHITE, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)

    @classmethod
    def find_conflicts(cls, get_rows: Callable[[str], Floats]) -> Iterator[FieldError]:
        """Find boxes whose `min_pt` exceeds `max_pt` in any coordinate."""
        min_pt, max_pt = get_rows("min_pt"), get_rows("max_pt")
        for index in np.flatnonzero((min_pt > max_pt).any(axis=1)).tolist():
            conflicts = [
                f"{axis} has {format_number(minimum)} > {format_number(maximum)}"
                for axis, minimum, maximum in zip("xyz", min_pt[index], max_pt[index], strict=True)
                if minimum > maximum
            ]
            message = f"must not exceed max_pt, but {' and '.join(conflicts)}; swap these"
            yield FieldError(row=index, name="min_pt", message=message)


Kind: TypeAlias = type[Sphere] | type[Box]
"""The class of a surface."""

# Methods that change a list.
_LIST_METHODS = frozenset(
    ("append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort")
)
# Suggested fix for calling one of them on `Surfaces`.
_CHANGE_REMEDY = "make a new scene: dataclasses.replace(scene, surfaces=[*scene.surfaces, x])"


class Surfaces(Sequence[Sphere | Box]):
    """All surfaces of a scene: a sequence of `Sphere` and `Box` that stores its numbers in arrays.

    The sequence has the order of the file.  In the arrays, all spheres come before all
    boxes.  The arrays are read-only copies of the arguments.  Two instances are equal if they are
    equal as sequences.

    Parameters
    ----------
    center : (S, 3) array_like
        Centres of S spheres.
    radius : (S,) array_like
        Radii of the spheres.
    min_pt, max_pt : (B, 3) array_like
        Corners of B boxes with the minimum and with the maximum coordinates.
    shader_index : (S + B,) array_like of int
        For each surface, the index of its shader in `shaders`.
    file_index : (S + B,) array_like of int, optional
        For each surface, its index in the file: a permutation of 0 ... S + B - 1.  By default, the
        file has the same order as the arrays.  If a ray hits two surfaces at the same distance,
        the surface with the lower index is visible.
    shaders : tuple of Lambertian or Phong
        The shaders, each of which can belong to several surfaces.
    line : (S + B,) array_like of int, optional
        For each surface, the line of the file where it begins, or 0 if it is not from a file.  The
        default is 0 for all.

    Raises
    ------
    SceneError
        For arrays whose lengths do not match, or that contain invalid numbers.
    """

    # For each kind of surface, in the order of the arrays, its numbers: an array for each field.
    tables: dict[Kind, dict[str, Floats]]
    counts: dict[Kind, int]  # number of surfaces of each kind
    shader_index: Shaped[Ints, "surfaces"]
    file_index: Shaped[Ints, "surfaces"]
    line: Shaped[NDArray[np.int32], "surfaces"]  # 0 if the surface is not from a file
    shaders: tuple[Shader, ...]

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
        spheres = {"center": center, "radius": radius}
        boxes = {"min_pt": min_pt, "max_pt": max_pt}
        self._fill({Sphere: spheres, Box: boxes}, shader_index, file_index, shaders, line)

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[Kind, Mapping[str, Any]],
        *,
        shader_index: ArrayLike,
        file_index: ArrayLike,
        shaders: tuple[Shader, ...],
        line: ArrayLike,
    ) -> Surfaces:
        """Create surfaces from the numbers of each field of each kind, copied and validated.

        `tables` has the form of the attribute `tables`, but may contain lists in place of arrays.
        The other arguments, and the errors, are those of `Surfaces`.
        """
        surfaces = cls.__new__(cls)
        surfaces._fill(tables, shader_index, file_index, shaders, line)
        return surfaces

    def _fill(
        self,
        tables: Mapping[Kind, Mapping[str, Any]],
        shader_index: ArrayLike,
        file_index: ArrayLike | None,
        shaders: tuple[Shader, ...],
        line: ArrayLike | None,
    ) -> None:
        """Set the attributes of a new instance, for `__init__` and `from_tables`."""
        self.tables = {kind: _copy_columns(kind, columns) for kind, columns in tables.items()}
        self.counts = {
            kind: len(next(iter(columns.values()))) for kind, columns in self.tables.items()
        }
        file_index = np.arange(len(self)) if file_index is None else file_index
        line = np.zeros(len(self)) if line is None else line
        self.shader_index = schema.copy_integers(shader_index, "shader_index")
        self.file_index = schema.copy_integers(file_index, "file_index")
        self.line = schema.copy_integers(line, "line").astype(np.int32)
        validate_shaders = schema.require_list(Lambertian, Phong)
        self.shaders = validate_shaders(shaders, "shaders")
        # Numbers can be validated only if the lengths of the arrays match.
        schema.raise_if_any(self._find_array_errors())
        errors = sorted(self._find_number_errors(), key=lambda error: error[0])
        schema.raise_if_any(f"surface {index}: {message}" for index, message in errors)
        self._protect_arrays()

    @property
    def center(self) -> Shaped[Floats, "spheres 3"]:
        return self.tables[Sphere]["center"]

    @property
    def radius(self) -> Shaped[Floats, "spheres"]:
        return self.tables[Sphere]["radius"]

    @property
    def min_pt(self) -> Shaped[Floats, "boxes 3"]:
        return self.tables[Box]["min_pt"]

    @property
    def max_pt(self) -> Shaped[Floats, "boxes 3"]:
        return self.tables[Box]["max_pt"]

    def _find_array_errors(self) -> Iterator[str]:
        """Yield a message for each array that has the wrong length or contains invalid indices."""
        for columns in self.tables.values():
            (first_name, first_column), *others = columns.items()
            for name, column in others:
                reason = f"the length of {first_name}"
                yield from _check_length(name, column, len(first_column), reason)
        for name in ("shader_index", "file_index", "line"):
            yield from _check_length(name, getattr(self, name), len(self), "the number of surfaces")
        shader_count = len(self.shaders)
        is_invalid = (self.shader_index < 0) | (self.shader_index >= shader_count)
        for invalid_index in self.shader_index[is_invalid].tolist()[:1]:
            yield f"shader_index: {invalid_index} is out of range for {shader_count} shaders"
        surface_count = len(self.file_index)
        if not np.array_equal(np.sort(self.file_index), np.arange(surface_count)):
            yield f"file_index: must be a permutation of 0 ... {surface_count - 1}"

    def _find_number_errors(self) -> Iterator[tuple[int, str]]:
        """Yield the index in the file of each surface with an invalid number, and what is wrong."""
        first_index = 0  # array index of the first surface of the kind
        for kind, columns in self.tables.items():
            # One row for each surface, also if the field is a single number.
            rows = {name: np.atleast_2d(column.T).T for name, column in columns.items()}
            for index, name, message in schema.find_field_errors(kind, rows):
                yield self.file_index.item(first_index + index), f"{name}: {message}"
            first_index += self.counts[kind]

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore an instance that was pickled."""
        vars(self).update(state)
        self._protect_arrays()

    def _protect_arrays(self) -> None:
        """Replace all arrays by read-only views (see `_protect`)."""
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(self, name, _protect(value))
        for columns in self.tables.values():
            for name, column in columns.items():
                columns[name] = _protect(column)

    @classmethod
    def from_objects(cls, surfaces: Iterable[Sphere | Box]) -> Surfaces:
        """Convert a sequence of spheres and boxes to arrays.

        Parameters
        ----------
        surfaces : iterable of Sphere and Box
            The objects.  An instance of `Surfaces` is returned unchanged.

        Returns
        -------
        surface_arrays : Surfaces
            A sequence of the same spheres and boxes, in the same order.

        Raises
        ------
        SceneError
            If `surfaces` is not iterable, or an item is neither a Sphere nor a Box.
        """
        if isinstance(surfaces, Surfaces):
            return surfaces
        objects: tuple[Any, ...] = schema.require_list(Sphere, Box)(surfaces, "surfaces")
        # Shaders are identified by id(), so surfaces that share a shader object still share it.
        shader_of_id = {id(surface.shader): surface.shader for surface in objects}
        index_of_id = {shader_id: index for index, shader_id in enumerate(shader_of_id)}
        file_index: list[int] = []  # for each surface, in the order of the arrays
        tables: dict[Kind, dict[str, Any]] = {}
        kinds: tuple[Kind, ...] = Sphere, Box
        for kind in kinds:
            indices = [index for index, surface in enumerate(objects) if isinstance(surface, kind)]
            file_index += indices
            tables[kind] = {
                name: [getattr(objects[index], name) for index in indices]
                for name in schema.get_number_validators(kind)
            }
        return cls.from_tables(
            tables,
            shader_index=[index_of_id[id(objects[index].shader)] for index in file_index],
            file_index=file_index,
            shaders=tuple(shader_of_id.values()),
            line=[objects[index].line or 0 for index in file_index],
        )

    def __len__(self) -> int:
        return sum(self.counts.values())

    @cached_property
    def array_index(self) -> Shaped[Ints, "surfaces"]:
        """Index of each surface in arrays such as `shader_index`, in the order of the file.

        In these arrays, all spheres come before all boxes.  The result is read-only.
        """
        array_index = np.argsort(self.file_index)
        array_index.setflags(write=False)
        return array_index

    @overload
    def __getitem__(self, index: int) -> Sphere | Box: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Sphere | Box, ...]: ...
    def __getitem__(self, index: int | slice) -> Sphere | Box | tuple[Sphere | Box, ...]:
        array_index = self.array_index[index].tolist()
        if isinstance(index, slice):
            return tuple(map(self._make_surface, array_index))
        return self._make_surface(array_index)

    def __iter__(self) -> Iterator[Sphere | Box]:
        return iter(self[:])

    def _make_surface(self, index: int) -> Sphere | Box:
        """Create the `Sphere` or `Box` at the given index of the arrays."""
        # Skip the tables before the surface's own.  Then `row` is the row in this table.
        row = index
        for kind in self.counts:
            if row < self.counts[kind]:
                break
            row -= self.counts[kind]
        fields: dict[str, object] = {
            "shader": self.shaders[self.shader_index[index]],
            "line": self.line.item(index) or None,
        }
        for name, column in self.tables[kind].items():
            value = column[row].tolist()  # converts NumPy's numbers to Python's
            fields[name] = tuple(value) if column.ndim > 1 else value
        return schema.construct_unchecked(kind, **fields)

    if not TYPE_CHECKING:  # type checkers know that these methods do not exist

        def __getattr__(self, name: str) -> NoReturn:
            """Tell a caller who wants to change the surfaces to make a new scene."""
            if name in _LIST_METHODS:
                raise AttributeError(f"Surfaces has no {name}; {_CHANGE_REMEDY}")
            raise AttributeError(f"'Surfaces' object has no attribute {name!r}")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surfaces):
            return NotImplemented
        return self[:] == other[:]

    def __hash__(self) -> int:
        # Hashing all surfaces would take too long.
        return hash((len(self), self[:1]))

    def __repr__(self) -> str:
        return f"<Surfaces: {len(self.radius)} spheres, {len(self.min_pt)} boxes>"


def _copy_columns(kind: Kind, columns: Mapping[str, ArrayLike]) -> dict[str, Floats]:
    """Copy the numbers of surfaces of one kind into arrays, one for each field, in their order.

    Raise `SceneError` if the numbers of a field have the wrong type or shape.
    """
    validators = schema.get_number_validators(kind)
    return {name: each.copy_rows(columns[name], name) for name, each in validators.items()}


def _check_length(
    name: str, array: NDArray[Any], required_length: int, reason: str
) -> Iterator[str]:
    """Yield a message if an array does not have the required length; `reason` says why it must."""
    if len(array) != required_length:
        yield f"{name}: must have length {required_length} ({reason}), not {len(array)}"


def _protect(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of an array, with NumPy's own dtype."""
    # The dtype of an unpickled array is a copy of NumPy's own.  With a copy, `ufunc.at` takes 20
    # times as long, and every array that is computed from the array inherits the copy.
    view: NDArray[Any] = array.view(array.dtype.type)
    view.setflags(write=False)
    return view


_DEFAULT_CAMERA = Camera()
_NO_SURFACES = Surfaces()


@dataclass(frozen=True, slots=True, init=False)
class Scene(Validated):
    """A scene to render: surfaces, lights, a camera, and the size of the picture.

    Parameters
    ----------
    width, height : int
        Size of the picture in pixels.  Their product is at least 1 and at most 2^28.
    camera : Camera
        The camera.  The default is at the origin and looks along the negative z axis.
    lights : iterable of PointLight
        The lights, stored as a tuple.
    surfaces : iterable of Sphere and Box, or Surfaces
        The surfaces, stored as `Surfaces`.

    Raises
    ------
    SceneError
        For a picture without pixels or with too many pixels, or values of the wrong type.
    """

    camera: Camera = field(metadata=tag_field(schema.require_type(Camera)))
    lights: tuple[PointLight, ...] = field(metadata=tag_field(schema.require_list(PointLight)))
    surfaces: Surfaces = field(metadata=tag_field(lambda value, _: Surfaces.from_objects(value)))
    width: int = field(metadata=tag_field(schema.validate_picture_side))
    height: int = field(metadata=tag_field(schema.validate_picture_side))

    # This constructor is not generated by @dataclass, because its parameters accept more types than
    # the fields have.
    def __init__(
        self,
        *,
        width: SupportsIndex,
        height: SupportsIndex,
        camera: Camera = _DEFAULT_CAMERA,
        lights: Iterable[PointLight] = (),
        surfaces: Iterable[Sphere | Box] = _NO_SURFACES,
    ) -> None:
        object.__setattr__(self, "camera", camera)
        object.__setattr__(self, "lights", lights)
        object.__setattr__(self, "surfaces", surfaces)
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "height", height)
        self.__post_init__()
        count = self.width * self.height
        if count > schema.MAX_PIXELS:
            memory = f"the picture would take {count * 24 / 2**30:.3g} GiB of memory"
            message = f"{self.width} x {self.height} pixels are too many: {memory}"
            limit = f"at most {schema.MAX_PIXELS} are allowed"
            raise schema.SceneError([f"width, height: {message}; {limit}"])

    def _repr_png_(self) -> bytes:
        """Show the scene as its picture in notebooks, which call this method."""
        return display.make_scene_png(self)
