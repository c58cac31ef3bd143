"""Blinn-Phong highlights.

Blinn, Models of light reflection for computer synthesized pictures, 1977, as in Shirley,
Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2: each light that is seen adds
I (kd max(0, n.l) + ks (n.h)^p), h halfway between the directions to the light and to the eye.
Light does not fall off with distance, and the highlight carries no further cosine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tracer.arrays import Floats, Ints, Triple, dot, indices, map3, scaled

# If 1 + l.v is less, too many of its digits have cancelled.
_CANCELLED = 1e-3

# If |l + v|^2 is less, it is rounding alone.
_OPPOSITE = 1e-24

# How many times larger the rounding of n.h may become in a highlight.
_SHOWS = 256.0


def highlight(
    n_dot_l: Floats,
    n_dot_v: Floats,
    l_dot_v: Floats,
    exponent: Floats,
    vectors: Callable[[Ints], tuple[Triple, Triple, Triple]],
) -> Floats:
    """(n.h)^exponent.

    It is right to 1e-12 where |l + v| > 0.3, and to 1e-10 where that is more than 0.002, for
    exponents up to 1e6.

    As n.h is (n.l + n.v) / |l + v|, and |l + v|^2 = 2 + 2 l.v, cosines alone do for most points.
    Where a high exponent amplifies the rounding of n.h, and where l and v almost cancel, it is
    found from vectors: with e = n - h the cosine is 1 - e.e / 2, and exp(p log1p(-e.e / 2)) keeps
    the digits that n.h itself has lost.

    Parameters
    ----------
    n_dot_l, n_dot_v, l_dot_v : (n,)
        n.l (more than zero), n.v, and l.v, of unit vectors.
    exponent : (n,)
    vectors : callable
        Given the index of some of the points, unit vectors n, l and v there.
    """
    half2 = 1 + l_dot_v
    square = n_dot_l + n_dot_v
    square *= square
    square /= 2 * half2
    power: Floats = np.exp(0.5 * exponent * np.log(square))
    at = indices((half2 < _CANCELLED) | (exponent * power > _SHOWS))
    if not at.size:
        return power
    n, light, view = vectors(at)
    h = map3(np.add, light, view)
    length2, some = dot(h, h), exponent[at]
    e = map3(np.subtract, n, scaled(h, 1 / np.sqrt(length2)))
    # With a zero exponent the highlight is 1 everywhere, whatever the logarithm.
    closer = np.where(some == 0, 1.0, np.exp(some * np.log1p(-0.5 * dot(e, e))))
    # Where l = -v, light can only graze the surface, and h is nothing but rounding.
    power[at] = np.where(length2 > _OPPOSITE, closer, 0.0)
    return power
