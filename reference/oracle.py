"""A slow, separate judge of what a pixel shows, in 80 decimal digits.

It shares no code with the tracer: it reads a `tracer.Scene` as data, follows
one ray at a time through every object with textbook formulas, and has digits
enough to afford them (`decimal`: exact conversion from float64, correctly
rounded square roots).  Two lengths that agree to 50 digits are equal: the
scene's own numbers have 16.

What is decided:

* The nearest root t > 0 is seen; of equal ones the first in the file.  A ray
  lying in a face of a box meets it.  With the eye inside an object (or on it)
  its far root is seen, and the normal points inward.
* Seen from outside, an object keeps light from its own point iff n.l <= 0;
  from inside, iff the light is not strictly inside.
* Another object does iff the segment from the point to the light has a root
  strictly between its ends; a segment in a face has none, and a flat plate
  has one.  A point touching a sphere is on the side it is seen from, and the
  sphere blocks whatever leaves that side.

Every verdict tells how far it is from a tie, relative to the lengths that a
float64 computation of the same thing rounds: `Verdict.margin`.
"""

from __future__ import annotations

import decimal
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import permutations
from typing import Any, TypeAlias

from tracer.scene.model import Scene
from tracer.scene.objects import Box, Phong, Shader, Sphere

__all__ = ["Oracle", "Verdict"]

Vector: TypeAlias = tuple[Decimal, Decimal, Decimal]

