"""The scene: frozen, validated dataclasses, and the arrays the tracer reads.

Everything is checked when it is made, whether it comes from XML or from
Python, so the renderer never meets an impossible value.  A check that fails
raises :class:`SceneError`, which tells all faults that can be told at once, not only
the first.

Surfaces come in thousands, so :class:`Surfaces` keeps them as arrays and
checks them whole; it still reads like a sequence of :class:`Sphere` and
:class:`Box`.
"""

from __future__ import annotations

import operator
import reprlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats, Ints
from tracer.messages import number

__all__ = [
    "LARGEST",
    "MAX_PIXELS",
    "SMALLEST",
    "Box",
    "Camera",
    "Fault",
    "Lambertian",
    "Phong",
    "PointLight",
    "Scene",
    "SceneError",
    "Shader",
    "Sphere",
    "Surfaces",
    "Vector",
    "unit",
]

Vector: TypeAlias = tuple[float, float, float]

MAX_PIXELS = 1 << 28
"""Largest picture, in pixels: 2^28 (16384 x 16384), 6 GiB as float64 RGB."""

SMALLEST, LARGEST = 1e-75, 1e75
"""Between these in size are lengths and coordinates other than 0: float64 holds fourth powers."""

# Below this sine or cosine the camera basis has no digit left worth trusting.
_DEGENERATE = 1e-10


class Fault(NamedTuple):
    """One fault: the parameter, and what is wrong with it, and what would be right."""

    field: str
    message: str
    surface: int | None = None
    """Index, in file order, of the surface at fault, if the fault lies in one of many."""

    def __str__(self) -> str:
        where = "" if self.surface is None else f"surface {self.surface}: "
        return f"{where}{self.field}: {self.message}"


class SceneError(ValueError):
    """An impossible scene.

    Attributes
    ----------
    faults : tuple of Fault
        Everything that is wrong, in the order it was found.
    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is copied as cls(*args), and `args` holds only the message.
        return type(self), (self.faults,), self.__dict__


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A perspective camera with a window that may be shifted or oblique.

    Parameters
    ----------
    view_point : (3,)
        Centre of projection.
    view_dir : (3,)
        From `view_point` to the window's centre; its length is not used.
    view_up : (3,)
        Orients the picture.
    proj_normal : (3,), optional
        Normal of the window; length and sign are not used.  The view
        direction if absent.
    proj_distance : float
        Distance from `view_point` to the window's centre along `view_dir`.
    view_width, view_height : float
        Size of the window.

    Raises
    ------
    SceneError
        For anything but finite numbers, a zero vector, a distance or size that is not positive, a
        length or coordinate out of range (`LARGEST`), `view_up` parallel to `proj_normal` or
        `proj_normal` perpendicular to `view_dir`.
    """

    view_point: Vector = (0.0, 0.0, 0.0)
    view_dir: Vector = (0.0, 0.0, -1.0)
    view_up: Vector = (0.0, 1.0, 0.0)
    proj_normal: Vector | None = None
    proj_distance: float = 1.0
    view_width: float = 1.0
    view_height: float = 1.0

    @np.errstate(under="ignore")
    def __post_init__(self) -> None:
        faults = _checked(self, view_point=_point, view_dir=_direction, view_up=_direction)
        if self.proj_normal is not None:
            faults += _checked(self, proj_normal=_direction)
        faults += _checked(
            self, proj_distance=_positive, view_width=_positive, view_height=_positive
        )
        if not faults:
            normal = unit(self.normal)
            sine = np.linalg.norm(np.cross(unit(self.view_up), normal))
            if sine < _DEGENERATE:
                of = "view_dir" if self.proj_normal is None else "proj_normal"
                wrong = f"must not be parallel to {of}; choose another view_up"
                faults.append(Fault("view_up", wrong))
            if abs(normal @ unit(self.view_dir)) < _DEGENERATE:
                wrong = "must not be perpendicular to view_dir: no ray would meet it"
                faults.append(Fault("proj_normal", wrong))
        _raise_any(faults)

    @property
    def normal(self) -> Vector:
        """The window's normal as given: `proj_normal`, or else `view_dir`."""
        return self.view_dir if self.proj_normal is None else self.proj_normal


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight:
    """A point light; its intensity does not fall off with distance.

    Parameters
    ----------
    position : (3,)
    intensity : (3,)
        Linear RGB.

    Raises
    ------
    SceneError
        For anything but three finite numbers, a coordinate out of range (`LARGEST`), or a negative
        intensity.
    """

    position: Vector
    intensity: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _raise_any(_checked(self, position=_point, intensity=_color))


