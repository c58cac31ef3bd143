"""The scene: frozen, validated dataclasses, and the arrays the tracer reads.

Everything is checked when it is made, whether it comes from XML or from Python, so the renderer
never meets an impossible value: numbers are finite, lengths and coordinates other than 0 within
`schema.SMALLEST` and `schema.LARGEST` in size, and colours not negative.  A check that fails
raises `SceneError`, which reports all faults that can be found at once, not only the first.
The fields' metadata are the table of elements that files are read by: see `schema.of`.

Surfaces come in thousands, so :class:`Surfaces` keeps them as arrays and checks them whole; it
still reads like a sequence of :class:`Sphere` and :class:`Box`.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats, Ints
from tracer.scene import schema
from tracer.scene.schema import Fault, of

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
    "VectorLike",
    "unit",
]

VectorLike: TypeAlias = Sequence[float] | NDArray[Any]
"""Three numbers.  Scenes take any sequence or array, and keep a tuple of float."""

_ZERO, _ONE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

# Below this sine or cosine the camera basis has no digit left worth trusting.
_DEGENERATE = 1e-10


@np.errstate(under="ignore")
def unit(vector: ArrayLike) -> Floats:
    """Unit vector (3,), scaled first so that no square that matters over- or underflows."""
    array = np.asarray(vector, dtype=np.float64)
    # By a power of two: exact, so that scaled scenes stay bit-identical.
    array = np.ldexp(array, -int(np.frexp(np.abs(array).max())[1]))
    return array / np.sqrt(array @ array)


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
        For numbers of the wrong kind, a zero vector, `view_up` parallel to `proj_normal`, or
        `proj_normal` perpendicular to `view_dir`.
    """

    view_point: VectorLike = field(default=_ZERO, metadata=of(schema.POINT, "viewPoint"))
    view_dir: VectorLike = field(default=(0.0, 0.0, -1.0), metadata=of(schema.DIRECTION, "viewDir"))
    view_up: VectorLike = field(default=(0.0, 1.0, 0.0), metadata=of(schema.DIRECTION, "viewUp"))
    proj_normal: VectorLike | None = field(
        default=None, metadata=of(schema.DIRECTION, "projNormal")
    )
    proj_distance: float = field(default=1.0, metadata=of(schema.LENGTH, "projDistance"))
    view_width: float = field(default=1.0, metadata=of(schema.LENGTH, "viewWidth"))
    view_height: float = field(default=1.0, metadata=of(schema.LENGTH, "viewHeight"))

    @np.errstate(under="ignore")
    def __post_init__(self) -> None:
        schema.check(self)
        faults = []
        normal = unit(self.normal)
        sine = np.linalg.norm(np.cross(unit(self.view_up), normal))
        if sine < _DEGENERATE:
            other = "view_dir" if self.proj_normal is None else "proj_normal"
            wrong = f"must not be parallel to {other}; choose another view_up"
            faults.append(Fault("view_up", wrong))
        if abs(normal @ unit(self.view_dir)) < _DEGENERATE:
            wrong = "must not be perpendicular to view_dir: no ray would meet it"
            faults.append(Fault("proj_normal", wrong))
        schema.raise_any(faults)

    @property
    def normal(self) -> VectorLike:
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
    line : int, optional
        Where it stands in its file, if it is from one; no part of equality.
    """

    position: VectorLike = field(metadata=of(schema.POINT, "position"))
    # The specification says color, the published scenes say intensity.
    intensity: VectorLike = field(default=_ONE, metadata=of(schema.COLOR, "intensity", "color"))
    line: int | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        schema.check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lambertian:
    """Matt: radiance I kd n.l from each light that is not hidden, of intensity I.

    See Shirley, Fundamentals of Computer Graphics, 2nd edition, 9.1.

    Parameters
    ----------
    diffuse : (3,)
        The colour kd: linear RGB, 1 for all of the light.
    """

    diffuse: VectorLike = field(default=_ONE, metadata=of(schema.COLOR, "diffuseColor"))

    def __post_init__(self) -> None:
        schema.check(self)


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
    """

    diffuse: VectorLike = field(default=_ONE, metadata=of(schema.COLOR, "diffuseColor"))
    specular: VectorLike = field(default=_ZERO, metadata=of(schema.COLOR, "specularColor"))
    exponent: float = field(default=1.0, metadata=of(schema.EXPONENT, "exponent"))

    def __post_init__(self) -> None:
        schema.check(self)


