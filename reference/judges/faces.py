"""A scene as its certificate takes it: faces, lights and occluders, in the camera's axes.

All that is taken of the tracer's inside is taken here: the prepared scene, its light grid, and
single samples, of which only *what* they see counts, and *which* lights reach that.

A face is a sphere or a rectangle of a box.  A ray d from the eye meets it at t d.  For a sphere
around c of radius r let p = |c|^2 - r^2 (`power`).  Then t = p / (c.d + sqrt((c.d)^2 - p d^2)), the
near hit from outside and the far one from inside, so that

    1 / t = k.d + s    with k = c / p and s^2 = w^2 (r^2 d^2 - |c x d|^2), w = 1 / p.

For a plane e.p = l it is k.d with k = e / l.

The height of a point q over the tangent plane, divided by t, is a.d + b / t.  With the normal
g (t d - c) / r, where g = 1 outside and -1 inside, and t^2 d^2 = 2 t c.d - p, it has
a = g (q - c) / r and b = g (p - c.q) / r.  For a plane that faces the eye, a = 0 and
b = -sign(l) (e.q - l).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from tracer import Scene
from tracer.geometry.camera import camera_frame
from tracer.geometry.silhouette import silhouette_planes
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
    lights : (m, 3)
    dead : (m, f)
        Whether a light reaches nothing of a face that is seen, as it is beyond an object around the
        eye, or inside another, or behind the face's plane.
    center, radius, power : (3, spheres) and (spheres,)
    owner, flat, order : (f,)
        The object that a face is of, whether it is a rectangle, and the object's place in the file.
    plane : (f,)
        The same number for rectangles in one plane: the first in the file is seen.
    k, w, a, b, b_size : (3, f), (f,), (3, m + 1, f) and (m + 1, f)
        See the module; b is a sum of terms of this size.  The last point q is the eye.
    rim : (4, 3, f)
        A rectangle is seen where rim.d >= 0 for all four.
    low, high : (3, f)
        Bounding boxes in the scene's axes.
    to_center : (3, m, spheres)
        From lights.
    normal, offset, offset_size, edge : (9, 3, m, boxes) and (9, m, boxes)
        A box keeps a light from p if normal.p + offset >= 0 for its three planes towards the light
        and six through the light and its silhouette; whether that is an edge of its shadow.
    edge_on : (m, boxes)
        Whether the light is in the plane of a flat box, which then shades nothing.
    """

    def __init__(self, scene: Scene) -> None:
        self.frame = frame = camera_frame(scene.camera, scene.width, scene.height)
        self.prepared = prepared = PreparedScene(scene, frame)
        balls, boxes = prepared.spheres, prepared.boxes
        self.spheres, self.count, self.lights = balls.count, prepared.repeated.size, prepared.local
        self.center, self.radius, self.power = np.array(balls.local), balls.radius, balls.power
        low, high = (m - frame.eye[:, None] for m in (boxes.min_pt, boxes.max_pt))
        inside = prepared.eye_inside
        on = inside[self.spheres :] & np.any((low == 0) | (high == 0), axis=0)
        if np.any(self.power == 0) or on.any():
            raise ValueError("the eye is on a surface; move it off")
        # Farther away, the two ends of an object may round to one as seen from the light.
        sizes = np.append(balls.radius, (boxes.max_pt - boxes.min_pt).ravel())
        if np.abs(self.lights).max(initial=0) > _FARTHEST * sizes[sizes > 0].min(initial=np.inf):
            wrong = f"a light is more than {_FARTHEST:g} times as far as an object is large"
            raise ValueError(f"{wrong}; move it nearer")
        self._add_faces(low, high, np.where(inside[self.spheres :], 1, -1))
        self._add_shadows(low, high)
        side, (x, y, z) = prepared.side.copy(), prepared.lights.T[:, :, None]
        some = np.arange(self.spheres, self.count)
        # A light on a box's face is not beyond it.
        side[:, some] *= boxes.signed_distance(some, (x, y, z)) != 0
        dead = np.any(np.where(inside, side > 0, side < 0), axis=1, keepdims=True)
        # It reaches nothing, though, of that box itself, if the eye is inside.
        dead = dead | (inside & (prepared.side >= 0))[:, self.owner]
        self.dead = dead | (self.flat & (self.b[:-1] <= 0))
        self.may_block = ~inside & ~prepared.repeated
        own = self.owner
        self.order, self.glossy = prepared.surfaces.file_index[own], prepared.glossy[own]
        self.diffuse, self.specular = prepared.diffuse[:, own], prepared.specular[:, own]
        self.exponent, self.error = prepared.exponent[own], prepared.position_error[own]

    def _add_faces(self, low: Floats, high: Floats, inward: Ints) -> None:
        """List spheres, then rectangles that face the eye; `inward` (boxes,): 1 around the eye."""
        prepared, axes, n = self.prepared, self.frame.axes, self.spheres
        c, r, power = self.center, self.radius, self.power
        q = np.append(self.lights, np.zeros((1, 3)), axis=0).T[:, :, None]
        g, c_q = np.where(power > 0, 1.0, -1.0), c[:, None] * q
        b, b_size = g * (power - c_q.sum(axis=0)) / r, (np.abs(power) + np.abs(c_q).sum(axis=0)) / r
        a, rim = g * (q - c[:, None]) / r, np.zeros((4, 3, n))
        zero, number = np.zeros(n), np.arange(n)
        faces: list[tuple[NDArray[Any], ...]] = [
            (c / power, 1 / power, a, b, b_size, rim, number, zero + 3, zero, number + 1, zero)
        ]
        points = np.append(prepared.lights, self.frame.eye[None], axis=0)
        for axis, far in np.ndindex(3, 2):
            corner, i, j = (high if far else low)[axis], (axis + 1) % 3, (axis + 2) % 3
            facing = np.sign(corner) == np.where(far, inward, -inward)
            at = np.flatnonzero(facing & (low[i] < high[i]) & (low[j] < high[j]))
            level, e, zero = corner[at], axes[:, axis], np.zeros(at.size)
            s = np.sign(level)
            # On the plane, e_q.p >= end where e_q.d |l| >= sign(l) end e.d.
            rim = np.array(
                [
                    side * (np.outer(axes[:, q], np.abs(level)) - np.outer(e, end[q, at] * s))
                    for q in (i, j)
                    for end, side in ((low, 1), (high, -1))
                ]
            )
            place = (prepared.boxes.max_pt if far else prepared.boxes.min_pt)[axis, at]
            height = -s * (points[:, axis, None] - place)
            numbers = at + n, zero + axis, s, zero, place
            a = np.zeros((3, len(points), at.size))
            faces.append((e[:, None] / level, zero, a, height, np.abs(height), rim, *numbers))
        joined = [np.concatenate(m, axis=-1) for m in zip(*faces, strict=True)]
        self.k, self.w, self.a, self.b, self.b_size, self.rim, *rest = joined
        owner, axis_of, sign, alone, place = rest
        self.owner, axis_of = owner.astype(np.intp), axis_of.astype(np.intp)
        self.flat = axis_of < 3
        keys = np.array([axis_of, alone, place])
        self.plane: Ints = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
        self._number = np.zeros((self.count, 4, 2), dtype=np.intp)
        self._number[self.owner, axis_of, (sign > 0).astype(int)] = np.arange(self.owner.size)
        center, at = prepared.spheres.center, np.flatnonzero(self.flat)
        ends = (center - r, prepared.boxes.min_pt), (center + r, prepared.boxes.max_pt)
        self.low, self.high = (np.concatenate(m, axis=1)[:, self.owner] for m in ends)
        self.low[axis_of[at], at] = self.high[axis_of[at], at] = place[at]

    def _add_shadows(self, low: Floats, high: Floats) -> None:
        """Prepare bounds of shadows; `low`, `high` (3, boxes): corners as seen from the eye."""
        frame = self.frame
        self.to_center = self.center[:, None] - self.lights.T[:, :, None]
        lights, corners = (self.prepared.lights - frame.eye).T[:, :, None], (low, high)
        low, high = low[:, None] - lights, high[:, None] - lights
        side = np.where(low >= 0, 1.0, np.where(high <= 0, -1.0, 0.0))
        near = side[:, None] * frame.axes.T[:, :, None, None]
        offsets = [*(-side * np.where(side > 0, corners[0][:, None], corners[1][:, None]))]
        sizes = [np.abs(offset) for offset in offsets]
        made = silhouette_planes(low.reshape(3, -1), high.reshape(3, -1))
        planes = np.array(made).reshape(3, 6, *side.shape[1:])
        for k, turn in product(range(3), (1, -1)):
            # A plane holds an edge of the box along axis k: its normal is (.., y, -x) for the edge
            # at x, y as seen from the light.  From the eye, nothing cancels however far the light.
            i, j, plane = (k + 1) % 3, (k + 2) % 3, planes[:, 2 * k + (turn < 0)]
            x = np.where(-turn * plane[j] == low[i], corners[0][i], corners[1][i])
            y = np.where(turn * plane[i] == low[j], corners[0][j], corners[1][j])
            offsets.append(-(plane[i] * x + plane[j] * y))
            sizes.append(np.abs(plane[i] * x) + np.abs(plane[j] * y))
        cone = np.array(frame.vector_to_camera((planes[0], planes[1], planes[2])))
        self.normal = np.append(near, cone.swapaxes(0, 1), axis=0)
        self.offset, self.offset_size = np.array(offsets), np.array(sizes)
        # What crosses a plane towards the light is in the box, unless the light is on the plane.
        on_plane = (low == 0) | (high == 0)
        self.edge = np.append(on_plane, np.ones(cone.shape[1:], dtype=np.bool_), axis=0)
        self.edge_on = np.any((low == 0) & (high == 0), axis=0)

    def candidates(self, middle: Floats, half: Floats, face: Ints, asked: Bools) -> Iterator[Ints]:
        """Lights, boxes and occluders (3, m) that may come between lights and boxes around faces.

        `middle`, `half` (3, n), `face` (n,); `asked` (lights, n): which lights.  In several octants
        the light grid may find the same.
        """
        grid = self.prepared.grid
        if grid is not None and asked.any():
            for rows in grid.query(middle, half[:, None], self.owner[face], asked):
                yield rows[:, self.may_block[rows[2]]]

    def trace(self, x: Floats, y: Floats, asked: Callable[[Ints], Bools]) -> Bools:
        """Whether lights reach what is seen at points of the picture (lights, n).

        `asked`: is given the faces (n,) seen, or -1, and returns which lights count (lights, n).
        """
        samples, order = Scattered.of(x, y)
        hits = nearest_hits(self.prepared, samples)
        at, face = order[hits.sample], np.full(x.size, -1)
        for group in hits.groups:
            below = np.broadcast_to(group.sign < 0, group.obj.shape).astype(np.intp)
            face[at[group.part]] = group.repeat_runs(self._number[group.obj, group.face, below])
        lit = asked(face)
        reached = lit[:, at] & (light_geometry(hits).n_dot_l > 0)
        lit[:, at] = reached & ~occlusion(hits, reached)
        return lit & (face >= 0)