@dataclass(frozen=True, slots=True, kw_only=True)
class Lambertian:
    """Matt: radiance I kd n.l from each light that is not hidden, of intensity I.

    See Shirley, Fundamentals of Computer Graphics, 2nd edition, 9.1.

    Parameters
    ----------
    diffuse : (3,)
        The colour kd: linear RGB, 1 for all of the light.

    Raises
    ------
    SceneError
        For a `diffuse` (kd), RGB, that is not three finite numbers of at least 0.
    """

    diffuse: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _raise_any(_checked(self, diffuse=_color))


@dataclass(frozen=True, slots=True, kw_only=True)
class Phong:
    """Blinn-Phong: I (kd n.l + ks (n.h)^exponent) from each light that is not hidden (Blinn 1977).

    A light, of intensity I, that is behind the surface (n.l <= 0) is hidden: it makes no highlight
    either.

    Parameters
    ----------
    diffuse, specular : (3,)
        The colours kd and ks: linear RGB, 1 for all of the light.
    exponent : float
        The larger, the smaller the highlight.

    Raises
    ------
    SceneError
        For a `diffuse` (kd) or `specular` (ks), RGB, that is not three finite numbers of at least
        0, and an `exponent` that is negative or not finite.
    """

    diffuse: Vector = (1.0, 1.0, 1.0)
    specular: Vector = (0.0, 0.0, 0.0)
    exponent: float = 1.0

    def __post_init__(self) -> None:
        _raise_any(_checked(self, diffuse=_color, specular=_color, exponent=_not_negative))


Shader: TypeAlias = Lambertian | Phong


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """A sphere; white and Lambertian if it has no shader.

    Parameters
    ----------
    center : (3,)
    radius : float
    shader : Lambertian or Phong

    Raises
    ------
    SceneError
        For a centre that is not three finite numbers, a radius that is not positive and finite, a
        length or coordinate out of range (`LARGEST`), or a shader of another type.
    """

    center: Vector = (0.0, 0.0, 0.0)
    radius: float = 1.0
    shader: Shader = field(default_factory=Lambertian)

    def __post_init__(self) -> None:
        shader = _one_of(Lambertian, Phong)
        _raise_any(_checked(self, center=_point, radius=_positive, shader=shader))


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """An axis-aligned box; it may be flat.  White and Lambertian if it has no shader.

    Parameters
    ----------
    min_pt, max_pt : (3,)
        Opposite corners, with the least and the largest coordinates.
    shader : Lambertian or Phong

    Raises
    ------
    SceneError
        For corners that are not three finite numbers, a coordinate out of range (`LARGEST`),
        `min_pt` beyond `max_pt` along any axis, or a shader of another type.
    """

    min_pt: Vector
    max_pt: Vector
    shader: Shader = field(default_factory=Lambertian)

    def __post_init__(self) -> None:
        faults = _checked(self, min_pt=_point, max_pt=_point)
        if not faults:
            low, high = np.array([self.min_pt]), np.array([self.max_pt])
            faults += _order_faults(low, high, _ALONE)
        _raise_any(faults + _checked(self, shader=_one_of(Lambertian, Phong)))