_CONTEXT = decimal.Context(prec=80, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN)
_EQUAL = Decimal("1e-50")
_ZERO, _ONE, _HALF = Decimal(0), Decimal(1), Decimal("0.5")
_FAR = Decimal("Infinity")
_AXES = range(3)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a pixel shows, and how surely.

    Attributes
    ----------
    radiance : (float, float, float)
        Linear RGB, rounded once.
    surface : int or None
        Place in the file of what is seen.
    lit : tuple of bool
        Which lights reach it.
    margin : float
        Distance from the nearest tie among the decisions made, relative to
        the lengths involved and to how steeply the surface is seen: rounding
        of relative size well below it changes no decision.
    """

    radiance: tuple[float, float, float]
    surface: int | None
    lit: tuple[bool, ...]
    margin: float


@dataclass(frozen=True, slots=True)
class _Hit:
    """A root at distance t; `clear` is how far (a length) the ray is from having none."""

    t: Decimal
    normal: Vector
    clear: Decimal
    plane: tuple[int, Decimal] | None = None
    """Of a box, the face: its axis and coordinate."""


@dataclass(frozen=True, slots=True)
class _Miss:
    """No root: `clear` is by how much (a length), t where it would be."""

    t: Decimal
    clear: Decimal


class Oracle:
    """The judge of one scene."""

    def __init__(self, scene: Scene) -> None:
        self._surfaces: Sequence[Sphere | Box] = scene.surfaces[:]
        self._lights = scene.lights
        self._width, self._height = scene.width, scene.height
        camera = scene.camera
        with decimal.localcontext(_CONTEXT):
            self._eye = _vector(camera.view_point)
            ahead = _unit(_vector(camera.view_dir))
            w = _unit(_vector(camera.normal))
            if _dot(w, ahead) > 0:
                w = _scale(w, -_ONE)
            u = _unit(_cross(_vector(camera.view_up), w))
            self._across = _scale(u, Decimal(camera.view_width))
            self._upward = _scale(_cross(w, u), Decimal(camera.view_height))
            self._center = _scale(ahead, Decimal(camera.proj_distance))
            self._eye_inside = [_side(surface, self._eye) <= 0 for surface in self._surfaces]

    def judge(self, x: float, y: float) -> Verdict:
        """What is seen at (x, y) pixels from the upper left corner; centres are at + 0.5."""
        with decimal.localcontext(_CONTEXT):
            across = Decimal(x) / self._width - _HALF
            upward = _HALF - Decimal(y) / self._height
            ray = _add(self._center, _scale(self._across, across), _scale(self._upward, upward))
            size = _length(ray)
            # A direction that lies in an axis plane, to 50 digits, lies in it exactly.
            return self._judge(_settle(_scale(ray, 1 / size), _EQUAL))

    def picture(self) -> list[list[Verdict]]:
        """Verdicts at all pixel centres, row by row."""
        return [
            [self.judge(column + 0.5, row + 0.5) for column in range(self._width)]
            for row in range(self._height)
        ]

    def _judge(self, d: Vector) -> Verdict:
        seen: int | None = None
        nearest: _Hit | None = None
        found = [self._meet(i, d) for i in range(len(self._surfaces))]
        for i, hit in enumerate(found):
            if isinstance(hit, _Hit) and (nearest is None or hit.t < nearest.t * (1 - _EQUAL)):
                seen, nearest = i, hit
        margin = _FAR
        for i, other in enumerate(found):
            scale = self._scale(i, min(other.t, nearest.t) if nearest else other.t)
            if i == seen or nearest is None or (isinstance(other, _Miss) and other.t < nearest.t):
                margin = min(margin, other.clear / scale)
            elif isinstance(other, _Hit) and not self._same_face(i, other, seen, nearest):
                steep = min(_steepness(d, other), _steepness(d, nearest))
                margin = min(margin, (other.t - nearest.t) * steep / scale)
        if seen is None or nearest is None:
            return Verdict((0.0, 0.0, 0.0), None, (False,) * len(self._lights), float(margin))

        surface = self._surfaces[seen]
        point = _add(self._eye, _scale(d, nearest.t))
        if nearest.plane is not None:
            axis, level = nearest.plane
            point = _replace(point, axis, level)
        rounding = self._scale(seen, nearest.t) / _steepness(d, nearest)
        total = [_ZERO, _ZERO, _ZERO]
        lit = []
        for light in self._lights:
            position = _vector(light.position)
            reached, clear = self._reached(seen, nearest, point, position, rounding)
            lit.append(reached)
            margin = min(margin, clear)
            if reached:
                to_light = _unit(_sub(position, point))
                shade = _reflect(surface.shader, nearest.normal, to_light, _scale(d, -_ONE))
                for k in _AXES:
                    total[k] += Decimal(light.intensity[k]) * shade[k]
        r, g, b = (float(value) for value in total)
        return Verdict((r, g, b), seen, tuple(lit), float(margin))

    def _meet(self, i: int, d: Vector) -> _Hit | _Miss:
        surface = self._surfaces[i]
        if isinstance(surface, Sphere):
            return _meet_sphere(surface, self._eye, d, self._eye_inside[i])
        return _meet_box(surface, self._eye, d, self._eye_inside[i])

    def _scale(self, i: int, t: Decimal) -> Decimal:
        """The lengths that go into a point of surface i at distance t."""
        return _size(self._surfaces[i]) + _length(self._eye) + abs(t)

    def _same_face(self, i: int, hit: _Hit, j: int | None, other: _Hit) -> bool:
        """Whether two roots are of equal spheres, or of coplanar faces: an exact tie."""
        if j is None or hit.plane != other.plane:
            return False
        if hit.plane is not None:
            return True
        a, b = self._surfaces[i], self._surfaces[j]
        return (
            isinstance(a, Sphere)
            and isinstance(b, Sphere)
            and (a.center, a.radius) == (b.center, b.radius)
        )

    def _reached(
        self, seen: int, hit: _Hit, point: Vector, light: Vector, rounding: Decimal
    ) -> tuple[bool, Decimal]:
        """Whether a light reaches the point, and by what margin."""
        segment = _sub(light, point)
        distance = _length(segment)
        if distance == 0:
            return False, _FAR
        surface = self._surfaces[seen]
        facing = _dot(hit.normal, segment) / distance
        tilt = abs(facing) * distance / (distance + _length(light) + rounding)
        if isinstance(surface, Sphere):
            tilt = min(tilt, abs(facing) * Decimal(surface.radius) / rounding)
        margin = _FAR if isinstance(surface, Box) and facing == 0 else tilt
        if facing <= _EQUAL:
            return False, margin
        if self._eye_inside[seen]:
            gap = _side(surface, light)
            if gap != 0:
                margin = min(margin, abs(gap) / (_size(surface) + _length(light)))
            if gap >= 0:
                return False, margin
        blockers = []
        for i, other in enumerate(self._surfaces):
            if i == seen:
                continue
            if isinstance(other, Sphere):
                blocks, clear = _sphere_blocks(other, point, light, self._eye_inside[i])
            else:
                blocks, clear = _box_blocks(other, point, light)
            clear /= rounding + _size(other) + _length(light)
            if blocks:
                blockers.append(clear)
            else:
                margin = min(margin, clear)
        # One sure blocker decides, whatever the others do.
        return (False, max(blockers)) if blockers else (True, margin)


def _steepness(d: Vector, hit: _Hit) -> Decimal:
    """Cosine at which a ray meets the surface."""
    return max(abs(_dot(d, hit.normal)), _EQUAL)


def _reflect(shader: Shader, n: Vector, light: Vector, view: Vector) -> Vector:
    """Lambert's and Blinn's terms for unit vectors."""
    cosine = _dot(n, light)
    values = [Decimal(c) * cosine for c in shader.diffuse]
    if isinstance(shader, Phong) and any(shader.specular):
        exponent = Decimal(shader.exponent)
        nh = _dot(n, _unit(_add(light, view)))
        power = _ONE if exponent == 0 else max(nh, _ZERO) ** exponent
        values = [a + Decimal(s) * power for a, s in zip(values, shader.specular, strict=True)]
    return values[0], values[1], values[2]


def _meet_sphere(sphere: Sphere, eye: Vector, d: Vector, inside: bool) -> _Hit | _Miss:
    """From the point of closest approach, half a chord back or on; d is a unit vector."""
    center, radius = _vector(sphere.center), Decimal(sphere.radius)
    to_center = _sub(center, eye)
    middle = _dot(to_center, d)
    aside = _length(_sub(to_center, _scale(d, middle)))
    gap = radius - aside
    if gap < 0 or (middle <= 0 and not inside):
        off = max(-gap, _ZERO) if middle > 0 else abs(_length(to_center) - radius)
        return _Miss(max(middle, _ZERO), off)
    half = (gap * (radius + aside)).sqrt()
    t = middle + half if inside else middle - half
    end = _length(to_center) - radius
    if t <= _EQUAL * radius:
        # On the surface, looking away: t = 0 is no root.
        return _Miss(_ZERO, abs(middle))
    outward = _scale(_sub(_scale(d, t), to_center), 1 / radius)
    clear = min(gap, end) if not inside else (-end if end < -_EQUAL * radius else abs(middle))
    return _Hit(t, _scale(outward, -_ONE) if inside else outward, clear)


def _meet_box(box: Box, eye: Vector, d: Vector, inside: bool) -> _Hit | _Miss:
    """Closed slabs: the hit is where the ray enters the box, or from inside where it leaves."""
    low, high = _sub(_vector(box.min_pt), eye), _sub(_vector(box.max_pt), eye)
    near, far, gap = _slabs(low, high, d, closed=True)
    enter, leave = max(near), min(far)
    if enter > leave:
        return _Miss(max(enter, _ZERO) if enter < _FAR else _ZERO, abs(gap))
    clear = abs(_side(box, eye))
    if clear == 0:
        # On a face: in or out depends on the direction across it.
        clear = min(abs(c) for c in d if c) * _size(box)
    t = leave if inside else enter
    if t <= 0:
        return _Miss(_ZERO, clear)
    roots = far if inside else near
    axis = roots.index(t)
    # Through a ridge between two faces a ray meets both.
    for k in _AXES:
        if k != axis and d[k] != 0:
            clear = min(clear, abs(t - roots[k]) * _slope(d, axis, k))
    forward = d[axis] > 0
    normal = _replace((_ZERO, _ZERO, _ZERO), axis, -_ONE if forward else _ONE)
    corner = box.max_pt if forward == inside else box.min_pt
    plane = (axis, Decimal(corner[axis]))
    return _Hit(t, normal, clear if inside else min(clear, gap), plane)


def _slabs(
    low: Vector, high: Vector, d: Vector, *, closed: bool
) -> tuple[list[Decimal], list[Decimal], Decimal]:
    """Entries and exits of a line from the origin, and its distance from missing.

    The distance is negative for a miss; a line within a closed face plane is at 0.
    """
    near, far = [], []
    gaps = []
    for k in _AXES:
        if d[k] == 0:
            gap = min(-low[k], high[k])
            between = gap >= 0 if closed else gap > 0
            near.append(-_FAR if between else _FAR)
            far.append(_FAR if between else -_FAR)
            gaps.append(gap)
        else:
            a, b = low[k] / d[k], high[k] / d[k]
            near.append(min(a, b))
            far.append(max(a, b))
    # In the plane of each two axes: distance of the line from the edge.
    gaps += (
        (far[j] - near[i]) * _slope(d, i, j)
        for i, j in permutations(_AXES, 2)
        if d[i] != 0 and d[j] != 0
    )
    # All gaps must be open; a miss is as sure as the surest of the closed ones.
    return near, far, min(gaps, default=_FAR)


def _slope(d: Vector, i: int, j: int) -> Decimal:
    """Of a length along a line, the distance from a box's edge in the plane of axes i and j."""
    return abs(d[i] * d[j]) / (d[i] * d[i] + d[j] * d[j]).sqrt()


