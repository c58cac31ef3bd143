"""Products of vectors that depend linearly on the position (X, Y) in a cell of the picture."""

from __future__ import annotations

import numpy as np

from reference.judges.arrays import Floats


def squared_length(vectors: Floats) -> Floats:
    """Compute the squared lengths of vectors that depend linearly on the coordinates X and Y.

    Parameters
    ----------
    vectors : (3, 3, n) float array
        n vectors.  The first axis holds the components of a vector, the second the coefficients of
        1, X and Y of each component.

    Returns
    -------
    squared_length : (6, n) float array
        The squared lengths as polynomials: coefficients of 1, X, Y, X^2, X Y and Y^2.
    """
    constant, x, y = vectors.swapaxes(0, 1)
    products = ((constant, constant), (constant, x), (constant, y), (x, x), (x, y), (y, y))
    return np.array([(a * b).sum(axis=0) * (1 if a is b else 2) for a, b in products])


def cross_product(constant: Floats, vectors: Floats) -> Floats:
    """Compute cross products of constant vectors and vectors that may depend on the position.

    Parameters
    ----------
    constant : (3, n) float array
        The first factors.
    vectors : (3, k, n) float array
        The second factors.  The first axis holds the components of a vector, the second the k
        coefficients of each component, for example those of 1, X and Y.

    Returns
    -------
    product : (3, k, n) float array
        The cross products, with the axes of `vectors`.
    """
    c, v = constant, vectors
    return np.array([c[i - 2] * v[i - 1] - c[i - 1] * v[i - 2] for i in range(3)])