class Surfaces(Sequence[Sphere | Box]):
    """All surfaces of a scene, as arrays; also a sequence of Sphere and Box.

    The arrays are read-only copies.  Two objects are equal if they are equal as sequences.

    Parameters
    ----------
    center, radius : (S, 3) and (S,)
        The spheres.
    min_pt, max_pt : (B, 3)
        The boxes.
    sphere_index, box_index : (S,) and (B,)
        Place of each in the file: together a permutation of 0 ... S + B - 1.
        Of two surfaces at the same distance, the earlier is seen.
    sphere_shader, box_shader : (S,) and (B,)
        Index into `shaders`.
    shaders : tuple of Lambertian or Phong

    Raises
    ------
    SceneError
        For arrays that do not fit together; for a radius that is not positive, `min_pt` beyond
        `max_pt`, or a number that is not finite or out of range (`LARGEST`).
    """

    def __init__(
        self,
        *,
        center: ArrayLike = (),
        radius: ArrayLike = (),
        sphere_shader: ArrayLike = (),
        sphere_index: ArrayLike | None = None,
        min_pt: ArrayLike = (),
        max_pt: ArrayLike = (),
        box_shader: ArrayLike = (),
        box_index: ArrayLike | None = None,
        shaders: tuple[Shader, ...] = (),
    ) -> None:
        faults: list[Fault] = []
        self.center = _rows(center, "center", faults)
        self.radius = _values(radius, "radius", faults)
        self.min_pt = _rows(min_pt, "min_pt", faults)
        self.max_pt = _rows(max_pt, "max_pt", faults)
        self.sphere_shader = _integers(sphere_shader, "sphere_shader", faults)
        self.box_shader = _integers(box_shader, "box_shader", faults)
        spheres, boxes = len(self.center), len(self.min_pt)
        if sphere_index is None:
            sphere_index = np.arange(spheres)
        if box_index is None:
            box_index = np.arange(spheres, spheres + boxes)
        self.sphere_index = _integers(sphere_index, "sphere_index", faults)
        self.box_index = _integers(box_index, "box_index", faults)
        self.shaders = _list_of(Lambertian, Phong)(shaders, "shaders", faults)
        # What does not fit together cannot be checked further.
        faults = faults or self._misfits()
        if not faults:
            faults += _positive_faults("radius", self.radius, self.sphere_index)
            faults += _point_faults("center", self.center, self.sphere_index)
            faults += _point_faults("min_pt", self.min_pt, self.box_index)
            faults += _point_faults("max_pt", self.max_pt, self.box_index)
            faults += _order_faults(self.min_pt, self.max_pt, self.box_index)
        _raise_any(sorted(faults, key=lambda fault: fault.surface or 0))
        self._protect()

    def _misfits(self) -> list[Fault]:
        """What is wrong with lengths, shaders and indices."""
        faults: list[Fault] = []
        for name, of in (
            ("radius", "center"),
            ("sphere_shader", "center"),
            ("sphere_index", "center"),
            ("max_pt", "min_pt"),
            ("box_shader", "min_pt"),
            ("box_index", "min_pt"),
        ):
            count, needed = len(getattr(self, name)), len(getattr(self, of))
            if count != needed:
                faults.append(Fault(name, f"needs {needed}, as many as {of}; has {count}"))
        for name in ("sphere_shader", "box_shader"):
            places = getattr(self, name)
            wrong = places[(places < 0) | (places >= len(self.shaders))]
            if wrong.size:
                message = f"must be places among {len(self.shaders)} shaders, has {wrong[0]}"
                faults.append(Fault(name, message))
        index = np.concatenate([self.sphere_index, self.box_index])
        missing = np.ones(len(self), dtype=bool)
        missing[index[(index >= 0) & (index < len(self))]] = False
        if len(index) == len(self) and missing.any():
            message = f"must together be a permutation of 0 ... {len(self) - 1}"
            faults.append(Fault("sphere_index, box_index", message))
        return faults

    def _protect(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Unpickled arrays have copies of NumPy's built-in dtypes.  With a copy `ufunc.at` takes a
        # generic path, twenty times as slow, and every array computed from them inherits it.
        for name, value in state.items():
            own = isinstance(value, np.ndarray)
            setattr(self, name, value.view(value.dtype.type) if own else value)
        self._protect()

    @classmethod
    def of(cls, surfaces: Iterable[Sphere | Box]) -> Surfaces:
        """Gather Sphere and Box objects, in order."""
        faults: list[Fault] = []
        items: tuple[Sphere | Box, ...] = _list_of(Sphere, Box)(surfaces, "surfaces", faults)
        _raise_any(faults)
        # By identity: objects that share a shader keep sharing it.
        place = {id(item.shader): item.shader for item in items}
        slot = {key: i for i, key in enumerate(place)}
        spheres = [(i, item) for i, item in enumerate(items) if isinstance(item, Sphere)]
        boxes = [(i, item) for i, item in enumerate(items) if isinstance(item, Box)]
        return cls(
            center=[item.center for _, item in spheres],
            radius=[item.radius for _, item in spheres],
            sphere_shader=[slot[id(item.shader)] for _, item in spheres],
            sphere_index=[i for i, _ in spheres],
            min_pt=[item.min_pt for _, item in boxes],
            max_pt=[item.max_pt for _, item in boxes],
            box_shader=[slot[id(item.shader)] for _, item in boxes],
            box_index=[i for i, _ in boxes],
            shaders=tuple(place.values()),
        )

    def __len__(self) -> int:
        return len(self.radius) + len(self.min_pt)

    @property
    def sphere_count(self) -> int:
        """How many are spheres: where all surfaces are numbered together, these come first."""
        return len(self.radius)

    @property
    def file_index(self) -> Ints:
        """Place of each (S + B,) in the file, spheres first."""
        return np.concatenate([self.sphere_index, self.box_index])

    @property
    def shader_index(self) -> Ints:
        """Index of each (S + B,) into `shaders`, spheres first."""
        return np.concatenate([self.sphere_shader, self.box_shader])

    @overload
    def __getitem__(self, index: int) -> Sphere | Box: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Sphere | Box, ...]: ...
    def __getitem__(self, index: int | slice) -> Sphere | Box | tuple[Sphere | Box, ...]:
        if isinstance(index, slice):
            return tuple(map(self._surface, np.argsort(self.file_index)[index].tolist()))
        (at,) = np.flatnonzero(self.file_index == range(len(self))[index]).tolist()
        return self._surface(at)

    def __iter__(self) -> Iterator[Sphere | Box]:
        # In order from the start: to look for each takes as long as there are surfaces.
        return map(self._surface, np.argsort(self.file_index).tolist())

    def _surface(self, at: int) -> Sphere | Box:
        """One by its place in the arrays, spheres first."""
        if at < self.sphere_count:
            x, y, z = self.center[at].tolist()
            shader = self.shaders[self.sphere_shader[at]]
            return Sphere(center=(x, y, z), radius=float(self.radius[at]), shader=shader)
        at -= self.sphere_count
        x0, y0, z0 = self.min_pt[at].tolist()
        x1, y1, z1 = self.max_pt[at].tolist()
        shader = self.shaders[self.box_shader[at]]
        return Box(min_pt=(x0, y0, z0), max_pt=(x1, y1, z1), shader=shader)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surfaces):
            return NotImplemented
        # Equal shaders get the same number, wherever they stand in the two tuples.
        numbers: dict[Shader, int] = {}
        return all(map(np.array_equal, self._in_order(numbers), other._in_order(numbers)))

    def _in_order(self, numbers: dict[Shader, int]) -> Iterable[NDArray[Any]]:
        """All arrays, spheres and boxes each in file order, and shaders as their `numbers`."""
        shader = np.array([numbers.setdefault(s, len(numbers)) for s in self.shaders], np.intp)
        for index, places, *values in (
            (self.sphere_index, self.sphere_shader, self.center, self.radius),
            (self.box_index, self.box_shader, self.min_pt, self.max_pt),
        ):
            for array in (index, shader[places], *values):
                yield array[np.argsort(index)]

    def __hash__(self) -> int:
        # Length and first surface are enough for a hash: all the arrays would take long.
        return hash((len(self), self[0] if len(self) else None))

    def __repr__(self) -> str:
        return f"<Surfaces: {len(self.radius)} spheres, {len(self.min_pt)} boxes>"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What is seen (`surfaces`), by what light, through which camera.

    Parameters
    ----------
    camera : Camera
    width, height : int
        Size of the picture in pixels; their product is at most `MAX_PIXELS`, 2^28.
    lights : iterable of PointLight
    surfaces : iterable of Sphere and Box, or Surfaces

    Raises
    ------
    SceneError
        For a picture of no pixels, or of more than `MAX_PIXELS`; for sizes that are not integers,
        or parts of the wrong type.
    """

    camera: Camera = field(default_factory=Camera)
    width: int
    height: int
    lights: tuple[PointLight, ...] = ()
    surfaces: Surfaces = field(default_factory=Surfaces)

    def __post_init__(self) -> None:
        faults = _checked(
            self,
            camera=_one_of(Camera),
            lights=_list_of(PointLight),
            surfaces=_surfaces,
            width=_size,
            height=_size,
        )
        if not faults and self.width * self.height > MAX_PIXELS:
            gib = self.width * self.height * 24 / 2**30
            wrong = (
                f"{self.width} x {self.height} pixels are too many: the picture would take"
                f" {gib:.3g} GiB of memory; at most {MAX_PIXELS} pixels are allowed"
            )
            faults.append(Fault("width, height", wrong))
        _raise_any(faults)


@np.errstate(under="ignore")
def unit(vector: ArrayLike) -> Floats:
    """Unit vector (3,), scaled first so that no square that matters over- or underflows."""
    array = np.asarray(vector, dtype=np.float64)
    # By a power of two: exact, so that scaled scenes stay bit-identical.
    array = np.ldexp(array, -int(np.frexp(np.abs(array).max())[1]))
    return array / np.sqrt(array @ array)


# How parameters are checked: from a value as given to the one to keep.  Told the parameter's name,
# a check adds to the faults.
_Check: TypeAlias = Callable[[Any, str, list[Fault]], Any]


def _checked(made: object, **checks: _Check) -> list[Fault]:
    """Set fields of a frozen dataclass to what their checks make of them; return all faults."""
    faults: list[Fault] = []
    for name, check in checks.items():
        object.__setattr__(made, name, check(getattr(made, name), name, faults))
    return faults


def _raise_any(faults: Sequence[Fault]) -> None:
    if faults:
        raise SceneError(faults)


def _vector(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    array = _floats(value, name, faults)
    if array is None:
        pass  # told already
    elif array.shape != (3,):
        has = array.size if array.ndim < 2 else f"shape {array.shape}"
        faults.append(Fault(name, f"needs 3 numbers, has {has}"))
    elif not np.isfinite(array).all():
        faults.append(Fault(name, "must be finite"))
    else:
        x, y, z = array.tolist()
        return (x, y, z)
    # In place of what is at fault: a point, a direction and a colour with no fault to add.
    return (0.0, 0.0, 1.0)


def _point(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    point = _vector(value, name, faults)
    faults += _size_faults(name, np.array([point]), _ALONE)
    return point


def _direction(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    vector = _vector(value, name, faults)
    if vector == (0.0, 0.0, 0.0):
        faults.append(Fault(name, "must not be the zero vector"))
    return vector


def _color(value: ArrayLike, name: str, faults: list[Fault]) -> Vector:
    color = _vector(value, name, faults)
    if min(color) < 0:
        faults.append(Fault(name, f"must not be negative, has {number(min(color))}"))
    return color


def _number(value: float, name: str, faults: list[Fault]) -> float:
    array = _floats(value, name, faults)
    if array is None:
        return 1.0
    if array.size != 1:
        faults.append(Fault(name, f"must be a single number, has {array.size}"))
        return 1.0
    return array.item()


def _positive(value: float, name: str, faults: list[Fault]) -> float:
    value = _number(value, name, faults)
    faults += _positive_faults(name, np.array([value]), _ALONE)
    return value


def _not_negative(value: float, name: str, faults: list[Fault]) -> float:
    value = _number(value, name, faults)
    if not (0 <= value < np.inf):
        faults.append(Fault(name, f"must be finite and not negative, is {number(value)}"))
    return value


def _size(value: int, name: str, faults: list[Fault]) -> int:
    """The size as a Python int: products of NumPy's integers may overflow."""
    try:
        size = int(operator.index(value))
    except TypeError:
        faults.append(Fault(name, f"must be an int, is {value!r}"))
        return 1
    # A message leaves out what may have more digits than float() or str() accepts.
    if size < 1:
        has = f", is {size}" if size > -MAX_PIXELS else ""
        faults.append(Fault(name, f"must be a whole number of at least 1{has}"))
    elif size > MAX_PIXELS:
        faults.append(Fault(name, f"must be at most {MAX_PIXELS}"))
    return size


