"""Enclose everything in cells of the picture: distances, edges, shadows and radiance.

The problem: for each pair (a face that may be visible in a cell), decide what is the same
everywhere in the cell, and find all edges where the picture may change.  The tool is the *edge
function*, which is positive on one side of an edge and negative on the other.  Silhouettes,
intersections of surfaces, terminators and shadow edges are zeros of such functions.  A function
that has the same sign everywhere in a cell decides a question there.  Otherwise the cell may
contain an edge.

The point where a camera ray meets a face is the face's *visible point*.  Its inverse distance is
linear in the ray's direction, plus a square root if the face is a sphere: the *root term* (see
`faces`).  Therefore every edge function has the form

    smooth_part + root_factor * root_term,

where the first two are polynomials of degree two or less in the ray's direction.  Polynomials with
error bounds (see `enclosures`) enclose all three parts, and therefore the function.  Near a
silhouette, the root term is too steep.  There, smooth_part^2 - (root_factor * root_term)^2 is a
better edge function.  It has the same zeros, and perhaps others, but no root.

Why the result is right: a question counts as decided only if the enclosure of its function has one
sign, and every other function is listed as an edge.

Rounding.  Linear functions are sums of three products.  Their rounding error is at most 4 e times
the sum of the absolute values of the products, with e = 2^-53.  The rounding error of the quadratic
polynomials of cones is at most 20 e times (r^2 + |c|^2) |q|^2 (see `_enclose_cone`).  The error
bounds contain at least 900 e times the same sums, so they also cover the rounding errors of earlier
results: centres relative to the eye, and planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints, add_at_sorted_index, list_segment_elements
from reference.judges.cells import MAX_WIDTH, Cells, Contributions
from reference.judges.enclosures import CONSTANT, ERROR, ROUNDING, UNKNOWN_Z, X_SQUARED, Enclosures
from reference.judges.faces import Faces
from reference.judges.vectors import compute_cross_product, compute_squared_length

# Squared distances, and |l + v|^2 of two unit vectors, are positive.  Their lower bounds are raised
# to this number before a negative power is computed.
_MIN_SQUARE = 1e-300


class _RayFunctions(NamedTuple):
    """n functions of the camera ray, each for one pair (a cell and a face in it).

    A function is the sum smooth_part + root_factor * root_term.  The root term is the square root
    in the formula for the inverse distance of a sphere.  For a side of a box, it is 0.

    Attributes
    ----------
    pair_index : (n,) int array
        Indices of the pairs.
    smooth_part : Enclosures
        Enclosures (8, n) of the first terms.
    root_factor : Enclosures, or (n,) float array
        The factors of the root terms.  An array holds factors that are constant in the cell.
    """

    pair_index: Ints
    smooth_part: Enclosures
    root_factor: Enclosures | Floats

    def take(self, index: Ints) -> _RayFunctions:
        """Copy the functions selected by indices (k,)."""
        return _RayFunctions._make(field[index] for field in self)


class _Condition(NamedTuple):
    """A condition for each of n claims, which holds where a function is positive.

    A claim concerns a pair (a cell and a face in it), for example that the face covers the cell.

    Attributes
    ----------
    claim_index : (n,) int array
        Indices of the claims.
    functions : _RayFunctions
        The n functions of the camera ray.
    has_edge : bool, or (n,) bool array
        Whether the picture may have an edge where the function is zero; by default True.
    """

    claim_index: Ints
    functions: _RayFunctions
    has_edge: Bools | bool = True


def _enclose_cone(
    center: Floats, radius: Floats, points: Floats, shifted_points: Floats, sizes: Floats
) -> tuple[Enclosures, Floats]:
    """Enclose a function that is positive at points inside the cone around a sphere.

    The cone consists of all lines that contain its apex and meet the sphere.  Let c be the
    sphere's centre and q a point, both relative to the apex, and let r be the radius.  The function
    is r^2 |q|^2 - |c x q|^2.

    Parameters
    ----------
    center, radius : (3, n) and (n,) float arrays
        The centres c and the radii r.
    points : (3, 3, n) float array
        The points q, which depend linearly on the position (X, Y) in a cell.  The first axis holds
        the components; the second holds the coefficients of 1, X and Y.
    shifted_points : (3, 3, n) float array
        Each q plus a multiple of c, from which c x q can be computed with less rounding error.
    sizes : (2,) or (2, n) float array
        Upper bounds on the absolute values of the terms of `points` and of `shifted_points`.

    Returns
    -------
    cone : Enclosures
        Enclosures (8, n) of the function.
    cross : (3, 3, n) float array
        The cross products c x q, with the same axes as `points`.
    """
    (size, shifted_size), r2, c2 = sizes, radius * radius, (center * center).sum(axis=0)
    cross, coefficients = compute_cross_product(center, shifted_points), np.zeros((8, radius.size))
    coefficients[:UNKNOWN_Z] = r2 * compute_squared_length(points) - compute_squared_length(cross)
    error_bound = r2 * size * np.abs(points).sum(axis=(0, 1))
    error_bound += c2 * shifted_size * np.abs(shifted_points).sum(axis=(0, 1))
    coefficients[ERROR] = 8 * ROUNDING * error_bound
    return Enclosures(coefficients), cross


class CellAnalysis:
    """Inverse distances, edge functions and radiance in cells of the picture, with error bounds.

    A pair consists of a cell (a square part of the picture) and a face (a sphere, or a side of a
    box) that may be visible in it.  A camera ray with direction d meets the face at the distance t,
    where 1 / t = k.d + root_term.  Here k is a constant vector of the face.  The root term is a
    square root if the face is a sphere, and 0 if it is a side of a box.

    A quantity is enclosed everywhere in a cell by a quadratic polynomial in the coordinates X and
    Y, which run from -1 to 1 in the cell.  Rows 0 to 5 of its array (8, n) hold the coefficients of
    1, X, Y, X^2, X Y and Y^2.  Row 6 holds the coefficient of an unknown Z from -1 to 1, and row 7
    (ERROR) an error bound.

    Attributes
    ----------
    faces : Faces
        The spheres and the sides of boxes in the scene.
    cells : Cells
        The cells, without the pairs and occluders that proved irrelevant.
    squared_ray_length : Enclosures
        Enclosures (8, c) of d^2, the squared length of the ray directions, one for each cell.
    inverse_distance : Enclosures
        Enclosures (8, p) of 1 / t, one for each pair.
    root_term, root_term_squared : Enclosures
        Enclosures (8, p) of the root term and its square, one for each pair.  The unknown Z is the
        same in the root term and in 1 / t.
    """

    def __init__(self, faces: Faces, cells: Cells) -> None:
        """Find the faces visible in each cell, the lights that reach them, and all possible edges.

        Parameters
        ----------
        faces : Faces
            The spheres and the sides of boxes in the scene.
        cells : Cells
            The cells to analyse.  This object is not changed.
        """
        self.faces, self.cells, frame = faces, cells, faces.frame
        # Directions of camera rays, which depend linearly on the position (X, Y) in a cell.  The
        # first axis holds the components (right, down, ahead), the second the coefficients of 1, X
        # and Y.
        self._rays = rays = np.zeros((3, 3, cells.x.size))
        rays[:2, 0] = frame.to_ray_x(cells.x), frame.to_ray_y(cells.y)
        rays[2, 0] = frame.depth
        pixel_size = np.array([[frame.pixel_width], [frame.pixel_height]])
        rays[0, 1], rays[1, 2] = self._half_cell_size = cells.width / 2 * pixel_size
        coefficients = np.zeros((8, cells.x.size))
        coefficients[:UNKNOWN_Z] = compute_squared_length(rays)
        coefficients[ERROR] = ROUNDING * coefficients[CONSTANT]
        self.squared_ray_length = Enclosures(coefficients)
        # Indices of pairs and of lights (or -1), and enclosures of edge functions.
        self._edges: list[tuple[Ints, Ints, Enclosures]] = []
        self._find_visible_faces()
        self._find_terminators()
        self._find_shadows()
        if cells.width <= 1:
            self._find_intersections()

    def _dot_with_rays(self, vectors: Floats, cell_index: Ints) -> Enclosures:
        """Enclose the dot product of each vector with the directions of the camera rays in a cell.

        Parameters
        ----------
        vectors : (3, n) float array
            The vectors, in the camera's axes (right, down, ahead).
        cell_index : (n,) int array
            For each vector, the index of the cell.

        Returns
        -------
        product : Enclosures
            Enclosures (8, n) of the dot products.  All rows are zero except 0 to 2 (the
            coefficients of 1, X and Y) and 7 (ERROR).
        """
        coefficients, max_ray_size = np.zeros((8, cell_index.size)), self.faces.frame.max_ray_size
        coefficients[CONSTANT] = (vectors * self._rays[:, 0].take(cell_index, axis=1)).sum(axis=0)
        coefficients[CONSTANT + 1 : X_SQUARED] = vectors[:2] * self._half_cell_size
        coefficients[ERROR] = ROUNDING * max_ray_size * np.abs(vectors).sum(axis=0)
        return Enclosures(coefficients)

    def _express_half_space(self, pair_index: Ints, half_space: Floats) -> _RayFunctions:
        """Express half-spaces as functions of the camera ray.

        A function is positive where the ray meets the pair's face inside the half-space.

        Parameters
        ----------
        pair_index : (n,) int array
            Indices of pairs.  A pair consists of a cell and a face in it.
        half_space : (5, n) float array
            For each pair, a half-space n.x + b >= 0.  Rows 0 to 2 contain n, and row 3 contains b.
            Row 4 contains the sum of the absolute values of the terms of b.

        Returns
        -------
        functions : _RayFunctions
            One function of the camera ray for each pair.
        """
        # The ray with direction d meets the face at t d, where 1 / t is the sum of the linear term
        # and the root term.  There, n.x + b >= 0 becomes n.d + b / t >= 0, after division by t.
        *normal, b, b_abs_sum = half_space
        smooth_part = self._dot_with_rays(np.array(normal), self.cells.cell_index[pair_index])
        smooth_part += self._linear_term[pair_index] * b
        smooth_part.widen(ROUNDING * b_abs_sum * self._max_inverse_distance[pair_index])
        return _RayFunctions(pair_index, smooth_part, b)

    def _enclose_functions(self, functions: _RayFunctions) -> Enclosures:
        """Enclose functions of the camera ray by polynomials with error bounds.

        Parameters
        ----------
        functions : _RayFunctions
            n functions of the form smooth_part + root_factor * root_term, each for one pair (a cell
            and a face in it).  The root term is a square root for a sphere, and 0 for a side.

        Returns
        -------
        enclosures : Enclosures
            Enclosures (8, n) of the functions, each in the cell of its pair.
        """
        pair_index, smooth_part, root_factor = functions
        coefficients = smooth_part.coefficients.copy()
        function_index = np.flatnonzero(~self.faces.is_planar[self.cells.face_index[pair_index]])
        root_part = self.root_term[pair_index[function_index]] * root_factor[function_index]
        coefficients[:, function_index] += root_part.coefficients
        return Enclosures(coefficients)

    def _decide_claims(
        self, light_index: Ints | int, is_false: Bools, conditions: Iterable[_Condition]
    ) -> Bools:
        """Find the claims that are true everywhere in a cell, and list edges of undecided claims.

        A claim is a statement about a pair (a cell and a face in it), such as "the face covers the
        cell".  The claim is true wherever the functions of all its conditions are positive.  If the
        claim may be true in only a part of the cell, it is undecided.  Then each of its functions
        that may change sign in the cell is added to `_edges`, the list of possible edges.

        Parameters
        ----------
        light_index : (n,) int array, or int
            For each claim, the index of the light that it concerns, or -1 if it concerns no light.
        is_false : (n,) bool array
            For each claim, whether it is certainly false everywhere in its cell.  The array is
            updated in place after each condition, so later conditions can skip such claims.
        conditions : iterable of _Condition
            Conditions, each for some of the claims.  Those without `has_edge` give no edges.

        Returns
        -------
        is_true : (n,) bool array
            Whether the claim is certainly true everywhere in its cell.
        """
        light_index = np.broadcast_to(light_index, is_false.shape)
        is_true, possible_edges = np.ones(is_false.size, np.bool_), []
        for claim_index, functions, has_edge in conditions:
            enclosures = self._enclose_functions(functions)
            low, high = enclosures.find_bounds()
            is_false[claim_index[high <= 0]] = True
            is_true[claim_index[~(low > 0)]] = False
            # Indices of functions that may have both signs.
            index = np.flatnonzero(~(low >= 0) & ~(high <= 0) & has_edge)
            possible_edges.append((claim_index[index], functions.take(index), enclosures[index]))
        for claim_index, functions, enclosures in possible_edges:
            index = np.flatnonzero(~is_false[claim_index])
            edges = self._narrow_enclosures(functions.take(index), enclosures[index])
            self._edges += [(functions.pair_index[index], light_index[claim_index[index]], edges)]
        return is_true & ~is_false

    def _narrow_enclosures(self, functions: _RayFunctions, enclosures: Enclosures) -> Enclosures:
        """Replace the enclosures of edge functions on spheres with narrower ones, where possible.

        An enclosure is a polynomial with an error bound.  An edge function is smooth_part +
        root_factor * root_term, where the root term is a square root.  Near a silhouette, this root
        is steep, so the enclosure is wide.  The replacement encloses the expression smooth_part^2 -
        (root_factor * root_term)^2.  It has the same zeros, perhaps others, but no square root.

        Parameters
        ----------
        functions : _RayFunctions
            n edge functions.
        enclosures : Enclosures
            Enclosures (8, n) of the functions.  The enclosures are changed in place.

        Returns
        -------
        enclosures : Enclosures
            The same enclosures, each replaced if the replacement has a smaller `relative_width`.
        """
        # On sides of boxes, there is no unknown Z: its coefficient is 0.
        function_index = np.flatnonzero(enclosures.coefficients[UNKNOWN_Z])
        if function_index.size:
            pair_index, smooth_part, root_factor = functions.take(function_index)
            root_part_squared = self.root_term_squared[pair_index] * root_factor * root_factor
            replacement = smooth_part * smooth_part - root_part_squared
            is_narrower = replacement.relative_width < enclosures[function_index].relative_width
            enclosures[function_index[is_narrower]] = replacement[is_narrower]
        return enclosures

    def _find_visible_faces(self) -> None:
        """Remove invisible pairs, and enclose the inverse distance 1 / t of each remaining face.

        A pair consists of a cell and a face that may be visible in it.  A camera ray with direction
        d meets the face at t d.  A pair is removed if the face is outside the cell, or is hidden
        everywhere in it.  The outlines of the remaining faces become possible edges.

        The results are stored in `inverse_distance`, `root_term`, `root_term_squared` and `cells`.
        """
        faces, face_index, cell_index = self.faces, self.cells.face_index, self.cells.cell_index
        pair_index = np.flatnonzero(~faces.is_planar[face_index])
        sizes, zeros = np.full(2, faces.frame.max_ray_size), np.zeros((8, face_index.size))
        self.root_term, discriminants = Enclosures(zeros), Enclosures(zeros.copy())
        rays, sphere_index = self._rays[:, :, cell_index[pair_index]], face_index[pair_index]
        center, radius = faces.center[:, sphere_index], faces.radius[sphere_index]
        discriminants[pair_index], _ = _enclose_cone(center, radius, rays, rays, sizes)
        # The root term is the sphere's `root_coef` times the square root of its discriminant.
        self.root_term_squared = discriminants * faces.root_coef[face_index] ** 2
        self._linear_term = self._dot_with_rays(faces.linear_coef[:, face_index], cell_index)
        self._max_inverse_distance = self._linear_term.max_abs
        is_outside = np.zeros(face_index.size, np.bool_)
        covers_cell = self._decide_claims(-1, is_outside, self._make_hit_conditions(discriminants))
        self.inverse_distance = Enclosures(self._linear_term.coefficients.copy())
        hit_pair_index = pair_index[~is_outside[pair_index]]
        coefficients = self.root_term_squared[hit_pair_index].power(0.5).coefficients
        rounding_error = self.inverse_distance.coefficients[ERROR, hit_pair_index]
        # The error bound of the root term becomes the coefficient of the unknown Z, which the
        # inverse distance shares.  The new error bound covers only rounding errors.
        coefficients[UNKNOWN_Z] = coefficients[ERROR] + rounding_error
        coefficients[ERROR] = rounding_error
        self.root_term.coefficients[:, hit_pair_index] = coefficients
        self.inverse_distance.coefficients[:, hit_pair_index] += coefficients
        self.inverse_distance.coefficients[ERROR, hit_pair_index] = 0
        may_be_visible = ~(is_outside | self._find_hidden_pairs(covers_cell))
        cells = self.cells._replace(covers_cell=covers_cell)
        self.cells, new_index = cells.select_pairs(may_be_visible)
        for i, (pair_index, light_index, functions) in enumerate(self._edges):
            index = np.flatnonzero(may_be_visible[pair_index])
            self._edges[i] = new_index[pair_index[index]], light_index[index], functions[index]
        self.root_term = self.root_term[may_be_visible]
        self._linear_term = self._linear_term[may_be_visible]
        self.root_term_squared = self.root_term_squared[may_be_visible]
        self.inverse_distance = self.inverse_distance[may_be_visible]
        self._max_inverse_distance = self.inverse_distance.max_abs

    def _make_hit_conditions(self, discriminants: Enclosures) -> Iterator[_Condition]:
        """Yield the conditions under which camera rays hit the face of each pair.

        A pair consists of a cell and a face in it.  A ray hits a side of a box if it meets the
        side's plane within all four edges.  A ray hits a sphere if the sphere is ahead of the eye,
        and the ray's line meets the sphere.  There is no condition for faces that all rays hit.

        Parameters
        ----------
        discriminants : Enclosures
            Enclosures (8, p), one for each pair.  For a sphere, the enclosed function is positive
            where the ray's line meets the sphere.  Enclosures for sides of boxes are not used.

        Yields
        ------
        condition : _Condition
            A condition for some of the pairs.  Its `claim_index` lists these pairs.
        """
        faces, cells = self.faces, self.cells
        is_planar = faces.is_planar[cells.face_index]
        pair_index = np.flatnonzero(~cells.covers_cell & is_planar)
        for half_spaces in faces.rim_half_spaces.swapaxes(0, 1):
            half_space = half_spaces[:, cells.face_index[pair_index]]
            yield _Condition(pair_index, self._express_half_space(pair_index, half_space))
        pair_index = np.flatnonzero(~cells.covers_cell & ~is_planar)
        # If the eye is inside a sphere, all rays hit the sphere.
        pair_index = pair_index[faces.eye_power[cells.face_index[pair_index]] > 0]
        center, zeros = faces.center[:, cells.face_index[pair_index]], np.zeros(pair_index.size)
        projection = self._dot_with_rays(center, cells.cell_index[pair_index])
        # The zero of this function is no edge: there, the ray's line misses the sphere.
        yield _Condition(pair_index, _RayFunctions(pair_index, projection, zeros), has_edge=False)
        yield _Condition(pair_index, _RayFunctions(pair_index, discriminants[pair_index], zeros))

    def _find_hidden_pairs(self, covers_cell: Bools) -> Bools:
        """Find the pairs whose face is hidden by another face everywhere in the cell.

        A pair consists of a cell and a face in it.  In each cell, only one occluder is tested: the
        face that covers the cell and has the smallest upper bound on its distance.

        Parameters
        ----------
        covers_cell : (p,) bool array
            For each pair, whether its face covers all of the cell.

        Returns
        -------
        is_hidden : (p,) bool array
            For each pair, whether the occluder certainly hides its face.  If both are in the same
            plane, the face whose object comes first in the scene file hides the other.
        """
        faces, inverse_distance = self.faces, self.inverse_distance
        cell_index, face_index = self.cells.cell_index, self.cells.face_index
        file_index = faces.prepared_scene.surfaces.file_index[faces.object_index[face_index]]
        plane_id, covering_index = faces.plane_id[:, face_index], np.flatnonzero(covers_cell)
        min_inverse_distance, _ = inverse_distance[covering_index].find_bounds()
        sort_keys = -file_index[covering_index], min_inverse_distance, cell_index[covering_index]
        far_to_near = covering_index[np.lexsort(sort_keys)]
        occluder_index_by_cell = np.full(self.cells.x.size, -1)
        # If a cell has several covering pairs, the last one remains.  Index -1 stands for none.
        occluder_index_by_cell[cell_index[far_to_near]] = far_to_near
        occluder_index = occluder_index_by_cell[cell_index]
        has_occluder = (occluder_index >= 0) & (occluder_index != np.arange(cell_index.size))
        is_in_same_plane = (plane_id == plane_id[:, occluder_index]).all(axis=0)
        gap = inverse_distance.subtract_independent(inverse_distance[occluder_index])
        _, max_gap = gap.find_bounds()
        comes_later = file_index > file_index[occluder_index]
        return np.asarray(has_occluder & np.where(is_in_same_plane, comes_later, max_gap < 0))

    def _express_light_height(self, pair_index: Ints, light_index: Ints | int) -> _RayFunctions:
        """Express the heights of lights above faces as functions of the camera ray.

        A ray starts at the eye, which is the origin, and meets the face at the point t * d, where d
        is its direction.  The function is the light's height above the tangent plane of the face at
        this point, divided by t.  It is positive if the light is in front of the face.

        Parameters
        ----------
        pair_index : (n,) int array
            Indices of pairs.  A pair consists of a cell and a face in it.
        light_index : (n,) int array, or int
            For each pair, the index of a light.  Index -1 treats the eye as the light.

        Returns
        -------
        functions : _RayFunctions
            One function of the camera ray for each pair and light.
        """
        half_space = self.faces.height_half_space[:, light_index, self.cells.face_index[pair_index]]
        return self._express_half_space(pair_index, half_space)

    def _find_terminators(self) -> None:
        """Find terminators on spheres, and settle the lights that leave a sphere in a cell dark.

        A terminator is the curve between the lit and the dark side of a sphere.  If the sphere is
        certainly dark everywhere in a cell, the light is marked in `cells.is_settled`.  If only
        a part of the sphere may be dark, the terminator becomes a possible edge.
        """
        # Lights behind a side of a box are settled from the start.
        is_sphere = ~self.faces.is_planar[self.cells.face_index]
        pair_index, light_index = np.nonzero(~self.cells.is_settled & is_sphere[:, None])
        is_unlit = np.zeros(pair_index.size, np.bool_)
        heights = self._express_light_height(pair_index, light_index)
        self._decide_claims(light_index, is_unlit, [_Condition(np.arange(is_unlit.size), heights)])
        self.cells.is_settled[pair_index[is_unlit], light_index[is_unlit]] = True

    def _bound_visible_parts(self) -> tuple[Floats, Floats]:
        """Compute a box around the part of each face that may be visible in its cell.

        Returns
        -------
        center, half_size : (3, p) float arrays
            For each pair (a cell and a face in it), the box's centre and half size along the
            scene's axes.  The boxes are widened to allow for rounding errors.
        """
        faces, face_index, axes = self.faces, self.cells.face_index, self.faces.frame.axes.T
        eye, rays = faces.frame.eye[:, None], self._rays[:, :, self.cells.cell_index]
        center_ray, spread = axes @ rays[:, 0], np.abs(axes) @ rays[:, 1:].sum(axis=1)
        low_ray, high_ray = center_ray - spread, center_ray + spread
        inverse_far, inverse_near = self.inverse_distance.find_bounds()
        near, far = 1 / inverse_near, np.where(inverse_far > 0, 1 / inverse_far, np.inf)
        low, high = faces.bounding_box[:, :, face_index]
        low = np.fmax(low, eye + np.fmin(low_ray * near, low_ray * far))
        high = np.fmin(high, eye + np.fmax(high_ray * near, high_ray * far))
        position_error = faces.prepared_scene.position_error[faces.object_index[face_index]]
        return 0.5 * (low + high), np.maximum(0.5 * (high - low), 0) + position_error

    def _find_shadows(self) -> None:
        """Find shadow edges, and mark the lights that are blocked everywhere in a cell.

        A triple describes a possible shadow: a pair (a cell and a face in it), a light, and an
        object that may shade the face from the light.  If the object shades all of the face in the
        cell, the light is marked in `cells.is_settled`.  If it may shade only a part, the outline
        of its shadow becomes a possible edge.  Triples that no longer matter are removed.

        Cells of width `MAX_WIDTH` have no triples yet, so their triples are listed first.
        """
        cells = self.cells
        if cells.width == MAX_WIDTH:
            part_boxes = self._bound_visible_parts()
            triples = self.faces.find_occluders(*part_boxes, cells.face_index, ~cells.is_settled.T)
            self.cells = cells = cells._replace(shadow_triples=triples)
        pair_index, light_index, _ = cells.shadow_triples
        # `_decide_claims` updates `casts_no_shadow` after each condition.
        casts_no_shadow = np.zeros(pair_index.size, dtype=np.bool_)
        sphere_conditions = self._make_sphere_shadow_conditions()
        conditions = chain(sphere_conditions, self._make_box_shadow_conditions(casts_no_shadow))
        is_shaded = self._decide_claims(light_index, casts_no_shadow, conditions)
        cells.is_settled[pair_index[is_shaded], light_index[is_shaded]] = True
        is_settled = cells.is_settled[pair_index, light_index]
        self.cells = cells.select_triples(~casts_no_shadow & ~is_settled)

    def _make_sphere_shadow_conditions(self) -> Iterator[_Condition]:
        """Yield the conditions under which camera rays meet a face in the shadow of a sphere.

        First, the ray must meet the face inside the cone from the light around the sphere.  Second,
        the ray must meet the face behind the plane in which the cone touches the sphere.

        Yields
        ------
        condition : _Condition
            Functions of the camera ray that are positive where the condition holds, one for each
            triple whose occluder is a sphere.  A triple is a possible shadow: a pair (a cell and
            a face in it), a light, an occluder.
        """
        faces, cells = self.faces, self.cells
        triple_index = np.flatnonzero(cells.shadow_triples[2] < faces.sphere_count)
        pair_index, light_index, sphere_index = cells.shadow_triples[:, triple_index]
        radius, center = faces.radius[sphere_index], faces.center[:, sphere_index]
        position = faces.light_position[light_index].T
        to_center = faces.to_center[:, light_index, sphere_index]
        position2, center2, to_center2 = np.square([position, center, to_center]).sum(axis=1)
        # Let L be the light, C the sphere's centre, c = C - L, and r the radius.  The ray with
        # direction d meets the face at p = t d, where 1 / t = k.d + s with the root term s.
        # The point p is in the cone if |c x (p - L)| <= r |p - L|.  On the left, p - L can be
        # replaced by p - C, so that nothing cancels if the light is distant.  Divided by t, p - L
        # is q - L s with q = d - L k.d, and p - C is w - C s with w = d - C k.d.  Divided by t^2,
        # the condition is u + v s >= 0 with
        #     u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
        #     v = 2 ((c x C).(c x w) - r^2 L.q).
        rays = self._rays[:, :, cells.cell_index[pair_index]]
        linear_term = self._linear_term.coefficients[:X_SQUARED, pair_index]
        linear_size = 2 * np.abs(faces.linear_coef[:, cells.face_index[pair_index]]).sum(axis=0)
        q, w = (rays - point[:, None] * linear_term for point in (position, center))
        lengths, radius2 = np.sqrt([position2, center2]), radius**2
        q_size, w_size = sizes = faces.frame.max_ray_size * (1 + lengths * linear_size)
        u, c_cross_w = _enclose_cone(to_center, radius, q, w, sizes)
        c_cross_center = compute_cross_product(to_center, center[:, None])
        dot_of_crosses, v = (c_cross_center * c_cross_w).sum(axis=0), np.zeros((8, pair_index.size))
        v[:X_SQUARED] = 2 * (dot_of_crosses - radius2 * (position[:, None] * q).sum(axis=0))
        v_size = to_center2 * lengths[1] * w_size + radius2 * lengths[0] * q_size
        v[ERROR] = 16 * ROUNDING * v_size
        s2 = self.root_term_squared[pair_index]
        u += s2 * (radius2 * position2 - (c_cross_center * c_cross_center).sum(axis=(0, 1)))
        u.widen(16 * ROUNDING * (to_center2 * center2 + radius2 * position2) * s2.max_abs)
        yield _Condition(triple_index, _RayFunctions(pair_index, u, Enclosures(v)))
        # The second condition is c.(p - L) >= |c|^2 - r^2, which is c.p - c.C + r^2 >= 0.  The
        # plane is no edge: inside the cone, it lies inside the sphere.
        products = to_center * center
        b, b_abs_sum = radius2 - products.sum(axis=0), radius2 + np.abs(products).sum(axis=0)
        plane_functions = self._express_half_space(pair_index, np.array([*to_center, b, b_abs_sum]))
        yield _Condition(triple_index, plane_functions, has_edge=False)

    def _make_box_shadow_conditions(self, casts_no_shadow: Bools) -> Iterator[_Condition]:
        """Yield the conditions under which camera rays meet a face in the shadow of a box.

        The shadow is the intersection of at most nine half-spaces.  Each half-space gives one
        condition: the ray must meet the face inside it.

        Parameters
        ----------
        casts_no_shadow : (q,) bool array
            For each triple, whether the occluder certainly does not shade the face in the cell.
            A triple is a possible shadow: a pair (a cell and a face in it), a light, an occluder.
            The caller may update this array between conditions.

        Yields
        ------
        condition : _Condition
            A condition for all triples whose occluder is a box that may cast a shadow.
        """
        pair_index, light_index, occluder_index = self.cells.shadow_triples
        # Objects are numbered with spheres first.  Spheres have a negative box index.
        box_index = occluder_index - self.faces.sphere_count
        shadow_planes = self.faces.shadow_volume.swapaxes(0, 1)
        for half_spaces, has_edge in zip(shadow_planes, self.faces.has_shadow_edge, strict=True):
            index = np.flatnonzero((box_index >= 0) & ~casts_no_shadow)
            half_space = half_spaces[:, light_index[index], box_index[index]]
            # A box seen edge-on from the light has fewer than nine planes.
            has_plane = half_space[:4].any(axis=0)
            index = index[has_plane]
            functions = self._express_half_space(pair_index[index], half_space[:, has_plane])
            yield _Condition(index, functions, has_edge[light_index[index], box_index[index]])

    def _find_intersections(self) -> None:
        """Find possible edges where two faces intersect in a cell, and add them to `_edges`.

        The intersection of two faces lies in a plane.  The possible edge is where camera rays meet
        one of the faces in this plane.
        """
        faces, cells = self.faces, self.cells
        sorted_index = np.argsort(cells.cell_index, kind="stable")
        cell_start = cells.cell_index[sorted_index].searchsorted(cells.cell_index[sorted_index])
        # Combine each pair (a cell and a face in it) with all earlier pairs of the same cell.
        positions = list_segment_elements(np.arange(sorted_index.size) - cell_start, cell_start)
        pair_indices = sorted_index[np.array(positions)]
        # If only one of two faces is planar, make it the other face.
        is_planar = faces.is_planar[cells.face_index[pair_indices[0]]]
        pair_indices = np.where(is_planar, pair_indices[::-1], pair_indices)
        face_indices = cells.face_index[pair_indices]
        object_index, plane_id = faces.object_index[face_indices], faces.plane_id[:, face_indices]
        objects_differ = object_index[0] != object_index[1]
        may_intersect = objects_differ & (plane_id[:, 0] != plane_id[:, 1]).any(axis=0)
        pair_index, face_indices = pair_indices[0, may_intersect], face_indices[:, may_intersect]
        # If the other face is a sphere, both are.  The difference of their equations is linear.
        equation, plane = faces.face_equation[:, face_indices].swapaxes(0, 1)
        is_sphere = ~faces.is_planar[face_indices[1]]
        plane[:, is_sphere] += equation[:, is_sphere] * [[-1], [-1], [-1], [-1], [1]]
        functions = self._express_half_space(pair_index, plane)
        condition = _Condition(np.arange(pair_index.size), functions)
        self._decide_claims(-1, np.zeros(pair_index.size, np.bool_), [condition])

    def collect_edge_functions(self) -> tuple[Ints, Ints, Enclosures]:
        """Collect the edge functions of all cells.

        The picture can have an edge only where one of these functions is zero.

        Returns
        -------
        pair_index : (n,) int array
            For each function, the index of its pair (a cell and a face in it).
        light_index : (n,) int array
            For each function, the index of the light that is cut off at the edge, or -1 if the
            visible face changes there.
        functions : Enclosures
            Enclosures (8, n) of the functions in the cells of the pairs.
        """
        pair_indices, light_indices, functions = zip(*self._edges, strict=True)
        coefficients = np.concatenate([enclosures.coefficients for enclosures in functions], axis=1)
        return np.concatenate(pair_indices), np.concatenate(light_indices), Enclosures(coefficients)

    def shade(self, is_requested: Bools, permitted_error: float) -> Contributions:
        """Compute the radiance from unsettled lights, and settle those with accurate results.

        A pair consists of a cell and a face in it.  A light is settled for a pair if no terminator
        or shadow edge of the light can cross the cell, and its radiance is accurate enough.  This
        radiance is then added to `cells.radiance`, and the light is marked in `cells.is_settled`.

        Parameters
        ----------
        is_requested : (p,) bool array
            For each pair, whether to compute its radiance.
        permitted_error : float
            Permitted error of the radiance that a face reflects from all settled lights together,
            in any channel.  Each light may cause an equal part of this error.

        Returns
        -------
        contributions : Contributions
            The radiance that each remaining unsettled light adds to each requested pair.
        """
        contributions, cells = self._enclose_contributions(is_requested), self.cells
        has_edge = np.zeros_like(cells.is_settled)
        has_edge[cells.shadow_triples[0], cells.shadow_triples[1]] = True
        for pair_index, light_index, _ in self._edges:
            has_edge[pair_index[light_index >= 0], light_index[light_index >= 0]] = True
        max_light_error = permitted_error / cells.is_settled.shape[1]
        is_newly_settled = ~has_edge[contributions.pair_index, contributions.light_index]
        is_newly_settled &= contributions.radiance.max_deviation.max(axis=0) <= max_light_error
        pair_index, light_index, radiance = contributions.select(is_newly_settled)
        add_at_sorted_index(cells.radiance.coefficients, pair_index, radiance.coefficients)
        cells.is_settled[pair_index, light_index] = True
        return contributions.select(~is_newly_settled)

    def _enclose_contributions(self, is_requested: Bools) -> Contributions:
        """Enclose the radiance that lit points of a face reflect from each unsettled light.

        A light is unsettled if it is not known to reach all of the face in the cell, or none of it.

        Parameters
        ----------
        is_requested : (p,) bool array
            For each pair (a cell and a face in it), whether to enclose its radiance.

        Returns
        -------
        contributions : Contributions
            Radiance from each unsettled light for each requested pair, sorted by pair and light.
        """
        faces, cells, scene = self.faces, self.cells, self.faces.prepared_scene
        pair_index, light_index = np.nonzero(~cells.is_settled & is_requested[:, None])
        cell_index = cells.cell_index[pair_index]
        object_index = faces.object_index[cells.face_index[pair_index]]
        light_position = faces.light_position[light_index].T
        squared_ray_length = self.squared_ray_length[cell_index]
        # The ray with direction d meets the face at p = t d, relative to the eye.  All lengths are
        # divided by t, and squared lengths by t^2.  For a light at q, this gives
        #     |q - p|^2 = d^2 - 2 q.d / t + q^2 / t^2  and  (q - p).(-p) = d^2 - q.d / t.
        q_dot_d = self._dot_with_rays(light_position, cell_index)
        q_dot_d_over_t = self.inverse_distance[pair_index] * q_dot_d
        inverse_distance2 = (self.inverse_distance * self.inverse_distance)[pair_index]
        light_distance2 = squared_ray_length - q_dot_d_over_t * 2.0
        light_distance2 += inverse_distance2 * (light_position * light_position).sum(axis=0)
        inverse_light_distance = light_distance2.power(-0.5, _MIN_SQUARE)  # t / |q - p|
        light_height = self._enclose_functions(self._express_light_height(pair_index, light_index))
        n_dot_l = (light_height * inverse_light_distance).fall_back_to_unit_interval()
        intensity = faces.prepared_lights.intensity[light_index].T
        radiance = n_dot_l.coefficients[:, None] * (intensity * scene.diffuse[:, object_index])
        # Let n be the unit normal, l and v the unit vectors to the light and to the eye, and h the
        # unit vector halfway between them.  Then n.h = (n.l + n.v) / |l + v|, and
        # |l + v|^2 = 2 + 2 l.v.  Only glossy faces have this term.
        glossy_index = np.flatnonzero(scene.is_glossy[object_index])
        glossy_pair_index, pair_number = np.unique(pair_index[glossy_index], return_inverse=True)
        inverse_ray_length = self.squared_ray_length.power(-0.5)  # 1 / |d|
        eye_height = self._enclose_functions(self._express_light_height(glossy_pair_index, -1))
        n_dot_v = eye_height * inverse_ray_length[cells.cell_index[glossy_pair_index]]
        scale = inverse_light_distance[glossy_index] * inverse_ray_length[cell_index[glossy_index]]
        l_dot_v = (squared_ray_length - q_dot_d_over_t)[glossy_index] * scale
        inverse_sum = (l_dot_v * 2.0 + 2.0).power(-0.5, _MIN_SQUARE)  # 1 / |l + v|
        n_dot_sum = n_dot_l[glossy_index] + n_dot_v[pair_number]
        n_dot_h = (n_dot_sum * inverse_sum).fall_back_to_unit_interval()
        exponent = scene.exponent[object_index[glossy_index]]
        cosine_power = n_dot_h.power(exponent, 0.0, 1.0).fall_back_to_unit_interval()
        specular = intensity[:, glossy_index] * scene.specular[:, object_index[glossy_index]]
        radiance[..., glossy_index] += cosine_power.coefficients[:, None] * specular
        return Contributions(pair_index, light_index, Enclosures(radiance))