def _sphere_blocks(
    sphere: Sphere, point: Vector, light: Vector, inner: bool
) -> tuple[bool, Decimal]:
    """Whether a sphere other than the point's own blocks, and how clearly (a length)."""
    radius = Decimal(sphere.radius)
    d = _sub(light, point)
    distance = _length(d)
    to_center = _sub(_vector(sphere.center), point)
    toward = _dot(to_center, d) / distance
    start, end = _side(sphere, point), _side(sphere, light)
    ends = min((abs(gap) for gap in (start, end) if gap), default=_FAR)
    if start == 0:
        clear = min(ends, abs(toward))
        return (toward < 0 or end > 0, clear) if inner else (toward > 0, clear)
    if start < 0:
        return end > 0, ends
    if end < 0:
        return True, ends
    if end == 0:
        return toward < distance, min(ends, abs(toward - distance))
    if not 0 < toward < distance:
        return False, ends
    gap = radius - _length(_sub(to_center, _scale(d, toward / distance)))
    return gap > 0, abs(gap)


def _box_blocks(box: Box, point: Vector, light: Vector) -> tuple[bool, Decimal]:
    """Whether a box other than the point's own blocks, and how clearly (a length)."""
    distance = _length(_sub(light, point))
    equal = _EQUAL * (_size(box) + _length(light) + distance)
    d = _settle(_scale(_sub(light, point), 1 / distance), equal / distance)
    low = _settle(_sub(_vector(box.min_pt), point), equal)
    high = _settle(_sub(_vector(box.max_pt), point), equal)
    near, far, gap = _slabs(low, high, d, closed=False)
    enter, leave = max(near), min(far)
    if enter > leave:
        return False, abs(gap)

    between: list[Decimal] = []
    beyond: list[Decimal] = []
    for t, side in ((enter, near), (leave, far)):
        if abs(t) < _FAR:
            # How far the root is from the segment's ends, across its face; contact is no tie.
            ends = [abs(end) for end in (t, t - distance) if abs(end) > equal]
            clear = min(ends) * abs(d[side.index(t)])
            (between if len(ends) == 2 and 0 < t < distance else beyond).append(clear)
    if between:
        return True, min(gap, max(between))
    return False, min(beyond, default=_FAR)


