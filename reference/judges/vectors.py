"""Products of vectors that depend linearly on the position (X, Y) in a cell of the picture."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from reference.judges.arrays import Floats


def compute_squared_length(vectors: Floats) -> Floats:
    """Compute the squared lengths of vectors that depend linearly on X and Y.

    Parameters
    ----------
    vectors : (3, 3, n) float array
        n vectors.  The first axis holds the components; the second holds the coefficients of 1, X
        and Y in each component.

    Returns
    -------
    squared_length : (6, n) float array
        The squared lengths as polynomials: coefficients of 1, X, Y, X^2, X Y and Y^2.
    """
    # Pairs of coefficients, in the order of 1, X, Y, X^2, X Y and Y^2.
    pairs = combinations_with_replacement(vectors.swapaxes(0, 1), 2)
    return np.array([(a * b).sum(axis=0) * (1 if a is b else 2) for a, b in pairs])


def compute_cross_product(constant_vectors: Floats, vectors: Floats) -> Floats:
    """Compute the cross products of constant vectors with vectors that depend on X and Y.

    Parameters
    ----------
    constant_vectors : (3, n) float array
        The first factors.
    vectors : (3, k, n) float array
        The second factors.  The first axis holds the components; the second holds k coefficients of
        each component, such as those of 1, X and Y.

    Returns
    -------
    product : (3, k, n) float array
        The cross products, with the same axes as `vectors`.
    """
    yzx, zxy = [1, 2, 0], [2, 0, 1]
    first_factor = constant_vectors[:, None]
    return first_factor[yzx] * vectors[zxy] - first_factor[zxy] * vectors[yzx]