def _one_of(*types: type) -> _Check:
    def check(value: object, name: str, faults: list[Fault]) -> object:
        if not isinstance(value, types):
            right = " or ".join(each.__name__ for each in types)
            wrong = f"must be of type {right}, is of type {type(value).__name__}"
            faults.append(Fault(name, wrong))
        return value

    return check


def _list_of(*types: type) -> _Check:
    check_one = _one_of(*types)

    def check(values: Iterable[object], name: str, faults: list[Fault]) -> tuple[object, ...]:
        try:
            parts = tuple(values)
        except TypeError:
            faults.append(Fault(name, f"must be a list, is of type {type(values).__name__}"))
            return ()
        for part in {type(part): part for part in parts}.values():
            check_one(part, name, faults)
        return parts

    return check


def _surfaces(value: Any, _: str, faults: list[Fault]) -> Surfaces:
    if isinstance(value, Surfaces):
        return value
    try:
        return Surfaces.of(value)
    except SceneError as error:
        faults += error.faults
        return Surfaces()


def _rows(value: ArrayLike, name: str, faults: list[Fault]) -> Floats:
    """A copy as (n, 3)."""
    array = _floats(value, name, faults)
    if array is not None and (array.size % 3 or array.shape[1:] not in ((), (3,))):
        faults.append(Fault(name, f"needs 3 numbers in each row, has shape {array.shape}"))
        array = None
    return np.zeros((0, 3)) if array is None else array.reshape(-1, 3).copy()


