"""Objects of a scene: frozen dataclasses, checked when they are made.

Numbers are finite, lengths and coordinates other than 0 from 1e-75 to 1e75 in size, and colours not
negative; `SceneError` reports all that is wrong, not only the first.  The fields' metadata are the
table of elements that files are read and written by: see `schema.of`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracer.arrays import Floats
from tracer.scene import schema
from tracer.scene.schema import Fault, of

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
        Normal of the window; length and sign are not used.  The view direction if absent.
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


class _Checked:
    """Something whose values are checked when it is made."""

    __slots__ = ()

    def __post_init__(self) -> None:
        schema.check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class PointLight(_Checked):
    """A point light; its intensity does not fall off with distance.

    Parameters
    ----------
    position : (3,)
    intensity : (3,)
        Linear RGB.
    line : int, optional
        In its file, if it is from one; no part of equality.
    """

    position: VectorLike = field(metadata=of(schema.POINT, "position"))
    # The specification says color, the published scenes say intensity.
    intensity: VectorLike = field(default=_ONE, metadata=of(schema.COLOR, "intensity", "color"))
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lambertian(_Checked):
    """Matt: radiance I kd n.l from each light that is not hidden, of intensity I.

    See Shirley, Fundamentals of Computer Graphics, 2nd edition, 9.1.

    Parameters
    ----------
    diffuse : (3,)
        The colour kd: linear RGB, 1 for all of the light.
    """

    diffuse: VectorLike = field(default=_ONE, metadata=of(schema.COLOR, "diffuseColor"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Phong(_Checked):
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


Shader: TypeAlias = Lambertian | Phong

_SHADER = of(schema.one_of(Lambertian, Phong), "shader")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(_Checked):
    """A sphere; white and Lambertian if it has no shader.

    Parameters
    ----------
    center : (3,)
    radius : float
    shader : Lambertian or Phong
    line : int, optional
        In its file, if it is from one; no part of equality.
    """

    center: VectorLike = field(default=_ZERO, metadata=of(schema.POINT, "center"))
    radius: float = field(default=1.0, metadata=of(schema.LENGTH, "radius"))
    shader: Shader = field(default_factory=Lambertian, metadata=_SHADER)
    line: int | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(_Checked):
    """An axis-aligned box; it may be flat.  White and Lambertian if it has no shader.

    Parameters
    ----------
    min_pt, max_pt : (3,)
        Opposite corners, with the least and the largest coordinates.
    shader : Lambertian or Phong
    line : int, optional
        In its file, if it is from one; no part of equality.

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