def _side(surface: Sphere | Box, point: Vector) -> Decimal:
    """Signed distance to the surface: 0 on it (to 50 digits), negative inside."""
    if isinstance(surface, Sphere):
        center = _vector(surface.center)
        gap = _length(_sub(point, center)) - Decimal(surface.radius)
    else:
        low, high = _vector(surface.min_pt), _vector(surface.max_pt)
        gap = max(max(low[k] - point[k], point[k] - high[k]) for k in _AXES)
    return _ZERO if abs(gap) <= _EQUAL * (_size(surface) + _length(point)) else gap


def _size(surface: Sphere | Box) -> Decimal:
    if isinstance(surface, Sphere):
        return _length(_vector(surface.center)) + Decimal(surface.radius)
    return max(_length(_vector(surface.min_pt)), _length(_vector(surface.max_pt)))


def _settle(v: Vector, equal: Decimal) -> Vector:
    x, y, z = (_ZERO if abs(c) <= equal else c for c in v)
    return x, y, z


def _replace(v: Vector, axis: int, value: Decimal) -> Vector:
    x, y, z = (value if k == axis else c for k, c in enumerate(v))
    return x, y, z


def _vector(v: Any) -> Vector:
    return Decimal(v[0]), Decimal(v[1]), Decimal(v[2])


def _add(*vectors: Vector) -> Vector:
    x, y, z = (sum(c, _ZERO) for c in zip(*vectors, strict=True))
    return x, y, z


def _sub(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scale(v: Vector, factor: Decimal) -> Vector:
    return v[0] * factor, v[1] * factor, v[2] * factor


def _dot(a: Vector, b: Vector) -> Decimal:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _length(v: Vector) -> Decimal:
    return _dot(v, v).sqrt()


def _unit(v: Vector) -> Vector:
    return _scale(v, 1 / _length(v))
