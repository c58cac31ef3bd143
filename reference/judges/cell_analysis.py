"""Find out what is the same everywhere in a cell of the picture, and where its edges may be.

A *pair* is a cell and a face that may be visible in it (see `cells`).  For each pair, this module
decides whether the face covers the cell, is hidden in it, or is lit in all of it.  It does so by
means of *edge functions*: functions of the camera ray that are positive on one side of an edge and
negative on the other.  Silhouettes, intersections of surfaces, terminators (the borders between the
lit and the dark side of a sphere) and shadow edges are zeros of such functions.  A function with
the same sign everywhere in a cell decides a question there.  Otherwise the cell may contain an
edge.

The point where a camera ray meets a face is the face's *visible point*.  Its inverse distance is
linear in the ray's direction, plus a square root if the face is a sphere: the *root term* (see
`faces`).  Therefore every edge function has the form

    smooth_part + root_factor * root_term,

where the first two are polynomials of degree two or less in the ray's direction.  All three parts
are *enclosed*: each is given as a polynomial with an error bound (see `enclosures`).  So the
function is enclosed, too.  Near a silhouette, the root term is too steep.  There,
smooth_part^2 - (root_factor * root_term)^2 is a better edge function.  It has the same zeros, and
perhaps others, but no root.

Why the result is right: a question counts as decided only if the enclosure of its function has one
sign, and every other function is listed as an edge.

Rounding.  Linear functions are sums of three products.  Their rounding error is at most 4 e times
the sum of the absolute values of the products, with e = 2^-53.  The rounding error of the quadratic
polynomials of cones is at most 20 e times (r^2 + |c|^2) |q|^2 (see `enclose_cone`).  The error
bounds contain at least 900 e times the same sums, so they also cover the rounding errors of earlier
results: centres relative to the eye, and planes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Annotated as Shaped

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints
from reference.judges.cells import MAX_WIDTH, Cells
from reference.judges.certified_scene import CertifiedScene
from reference.judges.enclosures import (
    CONSTANT,
    ERROR,
    ROUNDING,
    UNKNOWN_Z,
    X_SQUARED,
    Enclosures,
    X,
)
from reference.judges.faces import Faces
from reference.judges.ray_functions import Condition, EdgeFunctions, RayFunctions, enclose_cone
from reference.judges.vectors import compute_cross_product, compute_squared_length


class CellAnalysis:
    """Cells of the picture, with inverse distances and possible edges of the faces in them.

    The ray with direction d meets the face of a pair at t d, where 1 / t is k.d plus the root term
    (see `faces`).
    """

    scene: CertifiedScene
    faces: Faces  # of the scene
    cells: Cells  # without the pairs and triples that proved irrelevant
    squared_ray_length: Enclosures  # (8, cells), of d^2
    inverse_distance: Enclosures  # (8, pairs), of 1 / t
    # (8, pairs).  The unknown Z is the same in the root term and in 1 / t.
    root_term: Enclosures
    root_term_squared: Enclosures  # (8, pairs)
    _linear_term: Enclosures  # (8, pairs), of k.d
    _max_inverse_distance: Shaped[Floats, "pairs"]
    # Directions d of the camera rays in each cell, as linear functions of X and Y (see `vectors`).
    _rays: Shaped[Floats, "3 3 cells"]
    _half_cell_size: Shaped[Floats, "2 1"]  # width and height, in the units of the rays
    edges: list[EdgeFunctions]

    def __init__(self, scene: CertifiedScene, cells: Cells) -> None:
        """Find the faces that may be visible in each cell, the lights that reach them, and edges.

        The cells of the caller are not changed.
        """
        self.scene = scene
        self.faces = scene.faces
        self.cells = cells
        self.edges = []
        self._set_rays()
        self._remove_invisible_pairs()
        self._find_terminators()
        self._find_shadows()
        if cells.width <= 1:
            self._find_intersections()

    def _set_rays(self) -> None:
        """Compute the directions of the camera rays in each cell, and enclose their squares."""
        cells = self.cells
        self._rays = self.scene.compute_rays(cells.x, cells.y, cells.width)
        pixel_size = self.scene.frame.pixel_width, self.scene.frame.pixel_height
        self._half_cell_size = cells.width / 2 * np.array(pixel_size)[:, None]
        coefficients = np.zeros((8, cells.x.size))
        coefficients[:UNKNOWN_Z] = compute_squared_length(self._rays)
        coefficients[ERROR] = ROUNDING * coefficients[CONSTANT]
        self.squared_ray_length = Enclosures(coefficients)

    def dot_with_rays(
        self, vectors: Shaped[Floats, "3 n"], cell_index: Shaped[Ints, "n"]
    ) -> Enclosures:
        """Enclose the dot products (8, n) of vectors with the directions of camera rays.

        The rays are those of the cell `cell_index[i]` for vector i.  The products are linear in X
        and Y.
        """
        max_ray_size = self.scene.frame.max_ray_size
        coefficients = np.zeros((8, cell_index.size))
        coefficients[CONSTANT] = (vectors * self._rays[:, 0].take(cell_index, axis=1)).sum(axis=0)
        coefficients[X:X_SQUARED] = vectors[:2] * self._half_cell_size
        coefficients[ERROR] = ROUNDING * max_ray_size * np.abs(vectors).sum(axis=0)
        return Enclosures(coefficients)

    def _express_half_space(
        self, pair_index: Shaped[Ints, "n"], half_space: Shaped[Floats, "5 n"]
    ) -> RayFunctions:
        """Make functions that are positive where camera rays meet faces inside half-spaces.

        Function i is about the face of pair `pair_index[i]` and the half-space whose five numbers
        are `half_space[:, i]` (see `faces`).
        """
        # The ray with direction d meets the face at t d, where 1 / t is the sum of the linear term
        # and the root term.  There, n.x + b >= 0 becomes n.d + b / t >= 0, after division by t.
        *normal, b, b_abs_sum = half_space
        smooth_part = self.dot_with_rays(np.array(normal), self.cells.cell_index[pair_index])
        smooth_part += self._linear_term[pair_index] * b
        smooth_part.widen(ROUNDING * b_abs_sum * self._max_inverse_distance[pair_index])
        return RayFunctions(pair_index=pair_index, smooth_part=smooth_part, root_factor=b)

    def enclose_functions(self, functions: RayFunctions) -> Enclosures:
        """Enclose the values (8, n) of functions, each in the cell of its pair."""
        pair_index, smooth_part, root_factor = functions
        coefficients = smooth_part.coefficients.copy()
        function_index = np.flatnonzero(~self.faces.is_planar[self.cells.face_index[pair_index]])
        root_part = self.root_term[pair_index[function_index]] * root_factor[function_index]
        coefficients[:, function_index] += root_part.coefficients
        return Enclosures(coefficients)

    def _decide_claims(
        self,
        light_index: Shaped[Ints, "claims"] | int,
        is_false: Shaped[Bools, "claims"],
        conditions: Iterable[Condition],
    ) -> Shaped[Bools, "claims"]:
        """Find the claims that are true everywhere in a cell, and list edges of undecided claims.

        A claim is a statement about a pair (see `Condition`).  It is undecided if it may be true in
        only a part of its cell.  Then those of its functions that may change sign in the cell are
        added to `edges`, unless the condition says that their zeros are no edges.

        Parameters
        ----------
        light_index
            Index of the light that the claim concerns, or -1 if it concerns no light.
        is_false
            Whether the claim is certainly false everywhere in its cell.  The array is updated in
            place after each condition, so that generators of conditions can skip such claims.
        conditions
            Conditions that must all hold if a claim is true.
        """
        light_index = np.broadcast_to(light_index, is_false.shape)
        is_true = np.ones(is_false.size, np.bool_)
        possible_edges = []
        for claim_index, functions, has_edge in conditions:
            enclosures = self.enclose_functions(functions)
            low, high = enclosures.find_bounds()
            is_false[claim_index[high <= 0]] = True
            is_true[claim_index[~(low > 0)]] = False
            may_have_both_signs = ~(low >= 0) & ~(high <= 0)
            index = np.flatnonzero(may_have_both_signs & has_edge)
            possible_edges.append((claim_index[index], functions.take(index), enclosures[index]))
        # Only now is it known which claims are false.
        for claim_index, functions, enclosures in possible_edges:
            index = np.flatnonzero(~is_false[claim_index])
            edges = EdgeFunctions(
                pair_index=functions.pair_index[index],
                light_index=light_index[claim_index[index]],
                functions=self._narrow_enclosures(functions.take(index), enclosures[index]),
            )
            self.edges.append(edges)
        return is_true & ~is_false

    def _narrow_enclosures(self, functions: RayFunctions, enclosures: Enclosures) -> Enclosures:
        """Replace the enclosures of edge functions on spheres with narrower ones, where possible.

        Near a silhouette, the root term is steep, so the enclosure is wide.  The replacement
        encloses smooth_part^2 - (root_factor * root_term)^2, which has no square root.  The
        coefficients of `enclosures` are changed in place.
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

    def _remove_invisible_pairs(self) -> None:
        """Remove each pair of a cell and a face whose face cannot be seen in the cell.

        The remaining pairs replace `self.cells`.  The method also stores what encloses the inverse
        distances 1 / t of their faces, and lists the outlines of these faces as possible edges.
        """
        face_index = self.cells.face_index
        discriminants = self._enclose_discriminants()
        # The root term is the sphere's `root_coef` times the square root of its discriminant.
        self.root_term_squared = discriminants * self.faces.root_coef[face_index] ** 2
        self.root_term = Enclosures(np.zeros((8, face_index.size)))
        linear_coef = self.faces.linear_coef[:, face_index]
        self._linear_term = self.dot_with_rays(linear_coef, self.cells.cell_index)
        self._max_inverse_distance = self._linear_term.max_abs
        is_outside = np.zeros(face_index.size, np.bool_)
        covers_cell = self._decide_claims(-1, is_outside, self._make_hit_conditions(discriminants))
        self._enclose_inverse_distances(is_outside)
        may_be_visible = ~(is_outside | self._find_hidden_pairs(covers_cell))
        self.cells = self.cells._replace(covers_cell=covers_cell)
        self._select_pairs(may_be_visible)

    def _enclose_discriminants(self) -> Enclosures:
        """Enclose discriminants (8, pairs), which are positive where a ray's line meets a sphere.

        The discriminant of a side of a box is 0.
        """
        scene, faces, cells = self.scene, self.faces, self.cells
        discriminants = Enclosures(np.zeros((8, cells.face_index.size)))
        pair_index = np.flatnonzero(~faces.is_planar[cells.face_index])
        sphere_index = cells.face_index[pair_index]
        rays = self._rays[:, :, cells.cell_index[pair_index]]
        sizes = scene.frame.max_ray_size, scene.frame.max_ray_size
        center, radius = scene.spheres.center[:, sphere_index], scene.spheres.radius[sphere_index]
        discriminants[pair_index] = enclose_cone(center, radius, rays, rays, sizes).function
        return discriminants

    def _enclose_inverse_distances(self, is_outside: Shaped[Bools, "pairs"]) -> None:
        """Enclose the root term and 1 / t, except for spheres that are outside their cell."""
        self.inverse_distance = Enclosures(self._linear_term.coefficients.copy())
        is_sphere = ~self.faces.is_planar[self.cells.face_index]
        pair_index = np.flatnonzero(is_sphere & ~is_outside)
        coefficients = self.root_term_squared[pair_index].power(0.5).coefficients
        rounding_error = self.inverse_distance.coefficients[ERROR, pair_index]
        # The error bound of the root term becomes the coefficient of the unknown Z, which the
        # inverse distance shares.  The new error bound covers only rounding errors.
        coefficients[UNKNOWN_Z] = coefficients[ERROR] + rounding_error
        coefficients[ERROR] = rounding_error
        self.root_term.coefficients[:, pair_index] = coefficients
        self.inverse_distance.coefficients[:, pair_index] += coefficients
        self.inverse_distance.coefficients[ERROR, pair_index] = 0

    def _select_pairs(self, is_selected: Shaped[Bools, "pairs"]) -> None:
        """Remove the pairs that are not selected from all attributes, and renumber the others."""
        self.cells, new_index = self.cells.select_pairs(is_selected)
        for i, edges in enumerate(self.edges):
            kept_edges = edges.take(np.flatnonzero(is_selected[edges.pair_index]))
            self.edges[i] = kept_edges._replace(pair_index=new_index[kept_edges.pair_index])
        self.root_term = self.root_term[is_selected]
        self._linear_term = self._linear_term[is_selected]
        self.root_term_squared = self.root_term_squared[is_selected]
        self.inverse_distance = self.inverse_distance[is_selected]
        self._max_inverse_distance = self.inverse_distance.max_abs

    def _make_hit_conditions(self, discriminants: Enclosures) -> Iterator[Condition]:
        """Yield the conditions under which camera rays hit the face of each pair.

        A ray hits a side of a box if it meets the side's plane within all four edges.  A ray hits a
        sphere if the sphere is ahead of the eye, and the ray's line meets the sphere.  There is no
        condition for faces that all rays hit.
        """
        faces, spheres, cells = self.faces, self.scene.spheres, self.cells
        is_planar = faces.is_planar[cells.face_index]
        pair_index = np.flatnonzero(~cells.covers_cell & is_planar)
        for half_spaces in faces.rim_half_spaces.swapaxes(0, 1):
            half_space = half_spaces[:, cells.face_index[pair_index]]
            functions = self._express_half_space(pair_index, half_space)
            yield Condition(claim_index=pair_index, functions=functions)
        pair_index = np.flatnonzero(~cells.covers_cell & ~is_planar)
        # If the eye is inside a sphere, all rays hit the sphere.
        pair_index = pair_index[spheres.eye_power[cells.face_index[pair_index]] > 0]
        center = spheres.center[:, cells.face_index[pair_index]]
        projection = self.dot_with_rays(center, cells.cell_index[pair_index])
        no_root = np.zeros(pair_index.size)
        is_ahead = RayFunctions(pair_index=pair_index, smooth_part=projection, root_factor=no_root)
        # The zero of this function is no edge: there, the ray's line misses the sphere.
        yield Condition(claim_index=pair_index, functions=is_ahead, has_edge=False)
        meets_sphere = is_ahead._replace(smooth_part=discriminants[pair_index])
        yield Condition(claim_index=pair_index, functions=meets_sphere)

    def _find_hidden_pairs(self, covers_cell: Shaped[Bools, "pairs"]) -> Shaped[Bools, "pairs"]:
        """Find the pairs whose face is certainly hidden by another face everywhere in the cell.

        In each cell, only the nearest covering face is tested as an occluder.  If two faces are in
        the same plane, the one whose object comes first in the scene file hides the other.
        """
        faces, inverse_distance = self.faces, self.inverse_distance
        cell_index, face_index = self.cells.cell_index, self.cells.face_index
        file_index = self.scene.prepared_scene.surfaces.file_index[faces.object_index[face_index]]
        plane_id = faces.plane_id[:, face_index]
        occluder_index = self._find_nearest_covers(covers_cell, file_index)[cell_index]
        has_occluder = (occluder_index >= 0) & (occluder_index != np.arange(cell_index.size))
        is_in_same_plane = (plane_id == plane_id[:, occluder_index]).all(axis=0)
        # If the inverse distance is smaller everywhere, the face is farther away everywhere.
        gap = inverse_distance.subtract_independent(inverse_distance[occluder_index])
        _, max_gap = gap.find_bounds()
        comes_later = file_index > file_index[occluder_index]
        return np.asarray(has_occluder & np.where(is_in_same_plane, comes_later, max_gap < 0))

    def _find_nearest_covers(
        self, covers_cell: Shaped[Bools, "pairs"], file_index: Shaped[Ints, "pairs"]
    ) -> Shaped[Ints, "cells"]:
        """Find, for each cell, the pair of the nearest face that covers it, or -1 if there is none.

        The nearest face is the one with the smallest upper bound on its distance; of several, the
        first in the scene file.
        """
        cell_index = self.cells.cell_index
        covering_index = np.flatnonzero(covers_cell)
        min_inverse_distance, _ = self.inverse_distance[covering_index].find_bounds()
        sort_keys = -file_index[covering_index], min_inverse_distance, cell_index[covering_index]
        far_to_near = covering_index[np.lexsort(sort_keys)]
        nearest_index = np.full(self.cells.x.size, -1)
        # If a cell has several covering pairs, the last one remains.
        nearest_index[cell_index[far_to_near]] = far_to_near
        return nearest_index

    def express_light_height(
        self, pair_index: Shaped[Ints, "n"], light_index: Shaped[Ints, "n"] | int
    ) -> RayFunctions:
        """Make functions that are positive where a light is in front of a face.

        Each is the height of the light above the face's tangent plane at the visible point t d,
        divided by t.  Light index -1 stands for the eye.
        """
        half_space = self.faces.height_half_space[:, light_index, self.cells.face_index[pair_index]]
        return self._express_half_space(pair_index, half_space)

    def _find_terminators(self) -> None:
        """Settle lights that leave all of a sphere in a cell dark, and list terminators as edges.

        A terminator is listed if only a part of the sphere in the cell may be dark.
        """
        # Lights behind a side of a box are settled from the start.
        is_sphere = ~self.faces.is_planar[self.cells.face_index]
        pair_index, light_index = np.nonzero(~self.cells.is_settled & is_sphere[:, None])
        is_unlit = np.zeros(pair_index.size, np.bool_)
        heights = self.express_light_height(pair_index, light_index)
        condition = Condition(claim_index=np.arange(is_unlit.size), functions=heights)
        self._decide_claims(light_index, is_unlit, [condition])
        self.cells.is_settled[pair_index[is_unlit], light_index[is_unlit]] = True

    def _bound_visible_parts(self) -> tuple[Shaped[Floats, "3 pairs"], Shaped[Floats, "3 pairs"]]:
        """Compute the centre and half size of a box around the part of each face in its cell.

        The boxes are aligned with the scene's axes, and widened to allow for rounding errors.
        """
        faces, face_index, frame = self.faces, self.cells.face_index, self.scene.frame
        axes, eye = frame.axes.T, frame.eye[:, None]
        # The rays of a cell, along the scene's axes, are between two corners.
        rays = self._rays[:, :, self.cells.cell_index]
        center_ray = axes @ rays[:, 0]
        spread = np.abs(axes) @ rays[:, 1:].sum(axis=1)
        low_ray, high_ray = center_ray - spread, center_ray + spread
        # A visible point t d has t between near and far.
        inverse_far, inverse_near = self.inverse_distance.find_bounds()
        near = 1 / inverse_near
        far = np.where(inverse_far > 0, 1 / inverse_far, np.inf)
        low, high = faces.bounding_box[:, :, face_index]
        low = np.fmax(low, eye + np.fmin(low_ray * near, low_ray * far))
        high = np.fmin(high, eye + np.fmax(high_ray * near, high_ray * far))
        position_error = self.scene.prepared_scene.position_error[faces.object_index[face_index]]
        half_size = np.maximum(0.5 * (high - low), 0) + position_error
        return 0.5 * (low + high), half_size

    def _find_shadows(self) -> None:
        """Settle lights that are blocked everywhere in a cell, and list shadow edges.

        If an object may shade only a part of the face in the cell, the outline of its shadow
        becomes a possible edge.  Triples (see `cells`) that no longer matter are removed.  Cells of
        width `MAX_WIDTH` have no triples yet, so their triples are listed first.
        """
        cells = self.cells
        if cells.width == MAX_WIDTH:
            part_boxes = self._bound_visible_parts()
            triples = self.scene.find_occluders(*part_boxes, cells.face_index, ~cells.is_settled.T)
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

    def _make_sphere_shadow_conditions(self) -> Iterator[Condition]:
        """Yield the conditions under which camera rays meet a face in the shadow of a sphere.

        Each triple (see `cells`) claims that its sphere shades its face.  First, the ray must meet
        the face inside the cone from the light around the sphere.  Second, it must meet the face
        behind the plane in which the cone touches the sphere.
        """
        scene, triples = self.scene, self.cells.shadow_triples
        triple_index = np.flatnonzero(triples[2] < scene.sphere_count)
        pair_index, light_index, sphere_index = triples[:, triple_index]
        is_in_cone = self._express_shadow_cones(pair_index, light_index, sphere_index)
        yield Condition(claim_index=triple_index, functions=is_in_cone)
        # Let L be the light, C the sphere's centre, c = C - L, and r the radius.  The second
        # condition for a point p is c.(p - L) >= |c|^2 - r^2, which is c.p - c.C + r^2 >= 0.  The
        # plane is no edge: inside the cone, it lies inside the sphere.
        to_center = scene.to_center[:, light_index, sphere_index]
        squared_radius = scene.spheres.radius[sphere_index] ** 2
        products = to_center * scene.spheres.center[:, sphere_index]
        b = squared_radius - products.sum(axis=0)
        b_abs_sum = squared_radius + np.abs(products).sum(axis=0)
        is_behind = self._express_half_space(pair_index, np.array([*to_center, b, b_abs_sum]))
        yield Condition(claim_index=triple_index, functions=is_behind, has_edge=False)

    def _express_shadow_cones(
        self,
        pair_index: Shaped[Ints, "n"],
        light_index: Shaped[Ints, "n"],
        sphere_index: Shaped[Ints, "n"],
    ) -> RayFunctions:
        """Make functions that are positive where camera rays meet faces inside shadow cones.

        Each function is about one pair, one light and one sphere.  The cone consists of all lines
        that contain the light and meet the sphere.
        """
        # Let L be the light, C the sphere's centre, c = C - L, and r the radius.  The ray with
        # direction d meets the face at p = t d, where 1 / t = k.d + s with the root term s.
        # The point p is in the cone if |c x (p - L)| <= r |p - L|.  On the left, p - L can be
        # replaced by p - C, so that nothing cancels if the light is distant.  Divided by t, p - L
        # is q - L s with q = d - L k.d, and p - C is w - C s with w = d - C k.d.  Divided by t^2,
        # the condition is u + v s >= 0 with
        #     u = r^2 q^2 - |c x w|^2 + (r^2 L^2 - |c x C|^2) s^2,
        #     v = 2 ((c x C).(c x w) - r^2 L.q).
        # Below, each size bounds the absolute values of the terms of a vector or a polynomial.
        scene = self.scene
        radius, center = scene.spheres.radius[sphere_index], scene.spheres.center[:, sphere_index]
        light = scene.lights.from_eye[light_index].T
        to_center = scene.to_center[:, light_index, sphere_index]
        squared_radius = radius**2
        squares = np.square([light, center, to_center]).sum(axis=1)
        squared_light, squared_center, squared_to_center = squares
        points = np.array([light, center])
        (q, w), (q_size, w_size) = self._subtract_from_rays(pair_index, points)
        u, c_cross_w = enclose_cone(to_center, radius, q, w, (q_size, w_size))
        c_cross_center = compute_cross_product(to_center, center[:, None])
        s_squared = self.root_term_squared[pair_index]
        u += s_squared * (squared_radius * squared_light - np.square(c_cross_center).sum((0, 1)))
        u_size = squared_to_center * squared_center + squared_radius * squared_light
        u.widen(16 * ROUNDING * u_size * s_squared.max_abs)
        v = np.zeros((8, pair_index.size))
        dot_of_crosses = (c_cross_center * c_cross_w).sum(axis=0)
        v[:X_SQUARED] = 2 * (dot_of_crosses - squared_radius * (light[:, None] * q).sum(axis=0))
        v_size = squared_to_center * np.sqrt(squared_center) * w_size
        v_size += squared_radius * np.sqrt(squared_light) * q_size
        v[ERROR] = 16 * ROUNDING * v_size
        return RayFunctions(pair_index=pair_index, smooth_part=u, root_factor=Enclosures(v))

    def _subtract_from_rays(
        self, pair_index: Shaped[Ints, "n"], points: Shaped[Floats, "m 3 n"]
    ) -> tuple[Shaped[Floats, "m 3 3 n"], Shaped[Floats, "m n"]]:
        """Compute d - p k.d for the rays of each pair and m points p; bound the sizes of its terms.

        It is the vector from p to the visible point t d, divided by t, without the root term of
        1 / t = k.d + s.  It is linear in X and Y (see `vectors`).
        """
        rays = self._rays[:, :, self.cells.cell_index[pair_index]]
        linear_term = self._linear_term.coefficients[:X_SQUARED, pair_index]
        linear_coef = self.faces.linear_coef[:, self.cells.face_index[pair_index]]
        scale = 2 * np.abs(linear_coef).sum(axis=0) * np.sqrt(np.square(points).sum(axis=1))
        size = self.scene.frame.max_ray_size * (1 + scale)
        return rays - points[:, :, None] * linear_term, size

    def _make_box_shadow_conditions(
        self, casts_no_shadow: Shaped[Bools, "triples"]
    ) -> Iterator[Condition]:
        """Yield the conditions under which camera rays meet a face in the shadow of a box.

        Each triple (see `cells`) claims that its box shades its face.  The ray must meet the face
        inside each half-space of the shadow volume.  `casts_no_shadow` marks triples that need no
        more conditions, because there is certainly no shadow.  The caller may update it between
        conditions.
        """
        pair_index, light_index, occluder_index = self.cells.shadow_triples
        # Objects are numbered with spheres first.  Spheres have a negative box index.
        box_index = occluder_index - self.scene.sphere_count
        for half_spaces, has_edge in zip(*self.scene.shadow_volumes, strict=True):
            index = np.flatnonzero((box_index >= 0) & ~casts_no_shadow)
            half_space = half_spaces[:, light_index[index], box_index[index]]
            # A box seen edge-on from the light has fewer than nine planes.
            has_plane = half_space[:4].any(axis=0)
            index = index[has_plane]
            functions = self._express_half_space(pair_index[index], half_space[:, has_plane])
            yield Condition(
                claim_index=index,
                functions=functions,
                has_edge=has_edge[light_index[index], box_index[index]],
            )

    def _find_intersections(self) -> None:
        """List possible edges where two faces intersect in a cell.

        The intersection of two faces lies in a plane.  The possible edge is where camera rays meet
        one of the faces in this plane.
        """
        faces, cells = self.faces, self.cells
        pair_indices = cells.list_combined_pairs()
        # If only one of two faces is planar, make it the second one.
        is_planar = faces.is_planar[cells.face_index[pair_indices[0]]]
        pair_indices = np.where(is_planar, pair_indices[::-1], pair_indices)
        face_indices = cells.face_index[pair_indices]
        object_index, plane_id = faces.object_index[face_indices], faces.plane_id[:, face_indices]
        objects_differ = object_index[0] != object_index[1]
        may_intersect = objects_differ & (plane_id[:, 0] != plane_id[:, 1]).any(axis=0)
        pair_index, face_indices = pair_indices[0, may_intersect], face_indices[:, may_intersect]
        # If the second face is a sphere, both are.  Both equations have the term x^2, so their
        # difference is linear, and it is 0 in the plane of the intersection.
        equation, plane = faces.face_equation[:, face_indices].swapaxes(0, 1)
        is_sphere = ~faces.is_planar[face_indices[1]]
        plane[:, is_sphere] += equation[:, is_sphere] * [[-1], [-1], [-1], [-1], [1]]
        functions = self._express_half_space(pair_index, plane)
        condition = Condition(claim_index=np.arange(pair_index.size), functions=functions)
        self._decide_claims(-1, np.zeros(pair_index.size, np.bool_), [condition])
