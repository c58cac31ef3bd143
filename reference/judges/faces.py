"""A scene as its certificate takes it: faces, lights and occluders, in the camera's axes.

All that is taken of the tracer's inside is taken here: the prepared scene, its light grid, and
single samples, of which only *what* they see counts, and *which* lights reach that.

A face is a sphere or a rectangle of a box.  A ray d from the eye meets it at t d.  For a sphere
around c of radius r let p = |c|^2 - r^2 (`power`).  Then t = p / (c.d + sqrt((c.d)^2 - p d^2)), the
near hit from outside and the far one from inside, so that

    1 / t = k.d + s    with k = c / p and s^2 = w^2 (r^2 d^2 - |c x d|^2), w = 1 / p.

For a plane e.p = l it is k.d with k = e / l.

A *half-space* n.p + b >= 0 is five numbers: n, b, and the size of the terms that b is a sum of.
Of the point t d, n.d + b / t tells whether it is inside.  Such is, too, the height of a point q
over the tangent plane, divided by t.  With the normal g (t d - c) / r, where g = 1 outside and -1
inside, and t^2 d^2 = 2 t c.d - p, it has n = g (q - c) / r and b = g (p - c.q) / r.  Over a
rectangle it has n = 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from tracer import Scene
from tracer.geometry.camera import camera_frame
from tracer.geometry.silhouette import silhouette_planes
from tracer.trace.hits import Hits
from tracer.trace.lighting import light_geometry
from tracer.trace.occlusion import occlusion
from tracer.trace.samples import Scattered
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# The most that a light may be away, as a multiple of the least object's size.
_FARTHEST = 1e14


class Faces:
    """The faces (f,) and lights (m,) of a scene, and its objects (n,), spheres first.

    Attributes
    ----------
    given : Lights
    lights : (m, 3)
        Their positions in the camera's axes.
    center, radius, power : (3, spheres) and (spheres,)
    owner, flat, seen : (f,)
        The object that a face is of, whether it is a rectangle, and whether it may be seen at all.
        After the spheres come, of all boxes, the low sides along x, the high ones, along y, ...
    plane : (2, f)
        The same numbers for rectangles in one plane: the first in the file is seen.
    k, w : (3, f) and (f,)
        See the module.
    surface : (5, f)
        Half-spaces, beyond planes; of spheres, all of the equation that two do not share.
    height : (5, m + 1, f)
        Half-spaces that tell the heights of lights and the eye over the face.
    rim : (5, 4, f)
        Half-spaces that share a rectangle.
    bounds : (2, 3, f)
        Lower and upper corners of bounding boxes, in the scene's axes.
    dead : (m, f)
        Whether a light reaches nothing of a face that is seen, as it is beyond an object around the
        eye, or inside another, or behind the face's plane.
    to_center : (3, m, spheres)
        From lights.
    shadow : (5, 9, m, boxes)
        Half-spaces that share what a box keeps a light from: behind its three planes towards the
        light, and beside the six through the light and its silhouette.
    edge : (9, m, boxes)
        Whether the shadow may end there.  What crosses a plane towards the light is in the box,
        unless the light is on the plane.
    """

    def __init__(self, scene: Scene) -> None:
        self.frame = frame = camera_frame(scene.camera, scene.width, scene.height)
        self.prepared = prepared = PreparedScene(scene, frame)
        self.given = given = prepared.lights()
        balls, boxes, inside = prepared.spheres, prepared.boxes, prepared.eye_inside
        self.spheres, self.count, self.lights = balls.count, inside.size, given.local
        self.center, self.radius, self.power = np.array(balls.local), balls.radius, balls.power
        low, high = (m - frame.eye[:, None] for m in (boxes.min_pt, boxes.max_pt))
        on = inside[self.spheres :] & np.any((low == 0) | (high == 0), axis=0)
        if np.any(self.power == 0) or on.any():
            raise ValueError("the eye is on a surface; move it off")
        # Farther away, the two ends of an object may round to one as seen from the light.
        sizes = np.append(balls.radius, (boxes.max_pt - boxes.min_pt).ravel())
        if np.abs(self.lights).max(initial=0) > _FARTHEST * sizes[sizes > 0].min(initial=np.inf):
            wrong = f"a light is more than {_FARTHEST:g} times as far as an object is large"
            raise ValueError(f"{wrong}; move it nearer")
        self._add_faces(low, high)
        self.to_center = self.center[:, None] - self.lights.T[:, :, None]
        self._add_shadows(low, high)
        # A light on a box's face is not beyond it.
        side, (x, y, z) = given.side.copy(), given.position.T[:, :, None]
        some = np.arange(self.spheres, self.count)
        side[:, some] *= boxes.signed_distance(some, (x, y, z)) != 0
        dead = np.any(np.where(inside, side > 0, side < 0), axis=1, keepdims=True)
        # It reaches nothing, though, of that box itself, if the eye is inside.
        dead = dead | (inside & (given.side >= 0))[:, self.owner]
        self.dead = dead | (self.flat & (self.height[3, :-1] <= 0))

    def _add_faces(self, low: Floats, high: Floats) -> None:
        """List spheres, then sides of boxes, of which corners are `low` and `high` (3, boxes)."""
        prepared, axes, n = self.prepared, self.frame.axes, self.spheres
        c, r, power, c_scene = self.center, self.radius, self.power, prepared.spheres.center
        points = np.append(self.given.position, self.frame.eye[None], axis=0)[:, :, None, None]
        q = np.append(self.lights, np.zeros((1, 3)), axis=0).T[:, :, None]
        g, c_q = np.where(power > 0, 1.0, -1.0), c[:, None] * q
        b, size = power - c_q.sum(axis=0), np.abs(power) + np.abs(c_q).sum(axis=0)
        over_balls = np.array([*(g * (q - c[:, None])), g * b, size]) / r
        # Of boxes by axis, side and number.
        corner = np.stack([low, high], axis=1)
        place = np.stack([prepared.boxes.min_pt, prepared.boxes.max_pt], axis=1)
        inward = np.where(prepared.eye_inside[n:], 1, -1) * [[-1], [1]]
        wide = low < high
        seen = (corner * inward > 0) & (wide[[1, 2, 0]] & wide[[2, 0, 1]])[:, None]
        above = np.sign(corner) * (place - points)
        over_sides = np.array([*np.zeros((3, *above.shape)), above, np.abs(above)])
        sides = np.empty((5, *corner.shape))  # the half-spaces that share a box
        sides[:3] = axes[:, :, None, None] * [[1], [-1]]
        sides[3:] = corner * [[-1], [1]], np.abs(corner)
        rim = sides[:, [[1, 2], [2, 0], [0, 1]]].reshape(5, 3, 4, 1, -1).swapaxes(1, 2)
        plane = np.array([np.broadcast_to([[[0]], [[1]], [[2]]], place.shape), place])

        def joined(balls: NDArray[Any], boxes: NDArray[Any]) -> NDArray[Any]:
            return np.append(balls, boxes.reshape(*balls.shape[:-1], -1), axis=-1)

        within = np.empty((2, 3, *corner.shape))
        within[:] = place.swapaxes(0, 1)[:, :, None, None]
        for k in range(3):
            within[:, k, k] = place[k]
        self.bounds = joined(np.array([c_scene - r, c_scene + r]), within)
        self.surface = joined(np.array([*(-2 * c), power, np.abs(power)]), sides)
        self.k = joined(c / power, axes[:, :, None, None] / corner)
        self.w = joined(1 / power, 0 * corner)
        self.height = joined(over_balls, over_sides)
        self.rim = joined(np.zeros((5, 4, n)), rim.repeat(2, axis=3))
        self.plane = joined(np.array([np.full(n, 3), np.arange(n)]), plane)
        self.owner = joined(np.arange(n), np.broadcast_to(np.arange(n, self.count), corner.shape))
        self.flat = self.owner >= n
        self.seen = joined(np.ones(n, np.bool_), seen) & ~prepared.repeated[self.owner]

    def _add_shadows(self, low: Floats, high: Floats) -> None:
        """Find shadows of boxes, of which corners are `low` and `high` (3, boxes).

        Each half-space touches its box: there, of all corners, n.p is least.  From the eye, nothing
        cancels in that, however far the light.
        """
        lights = (self.given.position - self.frame.eye).T[:, :, None]
        low, high, a, b = low[:, None], high[:, None], low[:, None] - lights, high[:, None] - lights
        cone = np.array(silhouette_planes(a.reshape(3, -1), b.reshape(3, -1)))
        edge_on, on = (a == 0) & (b == 0), (a == 0) | (b == 0)
        side = np.where(edge_on, 0, np.where(a >= 0, 1, np.where(b <= 0, -1, 0)))
        near = np.eye(3)[:, :, None, None] * side
        n = np.append(near, cone.reshape(3, 6, *a.shape[1:]), axis=1)
        ends = np.array([n * low[:, None], n * high[:, None]])
        offset, size = -ends.min(axis=0).sum(axis=0), np.abs(ends).max(axis=0).sum(axis=0)
        offset[:3] -= edge_on  # a flat box shades nothing from a light in its plane
        u, v, w = self.frame.vector_to_camera((n[0], n[1], n[2]))
        self.shadow = np.array([u, v, w, offset, size])
        self.edge = np.append(
            on, np.ones(cone.shape[1:], np.bool_).reshape(6, *on.shape[1:]), axis=0
        )

    def blockers(self, middle: Floats, half: Floats, face: Ints, asked: Bools) -> Ints:
        """Boxes, lights and occluders (3, q) that may come between boxes around faces and lights.

        `middle`, `half` (3, n), `face` (n,); `asked` (lights, n): which lights.
        """
        prepared, grid, found = self.prepared, self.given.grid, [np.zeros(0, dtype=np.intp)]
        may_block, shape = ~prepared.eye_inside & ~prepared.repeated, (*asked.T.shape, self.count)
        if grid is not None and asked.any():
            owner = self.owner[face]
            for light, box, obj in grid.query(middle, half[:, None], owner, asked):
                rows = np.ravel_multi_index((box, light, obj), shape)
                found.append(rows[may_block[obj]])
        # In several octants the grid may find the same.
        return np.array(np.unravel_index(np.unique(np.concatenate(found)), shape))

    def see(self, x: Floats, y: Floats) -> tuple[Hits, Ints, Ints]:
        """Hits (n,) of samples at points of the picture; of each, which point, and the face."""
        samples, order = Scattered.of(x, y)
        hits, n = nearest_hits(self.prepared, samples), self.count - self.spheres
        face = np.empty(hits.sample.size, dtype=np.intp)
        for group in hits.groups:
            high = (group.sign > 0) ^ self.prepared.eye_inside[group.obj]
            side = group.obj + group.shape.flat * n * (2 * group.face + high)
            face[group.part] = group.repeat_runs(side)
        return hits, order[hits.sample], face

    def lit(self, hits: Hits, asked: Bools) -> Bools:
        """Whether lights reach hits (lights, n), of those that are asked about."""
        reached = asked & (light_geometry(hits, self.given).n_dot_l > 0)
        return reached & ~occlusion(hits, self.given, reached)
