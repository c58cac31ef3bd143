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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats, Ints, Vector
from tracer.scene import schema as checks
from tracer.scene.schema import Fault, SceneError

__all__ = [
    "Box",
    "Camera",
    "Lambertian",
    "Phong",
    "PointLight",
    "Scene",
    "Shader",
    "Sphere",
    "Surfaces",
    "unit",
]

# Below this sine or cosine the camera basis has no digit left worth trusting.
_DEGENERATE = 1e-10


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
        length or coordinate out of range (`checks.LARGEST`), `view_up` parallel to `proj_normal` or
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
        checks.apply(
            self,
            view_point=checks.point,
            view_dir=checks.direction,
            view_up=checks.direction,
            proj_normal=checks.optional(checks.direction),
            proj_distance=checks.positive,
            view_width=checks.positive,
            view_height=checks.positive,
        )
        faults = []
        normal = unit(self.normal)
        sine = np.linalg.norm(np.cross(unit(self.view_up), normal))
        if sine < _DEGENERATE:
            of = "view_dir" if self.proj_normal is None else "proj_normal"
            wrong = f"must not be parallel to {of}; choose another view_up"
            faults.append(Fault("view_up", wrong))
        if abs(normal @ unit(self.view_dir)) < _DEGENERATE:
            wrong = "must not be perpendicular to view_dir: no ray would meet it"
            faults.append(Fault("proj_normal", wrong))
        checks.raise_any(faults)

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
        For anything but three finite numbers, a coordinate out of range (`checks.LARGEST`), or a
        negative intensity.
    """

    position: Vector
    intensity: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        checks.apply(self, position=checks.point, intensity=checks.color)


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
        checks.apply(self, diffuse=checks.color)


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
        checks.apply(
            self, diffuse=checks.color, specular=checks.color, exponent=checks.not_negative
        )


Shader: TypeAlias = Lambertian | Phong

_A_SHADER = checks.one_of(Lambertian, Phong)


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
        length or coordinate out of range (`checks.LARGEST`), or a shader of another type.
    """

    center: Vector = (0.0, 0.0, 0.0)
    radius: float = 1.0
    shader: Shader = field(default_factory=Lambertian)

    def __post_init__(self) -> None:
        checks.apply(self, center=checks.point, radius=checks.positive, shader=_A_SHADER)


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
        For corners that are not three finite numbers, a coordinate out of range (`checks.LARGEST`),
        `min_pt` beyond `max_pt` along any axis, or a shader of another type.
    """

    min_pt: Vector
    max_pt: Vector
    shader: Shader = field(default_factory=Lambertian)

    def __post_init__(self) -> None:
        checks.apply(self, min_pt=checks.point, max_pt=checks.point, shader=_A_SHADER)
        checks.raise_any(checks.order_faults(np.array([self.min_pt]), np.array([self.max_pt])))


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
        `max_pt`, or a number that is not finite or out of range (`checks.LARGEST`).
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
        self.center = checks.rows(center, "center", faults)
        self.radius = checks.values(radius, "radius", faults)
        self.min_pt = checks.rows(min_pt, "min_pt", faults)
        self.max_pt = checks.rows(max_pt, "max_pt", faults)
        self.sphere_shader = checks.integers(sphere_shader, "sphere_shader", faults)
        self.box_shader = checks.integers(box_shader, "box_shader", faults)
        spheres, boxes = len(self.center), len(self.min_pt)
        if sphere_index is None:
            sphere_index = np.arange(spheres)
        if box_index is None:
            box_index = np.arange(spheres, spheres + boxes)
        self.sphere_index = checks.integers(sphere_index, "sphere_index", faults)
        self.box_index = checks.integers(box_index, "box_index", faults)
        self.shaders = checks.list_of(Lambertian, Phong)(shaders, "shaders", faults)
        # What does not fit together cannot be checked further.
        faults = faults or self._misfits()
        if not faults:
            faults += checks.positive_faults("radius", self.radius, self.sphere_index)
            faults += checks.point_faults("center", self.center, self.sphere_index)
            faults += checks.point_faults("min_pt", self.min_pt, self.box_index)
            faults += checks.point_faults("max_pt", self.max_pt, self.box_index)
            faults += checks.order_faults(self.min_pt, self.max_pt, self.box_index)
        checks.raise_any(sorted(faults, key=lambda fault: fault.surface or 0))
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
        items: tuple[Sphere | Box, ...] = checks.list_of(Sphere, Box)(surfaces, "surfaces", faults)
        checks.raise_any(faults)
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
        Size of the picture in pixels; their product is at most `checks.MAX_PIXELS`, 2^28.
    lights : iterable of PointLight
    surfaces : iterable of Sphere and Box, or Surfaces

    Raises
    ------
    SceneError
        For a picture of no pixels, or of more than `checks.MAX_PIXELS`; for sizes that are not
        integers, or parts of the wrong type.
    """

    camera: Camera = field(default_factory=Camera)
    width: int
    height: int
    lights: tuple[PointLight, ...] = ()
    surfaces: Surfaces = field(default_factory=Surfaces)

    def __post_init__(self) -> None:
        checks.apply(
            self,
            camera=checks.one_of(Camera),
            lights=checks.list_of(PointLight),
            surfaces=_surfaces,
            width=checks.size,
            height=checks.size,
        )
        if self.width * self.height > checks.MAX_PIXELS:
            gib = self.width * self.height * 24 / 2**30
            wrong = (
                f"{self.width} x {self.height} pixels are too many: the picture would take"
                f" {gib:.3g} GiB of memory; at most {checks.MAX_PIXELS} pixels are allowed"
            )
            raise SceneError([Fault("width, height", wrong)])


@np.errstate(under="ignore")
def unit(vector: ArrayLike) -> Floats:
    """Unit vector (3,), scaled first so that no square that matters over- or underflows."""
    array = np.asarray(vector, dtype=np.float64)
    # By a power of two: exact, so that scaled scenes stay bit-identical.
    array = np.ldexp(array, -int(np.frexp(np.abs(array).max())[1]))
    return array / np.sqrt(array @ array)


def _surfaces(value: Any, _: str, faults: list[Fault]) -> Surfaces:
    if isinstance(value, Surfaces):
        return value
    try:
        return Surfaces.of(value)
    except SceneError as error:
        faults += error.faults
        return Surfaces()
