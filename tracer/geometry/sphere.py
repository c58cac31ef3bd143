"""Spheres: intersections with rays from the eye, and tests of shadow segments.

`Spheres` and `Boxes` have the same methods and attributes.  All methods take indices of objects
among all objects of the scene (see `ObjectRange`).

Rays start at the eye.  A ray has the direction (s, g, depth) in the axes of the camera: s changes
along a row of the picture, g from row to row, and depth is the same for all rays (see
`CameraFrame`).  The result for a pair of a ray and an object depends on this pair only.  It is the
same to the last bit whatever else the scene contains, and however pairs are arranged in batches.

Infinities and NaN are valid intermediate results, so callers turn off floating-point warnings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Sides, Triple, dot, indices, map3, repeat_runs, take3
from tracer.geometry.camera import CameraFrame, ScreenBounds
from tracer.geometry.numbering import ObjectRange, sphere_range
from tracer.geometry.rounding import (
    LIGHT_TOLERANCE,
    MIN_POWER,
    ON,
    OUTSIDE,
    SQUARE_ROUNDING,
    UNIT_TOLERANCE,
    hit_tolerance,
    side_of_surface,
)
from tracer.scene.model import Surfaces

NO_FACE = 3
"""Stands for the axis of a face (0, 1 or 2) at hits on spheres, which have no faces."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """The n spheres of a scene, prepared for the rays of one camera.

    Attributes
    ----------
    is_planar : bool
        Whether objects of this shape consist of planar faces.
    frame : CameraFrame
        The rays of the camera.
    objects : ObjectRange
        Indices of the spheres among all objects of the scene.
    center : (3, n) float array
        Centres, in the axes of the scene.
    radius : (n,) float array
        Radii.
    local : tuple of three (n,) float arrays
        Vectors from the eye to the centres, in the axes of the camera.
    power : (n,) float array
        |centre - eye|^2 - radius^2 for each sphere: positive if the eye is outside, 0 if the eye
        is on the sphere.
    bounds : ScreenBounds
        Bounding rectangles of the spheres in the picture.
    is_eye_inside : (n,) bool array
        Whether the eye is inside the sphere, or on it.
    curvature : (n,) float array
        Curvature of the surface: 1 / radius; 0 for planar shapes.
    coordinate_size : (n,) float array
        Upper bound on |x| + |y| + |z| of all points of the object.  Rounding errors of points on
        the surface are proportional to it.
    """

    is_planar: ClassVar = False

    frame: CameraFrame
    objects: ObjectRange
    center: Floats
    radius: Floats
    local: Triple
    power: Floats
    bounds: ScreenBounds
    is_eye_inside: Bools
    curvature: Floats
    coordinate_size: Floats

    @classmethod
    def from_surfaces(cls, frame: CameraFrame, surfaces: Surfaces) -> Spheres:
        """Prepare all spheres among the surfaces of a scene for the rays of a camera."""
        center, radius = surfaces.center.T.copy(), surfaces.radius
        local = frame.points_to_camera(surfaces.center)
        distance = np.sqrt(dot(local, local))
        height = distance - radius
        # Rounding errors alone must not move the eye off a sphere on which it lies.
        is_on = np.abs(height) <= UNIT_TOLERANCE * radius
        power = np.where(is_on, 0, height * (distance + radius))
        (u, v, w), radius2 = local, radius * radius
        rows, columns = (_tangent_slopes(m, w, radius2, m * m + w * w - radius2) for m in (v, u))
        bounds = ScreenBounds.from_slopes(frame, rows, columns)
        objects, size = sphere_range(surfaces), np.abs(center).sum(axis=0) + radius
        inside, curvature = power <= 0, 1 / radius
        return cls(frame, objects, center, radius, local, power, bounds, inside, curvature, size)

    def bounding_boxes(self) -> tuple[Floats, Floats]:
        """Return the corners of axis-aligned bounding boxes, in the axes of the scene.

        Returns
        -------
        low, high : (3, n) float arrays
            For each object, the corners with the smallest and with the largest coordinates.
        """
        return self.center - self.radius, self.center + self.radius

    # Intersections with rays from the eye.

    def row_extent(self, object_index: Ints, rows: Floats, height: float) -> tuple[Floats, Floats]:
        """Compute where objects begin and end in rows of the picture, for pairs of both.

        Parameters
        ----------
        object_index : (n,) int array
            The object of each pair.
        rows : (n,) float array
            The upper border of each row, in pixels from the top of the picture.
        height : float
            Height of the rows, in pixels.  If it is 0, a row is a line and the result is exact
            except for rounding.  Otherwise the result is conservative: it contains all positions
            at which any ray in the row meets the object.

        Returns
        -------
        left, right : (n,) float arrays
            Both ends, in pixels from the left border of the picture; left > right if the object
            does not reach the row.
        """
        # A row consists of columns of rays.  At the sphere, the rays of a column are at most a
        # margin away from the ray in its centre.  So if any ray of the column meets the sphere, the
        # ray in the centre meets the sphere grown by the margin.
        frame, sphere = self.frame, self.objects.positions(object_index)
        radius = self.radius[sphere]
        slope_margin = 0.5 * height * frame.step_v / frame.depth
        grown = radius + slope_margin * np.maximum(self.local[2][sphere] + radius, 0)
        power = self.power[sphere] - (grown - radius) * (grown + radius)
        g = frame.ray_g(rows + height / 2)
        hypot2, u, ahead, chord2 = self._cut_discs(sphere, grown, g)
        low, high = _tangent_slopes(u, ahead, chord2, power)
        hypot = np.sqrt(hypot2)
        return frame.column_of(low * hypot), frame.column_of(high * hypot)

    def _cut_discs(
        self, sphere: Ints, radius: Floats, g: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Intersect spheres with the planes of rays: each plane cuts a disc out of its sphere.

        All rays (s, g, depth) with the same g lie in one plane through the eye.  A ray has two
        components in this plane: s, and the length of (g, depth).

        Parameters
        ----------
        sphere : (n,) int array
            Position of each sphere in the arrays of this class.
        radius : (n,) float array
            Radius of each sphere, which may differ from that in `self.radius`.
        g : (n,) float array
            Second component of the rays in each plane.

        Returns
        -------
        hypot2 : (n,) float array
            g^2 + depth^2: square of the second component of the rays in the plane.
        u, ahead : (n,) float arrays
            Centre of the disc in the plane: its components along the row, and perpendicular to it.
        chord2 : (n,) float array
            Squared radius of the disc; negative if the plane misses the sphere.
        """
        (u, v, w), depth = take3(self.local, sphere), self.frame.depth
        hypot2 = g * g + depth * depth
        hypot = np.sqrt(hypot2)
        offset, ahead = (v * depth - w * g) / hypot, (v * g + w * depth) / hypot
        return hypot2, u, ahead, (radius - offset) * (radius + offset)

    def intersect(
        self, object_index: Ints, g: Floats, s: Floats, ray_count: Ints | None
    ) -> tuple[Floats, Floats]:
        """Compute the distances at which rays meet objects.

        The rays of a row lie in a plane through the eye, and the plane cuts a disc out of a sphere.
        Rays and discs are intersected in this plane by their closest approach, with the near root
        in the stable form t = C / (B + sqrt(B^2 - A C)) (Haines, Günther and Akenine-Möller,
        Precision improvements for ray/sphere intersection, Ray Tracing Gems, ch. 7).

        Parameters
        ----------
        object_index : (spans,) int array
            A span consists of consecutive rays in one row that are tested with the same object: the
            index of this object.
        g : (spans,) float array
            Second component of the rays in each span.
        s : (n,) float array
            First component of each ray.
        ray_count : (spans,) int array or None
            Number of rays in each span; None if each span has one ray.

        Returns
        -------
        t : (n,) float array
            Distance from the eye, in units of the length of (s, g, depth); infinity if the ray
            misses the object.  If the eye is inside the object or on it, this is the distance at
            which the ray leaves the object.
        detail : (n,) array
            Argument for `tangent_planes`.  For spheres, this is |n . d| radius, with the unit
            normal n and the direction d = (s, g, depth).  For boxes, it is an int8 number of the
            face.
        """
        sphere = self.objects.positions(object_index)
        hypot2, u, ahead, chord2 = self._cut_discs(sphere, self.radius[sphere], g)
        hypot = np.sqrt(hypot2)
        power = self.power[sphere]
        length2 = s * s + repeat_runs(hypot2, ray_count)
        # Cross product and dot product of the centre (u, ahead) and the ray (s, hypot).
        cross = repeat_runs(u * hypot, ray_count) - repeat_runs(ahead, ray_count) * s
        root = np.sqrt(length2 * repeat_runs(chord2, ray_count) - cross * cross)
        dot_product = repeat_runs(u, ray_count) * s + repeat_runs(ahead * hypot, ray_count)
        divisor = dot_product + root
        all_outside, power = np.all(power > 0), repeat_runs(power, ray_count)
        t = power / divisor
        if not all_outside:  # use the far root, in the form with less cancellation
            far = np.where(dot_product > 0, divisor / length2, power / (dot_product - root))
            t = np.where(power > 0, t, far)
        # t is NaN if there is no root, and negative if the sphere is behind the eye.
        return np.where(t > 0, t, np.inf), root

    def tangent_planes(
        self, object_index: Ints, run_length: Ints, local: Floats, t: Floats, detail: Floats
    ) -> tuple[Ints, Floats, Floats, Triple, Floats]:
        """Compute the face, the normal and the tangent plane at hits.

        A run consists of consecutive hits on the same face of the same object.

        Parameters
        ----------
        object_index : (runs,) int array
            The object of each run.
        run_length : (runs,) int array
            Number of hits in each run.
        local : (3, n) float array
            Vectors from the eye to the hits, in the axes of the camera.
        t, detail : (n,) arrays
            Results of `intersect` for the hits.

        Returns
        -------
        face : (runs,) int array
            Axis to which the face is perpendicular: 0, 1 or 2; `NO_FACE` for spheres.
        sign : (runs,) float array
            1 if the normal of the face points up its axis, and -1 if it points down.  For spheres,
            an array of no dimensions without meaning.
        level : (runs,) float array
            Coordinate of the face along its axis, in the axes of the scene.  For spheres, an array
            of no dimensions without meaning.
        normal : tuple of three float arrays
            Unit normals on the side of the eye, in the axes of the camera: (n,) for spheres, and
            (runs,) for boxes.
        eye_height : float array
            Distance of the eye from the tangent plane: (n,) for spheres, and (runs,) for boxes.
        """
        sphere = self.objects.positions(object_index)
        inverse = repeat_runs(1 / self.radius[sphere], run_length)
        center = (repeat_runs(m[sphere], run_length) for m in self.local)
        x, y, z = ((p - c) * inverse for p, c in zip(local, center, strict=True))
        inside = self.is_eye_inside[sphere]
        if inside.any():
            flip = repeat_runs(np.where(inside, -1.0, 1.0), run_length)
            x, y, z = flip * x, flip * y, flip * z
        face, sign, level = np.full(sphere.size, NO_FACE), np.ones(()), np.zeros(())
        return face, sign, level, (x, y, z), detail * inverse * t

    # Tests of shadow segments: segments from hits to lights.

    def side_of_light(self, object_index: Ints, light: Triple) -> Sides:
        """Decide, for pairs of an object and a light, on which side of the surface the light lies.

        Parameters
        ----------
        object_index : (n,) int array
            The object of each pair.
        light : tuple of three (n,) float arrays
            Position of the light of each pair, in the axes of the scene.  The arrays may have any
            shape that broadcasts with (n,).

        Returns
        -------
        side : int8 array
            `OUTSIDE`, `ON` (for spheres only) or `INSIDE`, in the shape to which the arguments
            broadcast.
        """
        tolerance = LIGHT_TOLERANCE * self.coordinate_size[self.objects.positions(object_index)]
        return side_of_surface(self.signed_distance(object_index, light), tolerance)

    def signed_distance(self, object_index: Ints, point: Triple) -> Floats:
        """Compute the distance of each point from the surface of an object; negative inside.

        Parameters
        ----------
        object_index : (n,) int array
            The object of each pair of an object and a point.
        point : tuple of three (n,) float arrays
            The point of each pair, in the axes of the scene.  The arrays may have any shape that
            broadcasts with (n,).

        Returns
        -------
        distance : float array
            Signed distances, in the shape to which the arguments broadcast.  For boxes, this is the
            largest of the signed distances from the planes of the six faces: outside of the box, at
            most the distance from the box.
        """
        sphere = self.objects.positions(object_index)
        offset = map3(np.subtract, take3(self.center, sphere), point)
        return np.sqrt(dot(offset, offset)) - self.radius[sphere]

    def occludes(
        self,
        object_index: Ints,
        hit: Triple,
        light: Triple,
        side: Sides,
        growth: Floats | None = None,
    ) -> Bools:
        """Test, pair by pair, whether an object blocks the open segment from a hit to a light.

        A segment is blocked if it crosses the surface strictly between its ends.  An end that lies
        within its tolerance of the surface counts as on the surface.  For a hit on a sphere, the
        segment then starts on the side of the sphere on which the eye lies.

        Parameters
        ----------
        object_index : (n,) int array
            The object of each pair of an object and a segment.
        hit, light : tuples of three (n,) float arrays
            Both ends of each segment, in the axes of the scene.
        side : (n,) int8 array
            The side of the object's surface on which the light lies: see `Spheres.side_of_light`.
        growth : (n,) float array, optional
            Distance by which the object is grown before the test; a negative value shrinks the
            object.  An object that shrinks to nothing blocks nothing.

        Returns
        -------
        blocked : (n,) bool array
            Whether the object blocks the segment.
        """
        sphere = self.objects.positions(object_index)
        to_light = map3(np.subtract, light, hit)
        to_center = map3(np.subtract, take3(self.center, sphere), hit)
        radius = self.radius[sphere]
        if growth is not None:
            radius = np.maximum(radius + growth, 0)
        # If both ends are outside, the sphere blocks the segment if the point of the line that is
        # closest to the centre lies between the ends and inside the sphere.
        b, length2 = dot(to_center, to_light), dot(to_light, to_light)
        closest = b / length2
        perpendicular = map3(lambda c, d: c - closest * d, to_center, to_light)
        is_within = dot(perpendicular, perpendicular) < radius * radius
        blocked: Bools = is_within & (b > 0) & (b < length2)
        height = np.sqrt(dot(to_center, to_center)) - radius
        hit_side = side_of_surface(
            height, hit_tolerance(self.coordinate_size[sphere], hit, self.frame.eye)
        )
        special = indices((hit_side != OUTSIDE) | (side != OUTSIDE))
        if special.size:
            hit_side, side = hit_side[special], side[special]
            b, length2 = b[special], length2[special]
            starts_inside = self.is_eye_inside[sphere[special]]
            blocked[special] = np.where(
                hit_side == ON,
                np.where(starts_inside, (b < 0) | (side == OUTSIDE), b > 0),
                np.where(side == ON, (hit_side == OUTSIDE) & (b < length2), hit_side != side),
            )
        return blocked

    def test_capsules(
        self, object_index: Ints, start: Triple, end: Triple, thickness: Floats
    ) -> tuple[Bools, Bools]:
        """Test, pair by pair, whether an object meets a capsule, and whether it cuts the capsule.

        A capsule consists of all points within a certain distance, the thickness, of a segment
        (Haines and Wallace, Shaft culling, 1991).  It contains all segments from a ball around its
        start to its end.

        1. If the object does not meet the capsule, or the capsule lies entirely inside the object,
           then the object blocks none of these segments.
        2. If the object cuts the capsule, it blocks all of them: it contains a whole cross-section
           of the capsule, and the ball around the start is outside the object.

        Both results are conservative: rounding errors never exclude an object that blocks a
        segment, and never let an object block all segments if it does not.

        Parameters
        ----------
        object_index : (n,) int array
            The object of each pair of an object and a capsule.
        start, end : tuples of three (n,) float arrays
            Both ends of the segment, in the axes of the scene.
        thickness : (n,) float array
            Radius of the capsule.

        Returns
        -------
        meets : (n,) bool array
            False if the object certainly blocks none of the segments.
        cuts : (n,) bool array
            True if the object certainly blocks all of the segments.
        """
        sphere = self.objects.positions(object_index)
        center, radius = take3(self.center, sphere), self.radius[sphere]
        d = map3(np.subtract, end, start)
        to_center = map3(np.subtract, center, start)
        b, length2, distance2 = dot(to_center, d), dot(d, d), dot(to_center, to_center)
        to_end2 = distance2 - 2 * b + length2
        # Squared distance of the centre from the line, and a bound on the error of squares.
        line_distance2, error = distance2 - b * b / length2, SQUARE_ROUNDING * distance2
        outer = (radius + thickness) ** 2 + error
        inner = np.maximum(radius - thickness, 0) ** 2 - error
        starts_outside, ends_outside = distance2 > outer, to_end2 > outer
        is_before, is_behind = b < 0, b > length2
        contains_capsule = np.maximum(distance2, to_end2) < inner
        # If the segment is a single point, `line_distance2` is NaN: the sphere does not cut it.
        misses = (
            (line_distance2 > outer) | (starts_outside & is_before) | (ends_outside & is_behind)
        )
        meets = ~(misses | contains_capsule)
        cuts = starts_outside & ~(is_before | is_behind) & (line_distance2 < inner)
        return meets, cuts


