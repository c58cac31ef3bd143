"""Radiance of lit points: Lambert and Blinn-Phong.

Shirley, Fundamentals of Computer Graphics, 9.1 and 9.2: each light that is
seen adds  I (kd max(0, n.l) + ks (n.h)^p), h halfway between the directions
to the light and to the eye.  Light does not fall off with distance, and the
highlight carries no further cosine.
"""

from __future__ import annotations

import numpy as np

from tracer.groups import Bools, Triple, dot, each, scaled
from tracer.scene import Floats, Phong, Shader

__all__ = ["Materials", "highlight"]

# Squared length of the sum of two unit vectors that cancel, up to rounding.
_OPPOSITE = 1e-24


class Materials:
    """Shaders as arrays.

    Attributes
    ----------
    diffuse, specular : (3, m)
    exponent : (m,)
    glossy : (m,)
        Whether there is a highlight at all.
    """

    __slots__ = ("diffuse", "exponent", "glossy", "specular")

    def __init__(self, shaders: tuple[Shader, ...]) -> None:
        count = len(shaders)
        self.diffuse = np.array([s.diffuse for s in shaders]).reshape(count, 3).T
        phong = [s if isinstance(s, Phong) else Phong() for s in shaders]
        self.specular = np.array([s.specular for s in phong]).reshape(count, 3).T
        self.exponent = np.array([s.exponent for s in phong])
        self.glossy: Bools = np.asarray((self.specular > 0).any(axis=0))


def highlight(n: Triple, light: Triple, view: Triple, exponent: Floats) -> Floats:
    """(n.h)^exponent for unit vectors, to a few ulp whatever the exponent.

    With a = |n - h|^2 the cosine is 1 - a / 2, and
    (n.h)^p = exp(p log1p(-a / 2)) keeps the digits that n.h itself has lost.
    """
    h = each(np.add, light, view)
    square = dot(h, h)
    e = each(np.subtract, n, scaled(h, 1 / np.sqrt(square)))
    loss = -0.5 * dot(e, e)
    # log1p by way of log (Kahan): log(u) (u - 1)^-1 is smooth where u - 1 is inexact.
    u = 1 + loss
    log1p = np.where(u == 1, loss, np.log(u) * (loss / (u - 1)))
    # A zero exponent is a highlight everywhere, whatever the logarithm.
    power = np.where(exponent == 0, 1.0, np.exp(exponent * log1p))
    # Light straight from behind touches the surface at most: h is only rounding there.
    return np.where(square > _OPPOSITE, power, 0.0)