def _values(value: ArrayLike, name: str, faults: list[Fault]) -> Floats:
    """A copy as (n,)."""
    array = _floats(value, name, faults)
    return np.zeros(0) if array is None else array.flatten()


def _integers(value: ArrayLike, name: str, faults: list[Fault]) -> Ints:
    """A copy as (n,)."""
    given = _values(value, name, faults)
    with np.errstate(invalid="ignore"):
        array = given.astype(np.intp)
    if not np.array_equal(array, given):
        faults.append(Fault(name, "must be whole numbers"))
    return array


def _floats(value: ArrayLike, name: str, faults: list[Fault]) -> Floats | None:
    """As an array; None after a fault."""
    try:
        array = np.asarray(value)
        # NumPy would read texts, make NaN of None and of times, and drop a part of complex numbers.
        if value is None or array.dtype.kind in "USmMc":
            raise TypeError
        return np.asarray(array, dtype=np.float64)
    except OverflowError:
        faults.append(Fault(name, "must be finite"))
    except (TypeError, ValueError):
        faults.append(Fault(name, f"must be given in numbers, is {reprlib.repr(value)}"))
    return None


# The index of what is none of many.
_ALONE = np.array([None])


def _positive_faults(name: str, values: Floats, index: NDArray[Any]) -> Iterable[Fault]:
    for i in np.flatnonzero(~((values > 0) & (values < np.inf))).tolist():
        yield Fault(name, f"must be positive and finite, is {number(values[i])}", index.item(i))
    yield from _size_faults(name, values[:, None], index)


