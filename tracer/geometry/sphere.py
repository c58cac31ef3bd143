"""Spheres: what the eye sees of them, and which shadow segments they block.

`Spheres` and `Boxes` answer the same questions; this class documents them for both.  Objects are
numbered together, spheres first: every method takes these numbers, `obj`.  Rays from the eye have
directions (s, g, depth) in the camera's axes, see `CameraFrame`.  Each pair of a ray and an object
is decided alone: what else is in the scene, and in which order or batches the pairs come, changes
no bit of an answer.

Infinities and NaN arise on the way and are meant: the caller turns off floating-point warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, indices, map3, repeat_runs, take3
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.rounding import (
    LIGHT_TOLERANCE,
    NEARLY_ZERO_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_ROUNDING,
    hit_tolerance,
    side_of,
)
from tracer.scene.model import Surfaces

NO_FACE = 3
"""In place of the axis of a box's face."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """All spheres of a scene, and how the eye sees them.

    Attributes
    ----------
    flat : bool
        Whether the surfaces are planes.
    first : int
        The number of the first; with `count` spheres, boxes begin at number `count`.
    center, radius : (3, n) and (n,)
        In the scene's axes.
    local : three (n,)
        The centres seen from the eye, in the camera's axes.
    power : (n,)
        |centre - eye|^2 - radius^2: positive where the eye is outside, 0 where it is on the sphere.
    bounds : ScreenBounds
        Bounds in the picture.
    """

    flat: ClassVar = False
    first: ClassVar = 0

    center: Floats
    radius: Floats
    local: Triple
    power: Floats
    bounds: ScreenBounds

    @classmethod
    def of(cls, frame: CameraFrame, surfaces: Surfaces) -> Spheres:
        """Prepare the spheres of a scene to be seen."""
        center, radius = surfaces.center.T.copy(), surfaces.radius
        local = frame.to_camera(surfaces.center)
        distance = np.sqrt(dot(local, local))
        height = distance - radius
        # Rounding alone does not lift the eye off a sphere that it is on.
        on = np.abs(height) <= UNIT_ROUNDING * radius
        power = np.where(on, 0, height * (distance + radius))
        (u, v, w), radius2 = local, radius * radius
        rows, columns = (_tangents(m, w, radius2, m * m + w * w - radius2) for m in (v, u))
        return cls(center, radius, local, power, ScreenBounds.between(frame, rows, columns))

    @property
    def count(self) -> int:
        """Number of spheres."""
        return self.radius.size

    @cached_property
    def eye_inside(self) -> Bools:
        """Objects (n,) that are seen from inside, the eye on the surface included."""
        return self.power <= 0

    @cached_property
    def size(self) -> Floats:
        """Size (n,) of the coordinates on each object (1-norm): rounding is in proportion."""
        size: Floats = np.abs(self.center).sum(axis=0) + self.radius
        return size

    # What the eye sees.

    def row_extent(
        self, frame: CameraFrame, obj: Ints, rows: Floats, height: float
    ) -> tuple[Floats, Floats]:
        """Columns at which objects begin and end in rows of the picture; a miss has its end first.

        `rows` (n,): where each row begins, in pixels from the top.  Exact but for rounding where
        their `height` is 0; else more than is needed.
        """
        # A ray in the row meets the sphere no farther than this from the ray below or above it in
        # the row's middle, which meets the sphere if that is so much larger.
        aside = 0.5 * height * frame.step_v / frame.depth
        radius = self.radius[obj]
        grown = radius + aside * np.maximum(self.local[2][obj] + radius, 0)
        power = self.power[obj] - (grown - radius) * (grown + radius)
        hypot2, u, ahead, chord2 = self._discs(frame, obj, grown, frame.down(rows + height / 2))
        low, high = _tangents(u, ahead, chord2, power)
        hypot = np.sqrt(hypot2)
        return frame.column(low * hypot), frame.column(high * hypot)

    def _discs(
        self, frame: CameraFrame, obj: Ints, radius: Floats, g: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Sections of spheres by the planes of rays (s, g, depth), for all s: discs.

        Returns the square of the rays' second component in that plane, where the first is s; each
        disc's centre, along the row and ahead; and its squared radius, negative if it misses.
        """
        (u, v, w), depth = take3(self.local, obj), frame.depth
        hypot2 = g * g + depth * depth
        hypot = np.sqrt(hypot2)
        aside, ahead = (v * depth - w * g) / hypot, (v * g + w * depth) / hypot
        return hypot2, u, ahead, (radius - aside) * (radius + aside)

    def hit(
        self, frame: CameraFrame, obj: Ints, g: Floats, s: Floats, counts: Ints | None
    ) -> tuple[Floats, Floats]:
        """Distance at which rays meet objects, or infinity.

        The rays of a row lie in a plane through the eye, so a sphere is a disc there: closest
        approach (Haines, Günther, Akenine-Möller, Ray Tracing Gems, ch. 7) in two dimensions, with
        the near root in the stable form t = C / (B + sqrt(B^2 - A C)).

        Parameters
        ----------
        obj : (spans,)
            The object of each span of rays in a row.
        g : (spans,)
        s : (n,)
        counts : (spans,), or None
            How many rays follow each other in each span; None if it is one.

        Returns
        -------
        t : (n,)
            In units of the direction's length.  With the eye inside (or on) the object, it is
            where the ray leaves.
        detail : (n,)
            What `surface` needs: of spheres, the cosine between the normal and the ray, without
            its sign, times the radius and the direction's length; of boxes, which face.
        """
        hypot2, u, ahead, chord2 = self._discs(frame, obj, self.radius[obj], g)
        hypot = np.sqrt(hypot2)
        power = self.power[obj]
        length2 = s * s + repeat_runs(hypot2, counts)
        # Of the centre (u, ahead) and the ray (s, hypot) the cross and the dot product.
        cross = repeat_runs(u * hypot, counts) - repeat_runs(ahead, counts) * s
        rise = np.sqrt(length2 * repeat_runs(chord2, counts) - cross * cross)
        middle = repeat_runs(u, counts) * s + repeat_runs(ahead * hypot, counts)
        root = middle + rise
        outside, power = np.all(power > 0), repeat_runs(power, counts)
        t = power / root
        if not outside:  # the far root, in the form that cancels less
            far = np.where(middle > 0, root / length2, power / (middle - rise))
            t = np.where(power > 0, t, far)
        # Not a number where there is no root; negative behind the eye.
        return np.where(t > 0, t, np.inf), rise

    def surface(
        self, frame: CameraFrame, obj: Ints, counts: Ints, p: Floats, t: Floats, detail: Floats
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """The surface at hits `p` (3, n), seen from the eye in the camera's axes; rest as in `hit`.

        `obj` (runs,): of each run of hits on one face, of which `counts` (runs,) gives the
        lengths.

        Returns
        -------
        face, sign, level
            Of boxes (runs,), the axis of the face, whether it looks up (1) or down (-1) that axis,
            and its coordinate there; `NO_FACE` for spheres.
        n : three (n,); of boxes, (runs,)
            Unit normal towards the eye, in the camera's axes.
        height : (n,); of boxes, (runs,)
            n . (eye - p), the eye's height over the tangent plane.
        """
        inverse = repeat_runs(1 / self.radius[obj], counts)
        center = (repeat_runs(m[obj], counts) for m in self.local)
        x, y, z = ((q - c) * inverse for q, c in zip(p, center, strict=True))
        inside = self.eye_inside[obj]
        if inside.any():
            flip = repeat_runs(np.where(inside, -1.0, 1.0), counts)
            x, y, z = flip * x, flip * y, flip * z
        face, sign, level = np.full(obj.size, NO_FACE), np.ones(()), np.zeros(())
        return face, sign, level, (x, y, z), detail * inverse * t

    # What blocks light.

    def side(self, obj: Ints, point: Triple) -> Sides:
        """Side of the surface that points are on: `OUTSIDE`, `ON` (spheres only) or `INSIDE`."""
        return side_of(self.signed_distance(obj, point), LIGHT_TOLERANCE * self.size[obj])

    def signed_distance(self, obj: Ints, point: Triple) -> Floats:
        """Signed distance of points from the surface; negative inside."""
        away = map3(np.subtract, take3(self.center, obj), point)
        return np.sqrt(dot(away, away)) - self.radius[obj]

    def occludes(
        self,
        eye: Floats,
        obj: Ints,
        p: Triple,
        light: Triple,
        light_side: Sides,
        offset: Floats | None = None,
    ) -> Bools:
        """Test whether objects block the open segments from points `p` to `light`, pair by pair.

        A root strictly between the ends blocks.  An end within its tolerance of a surface is on
        it; a point on a sphere is then on its outer side, or, if the eye is inside, on its inner.

        Parameters
        ----------
        eye : (3,)
        obj : (n,)
        p, light : three (n,)
        light_side : (n,)
            The `side` that each light is on.
        offset : (n,), optional
            Distance of the offset surface that blocks instead; none does if it shrinks to nothing.
        """
        to_light = map3(np.subtract, light, p)
        to_center = map3(np.subtract, take3(self.center, obj), p)
        radius = self.radius[obj]
        if offset is not None:
            radius = np.maximum(radius + offset, 0)
        # Where both ends are outside, a sphere blocks if the closest approach to its centre lies
        # between them and within the sphere.
        b, length2 = dot(to_center, to_light), dot(to_light, to_light)
        nearest = b / length2
        aside = map3(lambda c, d: c - nearest * d, to_center, to_light)
        blocked: Bools = (dot(aside, aside) < radius * radius) & (b > 0) & (b < length2)
        height = np.sqrt(dot(to_center, to_center)) - radius
        side = side_of(height, hit_tolerance(self.size[obj], p, eye))
        at = indices((side != OUTSIDE) | (light_side != OUTSIDE))
        if at.size:
            side, light_side, inner = side[at], light_side[at], self.eye_inside[obj[at]]
            b, length2 = b[at], length2[at]
            blocked[at] = np.where(
                side == ON,
                np.where(inner, (b < 0) | (light_side == OUTSIDE), b > 0),
                np.where(light_side == ON, (side == OUTSIDE) & (b < length2), side != light_side),
            )
        return blocked

    def capsules(
        self, obj: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """Test whether objects meet, and whether they cut, the capsules around segments.

        A capsule, all that is within a thickness of a segment, holds all segments from the ball
        around its start to its end (Haines and Wallace, Shaft culling, 1991).  An object that does
        not meet it, or holds all of it inside, blocks none of them.  One that cuts it blocks all:
        somewhere it holds the full cross-section, and the ball around the start is outside it.
        Both are on the safe side of rounding.
        """
        center, radius = take3(self.center, obj), self.radius[obj]
        d = map3(np.subtract, end, start)
        to_center = map3(np.subtract, center, start)
        along, length2, distance2 = dot(to_center, d), dot(d, d), dot(to_center, to_center)
        to_end2 = distance2 - 2 * along + length2
        # Squared distance from the centre to the line, and how far squares may be off.
        aside2, error = distance2 - along * along / length2, SQUARE_ROUNDING * distance2
        outer = (radius + thickness) ** 2 + error
        inner = np.maximum(radius - thickness, 0) ** 2 - error
        from_start, from_end = distance2 > outer, to_end2 > outer
        before, behind = along < 0, along > length2
        around = np.maximum(distance2, to_end2) < inner
        # Where the segment is a point, `aside2` is NaN: the sphere does not cut it.
        meets = ~((aside2 > outer) | (from_start & before) | (from_end & behind) | around)
        cuts = from_start & ~(before | behind) & (aside2 < inner)
        return meets, cuts


def _tangents(along: Floats, ahead: Floats, chord2: Floats, power: Floats) -> tuple[Floats, Floats]:
    """Slopes (along / ahead) between which rays from the origin meet discs.

    `along`, `ahead`: the disc's centre; `chord2`: its squared radius, negative or NaN if there is
    none; `power`: the centre's squared distance less that.
    """
    # The tangents lie at an angle to either side of the centre.  From inside all rays meet the
    # disc; where rounding decides, on the disc, half of them.
    surely = np.maximum(power - NEARLY_ZERO_POWER * (along * along + ahead * ahead), 0)
    half = np.arctan2(np.sqrt(chord2), np.sqrt(surely))
    middle = np.arctan2(along, ahead)
    half[power < 0] = np.inf
    ends = (np.clip(m, -np.pi / 2, np.pi / 2) for m in (middle - half, middle + half))
    # The tangent of pi / 2, as rounded, is 1.6e16: windows may be wider.
    low, high = (np.where(abs(m) < np.pi / 2, np.tan(m), np.copysign(np.inf, m)) for m in ends)
    return low, high
