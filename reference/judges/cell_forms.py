"""Enclose everything in cells of the picture: distances, edges, shadows and radiance.

The problem: for each pair (a cell, and a face that may be visible in it), decide what the whole
cell has in common, and find all edges where the picture may change.  The means is the *edge
function*, which has one sign on each side of an edge.  Silhouettes, intersections of surfaces,
terminators and edges of shadows all are zeros of such functions.  A function that has one sign in
all of a cell decides a question for this cell.  Otherwise the cell contains an edge.

On a face, every edge function has the form u + v s.  Here u and v are polynomials of degree two, or
less, in the ray's direction, and s is the root in the inverse distance (see `faces`; s = 0 on
rectangles).  Forms (see `forms`) enclose u, v and s, and so the function.  Near a silhouette, where
s has an infinite slope, the polynomial u^2 - v^2 s^2 is a better edge function: it contains s^2
only, and is zero wherever u + v s is.

Why the result is right: a question counts as decided only if the enclosure of its function has one
sign, and every other function is listed as an edge.

Rounding.  Linear functions are sums of three products.  Their rounding error is at most 4 e times
the sum of these, with e = 2^-53.  That of the quadratic polynomials of cones is at most 20 e times
(r^2 + |c|^2) |q|^2.  Both are widened by at least 900 e times the same, which also covers the
rounding errors of what was computed before: centres relative to the eye, and planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints, add_runs, segment_indices
from reference.judges.cells import MAX_WIDTH, Cells
from reference.judges.faces import Faces
from reference.judges.forms import ROUNDING, XX, C, Form, R, X, Y, Z, constant, difference

# |l + v|^2 of two unit vectors, and squared distances, are positive.  Their enclosures are cut off
# here before they are raised to a negative power.
_MIN_SQUARE = 1e-300


class Contributions(NamedTuple):
    """Radiance that n lights add to pairs where they reach the face, sorted by pair and light.

    Attributes
    ----------
    pair, light : (n,) int arrays
        The pair and the light.
    radiance : Form
        Enclosures (8, 3, n) of the reflected radiance.
    """

    pair: Ints
    light: Ints
    radiance: Form

    def take(self, kept: Bools) -> Contributions:
        """Select contributions by a mask (n,)."""
        return Contributions(self.pair[kept], self.light[kept], self.radiance[kept])


class _Condition(NamedTuple):
    """A function u + v s for n questions, which is positive if the answer may be yes.

    Attributes
    ----------
    question : (n,) int array
        The question to which each function belongs.
    u, v : Form, and Form or (n,) float array
        The function.
    is_edge : bool, or (n,) bool array
        Whether a zero of the function may be an edge of the picture.
    """

    question: Ints
    u: Form
    v: Form | Floats
    is_edge: Bools | bool


class _Edges(NamedTuple):
    """Edge functions u + v s (n,) that may be zero somewhere in the cells of pairs.

    Attributes
    ----------
    pair, light : (n,) int arrays
        The pair; the light whose radiance changes at the edge, or -1 if all radiance changes.
    u, v : Form
        The function.
    """

    pair: Ints
    light: Ints
    u: Form
    v: Form

    def take(self, index: Ints) -> _Edges:
        """Select edge functions by index."""
        return _Edges(self.pair[index], self.light[index], self.u[index], self.v[index])


def _squared(vector: Floats) -> Floats:
    """Square vectors whose components are linear in X and Y.

    Parameters
    ----------
    vector : (3, 3, n) float array
        Along the first axis the components, along the second the coefficients C, X and Y.

    Returns
    -------
    square : (6, n) float array
        Coefficients C, X, Y, XX, XY and YY of the squared length.
    """
    c, x, y = vector.swapaxes(0, 1)
    products = ((c, c), (c, x), (c, y), (x, x), (x, y), (y, y))
    return np.array([(a * b).sum(axis=0) * (1 if a is b else 2) for a, b in products])


def _cross(c: Floats, vector: Floats) -> Floats:
    """Compute the cross products c x q of constant and linear vectors.

    Parameters
    ----------
    c : (3, n) float array
        Constant vectors.
    vector : (3, k, n) float array
        Vectors q, with k coefficients for each component.

    Returns
    -------
    product : (3, k, n) float array
        The cross products, with the same k coefficients.
    """
    return np.array([c[i - 2] * vector[i - 1] - c[i - 1] * vector[i - 2] for i in range(3)])


def _cone(
    c: Floats, r: Floats, q: Floats, q_size: Floats, w: Floats, w_size: Floats
) -> tuple[Form, Floats]:
    """Compute r^2 q^2 - |c x w|^2, which is positive inside the cone around a sphere.

    Parameters
    ----------
    c, r : (3, n) and (n,) float arrays
        Vectors from the apex of the cone to the sphere's centre, and the sphere's radius.
    q, w : (3, 3, n) float arrays
        Vectors from the apex to a point, linear in X and Y.  They may differ by a multiple of c,
        which does not change the cross product.
    q_size, w_size : (n,) float arrays
        Bounds on the terms of which q and w are sums, for the rounding error.

    Returns
    -------
    cone : Form
        The function (8, n), whose radius contains the rounding errors.
    across : (3, 3, n) float array
        c x w.
    """
    across, coef = _cross(c, w), np.zeros((8, c.shape[1]))
    coef[:Z] = r * r * _squared(q) - _squared(across)
    c2 = (c * c).sum(axis=0)
    q_term = r * r * q_size * np.abs(q).sum(axis=(0, 1))
    coef[R] = q_term + c2 * w_size * np.abs(w).sum(axis=(0, 1))
    coef[R] *= 8 * ROUNDING
    return Form(coef), across


class CellForms:
    """Forms in cells: inverse distances, edge functions, and radiance.

    Attributes
    ----------
    faces : Faces
        The scene.
    cells : Cells
        The cells, without pairs and triples that proved to be irrelevant.
    square : Form
        d^2 of the camera rays through each cell (8, c).
    inverse : Form
        Inverse distance 1 / t of each pair (8, p).
    root2, root : Form
        s^2 and s of each pair (8, p): see the module.  Both are 0 for rectangles.  The Z of s is
        that of 1 / t.
    """

    def __init__(self, faces: Faces, cells: Cells) -> None:
        """Decide the questions that have one answer in all of a cell, and list the edges of others.

        Parameters
        ----------
        faces : Faces
            The scene.
        cells : Cells
            The cells.  Pairs and triples that prove to be irrelevant are removed, and settled
            lights are marked, in a copy: see the attribute `cells`.
        """
        self.faces, self.cells, frame = faces, cells, faces.frame
        # Coordinates of the cells' centres in the window, and half of their sizes.
        self._right, self._down = frame.ray_s(cells.x), frame.ray_g(cells.y)
        self._half_right = 0.5 * cells.width * frame.step_u
        self._half_down = 0.5 * cells.width * frame.step_v
        coef = np.zeros((8, cells.x.size))
        coef[:Z] = _squared(self._rays(np.arange(cells.x.size)))
        coef[R] = ROUNDING * coef[C]
        self.square, self._edges = Form(coef), list[_Edges]()
        self._find_surfaces()
        self._find_terminators()
        self._find_shadows()
        if cells.width <= 1:
            self._find_intersections()

    def _rays(self, cell: Ints) -> Floats:
        """Return the directions of the camera rays through cells, as linear functions of X and Y.

        Parameters
        ----------
        cell : (n,) int array
            The cells.

        Returns
        -------
        rays : (3, 3, n) float array
            Along the first axis the components of the directions d, along the second the
            coefficients of 1, X and Y.
        """
        rays = np.zeros((3, 3, cell.size))
        rays[:, 0] = self._right[cell], self._down[cell], np.full(cell.size, self.faces.frame.depth)
        rays[0, 1], rays[1, 2] = self._half_right, self._half_down
        return rays

    def _linear(self, k: Floats, cell: Ints) -> Form:
        """Compute the dot products k.d of vectors with the directions d of camera rays.

        Parameters
        ----------
        k : (3, n) float array
            The vectors.
        cell : (n,) int array
            For each vector, the cell through which the rays pass.

        Returns
        -------
        product : Form
            Enclosures (8, n) of the dot products: linear in X and Y, with their rounding errors.
        """
        coef, (u, v, w) = np.zeros((8, cell.size)), k
        coef[C] = u * self._right[cell] + v * self._down[cell] + w * self.faces.frame.depth
        coef[X], coef[Y] = u * self._half_right, v * self._half_down
        coef[R] = ROUNDING * self.faces.frame.max_ray_size * np.abs(k).sum(axis=0)
        return Form(coef)

    def _half_space(self, pair: Ints, half_space: Floats) -> tuple[Form, Floats]:
        """Express which points of faces are in half-spaces, by functions u + v s.

        Such a function is n.d + b / t, where the half-space is n.x + b >= 0, and the ray meets the
        face at t d.  It is positive if the point is inside.

        Parameters
        ----------
        pair : (n,) int array
            Pairs of a cell and a face.
        half_space : (5, n) float array
            For each pair a half-space: the three components of n, b, and the size of the terms of
            which b is a sum.

        Returns
        -------
        u, v : Form and (n,) float array
            The functions are u + v s, with the root s of the pair's inverse distance.
        """
        *normal, b, size = half_space
        u = self._linear(np.array(normal), self.cells.cell[pair]) + self._rootless[pair] * b
        u.coef[R] += ROUNDING * size * self._inverse_size[pair]
        return u, b

    def _function(self, pair: Ints, u: Form, v: Form | Floats) -> Form:
        """Enclose functions u + v s, where s is the root in the inverse distance of a face.

        Parameters
        ----------
        pair : (n,) int array
            Pairs of a cell and a face.
        u, v : Form, and Form or (n,) float array
            The functions.  On rectangles, s is 0, and v is ignored.

        Returns
        -------
        function : Form
            Enclosures (8, n) of the functions on the pairs.
        """
        coef = u.coef.copy()
        index = np.flatnonzero(~self.faces.is_planar[self.cells.face[pair]])
        coef[:, index] += (self.root[pair[index]] * v[index]).coef
        return Form(coef)

    def _decide(
        self, pair: Ints, light: Ints | int, is_never: Bools, conditions: Iterable[_Condition]
    ) -> Bools:
        """Answer questions about pairs: does a pair satisfy all conditions, everywhere or nowhere?

        A condition of a question is that its function u + v s is positive.  If a question is not
        decided, its functions that may change their signs are added to the edges.

        Parameters
        ----------
        pair : (n,) int array
            The pair of each question.
        light : (n,) int array or int
            The light of each question: see `_Edges`.
        is_never : (n,) bool array
            Changed in place: set to True where one condition is false everywhere in the cell.
            This happens condition by condition, so that `conditions` can skip such questions.
        conditions : iterable of _Condition
            All conditions of all questions.

        Returns
        -------
        is_always : (n,) bool array
            Whether all conditions of the question are true everywhere in the cell.
        """
        is_always, light = np.ones(pair.size, np.bool_), np.broadcast_to(light, pair.shape)
        edges = []
        for question, u, v, is_edge in conditions:
            low, high = self._function(pair[question], u, v).bounds()
            is_never[question[high <= 0]] = True
            is_always[question[~(low > 0)]] = False
            index = np.flatnonzero(~(low >= 0) & ~(high <= 0) & is_edge)
            edges.append((question[index], u[index], v[index]))
        for question, u, v in edges:
            index = np.flatnonzero(~is_never[question])
            question, v = question[index], v[index]
            v = v if isinstance(v, Form) else constant(v)
            self._edges.append(_Edges(pair[question], light[question], u[index], v))
        return is_always & ~is_never

    def _find_surfaces(self) -> None:
        """Compute the inverse distance 1 / t = k.d + s of each pair's face from the eye.

        Pairs are removed if their face is outside the cell, or hidden by another face in all of the
        cell.  The silhouettes of the others are added to the edges.
        """
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        face, cell, is_planar = cells.face, cells.cell, faces.is_planar[cells.face]
        ball, cone, root = np.flatnonzero(~is_planar), *np.zeros((2, 8, face.size))
        rays, size = self._rays(cell[ball]), np.full(ball.size, frame.max_ray_size)
        center, radius = faces.center[:, face[ball]], faces.radius[face[ball]]
        cone[:, ball] = _cone(center, radius, rays, size, rays, size)[0].coef
        self.root2, self.root = Form(cone * faces.w[face] ** 2), Form(root)
        self._rootless = self.inverse = self._linear(faces.k[:, face], cell)
        self._inverse_size = self.inverse.size
        is_outside = np.zeros(face.size, np.bool_)
        covers = self._decide(
            np.arange(face.size), -1, is_outside, self._silhouettes(ball, Form(cone))
        )
        self.inverse, index = Form(self._rootless.coef.copy()), ball[~is_outside[ball]]
        coef, rounding = self.root2[index].power(0.5).coef, self.inverse.coef[R, index]
        # The radius of s becomes its Z, which it shares with 1 / t, except for rounding errors.
        coef[Z], coef[R] = coef[R] + rounding, rounding
        root[:, index] = coef
        self.inverse.coef[:, index] += coef
        self.inverse.coef[R, index] = 0
        kept = ~(is_outside | self._is_hidden(covers))
        self.cells, new_index = cells._replace(covers=covers).with_pairs(kept)
        remaining = [edges.take(np.flatnonzero(kept[edges.pair])) for edges in self._edges]
        self._edges = [edges._replace(pair=new_index[edges.pair]) for edges in remaining]
        self.inverse, self.root2, self.root = self.inverse[kept], self.root2[kept], self.root[kept]
        self._rootless, self._inverse_size = self._rootless[kept], self.inverse.size

    def _silhouettes(self, ball: Ints, cone: Form) -> Iterator[_Condition]:
        """Yield the conditions for a face to be in the direction of a ray; a question is a pair.

        Parameters
        ----------
        ball : (n,) int array
            Pairs of a cell and a sphere.
        cone : Form
            For each pair (8, p) of a sphere: r^2 d^2 - |c x d|^2, which is not negative on lines
            that meet the sphere.
        """
        faces, cells = self.faces, self.cells
        pair = np.flatnonzero(~cells.covers & faces.is_planar[cells.face])
        for half_spaces in faces.rim.swapaxes(0, 1):
            half_space = half_spaces[:, cells.face[pair]]
            yield _Condition(pair, *self._half_space(pair, half_space), is_edge=True)
        # A sphere around the eye is in every direction.
        pair = ball[~cells.covers[ball] & (faces.power[cells.face[ball]] > 0)]
        center = faces.center[:, cells.face[pair]]
        no_root = np.zeros(pair.size)
        # The cone extends in the opposite direction as well, where c.d is negative.
        yield _Condition(pair, self._linear(center, cells.cell[pair]), no_root, is_edge=False)
        yield _Condition(pair, cone[pair], no_root, is_edge=True)

    def _is_hidden(self, covers: Bools) -> Bools:
        """Find pairs whose face is hidden in all of the cell.

        Only one occluder is tried in each cell: among the faces that cover the cell, the one whose
        lower bound on 1 / t is largest.

        Parameters
        ----------
        covers : (p,) bool array
            Whether the face covers all of the cell.

        Returns
        -------
        is_hidden : (p,) bool array
            Whether the face is certainly behind the occluder.
        """
        faces, cell, face, inverse = self.faces, self.cells.cell, self.cells.face, self.inverse
        order = faces.prepared.surfaces.file_index[faces.object_index[face]]
        covering = np.flatnonzero(covers)
        lower_bound = inverse[covering].bounds()[0]
        covering = covering[np.lexsort((-order[covering], lower_bound, cell[covering]))]
        nearest = np.full(self.cells.x.size, -1)
        nearest[cell[covering]] = covering  # the last one in each cell
        pair = np.flatnonzero((nearest[cell] >= 0) & (nearest[cell] != np.arange(cell.size)))
        other = nearest[cell[pair]]
        is_same_plane = (faces.plane[:, face[pair]] == faces.plane[:, face[other]]).all(axis=0)
        is_behind = difference(inverse[pair], inverse[other]).bounds()[1] < 0
        is_hidden = np.zeros(cell.size, np.bool_)
        is_hidden[pair] = np.where(is_same_plane, order[pair] > order[other], is_behind)
        return is_hidden

    def _heights(self, pair: Ints, light: Ints) -> tuple[Form, Floats]:
        """Express the heights of lights above the tangent planes of faces, as functions u + v s.

        A height is divided by the distance t of the visible point from the eye, and is positive if
        the light is in front of the face.

        Parameters
        ----------
        pair, light : (n,) int arrays
            Pairs of a cell and a face; lights, or -1 for the height of the eye.

        Returns
        -------
        u, v : Form and (n,) float array
            The functions are u + v s, with the root s of the pair's inverse distance.
        """
        return self._half_space(pair, self.faces.height[:, light, self.cells.face[pair]])

    def _find_terminators(self) -> None:
        """Find out which lights are below the horizon of a sphere, in each pair.

        A light that is below the horizon in all of the cell becomes settled, without radiance.  If
        it is below in a part of the cell, the terminator between light and dark is an edge.
        """
        # Lights behind the plane of a rectangle are settled from the start.
        is_curved = ~self.faces.is_planar[self.cells.face]
        pair, light = np.nonzero(~self.cells.is_settled & is_curved[:, None])
        is_unlit = np.zeros(pair.size, np.bool_)
        heights = _Condition(np.arange(pair.size), *self._heights(pair, light), is_edge=True)
        self._decide(pair, light, is_unlit, [heights])
        self.cells.is_settled[pair[is_unlit], light[is_unlit]] = True

    def _bounding_boxes(self) -> tuple[Floats, Floats]:
        """Bound the visible part of each pair's face.

        Returns
        -------
        center, half_size : (3, p) float arrays
            Bounding boxes in the scene's axes, widened by rounding errors of positions.
        """
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        center = frame.axes.T @ self._rays(cells.cell)[:, 0]
        half = np.abs(frame.axes[:2].T) @ np.array([self._half_right, self._half_down])
        a, b, eye = center - half[:, None], center + half[:, None], frame.eye[:, None]
        least, greatest = self.inverse.bounds()
        near, far = 1 / greatest, np.where(least > 0, 1 / least, np.inf)
        low, high = faces.bounding_box[:, :, cells.face]
        low = np.fmax(low, eye + np.fmin(a * near, a * far))
        high = np.fmin(high, eye + np.fmax(b * near, b * far))
        error = faces.prepared.position_error[faces.object_index[cells.face]]
        return 0.5 * (low + high), np.maximum(0.5 * (high - low), 0) + error

    def _find_shadows(self) -> None:
        """Find out which triples of a pair, a light and an occluder shade the face.

        A light becomes settled, without radiance, if a single occluder shades all of the face in
        the cell.  Triples that shade nothing are removed.  For the others, the edge of the shadow
        is added to the edges.
        """
        cells = self.cells
        if cells.width == MAX_WIDTH:
            triples = self.faces.occluders(*self._bounding_boxes(), cells.face, ~cells.is_settled.T)
            self.cells = cells = cells._replace(triples=triples)
        pair, light, occluder = cells.triples
        is_sphere, is_lit = occluder < self.faces.spheres, np.zeros(pair.size, dtype=np.bool_)
        cones = self._cone_shadows(np.flatnonzero(is_sphere))
        boxes = self._box_shadows(np.flatnonzero(~is_sphere), is_lit)
        is_shaded = self._decide(pair, light, is_lit, chain(cones, boxes))
        cells.is_settled[pair[is_shaded], light[is_shaded]] = True
        self.cells = cells.with_triples(~is_lit & ~cells.is_settled[pair, light])

    def _cone_shadows(self, triple: Ints) -> Iterator[_Condition]:
        """Yield the conditions for a point to be in the shadow of a sphere.

        Let L be the light, C the sphere's centre, both relative to the eye, and c = C - L.  The
        point p is in the shadow if it satisfies two conditions:

        1. It is inside the cone: |c x (p - L)| <= r |p - L|.
        2. It is behind the plane where the cone touches the sphere: c.(p - L) >= |c|^2 - r^2.  The
           part of this plane inside the cone is inside the sphere.  So it is never an edge.

        Divided by t, p - L is q - L s with q = d - L k.d.  The cross product c x (p - L) equals
        c x (p - C), in which nothing cancels however distant the light is.  Divided by t, p - C is
        w - C s with w = d - C k.d.  So the first condition is u + v s >= 0 with

            u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
            v = 2 ((c x C).(c x w) - r^2 L.q),

        and the second is c.d - (c.C - r^2) / t >= 0.

        Parameters
        ----------
        triple : (n,) int array
            The triples whose occluders are spheres.
        """
        faces, cells, (pair, light, ball) = self.faces, self.cells, self.cells.triples[:, triple]
        c, r2 = faces.to_center[:, light, ball], faces.radius[ball] ** 2
        position, center = faces.light_position[light].T, faces.center[:, ball]
        rays, root = self._rays(cells.cell[pair]), self._rootless.coef[:XX, pair]
        q, w = (rays - end[:, None] * root for end in (position, center))
        position2, center2, c2 = ((end * end).sum(axis=0) for end in (position, center, c))
        k_size = np.abs(faces.k[:, cells.face[pair]]).sum(axis=0)
        q_size, w_size = (
            faces.frame.max_ray_size * (1 + np.sqrt(square) * k_size * 2)
            for square in (position2, center2)
        )
        u, across = _cone(c, faces.radius[ball], q, q_size, w, w_size)
        c_center, v = _cross(c, center[:, None]), np.zeros((8, triple.size))
        dot = (c_center * across).sum(axis=0)
        v[:XX] = 2 * (dot - r2 * (position[:, None] * q).sum(axis=0))
        v_size = c2 * np.sqrt(center2) * w_size + r2 * np.sqrt(position2) * q_size
        v[R] = 16 * ROUNDING * v_size
        root2 = self.root2.coef[:, pair]
        u += Form(root2) * (r2 * position2 - (c_center * c_center).sum(axis=(0, 1)))
        root2_size = np.abs(root2).sum(axis=0)
        u.coef[R] += 16 * ROUNDING * (c2 * center2 + r2 * position2) * root2_size
        yield _Condition(triple, u, Form(v), is_edge=True)
        terms = c * center
        beyond = np.array([*c, r2 - terms.sum(axis=0), r2 + np.abs(terms).sum(axis=0)])
        yield _Condition(triple, *self._half_space(pair, beyond), is_edge=False)

    def _box_shadows(self, triple: Ints, is_lit: Bools) -> Iterator[_Condition]:
        """Yield the conditions for a point to be in the shadow of a box: nine half-spaces.

        Parameters
        ----------
        triple : (n,) int array
            The triples whose occluders are boxes.
        is_lit : (q,) bool array
            For each triple of the cells, whether an earlier condition is false everywhere.  Such
            triples are skipped.
        """
        pair, light, box = self.cells.triples - [[0], [0], [self.faces.spheres]]
        for half_spaces, has_edge in zip(
            self.faces.shadow.swapaxes(0, 1), self.faces.has_shadow_edge, strict=True
        ):
            pending = triple[~is_lit[triple]]
            half_space = half_spaces[:, light[pending], box[pending]]
            # A box that the light sees edge-on has fewer than nine planes.
            exists = half_space[:4].any(axis=0)
            pending = pending[exists]
            function = self._half_space(pair[pending], half_space[:, exists])
            yield _Condition(pending, *function, has_edge[light[pending], box[pending]])

    def _find_intersections(self) -> None:
        """Add edges where the faces of two pairs in a cell may intersect.

        A point on one face is on a plane if k.p - 1 = 0.  It is on a second sphere if it is on the
        plane that is the difference of both spheres' equations, p^2 - 2 c.p + power = 0.
        """
        faces, cells = self.faces, self.cells
        order = np.argsort(cells.cell, kind="stable")
        cell_start = cells.cell[order].searchsorted(cells.cell[order])
        # Each pair of a cell with all earlier pairs of the cell.
        segments = segment_indices(np.arange(order.size) - cell_start, cell_start)
        a, b = (order[index] for index in segments)
        a, b = np.where(faces.is_planar[cells.face[a]], (b, a), (a, b))  # rectangles last
        a_face, b_face = cells.face[a], cells.face[b]
        is_other_object = faces.object_index[a_face] != faces.object_index[b_face]
        is_other_plane = (faces.plane[:, a_face] != faces.plane[:, b_face]).any(axis=0)
        index = np.flatnonzero(is_other_object & is_other_plane)
        a, a_face, b_face = a[index], a_face[index], b_face[index]
        plane, ball = faces.equation[:, b_face], np.flatnonzero(~faces.is_planar[b_face])
        plane[:, ball] += faces.equation[:, a_face[ball]] * [[-1], [-1], [-1], [-1], [1]]
        crossing = _Condition(np.arange(a.size), *self._half_space(a, plane), is_edge=True)
        self._decide(a, -1, np.zeros(a.size, np.bool_), [crossing])

    def edge_functions(self) -> tuple[Ints, Ints, Form]:
        """Return all edge functions, which are zero where the picture has an edge.

        Each function is enclosed as u + v s, or as u^2 - v^2 s^2 if its unknown part is then
        smaller relative to its slope.

        Returns
        -------
        pair : (n,) int array
            The pair of a cell and a face to which each function belongs.
        light : (n,) int array
            The light whose radiance changes at the edge, or -1 if all radiance changes.
        form : Form
            Enclosures (8, n) of the functions in the cells.
        """
        pair, light = (np.concatenate([edges[i] for edges in self._edges]) for i in (0, 1))
        u = Form(np.concatenate([edges.u.coef for edges in self._edges], axis=1))
        v = Form(np.concatenate([edges.v.coef for edges in self._edges], axis=1))
        form = self._function(pair, u, v)

        def relative_width(form: Form) -> Floats:
            """Estimate the width of the strip around the zero."""
            size = np.abs(form.coef)
            return np.asarray(size[XX:].sum(axis=0) / np.maximum(size[X], size[Y]))

        index = np.flatnonzero(form.coef[Z])
        u, v = u[index], v[index]
        squares = u * u - self.root2[pair[index]] * v * v
        is_better = relative_width(squares) < relative_width(form[index])
        form.coef[:, index[is_better]] = squares.coef[:, is_better]
        return pair, light, form

    def shade(self, is_requested: Bools, error: float) -> Contributions:
        """Compute the radiance that unsettled lights add to pairs, and settle lights with it.

        A light becomes settled if it has no edge on the pair, so that it reaches all of it, and if
        the error of its radiance is within its even share of `error`.

        Parameters
        ----------
        is_requested : (p,) bool array
            The pairs to shade.
        error : float
            Maximum error of the radiance of all settled lights together.

        Returns
        -------
        contributions : Contributions
            The radiance of the lights that remain unsettled on the requested pairs.
        """
        contributions, cells = self._contributions(is_requested), self.cells
        has_edge = np.zeros_like(cells.is_settled)
        has_edge[cells.triples[0], cells.triples[1]] = True
        for pair, light, *_ in self._edges:
            has_edge[pair[light >= 0], light[light >= 0]] = True
        is_certain = ~has_edge[contributions.pair, contributions.light]
        light_count = cells.is_settled.shape[1]
        is_certain &= contributions.radiance.radius.max(axis=0) <= error / light_count
        settled = contributions.take(is_certain)
        add_runs(cells.radiance.coef, settled.pair, settled.radiance.coef)
        cells.is_settled[settled.pair, settled.light] = True
        return contributions.take(~is_certain)

    def _contributions(self, is_requested: Bools) -> Contributions:
        """Enclose the radiance that each unsettled light adds to pairs where it reaches the face.

        For a light at q, |p - q|^2 / t^2 is d^2 - 2 q.d / t + q^2 / t^2, and (q - p).(-p) / t^2 is
        d^2 - q.d / t.  With unit vectors n, l and v, the Blinn-Phong term n.h is
        (n.l + n.v) / |l + v|, and |l + v|^2 = 2 + 2 l.v.

        Parameters
        ----------
        is_requested : (p,) bool array
            The pairs to shade.
        """
        faces, cells, prepared = self.faces, self.cells, self.faces.prepared
        pair, light = np.nonzero(~cells.is_settled & is_requested[:, None])
        height = self._function(pair, *self._heights(pair, light))
        cell, obj = cells.cell[pair], faces.object_index[cells.face[pair]]
        q = faces.light_position[light].T
        square, along = self.square[cell], self.inverse[pair] * self._linear(q, cell)
        inverse2 = (self.inverse * self.inverse)[pair]
        distance2 = square - along * 2.0 + inverse2 * (q * q).sum(axis=0)
        inverse_distance = distance2.power(-0.5, _MIN_SQUARE)
        n_dot_l = (height * inverse_distance).unit()
        intensity = faces.prepared_lights.intensity[light].T
        radiance = n_dot_l.coef[:, None] * (intensity * prepared.diffuse[:, obj])
        glossy = np.flatnonzero(prepared.is_glossy[obj])
        glossy_pair, position = np.unique(pair[glossy], return_inverse=True)
        inverse_length = self.square.power(-0.5)
        eye_height = self._function(glossy_pair, *self._heights(glossy_pair, 0 * glossy_pair - 1))
        n_dot_v = eye_height * inverse_length[cells.cell[glossy_pair]]
        l_dot_v = (square[glossy] - along[glossy]) * (
            inverse_distance[glossy] * inverse_length[cell[glossy]]
        )
        inverse_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)
        n_dot_h = ((n_dot_l[glossy] + n_dot_v[position]) * inverse_sum).unit()
        lobe = n_dot_h.power(prepared.exponent[obj[glossy]], 0.0, 1.0).unit()
        specular = intensity[:, glossy] * prepared.specular[:, obj[glossy]]
        radiance[..., glossy] += lobe.coef[:, None] * specular
        return Contributions(pair, light, Form(radiance))
