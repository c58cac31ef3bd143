"""Radiance of lit points: Lambert and Blinn-Phong.

Blinn, Models of light reflection for computer synthesized pictures, 1977, as in
Shirley, Fundamentals of Computer Graphics, 2nd ed., 9.1 and 9.2: each light that
is seen adds  I (kd max(0, n.l) + ks (n.h)^p), h halfway between the directions
to the light and to the eye.  Light does not fall off with distance, and the
highlight carries no further cosine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Floats, Ints, Triple, dot, each, indices, scaled, select
from tracer.scene.model import Phong, Shader

# If 1 + l.v is less, too many of its digits have cancelled.
_CANCELLED = 1e-3

# If |l + v|^2 is less, it is rounding alone.
_OPPOSITE = 1e-24

# How many times larger the rounding of n.h may become in a highlight.
_SHOWS = 256.0


# Has what a Lambertian shader lacks.
_DULL = Phong()


class Materials(NamedTuple):
    """Shaders as arrays.

    Attributes
    ----------
    diffuse, specular : (3, m)
    exponent : (m,)
    glossy : (m,)
        Whether there is a highlight at all.
    """

    diffuse: Floats
    specular: Floats
    exponent: Floats
    glossy: Bools

    @classmethod
    def of(cls, shaders: tuple[Shader, ...]) -> Materials:
        """The shaders of a scene."""
        # There may be as many as objects: making each a Phong would take longer than the picture.
        phong = [s if isinstance(s, Phong) else _DULL for s in shaders]
        diffuse = np.array([s.diffuse for s in shaders]).reshape(-1, 3).T
        specular = np.array([s.specular for s in phong]).reshape(-1, 3).T
        exponent = np.array([s.exponent for s in phong])
        return cls(diffuse, specular, exponent, np.any(specular > 0, axis=0))


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

    As n.h is (n.l + n.v) / |l + v|, and |l + v|^2 = 2 + 2 l.v, cosines alone do
    for most points.  Vectors are needed where a high exponent amplifies the
    rounding of n.h, and where l and v almost cancel.

    Parameters
    ----------
    n_dot_l, n_dot_v, l_dot_v : (n,)
        n.l (more than zero), n.v, and l.v, of unit vectors.
    exponent : float or (n,)
    vectors : callable
        Given the index of some of the points, unit vectors n, l and v there.
    """
    half2 = 1 + l_dot_v
    square = n_dot_l + n_dot_v
    square *= square
    square /= 2 * half2
    power: Floats = np.exp(0.5 * exponent * np.log(square))
    at = indices((half2 < _CANCELLED) | (exponent * power > _SHOWS))
    if at.size:
        power[at] = _highlight(*vectors(at), select(exponent, at))
    return power


def _highlight(n: Triple, light: Triple, view: Triple, exponent: Floats) -> Floats:
    """The same from unit vectors, with smaller errors.

    With a = |n - h|^2 the cosine is 1 - a / 2, and
    (n.h)^p = exp(p log1p(-a / 2)) keeps the digits that n.h itself has lost.
    """
    h = each(np.add, light, view)
    square = dot(h, h)
    e = each(np.subtract, n, scaled(h, 1 / np.sqrt(square)))
    loss = -0.5 * dot(e, e)
    # With a zero exponent the highlight is 1 everywhere, whatever the logarithm.
    power = np.where(exponent == 0, 1.0, np.exp(exponent * np.log1p(loss)))
    # Where l = -v, light can only graze the surface, and h is nothing but rounding.
    return np.where(square > _OPPOSITE, power, 0.0)