Shader: TypeAlias = Lambertian | Phong

_SHADER = of(schema.one_of(Lambertian, Phong), "shader")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """A sphere; white and Lambertian if it has no shader.

    Parameters
    ----------
    center : (3,)
    radius : float
    shader : Lambertian or Phong
    line : int, optional
        Where it stands in its file, if it is from one; no part of equality.
    """

    center: VectorLike = field(default=_ZERO, metadata=of(schema.POINT, "center"))
    radius: float = field(default=1.0, metadata=of(schema.LENGTH, "radius"))
    shader: Shader = field(default_factory=Lambertian, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        schema.check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """An axis-aligned box; it may be flat.  White and Lambertian if it has no shader.

    Parameters
    ----------
    min_pt, max_pt : (3,)
        Opposite corners, with the least and the largest coordinates.
    shader : Lambertian or Phong
    line : int, optional
        Where it stands in its file, if it is from one; no part of equality.

    Raises
    ------
    SceneError
        For values of the wrong kind, or `min_pt` beyond `max_pt` along any axis.
    """

    min_pt: VectorLike = field(metadata=of(schema.POINT, "minPt"))
    max_pt: VectorLike = field(metadata=of(schema.POINT, "maxPt"))
    shader: Shader = field(default_factory=Lambertian, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        schema.check(self)
        corners = np.array([self.min_pt, self.max_pt])
        schema.raise_any(
            Fault("min_pt", wrong) for _, wrong in schema.order_faults(corners[:1], corners[1:])
        )


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
    line : (S + B,)
        Where each stands in its file, spheres first; 0 if it is from none.

    Raises
    ------
    SceneError
        For arrays that do not fit together, or numbers that no sphere or box may have.
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
        line: ArrayLike | None = None,
    ) -> None:
        faults: list[Fault] = []
        self.center = schema.POINT.table(center, "center", faults)
        self.radius = schema.LENGTH.table(radius, "radius", faults)
        self.min_pt = schema.POINT.table(min_pt, "min_pt", faults)
        self.max_pt = schema.POINT.table(max_pt, "max_pt", faults)
        self.sphere_shader = schema.integers(sphere_shader, "sphere_shader", faults)
        self.box_shader = schema.integers(box_shader, "box_shader", faults)
        spheres, boxes = len(self.center), len(self.min_pt)
        if sphere_index is None:
            sphere_index = np.arange(spheres)
        if box_index is None:
            box_index = np.arange(spheres, spheres + boxes)
        if line is None:
            line = np.zeros(spheres + boxes)
        self.sphere_index = schema.integers(sphere_index, "sphere_index", faults)
        self.box_index = schema.integers(box_index, "box_index", faults)
        self.shaders: tuple[Shader, ...] = schema.list_of(Lambertian, Phong)(
            shaders, "shaders", faults
        )
        self.line = schema.integers(line, "line", faults).astype(np.int32)
        # What does not fit together cannot be checked further.
        faults = faults or self._misfits() or self._faults()
        schema.raise_any(sorted(faults, key=lambda fault: fault.surface or 0))
        self._protect()

    def _misfits(self) -> list[Fault]:
        """What is wrong with lengths, shaders and indices."""
        faults: list[Fault] = []
        for name, other in (
            ("radius", "center"),
            ("sphere_shader", "center"),
            ("sphere_index", "center"),
            ("max_pt", "min_pt"),
            ("box_shader", "min_pt"),
            ("box_index", "min_pt"),
        ):
            count, needed = len(getattr(self, name)), len(getattr(self, other))
            if count != needed:
                faults.append(Fault(name, f"needs {needed}, as many as {other}; has {count}"))
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
        if len(self.line) != len(self) and not faults:
            faults.append(Fault("line", f"needs {len(self)}, one a surface; has {len(self.line)}"))
        return faults

    def _faults(self) -> list[Fault]:
        """What is wrong with numbers."""
        found = [
            ("radius", self.sphere_index, schema.LENGTH.faults(self.radius[:, None])),
            ("center", self.sphere_index, schema.POINT.faults(self.center)),
            ("min_pt", self.box_index, schema.POINT.faults(self.min_pt)),
            ("max_pt", self.box_index, schema.POINT.faults(self.max_pt)),
            ("min_pt", self.box_index, schema.order_faults(self.min_pt, self.max_pt)),
        ]
        return [
            Fault(name, message, index.item(i))
            for name, index, faults in found
            for i, message in faults
        ]

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
        items: tuple[Sphere | Box, ...] = schema.list_of(Sphere, Box)(surfaces, "surfaces", faults)
        schema.raise_any(faults)
        # By identity: objects that share a shader keep sharing it.
        place = {id(item.shader): item.shader for item in items}
        slot = {key: i for i, key in enumerate(place)}
        spheres: list[tuple[int, Any]] = []
        boxes: list[tuple[int, Any]] = []
        for i, item in enumerate(items):
            (spheres if isinstance(item, Sphere) else boxes).append((i, item))
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
            line=[item.line or 0 for _, item in spheres + boxes],
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
        order = np.argsort(self.file_index)
        if isinstance(index, slice):
            return tuple(map(self._surface, order[index].tolist()))
        return self._surface(order[index].item())

    def __iter__(self) -> Iterator[Sphere | Box]:
        return map(self._surface, np.argsort(self.file_index).tolist())

    def _surface(self, at: int) -> Sphere | Box:
        """One by its place in the arrays, spheres first."""
        line = self.line[at].item() or None
        if at < self.sphere_count:
            return schema.unchecked(
                Sphere,
                center=tuple(self.center[at].tolist()),
                radius=self.radius[at].item(),
                shader=self.shaders[self.sphere_shader[at]],
                line=line,
            )
        at -= self.sphere_count
        return schema.unchecked(
            Box,
            min_pt=tuple(self.min_pt[at].tolist()),
            max_pt=tuple(self.max_pt[at].tolist()),
            shader=self.shaders[self.box_shader[at]],
            line=line,
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surfaces):
            return NotImplemented
        return len(self) == len(other) and all(map(operator.eq, self, other))

    def __hash__(self) -> int:
        # Length and first surface are enough for a hash: all the arrays would take long.
        return hash((len(self), self[0] if len(self) else None))

    def __repr__(self) -> str:
        return f"<Surfaces: {len(self.radius)} spheres, {len(self.min_pt)} boxes>"


_DEFAULT_CAMERA = Camera()


def _surfaces(value: Any, _: str, faults: list[Fault]) -> Surfaces:
    """The kind of a scene's surfaces."""
    if isinstance(value, Surfaces):
        return value
    try:
        return Surfaces.of(value)
    except schema.SceneError as error:
        faults += error.faults
        return Surfaces()


@dataclass(frozen=True, slots=True, init=False)
class Scene:
    """What is seen (`surfaces`), by what light, through which camera.

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
        For a picture of no pixels or too many, or parts of the wrong type.
    """

    camera: Camera = field(metadata=of(schema.one_of(Camera)))
    lights: tuple[PointLight, ...] = field(metadata=of(schema.list_of(PointLight)))
    surfaces: Surfaces = field(metadata=of(_surfaces))
    width: int = field(metadata=of(schema.size))
    height: int = field(metadata=of(schema.size))

    # Written out, as it takes more types than the fields keep.
    def __init__(
        self,
        *,
        width: int,
        height: int,
        camera: Camera = _DEFAULT_CAMERA,
        lights: Iterable[PointLight] = (),
        surfaces: Iterable[Sphere | Box] = (),
    ) -> None:
        given = {"camera": camera, "lights": lights, "surfaces": surfaces}
        for name, value in {**given, "width": width, "height": height}.items():
            object.__setattr__(self, name, value)
        schema.check(self)
        if self.width * self.height > schema.MAX_PIXELS:
            gib = self.width * self.height * 24 / 2**30
            wrong = (
                f"{self.width} x {self.height} pixels are too many: the picture would take"
                f" {gib:.3g} GiB of memory; at most {schema.MAX_PIXELS} pixels are allowed"
            )
            raise schema.SceneError([Fault("width, height", wrong)])
