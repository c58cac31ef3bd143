"""Enclose everything in cells of the picture: distances, edges, shadows and radiance.

The problem: for each pair (a cell, and a face that may be visible in it), decide what is
the same everywhere in the cell, and find all edges where the picture may change.  The tool is the
*edge function*, which is positive on one side of an edge and negative on the other.  Silhouettes,
intersections of surfaces, terminators and shadow edges are zeros of such functions.  If a function
has the same sign everywhere in a cell, it decides a case there.  Otherwise the cell may contain an
edge.

On a face, every edge function has the form u + v s.  Here u and v are polynomials of degree two, or
less, in the ray's direction, and s is the square-root term of the inverse distance (see `faces`; s
is 0 on rectangles).  Polynomials with error bounds (see `enclosures`) enclose u, v and s, and so
the function.  Near a silhouette, where s has an infinite slope, the polynomial u^2 - v^2 s^2 is a
better edge function: it contains s^2 only, and is zero wherever u + v s is.

Why the result is right: a case counts as decided only if the enclosure of its function has one
sign, and every other function is listed as an edge.

Rounding.  Linear functions are sums of three products.  Their rounding error is at most 4 e times
the sum of the products, with e = 2^-53.  The rounding error of the quadratic polynomials of cones
is at most 20 e times (r^2 + |c|^2) |q|^2.  The error bounds contain at least 900 e times the same
sums, so they also cover the rounding errors of earlier results: centres relative to the eye, and
planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints, add_at_sorted_index, list_segment_elements
from reference.judges.cells import MAX_WIDTH, Cells
from reference.judges.enclosures import CONSTANT, RADIUS, ROUNDING, UNKNOWN, X_SQUARED, Enclosures
from reference.judges.faces import Faces
from reference.judges.vectors import cross_product, squared_length

# Squared distances, and |l + v|^2 of two unit vectors, are positive.  Their lower bounds are raised
# to this number before a negative power is computed.
_MIN_SQUARE = 1e-300


class Contributions(NamedTuple):
    """The radiance that each of n (pair, light) combinations adds, sorted by pair and light.

    A pair is one face (a sphere, or a side of a box) in one cell (a square part of the picture).

    Attributes
    ----------
    pair, light : (n,) int arrays
        Indices of the pair and of the light of each contribution.
    radiance : Enclosures
        Enclosures (8, 3, n) of the radiance that the face reflects to the eye wherever the light
        reaches it.  The first axis holds the coefficients of a polynomial and its error bound;
        the second holds the three channels.
    """

    pair: Ints
    light: Ints
    radiance: Enclosures

    def select(self, is_kept: Bools) -> Contributions:
        """Copy the contributions selected by a mask (n,)."""
        return Contributions(self.pair[is_kept], self.light[is_kept], self.radiance[is_kept])


class _Condition(NamedTuple):
    """One condition on each of n cases: it holds where a function u + v s is positive.

    A case asks something about one pair (one face in one cell), for example whether the face fills
    the cell.  A camera ray with direction d meets the face at the distance t, where
    1 / t = k.d + s.  Here k is a constant vector, and s is the square-root term, which is 0 for
    planes.

    Attributes
    ----------
    case_index : (n,) int array
        Indices of the cases.
    u, v : Enclosures, and Enclosures or (n,) float array
        The coefficients u and v of each function.  If v is an array, it is constant in each cell.
    is_edge : bool, or (n,) bool array
        Whether the picture may have an edge where the function is zero.
    """

    case_index: Ints
    u: Enclosures
    v: Enclosures | Floats
    is_edge: Bools | bool


def _enclose_cone(
    center: Floats, radius: Floats, sized_q: tuple[Floats, Floats], sized_w: tuple[Floats, Floats]
) -> tuple[Enclosures, Floats]:
    """Bound r^2 |q|^2 - |c x q|^2 over cells: it is positive at points inside a sphere's cone.

    The double cone consists of all lines through an apex that meet the sphere.  Here r is the
    sphere's radius, c is the vector from the apex to the sphere's centre, and q is the vector from
    the apex to the tested point.  The vectors q are linear in the position (X, Y) in a cell of the
    picture.

    Parameters
    ----------
    center, radius : (3, n) and (n,) float arrays
        The vectors c and the radii r.
    sized_q : (3, 3, n) and (n,) float arrays
        The vectors q, and for each an upper bound on the absolute value of any of its terms, which
        scales the rounding errors.  The first axis of q holds the components, the second the
        coefficients of 1, X and Y.
    sized_w : (3, 3, n) and (n,) float arrays
        Vectors w with c x w = c x q, and the same bounds for them.  Each w is q plus a multiple of
        c, chosen so that the rounding error of c x w is small.

    Returns
    -------
    cone : Enclosures
        Enclosures (8, n) of the function.
    c_cross_w : (3, 3, n) float array
        The cross products c x q, with the axes of q.
    """
    (q, q_size), (w, w_size) = sized_q, sized_w
    c_cross_w, coef = cross_product(center, w), np.zeros((8, center.shape[1]))
    coef[:UNKNOWN] = radius * radius * squared_length(q) - squared_length(c_cross_w)
    error_bound = radius * radius * q_size * np.abs(q).sum(axis=(0, 1))
    error_bound += (center * center).sum(axis=0) * w_size * np.abs(w).sum(axis=(0, 1))
    coef[RADIUS] = 8 * ROUNDING * error_bound
    return Enclosures(coef), c_cross_w


class CellAnalysis:
    """Inverse distances, edge functions and radiance in cells of the picture, with error bounds.

    A pair is one face (a sphere, or a side of a box) that may be visible in one cell (a square part
    of the picture).  A camera ray with direction d meets the face at the distance t, where
    1 / t = k.d + s.  Here k is a constant vector of the face, and s is the square-root term, which
    is 0 for planes.

    A quantity is enclosed everywhere in a cell by a quadratic polynomial in the coordinates X and
    Y, which run from -1 to 1 in the cell.  Its array (8, n) holds in rows 0 to 5 the coefficients
    of 1, X, Y, X^2, X Y and Y^2, in row 6 the coefficient of an unknown Z from -1 to 1, and in row
    7 (RADIUS) an error bound.

    Attributes
    ----------
    faces : Faces
        The spheres and the sides of boxes in the scene.
    cells : Cells
        The cells, without pairs and triples that proved irrelevant.
    squared_direction : Enclosures
        Enclosures (8, c) of d^2, the squared length of the ray directions, one for each cell.
    inverse_distance : Enclosures
        Enclosures (8, p) of 1 / t, one for each pair.
    squared_root_term, root_term : Enclosures
        Enclosures (8, p) of s^2 and of s, one for each pair.  The unknown Z is the same in s and in
        1 / t.
    """

    def __init__(self, faces: Faces, cells: Cells) -> None:
        """Find the visible faces of each cell, the lights that reach them, and all possible edges.

        A pair is one face in one cell.  A triple is a pair, a light, and an object that may shade
        the face from the light.  A light is settled for a pair if it is known to reach all of the
        face in the cell, or nothing of it.

        Parameters
        ----------
        faces : Faces
            The spheres and the sides of boxes in the scene.
        cells : Cells
            The cells, which are not changed.  The attribute `cells` is a copy without irrelevant
            pairs and triples, in which more lights are settled.
        """
        self.faces, self.cells, frame = faces, cells, faces.frame
        # Directions of camera rays as functions of the position in each cell.  The first axis holds
        # the components (to the right, down, ahead), the second the coefficients of 1, X and Y.
        self._rays = rays = np.zeros((3, 3, cells.x.size))
        rays[:2, 0], rays[2, 0] = (frame.ray_right(cells.x), frame.ray_down(cells.y)), frame.depth
        pixel_size = np.array([[frame.pixel_width], [frame.pixel_height]])
        rays[0, 1], rays[1, 2] = self._half_cell_size = cells.width / 2 * pixel_size
        coef = np.zeros((8, cells.x.size))
        coef[:UNKNOWN] = squared_length(rays)
        coef[RADIUS] = ROUNDING * coef[CONSTANT]
        self.squared_direction = Enclosures(coef)
        # Pairs, lights (or -1) and enclosures of edge functions.
        self._edges: list[tuple[Ints, Ints, Enclosures]] = []
        self._find_visible_faces()
        self._find_terminators()
        self._find_shadows()
        if cells.width <= 1:
            self._find_intersections()

    def _dot_with_rays(self, vectors: Floats, cell: Ints) -> Enclosures:
        """Enclose the dot products of constant vectors with the ray directions in their cells.

        Parameters
        ----------
        vectors : (3, n) float array
            The constant vectors, in the camera's axes (to the right, down, ahead).
        cell : (n,) int array
            For each vector, the index of the cell.

        Returns
        -------
        product : Enclosures
            Enclosures (8, n) of the dot products, which are linear in the position (X, Y) in the
            cell.  Only rows 0 to 2 (coefficients of 1, X and Y) and row 7 (RADIUS) are not zero.
        """
        coef, max_ray_size = np.zeros((8, cell.size)), self.faces.frame.max_ray_size
        coef[CONSTANT] = (vectors * self._rays[:, 0].take(cell, axis=1)).sum(axis=0)
        coef[CONSTANT + 1 : X_SQUARED] = vectors[:2] * self._half_cell_size
        coef[RADIUS] = ROUNDING * max_ray_size * np.abs(vectors).sum(axis=0)
        return Enclosures(coef)

    def _half_space_function(self, pair: Ints, half_space: Floats) -> tuple[Enclosures, Floats]:
        """Find u and v such that u + v s is positive where a ray meets a face inside a half-space.

        Let n.x + b >= 0 be the half-space.  The ray with direction d meets the face at x = t d,
        where 1 / t = k.d + s.  Here k is a constant vector, and s is the square-root term, which is
        0 for planes.  The point is in the half-space if n.d + b / t >= 0, where
        n.d + b / t = (n.d + b k.d) + b s.

        Parameters
        ----------
        pair : (n,) int array
            Indices of pairs.  A pair is one face in one cell.
        half_space : (5, n) float array
            One half-space for each pair.  Rows 0 to 2 contain n, and row 3 contains b.  Row 4
            contains the sum of the absolute values of the terms of b, to which the rounding error
            of b is proportional.

        Returns
        -------
        u : Enclosures
            Enclosures (8, n) of u = n.d + b k.d in the cells of the pairs.
        v : (n,) float array
            The coefficients v = b.
        """
        *normal, b, b_size = half_space
        u = self._dot_with_rays(np.array(normal), self.cells.pair_cell[pair])
        u += self._linear_term[pair] * b
        u.coef[RADIUS] += ROUNDING * b_size * self._max_inverse_distance[pair]
        return u, b

    def _enclose_functions(self, pair: Ints, u: Enclosures, v: Enclosures | Floats) -> Enclosures:
        """Enclose functions u + v s over cells, where s depends on the ray and the surface.

        The ray with direction d meets the surface at the distance t, where 1 / t = k.d + s with a
        constant vector k.  For spheres, s is a square root; for planes, it is 0.

        Parameters
        ----------
        pair : (n,) int array
            For each function, the index of its pair.  A pair is one face in one cell.
        u, v : Enclosures, and Enclosures or (n,) float array
            The coefficients u and v.  If the face is a side of a box, v is ignored.

        Returns
        -------
        functions : Enclosures
            Enclosures (8, n) of the functions in the cells of the pairs.
        """
        coef = u.coef.copy()
        # Indices of the functions on spheres; on sides of boxes, s is 0.
        spherical = np.flatnonzero(~self.faces.is_planar[self.cells.pair_face[pair]])
        coef[:, spherical] += (self.root_term[pair[spherical]] * v[spherical]).coef
        return Enclosures(coef)

    def _decide(
        self, pair: Ints, light: Ints | int, is_false: Bools, conditions: Iterable[_Condition]
    ) -> Bools:
        """Decide which cases are true everywhere in their cell, and which are false everywhere.

        Each of n cases concerns one pair (one face in one cell).  It is true where all of its
        conditions hold.  A condition holds where its function u + v s is positive.  Here s is the
        square-root term of the face's inverse distance: a ray with direction d meets the face at
        the distance t, where 1 / t = k.d + s with a constant vector k.

        If a case remains undecided, each of its functions that may have both signs in the cell is
        listed as an edge, except where `is_edge` of its condition is False.

        Parameters
        ----------
        pair : (n,) int array
            For each case, the index of its pair.
        light : (n,) int array, or int
            For each case, the light whose radiance depends on the decision, or -1 if all radiance
            depends on it.
        is_false : (n,) bool array
            Changed in place: set to True for each case with a condition that holds nowhere in the
            cell.  This happens after each item of `conditions`, so that an iterator can skip the
            cases that are already decided.
        conditions : iterable of _Condition
            Each item holds one condition on some of the cases.

        Returns
        -------
        is_true : (n,) bool array
            Whether all conditions on the case hold everywhere in the cell.
        """
        is_true, light = np.ones(pair.size, np.bool_), np.broadcast_to(light, pair.shape)
        possible_edges = []
        for case, u, v, is_edge in conditions:
            functions = self._enclose_functions(pair[case], u, v)
            low, high = functions.bounds()
            is_false[case[high <= 0]] = True
            is_true[case[~(low > 0)]] = False
            # Indices of functions that may have both signs.
            mixed = np.flatnonzero(~(low >= 0) & ~(high <= 0) & is_edge)
            possible_edges.append((case[mixed], functions[mixed], u[mixed], v[mixed]))
        for case, functions, u, v in possible_edges:
            index = np.flatnonzero(~is_false[case])
            edge_pair, edge_light = pair[case[index]], light[case[index]]
            edges = self._narrow_edge_functions(edge_pair, functions[index], u[index], v[index])
            self._edges.append((edge_pair, edge_light, edges))
        return is_true & ~is_false

    def _narrow_edge_functions(
        self, pair: Ints, functions: Enclosures, u: Enclosures, v: Enclosures | Floats
    ) -> Enclosures:
        """Replace edge functions u + v s with u^2 - v^2 s^2 where the enclosure is then narrower.

        The picture may have an edge where such a function is zero.  Here s is the square-root term
        of a face's inverse distance: a ray with direction d meets the face at the distance t, where
        1 / t = k.d + s with a constant vector k.  Near a silhouette, s is steep, so its enclosure
        is wide.  The second function is zero wherever the first is.

        Parameters
        ----------
        pair : (n,) int array
            For each function, the index of its pair.  A pair is one face in one cell.
        functions : Enclosures
            Enclosures (8, n) of u + v s in the cells of the pairs.  They are changed in place.
        u, v : Enclosures, and Enclosures or (n,) float array
            The coefficients u and v.

        Returns
        -------
        narrowed : Enclosures
            The narrower enclosure for each function, relative to its slope.
        """
        # Indices of the functions on spheres: elsewhere, s and the coefficient of Z are zero.
        spherical = np.flatnonzero(functions.coef[UNKNOWN])
        if spherical.size:
            u, v = u[spherical], v[spherical]
            narrowed = u * u - self.squared_root_term[pair[spherical]] * v * v
            is_narrower = narrowed.relative_width < functions[spherical].relative_width
            functions.coef[:, spherical[is_narrower]] = narrowed.coef[:, is_narrower]
        return functions

    def _find_visible_faces(self) -> None:
        """Enclose the inverse distance of each pair's face, and remove invisible pairs.

        A pair is one face in one cell.  A camera ray with direction d meets the face at the
        distance t, where 1 / t = k.d + s.  Here k is a constant vector, and s is the square-root
        term, which is 0 for planes.

        A pair is removed if its face is outside the cell, or if another face hides it everywhere in
        the cell.  For each remaining pair, the outline of the face is listed as an edge if it may
        cross the cell.

        The attributes `inverse_distance` (1 / t), `root_term` (s) and `squared_root_term` (s^2) are
        set.  In `cells`, `covers_cell` is updated.
        """
        faces, face, cell = self.faces, self.cells.pair_face, self.cells.pair_cell
        sphere_pair = np.flatnonzero(~faces.is_planar[face])
        discriminants = np.zeros((8, face.size))
        rays = self._rays[:, :, cell[sphere_pair]], np.array([faces.frame.max_ray_size])
        center, radius = faces.center[:, face[sphere_pair]], faces.radius[face[sphere_pair]]
        discriminants[:, sphere_pair] = _enclose_cone(center, radius, rays, rays)[0].coef
        # For a sphere with centre c and radius r, s^2 = w^2 (r^2 d^2 - |c x d|^2), where w is its
        # `root_coef` and the second factor its discriminant.
        self.squared_root_term = Enclosures(discriminants * faces.root_coef[face] ** 2)
        self.root_term = Enclosures(np.zeros((8, face.size)))
        self._linear_term = self._dot_with_rays(faces.linear_coef[:, face], cell)
        self._max_inverse_distance = self._linear_term.max_abs
        is_outside = np.zeros(face.size, np.bool_)
        conditions = self._hit_conditions(sphere_pair, Enclosures(discriminants))
        covers_cell = self._decide(np.arange(face.size), -1, is_outside, conditions)
        self.inverse_distance = Enclosures(self._linear_term.coef.copy())
        visible_pair = sphere_pair[~is_outside[sphere_pair]]
        coef = self.squared_root_term[visible_pair].power(0.5).coef
        rounding_error = self.inverse_distance.coef[RADIUS, visible_pair]
        # The error bound of s becomes the coefficient of the unknown Z, which s shares with 1 / t.
        # The new error bound covers only rounding errors.
        coef[UNKNOWN], coef[RADIUS] = coef[RADIUS] + rounding_error, rounding_error
        self.root_term.coef[:, visible_pair] = coef
        self.inverse_distance.coef[:, visible_pair] += coef
        self.inverse_distance.coef[RADIUS, visible_pair] = 0
        is_kept = ~(is_outside | self._find_hidden_pairs(covers_cell))
        self.cells, new_pair = self.cells._replace(covers_cell=covers_cell).select_pairs(is_kept)
        for i, (pair, light, functions) in enumerate(self._edges):
            kept_edge = np.flatnonzero(is_kept[pair])
            self._edges[i] = new_pair[pair[kept_edge]], light[kept_edge], functions[kept_edge]
        self.inverse_distance = self.inverse_distance[is_kept]
        self.root_term = self.root_term[is_kept]
        self.squared_root_term = self.squared_root_term[is_kept]
        self._linear_term = self._linear_term[is_kept]
        self._max_inverse_distance = self.inverse_distance.max_abs

    def _hit_conditions(self, sphere_pair: Ints, discriminants: Enclosures) -> Iterator[_Condition]:
        """Yield conditions for rays to hit each pair's face: four for boxes, two for spheres.

        A pair is one face in one cell.  Pairs whose face is known to cover the cell are skipped.

        Conditions 1 to 4 apply to the faces of boxes: the ray meets the plane of the face at a
        point inside each of the face's four edges.  Conditions 5 and 6 apply to spheres that
        do not contain the eye: the centre is in front of the eye, and the line that contains the
        ray meets the sphere.

        Parameters
        ----------
        sphere_pair : (n,) int array
            Indices of the pairs whose face is a sphere.
        discriminants : Enclosures
            Enclosures (8, p) of r^2 d^2 - |c x d|^2 for each pair with a sphere, where r is the
            radius, c the centre relative to the eye, and d the direction of a ray.  Positive where
            the line that contains the ray meets the sphere.

        Yields
        ------
        condition : _Condition
            One of the six conditions, with the indices of the pairs to which it applies as
            `case_index`.
        """
        faces, cells = self.faces, self.cells
        pair = np.flatnonzero(~cells.covers_cell & faces.is_planar[cells.pair_face])
        for half_spaces in faces.rim_half_spaces.swapaxes(0, 1):
            half_space = half_spaces[:, cells.pair_face[pair]]
            yield _Condition(pair, *self._half_space_function(pair, half_space), is_edge=True)
        # A sphere that contains the eye is visible in every direction.  The power of the eye,
        # |c|^2 - r^2, is positive outside the sphere.
        is_eye_outside = faces.eye_power[cells.pair_face[sphere_pair]] > 0
        pair = sphere_pair[~cells.covers_cell[sphere_pair] & is_eye_outside]
        center, zeros = faces.center[:, cells.pair_face[pair]], np.zeros(pair.size)
        # The lines that meet the sphere form a double cone.  Behind the eye, c.d is negative.
        center_dot_ray = self._dot_with_rays(center, cells.pair_cell[pair])
        yield _Condition(pair, center_dot_ray, zeros, is_edge=False)
        yield _Condition(pair, discriminants[pair], zeros, is_edge=True)

    def _find_hidden_pairs(self, covers_cell: Bools) -> Bools:
        """Find the pairs whose face is certainly hidden by another face everywhere in the cell.

        A pair is one face in one cell.  Only one occluder is tried in each cell: among the faces
        that cover the cell, the one with the largest lower bound on its inverse distance.

        Parameters
        ----------
        covers_cell : (p,) bool array
            For each pair, whether its face covers all of its cell.

        Returns
        -------
        is_hidden : (p,) bool array
            For each pair, whether its face is certainly behind the occluder.  If both are in the
            same plane, the one whose object comes first in the scene file hides the other.
        """
        faces, inverse_distance = self.faces, self.inverse_distance
        cell, face = self.cells.pair_cell, self.cells.pair_face
        file_index = faces.prepared.surfaces.file_index[faces.object_index[face]]
        covering_pair = np.flatnonzero(covers_cell)
        min_inverse = inverse_distance[covering_pair].bounds()[0]
        order = np.lexsort((-file_index[covering_pair], min_inverse, cell[covering_pair]))
        occluder_of_cell = np.full(self.cells.x.size, -1)
        # If a cell has several covering pairs, the last one remains.
        occluder_of_cell[cell[covering_pair[order]]] = covering_pair[order]
        occluder = occluder_of_cell[cell]
        pair = np.flatnonzero((occluder >= 0) & (occluder != np.arange(cell.size)))
        occluder = occluder[pair]
        plane_id = faces.plane_id[:, face]
        in_same_plane = (plane_id[:, pair] == plane_id[:, occluder]).all(axis=0)
        difference = inverse_distance[pair].subtract_independent(inverse_distance[occluder])
        is_behind, is_later = difference.bounds()[1] < 0, file_index[pair] > file_index[occluder]
        is_hidden = np.zeros(cell.size, np.bool_)
        is_hidden[pair] = np.where(in_same_plane, is_later, is_behind)
        return is_hidden

    def _light_height_function(self, pair: Ints, light: Ints) -> tuple[Enclosures, Floats]:
        """Find u and v such that u + v s is positive where a light is in front of a face.

        A ray with direction d meets the face at the distance t, where 1 / t = k.d + s.  Here k is a
        constant vector, and s is the square-root term, which is 0 for planes.  The function equals
        h / t, where h is the height of the light above the tangent plane at this point.

        Parameters
        ----------
        pair : (n,) int array
            Indices of pairs.  A pair is one face in one cell.
        light : (n,) int array
            For each pair, the index of a light, or -1 for the eye instead of a light.

        Returns
        -------
        u : Enclosures
            Enclosures (8, n) of u in the cells of the pairs.
        v : (n,) float array
            The coefficients v.
        """
        face = self.cells.pair_face[pair]
        return self._half_space_function(pair, self.faces.height_half_space[:, light, face])

    def _find_terminators(self) -> None:
        """Settle lights that are behind a sphere's surface, and list terminators as edges.

        A terminator is the curve between the lit and the dark side of a sphere.  For each sphere in
        each cell, every unsettled light is examined.  If the light is behind the surface everywhere
        in the cell, it is marked in `cells.is_settled`, and adds no radiance.  If it may be behind
        the surface in only a part of the cell, the terminator is listed as an edge.
        """
        # Lights behind the plane of a rectangle are settled from the start.
        is_on_sphere = ~self.faces.is_planar[self.cells.pair_face]
        pair, light = np.nonzero(~self.cells.is_settled & is_on_sphere[:, None])
        is_unlit = np.zeros(pair.size, np.bool_)
        height_function = self._light_height_function(pair, light)
        is_in_front = _Condition(np.arange(pair.size), *height_function, is_edge=True)
        self._decide(pair, light, is_unlit, [is_in_front])
        self.cells.is_settled[pair[is_unlit], light[is_unlit]] = True

    def _bound_visible_parts(self) -> tuple[Floats, Floats]:
        """Compute a bounding box of the part of each pair's face that may be visible in its cell.

        A pair is one face in one cell.

        Returns
        -------
        center, half_size : (3, p) float arrays
            For each pair, the centre and half the size of a box along the scene's axes, widened to
            allow for rounding errors.
        """
        faces, axes = self.faces, self.faces.frame.axes.T
        eye, rays = faces.frame.eye[:, None], self._rays[:, :, self.cells.pair_cell]
        center, half_size = axes @ rays[:, 0], np.abs(axes) @ rays[:, 1:].sum(axis=1)
        low_ray, high_ray = center - half_size, center + half_size
        min_inverse, max_inverse = self.inverse_distance.bounds()
        near, far = 1 / max_inverse, np.where(min_inverse > 0, 1 / min_inverse, np.inf)
        low, high = faces.bounding_box[:, :, self.cells.pair_face]
        low = np.fmax(low, eye + np.fmin(low_ray * near, low_ray * far))
        high = np.fmin(high, eye + np.fmax(high_ray * near, high_ray * far))
        position_error = faces.prepared.position_error[faces.object_index[self.cells.pair_face]]
        return 0.5 * (low + high), np.maximum(0.5 * (high - low), 0) + position_error

    def _find_shadows(self) -> None:
        """Settle lights that an object blocks throughout a cell, and list shadow edges.

        A pair is one face in one cell.  A triple is a pair, a light, and an occluder (an object
        that may shade the face from the light).  If the occluder shades all of the face in the
        cell, the light is marked in `cells.is_settled`, and adds no radiance.

        A triple is removed if (1) its occluder shades nothing of the face in the cell, or (2) its
        light is settled for the pair.  For each remaining triple, the shadow edges that may cross
        the cell are listed.

        If the cells have the width `MAX_WIDTH`, the triples are created first.
        """
        cells = self.cells
        if cells.width == MAX_WIDTH:
            boxes = self._bound_visible_parts()
            triples = self.faces.find_occluders(*boxes, cells.pair_face, ~cells.is_settled.T)
            self.cells = cells = cells._replace(triples=triples)
        pair, light, occluder = cells.triples
        is_sphere, is_lit = occluder < self.faces.sphere_count, np.zeros(pair.size, dtype=np.bool_)
        sphere_conditions = self._sphere_shadow_conditions(np.flatnonzero(is_sphere))
        box_conditions = self._box_shadow_conditions(np.flatnonzero(~is_sphere), is_lit)
        is_shaded = self._decide(pair, light, is_lit, chain(sphere_conditions, box_conditions))
        cells.is_settled[pair[is_shaded], light[is_shaded]] = True
        self.cells = cells.select_triples(~is_lit & ~cells.is_settled[pair, light])

    def _sphere_shadow_conditions(self, triple_index: Ints) -> Iterator[_Condition]:
        """Yield the two conditions under which the visible point of a face is in a sphere's shadow.

        Let L be the light, C the sphere's centre, and p the visible point, all relative to the eye.
        Let c = C - L, and let r be the radius.  The point is in the shadow if two conditions hold:

        1. It is inside the cone: |c x (p - L)| <= r |p - L|.
        2.  It is behind the plane where the cone touches the sphere: c.(p - L) >= |c|^2 - r^2.
            Inside the cone, this plane is inside the sphere, so it is never an edge.

        The camera ray with direction d meets the face at p = t d, where 1 / t = k.d + s.  Here k is
        a constant vector, and s is the square-root term, which is 0 for planes.  So
        (p - L) / t = q - L s with q = d - L k.d.  The cross product c x (p - L) equals
        c x (p - C), in which nothing cancels however distant the light is, and
        (p - C) / t = w - C s with w = d - C k.d.  Divided by t^2, the first condition is
        u + v s >= 0 with

            u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
            v = 2 ((c x C).(c x w) - r^2 L.q),

        and, divided by t, the second is c.d - (c.C - r^2) / t >= 0.

        Parameters
        ----------
        triple_index : (n,) int array
            Indices of the triples whose occluder is a sphere.  A triple is a pair (one face in one
            cell), a light and an occluder.

        Yields
        ------
        condition : _Condition
            Condition 1 for all triples, then condition 2.  Each has `triple_index` as its
            `case_index`.
        """
        faces, (pair, light, sphere) = self.faces, self.cells.triples[:, triple_index]
        cell, face = self.cells.pair_cell[pair], self.cells.pair_face[pair]
        to_center, radius2 = faces.to_center[:, light, sphere], faces.radius[sphere] ** 2
        position, center = faces.light_position[light].T, faces.center[:, sphere]  # L and C
        position2, center2, to_center2 = (
            (vector * vector).sum(axis=0) for vector in (position, center, to_center)
        )
        rays, linear_term = self._rays[:, :, cell], self._linear_term.coef[:X_SQUARED, pair]
        linear_size = 2 * np.abs(faces.linear_coef[:, face]).sum(axis=0)
        q, w = (rays - point[:, None] * linear_term for point in (position, center))
        q_size, w_size = (
            faces.frame.max_ray_size * (1 + np.sqrt(square) * linear_size)
            for square in (position2, center2)
        )
        u, c_cross_w = _enclose_cone(to_center, faces.radius[sphere], (q, q_size), (w, w_size))
        c_cross_center, v = cross_product(to_center, center[:, None]), np.zeros((8, pair.size))
        dot_of_crosses = (c_cross_center * c_cross_w).sum(axis=0)
        v[:X_SQUARED] = 2 * (dot_of_crosses - radius2 * (position[:, None] * q).sum(axis=0))
        v_size = to_center2 * np.sqrt(center2) * w_size + radius2 * np.sqrt(position2) * q_size
        v[RADIUS] = 16 * ROUNDING * v_size
        s2 = self.squared_root_term[pair]
        u += s2 * (radius2 * position2 - (c_cross_center * c_cross_center).sum(axis=(0, 1)))
        u.coef[RADIUS] += 16 * ROUNDING * (to_center2 * center2 + radius2 * position2) * s2.max_abs
        yield _Condition(triple_index, u, Enclosures(v), is_edge=True)
        products = to_center * center
        b, b_size = radius2 - products.sum(axis=0), radius2 + np.abs(products).sum(axis=0)
        function = self._half_space_function(pair, np.array([*to_center, b, b_size]))
        yield _Condition(triple_index, *function, is_edge=False)

    def _box_shadow_conditions(self, triple_index: Ints, is_lit: Bools) -> Iterator[_Condition]:
        """Yield the conditions under which the visible point of a face is in a box's shadow.

        The shadow is the intersection of at most nine half-spaces.

        Parameters
        ----------
        triple_index : (n,) int array
            Indices of the triples whose occluder is a box.  A triple is a pair (one face in one
            cell), a light and an occluder.
        is_lit : (q,) bool array
            For each triple of the cells, whether an earlier condition is false everywhere in the
            cell.  Such triples are skipped.  The caller can change this array between conditions.

        Yields
        ------
        condition : _Condition
            The condition that the visible point is in one of these half-spaces.  Its `case_index`
            holds the triples that are not skipped.
        """
        pair, light, box = self.cells.triples - [[0], [0], [self.faces.sphere_count]]
        for half_spaces, has_edge in zip(
            self.faces.shadow_volume.swapaxes(0, 1), self.faces.has_shadow_edge, strict=True
        ):
            pending = triple_index[~is_lit[triple_index]]
            half_space = half_spaces[:, light[pending], box[pending]]
            # A box seen edge-on from the light has fewer than nine planes.
            has_plane = half_space[:4].any(axis=0)
            pending = pending[has_plane]
            function = self._half_space_function(pair[pending], half_space[:, has_plane])
            yield _Condition(pending, *function, has_edge[light[pending], box[pending]])

    def _find_intersections(self) -> None:
        """List an edge wherever two faces of a cell may intersect.

        A plane has a linear equation n.p + b = 0 for its points p.  A sphere with centre c has the
        equation p^2 - 2 c.p + b = 0.  If both faces are spheres, the difference of their equations
        is linear.  So each intersection lies in a plane, and the picture may have an edge where the
        visible point of one face is on this plane.
        """
        faces, cells = self.faces, self.cells
        sorted_pairs = np.argsort(cells.pair_cell, kind="stable")
        cell_start = cells.pair_cell[sorted_pairs].searchsorted(cells.pair_cell[sorted_pairs])
        # Combine each pair (one face in one cell) with all earlier pairs of the same cell.
        segments = list_segment_elements(np.arange(sorted_pairs.size) - cell_start, cell_start)
        pair, other_pair = (sorted_pairs[index] for index in segments)
        # Of a sphere and a plane, the sphere comes first.
        is_planar = faces.is_planar[cells.pair_face[pair]]
        pair, other_pair = np.where(is_planar, (other_pair, pair), (pair, other_pair))
        face, other_face = cells.pair_face[pair], cells.pair_face[other_pair]
        differs_in_object = faces.object_index[face] != faces.object_index[other_face]
        differs_in_plane = (faces.plane_id[:, face] != faces.plane_id[:, other_face]).any(axis=0)
        kept = np.flatnonzero(differs_in_object & differs_in_plane)
        pair, face, other_face = pair[kept], face[kept], other_face[kept]
        plane, both_spheres = faces.equation[:, other_face], ~faces.is_planar[other_face]
        sphere_equation = faces.equation[:, face[both_spheres]]
        plane[:, both_spheres] += sphere_equation * [[-1], [-1], [-1], [-1], [1]]
        function = self._half_space_function(pair, plane)
        is_beyond_plane = _Condition(np.arange(pair.size), *function, is_edge=True)
        self._decide(pair, -1, np.zeros(pair.size, np.bool_), [is_beyond_plane])

    def edge_functions(self) -> tuple[Ints, Ints, Enclosures]:
        """Return all edge functions; the picture can have an edge only where one of them is zero.

        Each function belongs to a pair (one face in one cell).

        Returns
        -------
        pair : (n,) int array
            For each function, the index of its pair.
        light : (n,) int array
            For each function, the light whose radiance changes at the edge, or -1 if all radiance
            changes.
        functions : Enclosures
            Enclosures (8, n) of the functions in the cells of the pairs.
        """
        pairs, lights, functions = zip(*self._edges, strict=True)
        coef = np.concatenate([enclosures.coef for enclosures in functions], axis=1)
        return np.concatenate(pairs), np.concatenate(lights), Enclosures(coef)

    def shade(self, is_requested: Bools, error: float) -> Contributions:
        """Compute the radiance due to unsettled lights; settle those without an edge in the cell.

        A pair is one face in one cell.  A light is settled for a pair if `cells.radiance` already
        contains the light's contribution.  A light becomes settled if (1) it has no edge in the
        cell, so that it reaches all of the face there, and (2) the error of its radiance is at most
        `error` divided by the number of lights.  Its radiance is then added to `cells.radiance`,
        and the light is marked in `cells.is_settled`.

        Parameters
        ----------
        is_requested : (p,) bool array
            For each pair, whether to shade it.
        error : float
            Maximum error of a pair's radiance due to all settled lights together, in any channel.

        Returns
        -------
        contributions : Contributions
            For each requested pair and each light that remains unsettled: the indices of both, and
            an enclosure of the reflected radiance.
        """
        contributions, cells = self._enclose_contributions(is_requested), self.cells
        has_edge = np.zeros_like(cells.is_settled)
        has_edge[cells.triples[0], cells.triples[1]] = True
        for pair, light, _ in self._edges:
            has_edge[pair[light >= 0], light[light >= 0]] = True
        max_error = error / cells.is_settled.shape[1]
        is_certain = ~has_edge[contributions.pair, contributions.light]
        is_certain &= contributions.radiance.radius.max(axis=0) <= max_error
        settled = contributions.select(is_certain)
        add_at_sorted_index(cells.radiance.coef, settled.pair, settled.radiance.coef)
        cells.is_settled[settled.pair, settled.light] = True
        return contributions.select(~is_certain)

    def _enclose_contributions(self, is_requested: Bools) -> Contributions:
        """Enclose the radiance that each unsettled light adds wherever it reaches a face.

        A pair is one face in one cell.  A light is unsettled for a pair unless it is known to reach
        all or none of the face in the cell.

        The ray with direction d meets the face at p = t d, relative to the eye.  All lengths are
        divided by t.  For a light at q,

            |q - p|^2 / t^2 = d^2 - 2 q.d / t + q^2 / t^2,
            (q - p).(-p) / t^2 = d^2 - q.d / t.

        Let n be the unit normal, and let l and v be the unit vectors from p to the light and to the
        eye.  For the Blinn-Phong term, n.h = (n.l + n.v) / |l + v|, with |l + v|^2 = 2 + 2 l.v and
        the unit vector h halfway between l and v.

        Parameters
        ----------
        is_requested : (p,) bool array
            For each pair, whether to shade it.

        Returns
        -------
        contributions : Contributions
            For each requested pair and each of its unsettled lights: the indices of both, and an
            enclosure of the radiance.  Sorted by pair and light.
        """
        faces, cells, prepared = self.faces, self.cells, self.faces.prepared
        pair, light = np.nonzero(~cells.is_settled & is_requested[:, None])
        cell, object_index = cells.pair_cell[pair], faces.object_index[cells.pair_face[pair]]
        light_position = faces.light_position[light].T
        squared_direction = self.squared_direction[cell]
        # The dot products q.d, divided by t.
        dot_over_t = self.inverse_distance[pair] * self._dot_with_rays(light_position, cell)
        inverse_distance2 = (self.inverse_distance * self.inverse_distance)[pair]
        distance2 = squared_direction - dot_over_t * 2.0
        distance2 += inverse_distance2 * (light_position * light_position).sum(axis=0)
        inverse_length = distance2.power(-0.5, _MIN_SQUARE)  # t / |q - p|
        light_height = self._enclose_functions(pair, *self._light_height_function(pair, light))
        n_dot_l = (light_height * inverse_length).clamp_to_unit_interval()
        intensity = faces.prepared_lights.intensity[light].T
        radiance = n_dot_l.coef[:, None] * (intensity * prepared.diffuse[:, object_index])
        # Indices of the combinations whose face is glossy.
        glossy = np.flatnonzero(prepared.is_glossy[object_index])
        glossy_pair, pair_number = np.unique(pair[glossy], return_inverse=True)
        inverse_direction = self.squared_direction.power(-0.5)  # 1 / |d|
        eye_function = self._light_height_function(glossy_pair, 0 * glossy_pair - 1)
        eye_height = self._enclose_functions(glossy_pair, *eye_function)
        n_dot_v = eye_height * inverse_direction[cells.pair_cell[glossy_pair]]
        l_dot_v = (squared_direction[glossy] - dot_over_t[glossy]) * (
            inverse_length[glossy] * inverse_direction[cell[glossy]]
        )
        inverse_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)  # 1 / |l + v|
        n_dot_h = ((n_dot_l[glossy] + n_dot_v[pair_number]) * inverse_sum).clamp_to_unit_interval()
        glossy_object = object_index[glossy]
        lobe = n_dot_h.power(prepared.exponent[glossy_object], 0.0, 1.0).clamp_to_unit_interval()
        specular = intensity[:, glossy] * prepared.specular[:, glossy_object]
        radiance[..., glossy] += lobe.coef[:, None] * specular
        return Contributions(pair, light, Enclosures(radiance))
