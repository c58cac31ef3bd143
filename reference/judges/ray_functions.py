"""Functions of the direction of a camera ray, whose zeros may be edges of the picture.

Every function is about a *pair*: a face that may be visible in a cell of the picture (see `cells`).
It is evaluated where a camera ray in the cell meets the face, and has the form

    smooth_part + root_factor * root_term,

where the root term, a square root, is the same for all functions of the pair (see `cell_analysis`).
The parts are known only as polynomials with error bounds (see `enclosures`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.judges.arrays import Bools, Floats, Ints
from reference.judges.enclosures import ERROR, ROUNDING, UNKNOWN_Z, Enclosures
from reference.judges.vectors import compute_cross_product, compute_squared_length


class RayFunctions(NamedTuple):
    """Functions smooth_part + root_factor * root_term of the camera ray, each about one pair."""

    pair_index: Shaped[Ints, "n"]
    smooth_part: Enclosures  # (8, n)
    root_factor: Enclosures | Shaped[Floats, "n"]  # an array if it is constant in the cell

    def take(self, index: Shaped[Ints, "k"]) -> RayFunctions:
        return RayFunctions._make(field[index] for field in self)


class Condition(NamedTuple):
    """Functions that are positive where claims may be true.

    A *claim* is a statement about a pair, such as "the ray hits the face".  There may be several
    conditions for a claim.  It is true for the rays for which the functions of all its conditions
    are positive.
    """

    claim_index: Shaped[Ints, "n"]  # the claim to which each function belongs
    functions: RayFunctions
    # Whether the picture may have an edge where the function is zero.
    has_edge: Shaped[Bools, "n"] | bool = True


class EdgeFunctions(NamedTuple):
    """Functions, each of which is zero at all points of one edge of the picture."""

    pair_index: Shaped[Ints, "n"]
    # Index of the light that is cut off at the edge, or -1 if the visible face changes there.
    light_index: Shaped[Ints, "n"]
    functions: Enclosures  # (8, n), in the cells of the pairs

    def take(self, index: Shaped[Ints, "k"]) -> EdgeFunctions:
        return EdgeFunctions._make(field[index] for field in self)


def concatenate_edges(edges: Sequence[EdgeFunctions]) -> EdgeFunctions:
    """Concatenate the arrays of several groups of edge functions; there must be at least one."""
    pair_indices, light_indices, functions = zip(*edges, strict=True)
    coefficients = np.concatenate([enclosures.coefficients for enclosures in functions], axis=1)
    return EdgeFunctions(
        pair_index=np.concatenate(pair_indices),
        light_index=np.concatenate(light_indices),
        functions=Enclosures(coefficients),
    )


class Cone(NamedTuple):
    """A function that is positive inside the cone around a sphere (see `enclose_cone`)."""

    function: Enclosures  # (8, n)
    cross: Shaped[Floats, "3 3 n"]  # the cross products c x q


def enclose_cone(
    center: Shaped[Floats, "3 n"],
    radius: Shaped[Floats, "n"],
    points: Shaped[Floats, "3 3 n"],
    shifted_points: Shaped[Floats, "3 3 n"],
    sizes: tuple[Shaped[Floats, "n"] | float, Shaped[Floats, "n"] | float],
) -> Cone:
    """Enclose, for each sphere, a function that is positive at points inside a cone around it.

    The cone consists of all lines that contain its apex and meet the sphere.  Let c be the sphere's
    centre and q a point, both relative to the apex, and let r be the radius.  The line from the
    apex through q has the distance |c x q| / |q| from the centre, and meets the sphere if this is
    at most r.  So the function is r^2 |q|^2 - |c x q|^2.

    Parameters
    ----------
    center, radius
        The spheres, relative to the apex.
    points
        The points q.  They are linear in X and Y: the first axis holds the components, and the
        second the coefficients of 1, X and Y (see `vectors`).
    shifted_points
        Each q plus a multiple of c, so that c x q is the same, but has a smaller rounding error.
    sizes
        Upper bounds on the absolute values of the terms of `points` and of `shifted_points`.
    """
    size, shifted_size = sizes
    squared_radius = radius * radius
    squared_center = (center * center).sum(axis=0)
    cross = compute_cross_product(center, shifted_points)
    coefficients = np.zeros((8, radius.size))
    coefficients[:UNKNOWN_Z] = squared_radius * compute_squared_length(points)
    coefficients[:UNKNOWN_Z] -= compute_squared_length(cross)
    error_bound = squared_radius * size * np.abs(points).sum(axis=(0, 1))
    error_bound += squared_center * shifted_size * np.abs(shifted_points).sum(axis=(0, 1))
    coefficients[ERROR] = 8 * ROUNDING * error_bound
    return Cone(function=Enclosures(coefficients), cross=cross)