def _point_faults(name: str, points: Floats, index: Ints) -> Iterable[Fault]:
    for i in np.flatnonzero(~np.isfinite(points).all(axis=1)).tolist():
        yield Fault(name, "must be finite", index.item(i))
    yield from _size_faults(name, points, index)


def _size_faults(name: str, lengths: Floats, index: NDArray[Any]) -> Iterable[Fault]:
    """Rows (n, k) of lengths or coordinates too large or too small to compute with.

    `index` (n,): of the surface that each row is of.
    """
    size = np.abs(lengths)
    # What is not finite is another fault.
    wrong = ((size > LARGEST) & (size < np.inf)) | ((size < SMALLEST) & (size > 0))
    for i in np.flatnonzero(wrong.any(axis=1)).tolist():
        k = wrong[i].argmax()
        too = "large" if size[i, k] > 1 else "small"
        limits = f"lengths other than 0 are from {number(SMALLEST)} to {number(LARGEST)}"
        yield Fault(name, f"{number(lengths[i, k])} is too {too}; {limits}", index.item(i))


def _order_faults(min_pt: Floats, max_pt: Floats, index: NDArray[Any]) -> Iterable[Fault]:
    wrong = min_pt > max_pt
    for i in np.flatnonzero(wrong.any(axis=1)).tolist():
        has = " and ".join(
            f"{'xyz'[axis]} has {number(min_pt[i, axis])} > {number(max_pt[i, axis])}"
            for axis in np.flatnonzero(wrong[i]).tolist()
        )
        yield Fault("min_pt", f"must not exceed max_pt, but {has}; swap these", index.item(i))
