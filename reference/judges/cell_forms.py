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

from reference.judges.arrays import Bools, Floats, Ints, add_at_sorted_index, list_segment_elements
from reference.judges.cells import MAX_WIDTH, Cells
from reference.judges.faces import Faces
from reference.judges.forms import ROUNDING, XX, C, Form, R, X, Y, Z, constant_form, difference_form

# |l + v|^2 of two unit vectors, and squared distances, are positive.  Their enclosures are cut off
# here before they are raised to a negative power.
_MIN_SQUARE = 1e-300


class Contributions(NamedTuple):
    """Radiance that n lights add to pairs where they reach the face, sorted by pair and light.

    A pair consists of a cell of the picture, and a face (a sphere, or a side of a box) that may be
    visible in the cell.

    Attributes
    ----------
    pair, light : (n,) int arrays
        The pair and the light of each contribution.
    radiance : Form
        Enclosures (8, 3, n) of the light that each lit face reflects to the eye, in three channels.
    """

    pair: Ints
    light: Ints
    radiance: Form

    def take(self, kept: Bools) -> Contributions:
        """Select contributions by a mask (n,), and copy them."""
        return Contributions(self.pair[kept], self.light[kept], self.radiance[kept])


class _Condition(NamedTuple):
    """A condition for n questions about pairs: it is true where a function u + v s is positive.

    The root s is the part of the inverse distance 1 / t = k.d + s that is not linear in the
    direction d of the ray.

    Attributes
    ----------
    question : (n,) int array
        The question that each function helps to answer.
    u, v : Form, and Form or (n,) float array
        The coefficients of the function.
    is_edge : bool, or (n,) bool array
        Whether the picture may have an edge where the function is zero.
    """

    question: Ints
    u: Form
    v: Form | Floats
    is_edge: Bools | bool


class _Edges(NamedTuple):
    """Edge functions u + v s (n,): the picture may have an edge where one of them is zero.

    The root s is the part of the inverse distance 1 / t = k.d + s that is not linear in the
    direction d of the ray.

    Attributes
    ----------
    pair, light : (n,) int arrays
        The pair of a cell and a face in which the edge lies; the light whose radiance changes at
        the edge, or -1 if all radiance changes.
    u, v : Form
        The coefficients of the functions.
    """

    pair: Ints
    light: Ints
    u: Form
    v: Form

    def take(self, index: Ints) -> _Edges:
        """Select edge functions by indices (k,), and copy them."""
        return _Edges(self.pair[index], self.light[index], self.u[index], self.v[index])


def _squared_length(vector: Floats) -> Floats:
    """Compute the squared lengths of vectors whose components are linear functions of X and Y.

    Parameters
    ----------
    vector : (3, 3, n) float array
        Along the first axis the components, along the second the coefficients of 1, X and Y.

    Returns
    -------
    square : (6, n) float array
        Coefficients of 1, X, Y, X^2, X Y and Y^2 of the squared length.
    """
    c, x, y = vector.swapaxes(0, 1)
    products = ((c, c), (c, x), (c, y), (x, x), (x, y), (y, y))
    return np.array([(a * b).sum(axis=0) * (1 if a is b else 2) for a, b in products])


def _cross_product(c: Floats, vector: Floats) -> Floats:
    """Compute cross products c x q of constant vectors c and linear or constant vectors q.

    Parameters
    ----------
    c : (3, n) float array
        The constant vectors.
    vector : (3, k, n) float array
        The vectors q.  Each component has k coefficients, for example of 1, X and Y.

    Returns
    -------
    product : (3, k, n) float array
        The cross products, in the same k coefficients.
    """
    return np.array([c[i - 2] * vector[i - 1] - c[i - 1] * vector[i - 2] for i in range(3)])


