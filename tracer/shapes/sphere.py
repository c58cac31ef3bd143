"""Spheres: what the eye sees of them, and which shadow segments they block.

`Spheres` and `Boxes` answer the same questions; this class documents them for both.  Objects are
numbered together, spheres first, and every method takes these numbers (`owner`).  Each pair of a
ray and an object is decided alone: what else is in the scene, and in which order or batches the
pairs come, changes no bit of an answer.

Infinities and NaN arise on the way and are meant: the caller turns off floating-point warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import (
    Bools,
    Floats,
    Index,
    Ints,
    Triple,
    columns,
    dot,
    each,
    indices,
    pick,
    select,
)
from tracer.scene.model import Surfaces
from tracer.shapes.rounding import (
    NEARLY_ZERO_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_ROUNDING,
    side_of,
    tolerance_at,
)
from tracer.view.camera import LEAST_SLOPE, Frames, Raster, Spans

NO_FACE = 3
"""In place of the axis of a box's face."""

# Within so many rows of its leftmost or rightmost point a silhouette leans to neither side.
_NEARBY = 0.5


@dataclass(frozen=True, eq=False)
class Spheres:
    """All spheres of a scene, and how the eye sees them.

    Attributes
    ----------
    flat : bool
        Whether the surfaces are planes.
    first : int
        The number of the first; with `count` spheres, boxes begin at number `count`.
    center, radius : (n, 3) and (n,)
        In the scene's axes.
    local : three (n,)
        The centres seen from the eye, in the camera's axes.
    power : (n,)
        |centre - eye|^2 - radius^2: positive where the eye is outside, 0 where it is on the sphere.
    frames : Frames
        Bounds in the picture.
    """

    flat: ClassVar = False
    first: ClassVar = 0

    center: Floats
    radius: Floats
    local: Triple
    power: Floats
    frames: Frames

    @classmethod
    def of(cls, raster: Raster, surfaces: Surfaces) -> Spheres:
        """Prepare the spheres of a scene to be seen."""
        center, radius = surfaces.center, surfaces.radius
        local = raster.to_camera(center)
        distance = np.sqrt(dot(local, local))
        height = distance - radius
        # Rounding alone does not lift the eye off a sphere that it is on.
        on = np.abs(height) <= UNIT_ROUNDING * radius
        power = np.where(on, 0, height * (distance + radius))
        return cls(center, radius, local, power, _frames(raster, local, radius))

    @property
    def count(self) -> int:
        """Number of spheres."""
        return self.radius.size

    @cached_property
    def eye_inside(self) -> Bools:
        """Objects (n,) that are seen from inside, the eye on the surface included."""
        return self.power <= 0

    @property
    def whole(self) -> Bools:
        """Objects (n,) whose `spans` are exact: not those that the eye is on, or too near to."""
        whole: Bools = self.power != 0
        return whole

    @property
    def slope(self) -> Floats:
        """Bounds (n,) on how the distance from the eye changes from a pixel to the next.

        In sizes of a pixel at that distance: one over the least cosine of incidence, kept within
        limits.  Intersections with another surface at a steeper slope may be missed.
        """
        return np.full(self.count, LEAST_SLOPE)

    @property
    def curvature(self) -> Floats:
        """One over the radius (n,); 0 for planes."""
        return 1 / self.radius

    @cached_property
    def size(self) -> Floats:
        """Size (n,) of the coordinates on each object (1-norm): rounding is in proportion."""
        size: Floats = np.abs(self.center).sum(axis=1) + self.radius
        return size

    # What the eye sees.

    def spans(self, raster: Raster, rows: Floats, height: float = 0.0, pad: float = 0.0) -> Spans:
        """Spans of the objects in rows of the picture, exact but for rounding, which widens them.

        Parameters
        ----------
        raster : Raster
        rows : (m,)
            Where the rows begin, ascending, in pixels from the top.
        height
            Of the rows; 0 for lines.
        pad
            Widens spans on either side, in pixels.
        """
        owner, row = self.frames.rows(raster, rows, height, pad)
        left, right = self._ends(raster, owner, rows[row])
        if height:
            # On the way down a silhouette goes to the left as far as its leftmost point, then to
            # the right: except where that point is, one of a row's two lines is the limit.
            left_below, right_below = self._ends(raster, owner, rows[row] + height)
            left, right = np.minimum(left, left_below), np.maximum(right, right_below)
            for end, extreme, side in (
                (left, self.frames.left, 1),
                (right, self.frames.right, -1),
            ):
                down = self._height_of(raster, extreme, side)[owner] - rows[row]
                # NaN, the place of what extends without end, is outside of no row.
                at = indices(~((down < -_NEARBY) | (down > height + _NEARBY)))
                end[at] = extreme[owner[at]]
        return Spans.clipped(owner, row, left, right, pad, raster.width)

    def _height_of(self, raster: Raster, extreme: Floats, side: int) -> Floats:
        """Heights (n,) of the leftmost (`side` 1) or rightmost (-1) points, at columns `extreme`.

        In pixels from the top; NaN where a sphere extends without end.  A plane through the eye
        that touches a sphere, and is upright in the picture, does so at the height of the centre.
        """
        _, v, w = self.local
        slope = raster.across(extreme)
        ahead = w + side * self.radius * slope / np.sqrt(slope * slope + raster.depth**2)
        return raster.row(v / (np.where(ahead > 0, ahead, np.nan) / raster.depth))

    def _ends(self, raster: Raster, owner: Ints, y: Floats) -> tuple[Floats, Floats]:
        """Columns at which spheres begin and end on lines at `y`; a miss has its end first."""
        g = raster.down(y)
        hypot2, u, ahead, chord2 = self._discs(raster, owner, g)
        low, high = _tangents(u, ahead, chord2, self.power[owner])
        hypot = np.sqrt(hypot2)
        return raster.column(low * hypot), raster.column(high * hypot)

    def _discs(
        self, raster: Raster, owner: Index, g: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Sections of spheres by the planes of rays (s, g, depth), for all s.

        Returns
        -------
        hypot2
            Square of the rays' second component in that plane; the first, s, is along the row.
        u, ahead
            The disc's centre: along the row, and ahead.
        chord2
            Its squared radius; negative where the plane misses the sphere.
        """
        (u, v, w), depth, radius = pick(self.local, owner), raster.depth, self.radius[owner]
        hypot2 = g * g + depth * depth
        hypot = np.sqrt(hypot2)
        aside, ahead = (v * depth - w * g) / hypot, (v * g + w * depth) / hypot
        return hypot2, u, ahead, (radius - aside) * (radius + aside)

    def hit(
        self, raster: Raster, owner: Index, g: Floats, s: Floats, span: Ints | slice
    ) -> tuple[Floats, Floats]:
        """Distance at which rays of pixel rows meet objects, or infinity.

        The rays of a row lie in a plane through the eye, so a sphere is a disc
        there: closest approach (Haines, Günther, Akenine-Möller, Ray Tracing
        Gems, ch. 7) in two dimensions, with the near root in the stable form
        t = C / (B + sqrt(B^2 - A C)).

        Parameters
        ----------
        raster : Raster
        owner : int or (spans,)
            One object, or one for each span of rays in a row.
        g : (spans,)
            Second component of the rays' directions (s, g, depth).
        s : (n,)
            First component, span by span.
        span : (n,)
            The span of each ray.

        Returns
        -------
        t : (n,)
            In units of the direction's length.  With the eye inside (or on) the object, it is
            where the ray leaves.
        detail : (n,)
            What `surface` needs: of spheres, the cosine between the normal and the ray, without
            its sign, times the radius and the direction's length; of boxes, which face.
        """
        hypot2, u, ahead, chord2 = self._discs(raster, owner, g)
        hypot = np.sqrt(hypot2)
        power = select(self.power[owner], span)
        length2 = s * s + select(hypot2, span)
        # Of the centre (u, ahead) and the ray (s, hypot) the cross and the dot product.
        cross = select(u * hypot, span) - select(ahead, span) * s
        rise = np.sqrt(length2 * select(chord2, span) - cross * cross)
        middle = select(u, span) * s + select(ahead * hypot, span)
        root = middle + rise
        if np.all(power > 0):
            t = power / root
        else:  # the far root, in the form that cancels less
            far = np.where(middle > 0, root / length2, power / (middle - rise))
            t = np.where(power > 0, power / root, far)
        # Not a number where there is no root; negative behind the eye.
        t[~(t > 0)] = np.inf
        return t, rise

    def surface(
        self,
        raster: Raster,
        owner: Index,
        span: Ints | slice,
        p: Floats,
        t: Floats,
        detail: Floats,
    ) -> tuple[Index, Floats, Floats, Triple, Floats]:
        """The surface at hits `p` (3, n), seen from the eye in the camera's axes; rest as in `hit`.

        Returns
        -------
        face, sign, level
            Of boxes, the axis of the face, whether it looks up (1) or down (-1) that axis, and its
            coordinate there; `NO_FACE` for spheres.
        n : three
            Unit normal towards the eye, in the camera's axes.
        height
            n . (eye - p), the eye's height over the tangent plane.
        """
        inverse = select(1 / self.radius[owner], span)
        center = (select(m[owner], span) for m in self.local)
        x, y, z = ((q - c) * inverse for q, c in zip(p, center, strict=True))
        inside = self.eye_inside[owner]
        if inside.any():
            flip = select(np.where(inside, -1.0, 1.0), span)
            x, y, z = flip * x, flip * y, flip * z
        return NO_FACE, np.ones(()), np.zeros(()), (x, y, z), detail * inverse * t

    # What blocks light.

    def holds(self, owner: Ints) -> Bools:
        """Which objects are of this shape."""
        return owner < self.count

    def side(self, owner: Ints, point: Triple) -> NDArray[np.int8]:
        """Side of the surface that points are on: `OUTSIDE`, `ON` (spheres only) or `INSIDE`."""
        return side_of(self.gap(owner, point), tolerance_at(point, None, self.size[owner]))

    def gap(self, owner: Ints, point: Triple) -> Floats:
        """Distance by which objects must grow to reach points; negative for points inside."""
        away = each(np.subtract, columns(self.center, owner), point)
        return np.sqrt(dot(away, away)) - self.radius[owner]

    def touches(self, owner: Ints, middle: Triple, reach: Floats) -> Bools:
        """Tell balls that may hold points for which `occludes` needs the closer test.

        These are in or on a sphere, or on the plane of a box's face.
        """
        return self.gap(owner, middle) <= reach

    def occludes(
        self,
        eye: Floats,
        owner: Ints,
        p: Triple,
        light: Triple,
        closely: Bools,
        grown: Floats | None = None,
    ) -> Bools:
        """Test whether objects block the open segments from points `p` to `light`, pair by pair.

        A root strictly between the ends blocks.  An end within its tolerance of a surface is on
        it; a point on a sphere is then on its outer side, or, if the eye is inside, on its inner.

        Parameters
        ----------
        eye : (3,)
            From where the points are seen: their rounding is in proportion to the distance.
        owner : (n,)
        p, light : three (n,)
        closely : (n,)
            False where both ends are surely farther from the object than `touches` asks.
        grown : (n,), optional
            By how much to grow objects on all sides; shrunk to less than nothing, none blocks.
        """
        to_light = each(np.subtract, light, p)
        to_center = each(np.subtract, columns(self.center, owner), p)
        radius = self.radius[owner]
        if grown is not None:
            radius = np.maximum(radius + grown, 0)
        # Where both ends are outside, a sphere blocks if the closest approach to its centre lies
        # between them and within the sphere.
        b, length2 = dot(to_center, to_light), dot(to_light, to_light)
        nearest = b / length2
        offset = each(lambda c, d: c - nearest * d, to_center, to_light)
        blocked: Bools = (dot(offset, offset) < radius * radius) & (b > 0) & (b < length2)
        at = indices(closely)
        if not at.size:
            return blocked
        owner, to_center, b, length2 = owner[at], pick(to_center, at), b[at], length2[at]
        height = np.sqrt(dot(to_center, to_center)) - radius[at]
        side = side_of(height, tolerance_at(pick(p, at), eye, self.size[owner]))
        light_side, inner = self.side(owner, pick(light, at)), self.eye_inside[owner]
        odd = (side != OUTSIDE) | (light_side != OUTSIDE)
        answer = np.where(
            side == ON,
            np.where(inner, (b < 0) | (light_side == OUTSIDE), b > 0),
            np.where(light_side == ON, (side == OUTSIDE) & (b < length2), side != light_side),
        )
        blocked[at] = np.where(odd, answer, blocked[at])
        return blocked

    def capsules(
        self, owner: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """Test whether objects meet, and whether they cut, the capsules around segments.

        A capsule, all that is within a thickness of a segment, holds all segments from the ball
        around its start to its end (Haines and Wallace, Shaft culling, 1991).  An object that does
        not meet it blocks none of them; one that holds all of it inside does not count as meeting
        it.  One that cuts it blocks all of them: somewhere it holds the capsule's full
        cross-section, and the ball around the start is outside it.  Both are on the safe side of
        rounding.
        """
        center, radius = columns(self.center, owner), self.radius[owner]
        d = each(np.subtract, end, start)
        to_center = each(np.subtract, center, start)
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


def _frames(raster: Raster, local: Triple, radius: Floats) -> Frames:
    """Bounds of spheres whose centres are seen at `local`."""
    (u, v, w), radius2, ends = local, radius * radius, []
    for along, place in ((v, raster.row), (u, raster.column)):
        low, high = _tangents(along, w, radius2, along * along + w * w - radius2)
        ends += [place(low * raster.depth), place(high * raster.depth)]
    return Frames(*ends)


def _tangents(along: Floats, ahead: Floats, chord2: Floats, power: Floats) -> tuple[Floats, Floats]:
    """Slopes (along / ahead) between which rays from the origin meet discs.

    Parameters
    ----------
    along, ahead
        The disc's centre.
    chord2, power
        Its squared radius, and its centre's squared distance less that.
    """
    tilt = along * ahead
    root = np.sqrt(chord2 * power)
    divisor = ahead * ahead - chord2
    # Clear of the plane beside the eye: all of the disc is ahead, or all behind.
    clear = divisor >= 0
    # The slopes s solve divisor s^2 - 2 tilt s + rest = 0.  Where the disc nearly touches the plane
    # beside the eye the divisor is as good as zero: only one of the two may be divided by it.
    # Both forms of `rest` are the same number; each is used where it cancels less.
    rest = np.where(clear, along * along - chord2, power - ahead * ahead)
    stable = tilt + np.copysign(root, tilt)
    a, b = stable / divisor, rest / stable
    least, most = np.minimum(a, b), np.maximum(a, b)
    low = np.where(clear, least, np.where(along > 0, most, -np.inf))
    high = np.where(clear, most, np.where(along > 0, np.inf, least))
    # With the eye on the disc, or nearly, any ray may meet it.
    whole = (power <= NEARLY_ZERO_POWER * (along * along + ahead * ahead)) & (chord2 >= 0)
    # No rays at all: the plane misses the sphere, or the disc lies behind the eye.
    miss = (chord2 < 0) | (clear & (ahead < 0) & ~whole)
    # What rounding left undecided covers the row: wider is always safe.
    low = np.where(whole | np.isnan(low), -np.inf, low)
    high = np.where(whole | np.isnan(high), np.inf, high)
    return np.where(miss, np.inf, low), np.where(miss, -np.inf, high)