def _tangent_slopes(
    u: Floats, ahead: Floats, chord2: Floats, power: Floats
) -> tuple[Floats, Floats]:
    """Compute the slopes of the rays from the origin that touch discs in a plane.

    Parameters
    ----------
    u, ahead : (n,) float arrays
        The centre (u, ahead) of each disc.  The slope of a ray is u / ahead.
    chord2 : (n,) float array
        Squared radius of each disc; negative or NaN if there is no disc.
    power : (n,) float array
        u^2 + ahead^2 - chord2: negative if the origin is inside the disc.

    Returns
    -------
    low, high : (n,) float arrays
        Rays ahead with slopes between these meet the disc; NaN if there is no disc.
    """
    # The tangents lie at the same angle on either side of the centre.  If the origin is inside the
    # disc, all rays meet the disc.  If rounding decides whether it is inside, the origin counts as
    # on the disc, and half of the rays meet the disc.
    power_bound = np.maximum(power - MIN_POWER * (u * u + ahead * ahead), 0)
    half_angle = np.arctan2(np.sqrt(chord2), np.sqrt(power_bound))
    center_angle = np.arctan2(u, ahead)
    half_angle[power < 0] = np.inf
    angle = np.array([center_angle - half_angle, center_angle + half_angle])
    angle = angle.clip(-np.pi / 2, np.pi / 2)
    # The tangent of the rounded number pi / 2 is 1.6e16, but windows may be wider.
    low, high = np.where(abs(angle) < np.pi / 2, np.tan(angle), np.copysign(np.inf, angle))
    return low, high