def _cone_function(
    c: Floats, r: Floats, q: Floats, q_size: Floats, w: Floats, w_size: Floats
) -> tuple[Form, Floats]:
    """Compute r^2 |q|^2 - |c x q|^2, which is positive inside the double cone around a sphere.

    The cone consists of all lines through an apex that meet the sphere.

    Parameters
    ----------
    c, r : (3, n) and (n,) float arrays
        Vectors from the apex of the cone to the sphere's centre, and the sphere's radius.
    q : (3, 3, n) float array
        Vectors from the apex to a point: along the first axis the components, along the second the
        coefficients of 1, X and Y.
    q_size : (n,) float array
        Bound on the size of the terms that were added up to compute q, for the rounding error.
    w, w_size : (3, 3, n) and (n,) float arrays
        Vectors, and bounds like `q_size`.  The cross product is computed as c x w.  So w is q plus
        any multiple of c, chosen such that the rounding error is small.

    Returns
    -------
    cone : Form
        Enclosures (8, n) of the function by polynomials in X and Y.  The radius is a bound on the
        rounding errors.
    across : (3, 3, n) float array
        The cross product c x w, with the axes of w.
    """
    across, coef = _cross_product(c, w), np.zeros((8, c.shape[1]))
    coef[:Z] = r * r * _squared_length(q) - _squared_length(across)
    c2 = (c * c).sum(axis=0)
    q_term = r * r * q_size * np.abs(q).sum(axis=(0, 1))
    coef[R] = q_term + c2 * w_size * np.abs(w).sum(axis=(0, 1))
    coef[R] *= 8 * ROUNDING
    return Form(coef), across


