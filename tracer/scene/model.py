"""The scene, and the arrays of its surfaces that the tracer reads.

Surfaces come in thousands, so :class:`Surfaces` keeps them as arrays and checks them whole; it
still reads like a sequence of :class:`~tracer.scene.objects.Sphere` and `Box`.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import Ints
from tracer.scene import schema
from tracer.scene.objects import Box, Camera, Lambertian, Phong, PointLight, Shader, Sphere
from tracer.scene.schema import Fault, of

__all__ = ["Scene", "Surfaces"]

_SHADERS = schema.list_of(Lambertian, Phong)


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
        self.center = schema.POINT.table(center, "center")
        self.radius = schema.LENGTH.table(radius, "radius")
        self.min_pt = schema.POINT.table(min_pt, "min_pt")
        self.max_pt = schema.POINT.table(max_pt, "max_pt")
        spheres, every = len(self.center), np.arange(len(self.center) + len(self.min_pt))
        sphere_index = every[:spheres] if sphere_index is None else sphere_index
        box_index = every[spheres:] if box_index is None else box_index
        self.sphere_index = schema.integers(sphere_index, "sphere_index")
        self.box_index = schema.integers(box_index, "box_index")
        self.sphere_shader = schema.integers(sphere_shader, "sphere_shader")
        self.box_shader = schema.integers(box_shader, "box_shader")
        self.shaders: tuple[Shader, ...] = _SHADERS(shaders, "shaders")
        line = np.zeros(every.size) if line is None else line
        self.line = schema.integers(line, "line").astype(np.int32)
        schema.raise_any(self._misfits())
        schema.raise_any(sorted(self._faults(), key=lambda fault: fault.surface or 0))
        self.__setstate__(vars(self))

    def _misfits(self) -> Iterator[Fault]:
        """Find arrays that do not fit together, and so cannot be checked further."""
        for first, others in (
            ("center", ("radius", "sphere_shader", "sphere_index")),
            ("min_pt", ("max_pt", "box_shader", "box_index")),
        ):
            needed = len(getattr(self, first))
            for name in others:
                if (count := len(getattr(self, name))) != needed:
                    yield Fault(name, f"needs {needed}, as many as {first}; has {count}")
        count = len(self.shaders)
        for name in ("sphere_shader", "box_shader"):
            for place in [i for i in getattr(self, name).tolist() if not 0 <= i < count][:1]:
                yield Fault(name, f"must be places among {count} shaders, has {place}")
        index, count = self.file_index, len(self)
        if len(index) == count and not np.array_equal(np.sort(index), np.arange(count)):
            wrong = f"must together be a permutation of 0 ... {count - 1}"
            yield Fault("sphere_index, box_index", wrong)
        elif len(index) == count != len(self.line):
            yield Fault("line", f"needs {count}, one a surface; has {len(self.line)}")

    def _faults(self) -> Iterator[Fault]:
        """Find numbers that no sphere or box may have."""
        for name, index, faults in (
            ("radius", self.sphere_index, schema.LENGTH.faults(self.radius[:, None])),
            ("center", self.sphere_index, schema.POINT.faults(self.center)),
            ("min_pt", self.box_index, schema.POINT.faults(self.min_pt)),
            ("max_pt", self.box_index, schema.POINT.faults(self.max_pt)),
            ("min_pt", self.box_index, schema.order_faults(self.min_pt, self.max_pt)),
        ):
            yield from (Fault(name, message, index.item(i)) for i, message in faults)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Unpickled arrays have copies of NumPy's built-in dtypes.  With a copy `ufunc.at` takes a
        # generic path, twenty times as slow, and every array computed from them inherits it.
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value = value.view(value.dtype.type)
                value.setflags(write=False)
            setattr(self, name, value)

    @classmethod
    def of(cls, surfaces: Iterable[Sphere | Box]) -> Surfaces:
        """Gather Sphere and Box objects, in order."""
        items: tuple[Any, ...] = schema.list_of(Sphere, Box)(surfaces, "surfaces")
        # By identity: objects that share a shader keep sharing it.
        shaders = {id(item.shader): item.shader for item in items}
        slot = {key: i for i, key in enumerate(shaders)}
        spheres = [i for i, item in enumerate(items) if isinstance(item, Sphere)]
        boxes = [i for i, item in enumerate(items) if isinstance(item, Box)]
        return cls(
            center=[items[i].center for i in spheres],
            radius=[items[i].radius for i in spheres],
            sphere_shader=[slot[id(items[i].shader)] for i in spheres],
            sphere_index=spheres,
            min_pt=[items[i].min_pt for i in boxes],
            max_pt=[items[i].max_pt for i in boxes],
            box_shader=[slot[id(items[i].shader)] for i in boxes],
            box_index=boxes,
            shaders=tuple(shaders.values()),
            line=[items[i].line or 0 for i in spheres + boxes],
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
        at = np.argsort(self.file_index)[index].tolist()
        return tuple(map(self._surface, at)) if isinstance(index, slice) else self._surface(at)

    def __iter__(self) -> Iterator[Sphere | Box]:
        return iter(self[:])

    def _surface(self, at: int) -> Sphere | Box:
        """One by its place in the arrays, spheres first."""
        values: dict[str, object] = {"line": self.line[at].item() or None}
        if at < self.sphere_count:
            values["shader"] = self.shaders[self.sphere_shader[at]]
            values["center"] = tuple(self.center[at].tolist())
            return schema.unchecked(Sphere, radius=self.radius[at].item(), **values)
        at -= self.sphere_count
        values["shader"] = self.shaders[self.box_shader[at]]
        values["min_pt"] = tuple(self.min_pt[at].tolist())
        return schema.unchecked(Box, max_pt=tuple(self.max_pt[at].tolist()), **values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surfaces):
            return NotImplemented
        return len(self) == len(other) and all(map(operator.eq, self, other))

    def __hash__(self) -> int:
        # Length and first surface are enough for a hash: all the arrays would take long.
        return hash((len(self), self[0] if len(self) else None))

    def __repr__(self) -> str:
        return f"<Surfaces: {len(self.radius)} spheres, {len(self.min_pt)} boxes>"


_DEFAULT_CAMERA, _NO_SURFACES = Camera(), Surfaces()


def _surfaces(value: Any, _: str) -> Surfaces:
    """The kind of a scene's surfaces."""
    return value if isinstance(value, Surfaces) else Surfaces.of(value)


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
        surfaces: Iterable[Sphere | Box] = _NO_SURFACES,
    ) -> None:
        given = {"camera": camera, "lights": lights, "surfaces": surfaces}
        schema.check(self, **given, width=width, height=height)
        if self.width * self.height > schema.MAX_PIXELS:
            gib = self.width * self.height * 24 / 2**30
            wrong = (
                f"{self.width} x {self.height} pixels are too many: the picture would take"
                f" {gib:.3g} GiB of memory; at most {schema.MAX_PIXELS} pixels are allowed"
            )
            raise schema.SceneError([Fault("width, height", wrong)])

    def _repr_png_(self) -> bytes:
        """Show the scene as a picture, in a notebook."""
        # By its name: pictures are made of scenes, so no module here imports one of theirs.
        png: bytes = import_module("tracer.picture.bands").to_png(self)
        return png
