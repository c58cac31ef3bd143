"""Products of vectors that depend linearly on the position (X, Y) in a cell of the picture.

Such vectors are arrays of shape (3, 3, n).  The first axis holds the components, and the second the
coefficients of 1, X and Y in each component.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Annotated as Shaped

import numpy as np

from reference.judges.arrays import Floats

# Indices of the components y, z, x and z, x, y, for cross products.
_YZX, _ZXY = [1, 2, 0], [2, 0, 1]


def compute_squared_length(vectors: Shaped[Floats, "3 3 n"]) -> Shaped[Floats, "6 n"]:
    """Compute the squared length of each vector, as coefficients of 1, X, Y, X^2, X Y and Y^2."""
    # The coefficients of a vector are themselves vectors: a constant, one times X, and one times Y.
    # Their pairs come in this order: 1 1, 1 X, 1 Y, X X, X Y and Y Y.  A product of two different
    # coefficients occurs twice in the square.
    pairs = combinations_with_replacement(vectors.swapaxes(0, 1), 2)
    return np.array([(a * b).sum(axis=0) * (1 if a is b else 2) for a, b in pairs])


def compute_cross_product(
    constant_vectors: Shaped[Floats, "3 n"], vectors: Shaped[Floats, "3 k n"]
) -> Shaped[Floats, "3 k n"]:
    """Compute the cross products of constant vectors with vectors that depend on X and Y.

    The second axis of `vectors` and of the result holds k coefficients of each component.
    """
    first_factor = constant_vectors[:, None]
    return first_factor[_YZX] * vectors[_ZXY] - first_factor[_ZXY] * vectors[_YZX]