class CellForms:
    """Inverse distances, edge functions, and radiance in cells of the picture, enclosed by forms.

    A form encloses a quantity in a cell by a quadratic polynomial with an error bound.  A pair
    consists of a cell and a face (a sphere, or a side of a box) that may be visible in the cell.

    Attributes
    ----------
    faces : Faces
        The spheres and the sides of boxes in the scene.
    cells : Cells
        The cells, without pairs and triples that proved to be irrelevant.
    square : Form
        Squared length d^2 of the direction of the camera rays through each cell (8, c).
    inverse : Form
        Inverse distance 1 / t = k.d + s of each pair (8, p).  The visible point is eye + t d.
    root2, root : Form
        s^2 and s of each pair (8, p).  Both are 0 for sides of boxes.  The unknown part Z of s is
        that of 1 / t.
    """

    def __init__(self, faces: Faces, cells: Cells) -> None:
        """Find out what is visible in each cell, which lights reach it, and where edges may be.

        Parameters
        ----------
        faces : Faces
            The spheres and the sides of boxes in the scene.
        cells : Cells
            The cells, which are not changed.  The attribute `cells` is a copy from which irrelevant
            pairs and triples are removed, and in which more lights are settled.
        """
        self.faces, self.cells, frame = faces, cells, faces.frame
        # Coordinates of the cells' centres in the window, and half of their sizes.
        self._right, self._down = frame.ray_s(cells.x), frame.ray_g(cells.y)
        self._half_right = 0.5 * cells.width * frame.step_u
        self._half_down = 0.5 * cells.width * frame.step_v
        coef = np.zeros((8, cells.x.size))
        coef[:Z] = _squared_length(self._ray_directions(np.arange(cells.x.size)))
        coef[R] = ROUNDING * coef[C]
        self.square, self._edges = Form(coef), list[_Edges]()
        self._find_surfaces()
        self._find_terminators()
        self._find_shadows()
        if cells.width <= 1:
            self._find_intersections()

    def _ray_directions(self, cell: Ints) -> Floats:
        """Return the directions of the camera rays through cells, as linear functions of X and Y.

        Parameters
        ----------
        cell : (n,) int array
            Indices of cells, in which X and Y run from -1 to 1.

        Returns
        -------
        rays : (3, 3, n) float array
            Along the first axis the components of the directions in the camera's axes, along the
            second the coefficients of 1, X and Y.
        """
        rays = np.zeros((3, 3, cell.size))
        rays[:, 0] = self._right[cell], self._down[cell], np.full(cell.size, self.faces.frame.depth)
        rays[0, 1], rays[1, 2] = self._half_right, self._half_down
        return rays

    def _dot_with_rays(self, k: Floats, cell: Ints) -> Form:
        """Enclose the dot products k.d of vectors k with the directions d of camera rays.

        Parameters
        ----------
        k : (3, n) float array
            The vectors, in the camera's axes.
        cell : (n,) int array
            For each vector, the cell through which the rays pass.

        Returns
        -------
        product : Form
            Enclosures (8, n) of the dot products.  They are linear in the position in the cell.
            The radius is a bound on the rounding errors.
        """
        coef, (u, v, w) = np.zeros((8, cell.size)), k
        coef[C] = u * self._right[cell] + v * self._down[cell] + w * self.faces.frame.depth
        coef[X], coef[Y] = u * self._half_right, v * self._half_down
        coef[R] = ROUNDING * self.faces.frame.max_ray_size * np.abs(k).sum(axis=0)
        return Form(coef)

    def _side_function(self, pair: Ints, half_space: Floats) -> tuple[Form, Floats]:
        """Express by a function's sign whether the visible point of a face is in a half-space.

        Let n.x + b >= 0 be the half-space, and x = t d the point where the ray with direction d
        meets the face.  Then n.d + b / t is positive if the point is inside.  As 1 / t = k.d + s,
        this function has the form u + v s, where s is the root in the inverse distance of the face.

        Parameters
        ----------
        pair : (n,) int array
            Pairs of a cell and a face.
        half_space : (5, n) float array
            For each pair a half-space.  Rows 0 to 2 contain the components of n, row 3 contains b,
            and row 4 a bound on the size of the terms that were added up to compute b.

        Returns
        -------
        u : Form
            Enclosures (8, n) of u = n.d + b k.d.
        v : (n,) float array
            The numbers v = b.
        """
        *normal, b, size = half_space
        u = self._dot_with_rays(np.array(normal), self.cells.pair_cell[pair])
        u += self._linear_inverse[pair] * b
        u.coef[R] += ROUNDING * size * self._inverse_max_abs[pair]
        return u, b

    def _enclose(self, pair: Ints, u: Form, v: Form | Floats) -> Form:
        """Enclose functions u + v s, where s is the root in the inverse distance of a face.

        Parameters
        ----------
        pair : (n,) int array
            Pairs of a cell and a face.
        u, v : Form, and Form or (n,) float array
            The coefficients of the functions.  On sides of boxes, s is 0, and v is ignored.

        Returns
        -------
        function : Form
            Enclosures (8, n) of the functions in the cells of the pairs.
        """
        coef = u.coef.copy()
        index = np.flatnonzero(~self.faces.is_planar[self.cells.pair_face[pair]])
        coef[:, index] += (self.root[pair[index]] * v[index]).coef
        return Form(coef)

    def _decide(
        self, pair: Ints, light: Ints | int, is_never: Bools, conditions: Iterable[_Condition]
    ) -> Bools:
        """Decide questions about cells: are all conditions true everywhere, or is one true nowhere?

        A question is about a pair of a cell and a face, and has several conditions.  A condition is
        true where its function u + v s is positive.  If a question stays undecided, those of its
        functions that may change their signs in the cell are added to `self._edges`.

        Parameters
        ----------
        pair : (n,) int array
            The pair of each question.
        light : (n,) int array, or int
            The light whose radiance depends on the question, or -1 if all radiance does.
        is_never : (n,) bool array
            Changed in place: set to True where a condition is false everywhere in the cell.  This
            happens after each item of `conditions`, so an iterator can skip questions that are
            already decided.
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
            low, high = self._enclose(pair[question], u, v).bounds()
            is_never[question[high <= 0]] = True
            is_always[question[~(low > 0)]] = False
            index = np.flatnonzero(~(low >= 0) & ~(high <= 0) & is_edge)
            edges.append((question[index], u[index], v[index]))
        for question, u, v in edges:
            index = np.flatnonzero(~is_never[question])
            question, v = question[index], v[index]
            v = v if isinstance(v, Form) else constant_form(v)
            self._edges.append(_Edges(pair[question], light[question], u[index], v))
        return is_always & ~is_never

    def _find_surfaces(self) -> None:
        """Enclose the inverse distance of each pair's face, and remove pairs that are not visible.

        The inverse distance is 1 / t = k.d + s, where the camera ray t d meets the face.  A pair is
        removed if its face is outside the cell, or hidden by another face everywhere in the cell.
        The silhouettes of the other faces are added to `self._edges`.

        The attributes `inverse`, `root` and `root2` are set.  In `cells`, `covers_cell` is updated.
        """
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        face, cell, is_planar = cells.pair_face, cells.pair_cell, faces.is_planar[cells.pair_face]
        ball, cone, root = np.flatnonzero(~is_planar), *np.zeros((2, 8, face.size))
        rays, size = self._ray_directions(cell[ball]), np.full(ball.size, frame.max_ray_size)
        center, radius = faces.center[:, face[ball]], faces.radius[face[ball]]
        cone[:, ball] = _cone_function(center, radius, rays, size, rays, size)[0].coef
        self.root2, self.root = Form(cone * faces.w[face] ** 2), Form(root)
        self._linear_inverse = self.inverse = self._dot_with_rays(faces.k[:, face], cell)
        self._inverse_max_abs = self.inverse.max_abs
        is_outside = np.zeros(face.size, np.bool_)
        covers_cell = self._decide(
            np.arange(face.size), -1, is_outside, self._visibility_conditions(ball, Form(cone))
        )
        self.inverse, index = Form(self._linear_inverse.coef.copy()), ball[~is_outside[ball]]
        coef, rounding = self.root2[index].power(0.5).coef, self.inverse.coef[R, index]
        # The radius of s becomes its Z, which it shares with 1 / t, except for rounding errors.
        coef[Z], coef[R] = coef[R] + rounding, rounding
        root[:, index] = coef
        self.inverse.coef[:, index] += coef
        self.inverse.coef[R, index] = 0
        kept = ~(is_outside | self._is_hidden(covers_cell))
        self.cells, new_index = cells._replace(covers_cell=covers_cell).select_pairs(kept)
        remaining = [edges.take(np.flatnonzero(kept[edges.pair])) for edges in self._edges]
        self._edges = [edges._replace(pair=new_index[edges.pair]) for edges in remaining]
        self.inverse, self.root2, self.root = self.inverse[kept], self.root2[kept], self.root[kept]
        self._linear_inverse = self._linear_inverse[kept]
        self._inverse_max_abs = self.inverse.max_abs

    def _visibility_conditions(self, ball: Ints, cone: Form) -> Iterator[_Condition]:
        """Yield the conditions under which camera rays meet the face of a pair.

        The question of each condition is a pair.

        Parameters
        ----------
        ball : (n,) int array
            The pairs whose face is a sphere.
        cone : Form
            For each pair (8, p) whose face is a sphere with centre c and radius r: r^2 d^2 - |c x
            d|^2.  This is at least 0 if the line through the eye with direction d meets the sphere.

        Yields
        ------
        condition : _Condition
            First, the four half-spaces of the rims of all sides of boxes, one after the other.
            Then two conditions for all spheres that are not around the eye: the centre is ahead,
            and the line meets the sphere.  Pairs whose face is known to cover the cell are skipped.
        """
        faces, cells = self.faces, self.cells
        pair = np.flatnonzero(~cells.covers_cell & faces.is_planar[cells.pair_face])
        for half_spaces in faces.rim.swapaxes(0, 1):
            half_space = half_spaces[:, cells.pair_face[pair]]
            yield _Condition(pair, *self._side_function(pair, half_space), is_edge=True)
        # A sphere around the eye is in every direction.
        pair = ball[~cells.covers_cell[ball] & (faces.power[cells.pair_face[ball]] > 0)]
        center, no_root = faces.center[:, cells.pair_face[pair]], np.zeros(pair.size)
        # The cone extends in the opposite direction as well, where c.d is negative.
        ahead = self._dot_with_rays(center, cells.pair_cell[pair])
        yield _Condition(pair, ahead, no_root, is_edge=False)
        yield _Condition(pair, cone[pair], no_root, is_edge=True)

    def _is_hidden(self, covers_cell: Bools) -> Bools:
        """Find pairs of a cell and a face whose face is hidden everywhere in the cell.

        Only one occluder is tried in each cell: among the faces that cover the cell, the one with
        the largest lower bound on its inverse distance.

        Parameters
        ----------
        covers_cell : (p,) bool array
            Whether the face of each pair covers all of the cell.

        Returns
        -------
        is_hidden : (p,) bool array
            Whether the face is certainly behind the occluder.  If both are in the same plane, the
            object that comes first in the scene file hides the other one.
        """
        faces, inverse = self.faces, self.inverse
        cell, face = self.cells.pair_cell, self.cells.pair_face
        file_index = faces.prepared.surfaces.file_index[faces.object_index[face]]
        covering = np.flatnonzero(covers_cell)
        lower_bound = inverse[covering].bounds()[0]
        covering = covering[np.lexsort((-file_index[covering], lower_bound, cell[covering]))]
        occluder_of_cell = np.full(self.cells.x.size, -1)
        occluder_of_cell[cell[covering]] = covering  # the last one in each cell
        occluder = occluder_of_cell[cell]
        pair = np.flatnonzero((occluder >= 0) & (occluder != np.arange(cell.size)))
        occluder = occluder[pair]
        in_same_plane = (faces.plane[:, face[pair]] == faces.plane[:, face[occluder]]).all(axis=0)
        is_behind = difference_form(inverse[pair], inverse[occluder]).bounds()[1] < 0
        is_later = file_index[pair] > file_index[occluder]
        is_hidden = np.zeros(cell.size, np.bool_)
        is_hidden[pair] = np.where(in_same_plane, is_later, is_behind)
        return is_hidden

    def _height_function(self, pair: Ints, light: Ints) -> tuple[Form, Floats]:
        """Express the heights of lights above the tangent planes of faces, by functions u + v s.

        The height is divided by the distance t of the visible point from the eye.  It is positive
        if the light is in front of the face.  Here s is the root in the inverse distance of the
        face.

        Parameters
        ----------
        pair : (n,) int array
            Pairs of a cell and a face.
        light : (n,) int array
            The light of each pair, or -1 for the height of the eye.

        Returns
        -------
        u : Form
            Enclosures (8, n) of the part of the functions without s.
        v : (n,) float array
            The factors of s.
        """
        return self._side_function(pair, self.faces.height[:, light, self.cells.pair_face[pair]])

    def _find_terminators(self) -> None:
        """Find the lights below the horizon of the sphere, for each pair of a cell and a sphere.

        A light that is below the horizon everywhere in the cell becomes settled without adding
        radiance.  If it is below the horizon in a part of the cell, the terminator between the lit
        and the dark side is added to `self._edges`.
        """
        # Lights behind the plane of a rectangle are settled from the start.
        is_curved = ~self.faces.is_planar[self.cells.pair_face]
        pair, light = np.nonzero(~self.cells.is_settled & is_curved[:, None])
        is_unlit = np.zeros(pair.size, np.bool_)
        height = self._height_function(pair, light)
        is_above = _Condition(np.arange(pair.size), *height, is_edge=True)
        self._decide(pair, light, is_unlit, [is_above])
        self.cells.is_settled[pair[is_unlit], light[is_unlit]] = True

    def _bound_visible_parts(self) -> tuple[Floats, Floats]:
        """Bound the part of each pair's face that may be visible in the pair's cell.

        Returns
        -------
        center, half_size : (3, p) float arrays
            Centres and half sizes of bounding boxes in the scene's axes.  The boxes are widened by
            the rounding errors of hits.
        """
        faces, cells, frame = self.faces, self.cells, self.faces.frame
        center = frame.axes.T @ self._ray_directions(cells.pair_cell)[:, 0]
        half = np.abs(frame.axes[:2].T) @ np.array([self._half_right, self._half_down])
        low_ray, high_ray, eye = center - half[:, None], center + half[:, None], frame.eye[:, None]
        min_inverse, max_inverse = self.inverse.bounds()
        near, far = 1 / max_inverse, np.where(min_inverse > 0, 1 / min_inverse, np.inf)
        low, high = faces.bounding_box[:, :, cells.pair_face]
        low = np.fmax(low, eye + np.fmin(low_ray * near, low_ray * far))
        high = np.fmin(high, eye + np.fmax(high_ray * near, high_ray * far))
        error = faces.prepared.position_error[faces.object_index[cells.pair_face]]
        return 0.5 * (low + high), np.maximum(0.5 * (high - low), 0) + error

    def _find_shadows(self) -> None:
        """Find out which triples of a pair, a light and an occluder shade the face.

        A light becomes settled without adding radiance if a single occluder shades all of the face
        in the cell.  A triple is removed if (1) its occluder shades nothing of the face in the
        cell, or (2) its light is settled for the pair.  For the other triples, the edge of the
        shadow is added to `self._edges`.

        If the cells have the width `MAX_WIDTH`, all triples are searched for first.
        """
        cells = self.cells
        if cells.width == MAX_WIDTH:
            bounds = self._bound_visible_parts()
            triples = self.faces.find_occluders(*bounds, cells.pair_face, ~cells.is_settled.T)
            self.cells = cells = cells._replace(triples=triples)
        pair, light, occluder = cells.triples
        is_sphere, is_lit = occluder < self.faces.sphere_count, np.zeros(pair.size, dtype=np.bool_)
        cones = self._sphere_shadow_conditions(np.flatnonzero(is_sphere))
        boxes = self._box_shadow_conditions(np.flatnonzero(~is_sphere), is_lit)
        is_shaded = self._decide(pair, light, is_lit, chain(cones, boxes))
        cells.is_settled[pair[is_shaded], light[is_shaded]] = True
        self.cells = cells.select_triples(~is_lit & ~cells.is_settled[pair, light])

    def _sphere_shadow_conditions(self, triple: Ints) -> Iterator[_Condition]:
        """Yield the two conditions for the visible point of a face to be in a sphere's shadow.

        Let L be the light, C the sphere's centre, both relative to the eye, c = C - L, and r the
        radius.  The point p is in the shadow if it satisfies two conditions:

        1. It is inside the cone: |c x (p - L)| <= r |p - L|.
        2.  It is behind the plane where the cone touches the sphere: c.(p - L) >= |c|^2 - r^2.  The
           part of this plane inside the cone is inside the sphere.  So it is never an edge.

        The camera ray with direction d meets the face at p = t d, and 1 / t = k.d + s.  Divided by
        t, p - L is q - L s with q = d - L k.d.  The cross product c x (p - L) equals c x (p - C),
        in which nothing cancels however distant the light is.  Divided by t, p - C is w - C s with
        w = d - C k.d.  So the first condition is u + v s >= 0 with

            u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
            v = 2 ((c x C).(c x w) - r^2 L.q),

        and the second is c.d - (c.C - r^2) / t >= 0.

        Parameters
        ----------
        triple : (n,) int array
            The triples (a pair, a light and an occluder) whose occluders are spheres.

        Yields
        ------
        condition : _Condition
            The first condition for all triples, then the second.
        """
        faces, cells, (pair, light, ball) = self.faces, self.cells, self.cells.triples[:, triple]
        c, r2 = faces.to_center[:, light, ball], faces.radius[ball] ** 2
        position, center = faces.light_position[light].T, faces.center[:, ball]
        rays = self._ray_directions(cells.pair_cell[pair])
        inverse = self._linear_inverse.coef[:XX, pair]
        q, w = (rays - end[:, None] * inverse for end in (position, center))
        position2, center2, c2 = ((end * end).sum(axis=0) for end in (position, center, c))
        k_size = np.abs(faces.k[:, cells.pair_face[pair]]).sum(axis=0)
        q_size, w_size = (
            faces.frame.max_ray_size * (1 + np.sqrt(square) * k_size * 2)
            for square in (position2, center2)
        )
        u, across = _cone_function(c, faces.radius[ball], q, q_size, w, w_size)
        c_center, v = _cross_product(c, center[:, None]), np.zeros((8, triple.size))
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
        yield _Condition(triple, *self._side_function(pair, beyond), is_edge=False)

    def _box_shadow_conditions(self, triple: Ints, is_lit: Bools) -> Iterator[_Condition]:
        """Yield the conditions under which the visible point of a face is in the shadow of a box.

        The shadow volume is the intersection of at most nine half-spaces.

        Parameters
        ----------
        triple : (n,) int array
            The triples (a pair, a light and an occluder) whose occluders are boxes.
        is_lit : (q,) bool array
            For all triples of the cells, whether an earlier condition is false everywhere in the
            cell.  Such triples are skipped.  The array may change between two conditions.

        Yields
        ------
        condition : _Condition
            One half-space of all triples that are not skipped.
        """
        pair, light, box = self.cells.triples - [[0], [0], [self.faces.sphere_count]]
        for half_spaces, has_edge in zip(
            self.faces.shadow_volume.swapaxes(0, 1), self.faces.has_shadow_edge, strict=True
        ):
            pending = triple[~is_lit[triple]]
            half_space = half_spaces[:, light[pending], box[pending]]
            # A box that the light sees edge-on has fewer than nine planes.
            exists = half_space[:4].any(axis=0)
            pending = pending[exists]
            function = self._side_function(pair[pending], half_space[:, exists])
            yield _Condition(pending, *function, has_edge[light[pending], box[pending]])

    def _find_intersections(self) -> None:
        """Add lines to `self._edges` where the faces of two pairs of a cell may intersect.

        A point p on one face is on a plane if k.p - 1 = 0.  It is on a second sphere if it is on
        the plane that is the difference of both spheres' equations, p^2 - 2 c.p + power = 0.
        """
        faces, cells = self.faces, self.cells
        order = np.argsort(cells.pair_cell, kind="stable")
        cell_start = cells.pair_cell[order].searchsorted(cells.pair_cell[order])
        # Each pair of a cell with all earlier pairs of the cell.
        segments = list_segment_elements(np.arange(order.size) - cell_start, cell_start)
        pair, other = (order[index] for index in segments)
        is_planar = faces.is_planar[cells.pair_face[pair]]
        pair, other = np.where(is_planar, (other, pair), (pair, other))  # spheres first
        face, other_face = cells.pair_face[pair], cells.pair_face[other]
        differs_in_object = faces.object_index[face] != faces.object_index[other_face]
        differs_in_plane = (faces.plane[:, face] != faces.plane[:, other_face]).any(axis=0)
        index = np.flatnonzero(differs_in_object & differs_in_plane)
        pair, face, other_face = pair[index], face[index], other_face[index]
        plane, ball = faces.equation[:, other_face], np.flatnonzero(~faces.is_planar[other_face])
        plane[:, ball] += faces.equation[:, face[ball]] * [[-1], [-1], [-1], [-1], [1]]
        function = self._side_function(pair, plane)
        crossing = _Condition(np.arange(pair.size), *function, is_edge=True)
        self._decide(pair, -1, np.zeros(pair.size, np.bool_), [crossing])

    def edge_functions(self) -> tuple[Ints, Ints, Form]:
        """Return all edge functions: the picture may have an edge only where one of them is zero.

        Each function is enclosed as u + v s, where s is the root in the inverse distance of a face.
        Near a silhouette, where s is steep, u^2 - v^2 s^2 has the same zeros, and is used if its
        unknown part is smaller relative to its slope.

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
        form = self._enclose(pair, u, v)

        def relative_width(form: Form) -> Floats:
            """Estimate the width of the strip around the zero of each function (8, n)."""
            size = np.abs(form.coef)
            return np.asarray(size[XX:].sum(axis=0) / np.maximum(size[X], size[Y]))

        index = np.flatnonzero(form.coef[Z])
        u, v = u[index], v[index]
        squares = u * u - self.root2[pair[index]] * v * v
        is_better = relative_width(squares) < relative_width(form[index])
        form.coef[:, index[is_better]] = squares.coef[:, is_better]
        return pair, light, form

    def shade(self, is_requested: Bools, error: float) -> Contributions:
        """Compute the radiance that unsettled lights add to pairs, and settle lights if possible.

        A light becomes settled for a pair of a cell and a face if (1) it has no edge there, so that
        it reaches all of the face in the cell, and (2) the error of its radiance is at most `error`
        divided by the number of lights.  The radiance of such a light is added to `cells.radiance`.

        Parameters
        ----------
        is_requested : (p,) bool array
            The pairs to shade.
        error : float
            Maximum error of the radiance that all settled lights add to a pair, in any channel.

        Returns
        -------
        contributions : Contributions
            The radiance of the lights that remain unsettled on the requested pairs.
        """
        contributions, cells = self._enclose_contributions(is_requested), self.cells
        has_edge = np.zeros_like(cells.is_settled)
        has_edge[cells.triples[0], cells.triples[1]] = True
        for pair, light, *_ in self._edges:
            has_edge[pair[light >= 0], light[light >= 0]] = True
        is_certain = ~has_edge[contributions.pair, contributions.light]
        light_count = cells.is_settled.shape[1]
        is_certain &= contributions.radiance.radius.max(axis=0) <= error / light_count
        settled = contributions.take(is_certain)
        add_at_sorted_index(cells.radiance.coef, settled.pair, settled.radiance.coef)
        cells.is_settled[settled.pair, settled.light] = True
        return contributions.take(~is_certain)

    def _enclose_contributions(self, is_requested: Bools) -> Contributions:
        """Enclose the radiance that each unsettled light adds to pairs, where it reaches the face.

        Distances are divided by the distance t of the visible point p = t d from the eye.  For a
        light at q relative to the eye, |p - q|^2 / t^2 is d^2 - 2 q.d / t + q^2 / t^2, and (q -
        p).(-p) / t^2 is d^2 - q.d / t.  Let n, l and v be the unit normal and the unit vectors to
        the light and to the eye.  Then the Blinn-Phong term n.h is (n.l + n.v) / |l + v|, and |l +
        v|^2 = 2 + 2 l.v.

        Parameters
        ----------
        is_requested : (p,) bool array
            The pairs to shade.

        Returns
        -------
        contributions : Contributions
            The radiance for all unsettled lights of the requested pairs, sorted by pair and light.
        """
        faces, cells, prepared = self.faces, self.cells, self.faces.prepared
        pair, light = np.nonzero(~cells.is_settled & is_requested[:, None])
        height = self._enclose(pair, *self._height_function(pair, light))
        cell, obj = cells.pair_cell[pair], faces.object_index[cells.pair_face[pair]]
        q = faces.light_position[light].T
        square, along = self.square[cell], self.inverse[pair] * self._dot_with_rays(q, cell)
        inverse2 = (self.inverse * self.inverse)[pair]
        distance2 = square - along * 2.0 + inverse2 * (q * q).sum(axis=0)
        inverse_distance = distance2.power(-0.5, _MIN_SQUARE)
        n_dot_l = (height * inverse_distance).clamp_to_unit_interval()
        intensity = faces.prepared_lights.intensity[light].T
        radiance = n_dot_l.coef[:, None] * (intensity * prepared.diffuse[:, obj])
        glossy = np.flatnonzero(prepared.is_glossy[obj])
        glossy_pair, position = np.unique(pair[glossy], return_inverse=True)
        inverse_length = self.square.power(-0.5)
        eye_function = self._height_function(glossy_pair, 0 * glossy_pair - 1)
        eye_height = self._enclose(glossy_pair, *eye_function)
        n_dot_v = eye_height * inverse_length[cells.pair_cell[glossy_pair]]
        l_dot_v = (square[glossy] - along[glossy]) * (
            inverse_distance[glossy] * inverse_length[cell[glossy]]
        )
        inverse_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)
        n_dot_h = ((n_dot_l[glossy] + n_dot_v[position]) * inverse_sum).clamp_to_unit_interval()
        lobe = n_dot_h.power(prepared.exponent[obj[glossy]], 0.0, 1.0).clamp_to_unit_interval()
        specular = intensity[:, glossy] * prepared.specular[:, obj[glossy]]
        radiance[..., glossy] += lobe.coef[:, None] * specular
        return Contributions(pair, light, Form(radiance))
