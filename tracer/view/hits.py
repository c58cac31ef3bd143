"""Visible: the points of surfaces that samples see."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Index, Ints, Triple, dot, pick, select
from tracer.view.view import Shape, View


class Group(NamedTuple):
    """Some of the hits: on one large object, or on many small ones, all of one shape.

    What is the same for all of them is a number; the rest are arrays (n,).

    Attributes
    ----------
    shape : Spheres or Boxes
    part : slice
        Their places among the hits.
    sample : (n,)
        Which sample.
    owner : int, or (spans,)
        Which object they see (spheres first): one, or one for each span.
    span : (n,), or a slice
        The span that each is in: samples in one row that see one object.
    face, sign, level, n, height
        See `Spheres.surface`: all of them numbers or (n,).
    """

    shape: Shape
    part: slice
    sample: Ints
    owner: Index
    span: Ints | slice
    face: Index
    sign: Floats
    level: Floats
    n: Triple
    height: Floats

    @property
    def flat(self) -> bool:
        """True for planes."""
        return self.shape.flat

    def spread(self, values: Any) -> Any:
        """Values of spans, repeated for each of their samples; of one object, as they are."""
        return select(values, self.span)

    def of(self, values: NDArray[Any]) -> Any:
        """Values of objects, spheres first, for each of the samples that see them."""
        return self.spread(values[self.owner])

    def height_of(self, position: Floats, vector: Triple, out: Floats) -> None:
        """Height `out` (n,) of a point over the tangent planes.

        Parameters
        ----------
        position : (3,)
            The point in the scene's axes.
        vector : three (n,)
            From the hits to the point, in the camera's axes.
        """
        if self.flat:
            # Along the scene's axes a light in a face's plane is at height 0 exactly.
            out[:] = self.sign * (position[self.face] - self.level)
        else:
            dot(self.n, vector, out)


class Visible(NamedTuple):
    """The points that samples see, group by group.

    Attributes
    ----------
    view : View
    p : (3, n)
        Points seen from the eye, in the camera's axes.
    groups : list of Group
    first : (runs + 1,)
        Where each run of points begins, through all groups, and the end of the last.  A run is on
        one object and one face, in one row of samples; or, if these are scattered, in one row of
        pixels, without gaps of several pixels.
    owner : (runs,)
        The object that each run sees.
    row, column : (runs,)
        The pixel that each begins in.
    scattered : bool
        Whether the samples are.
    """

    view: View
    p: Floats
    groups: list[Group]
    first: Ints
    owner: Ints
    row: Ints
    column: Ints
    scattered: bool

    @property
    def own(self) -> Ints:
        """The object (n,) that each point lies on."""
        return self.owner.repeat(np.diff(self.first))

    @property
    def sample(self) -> Ints:
        """The sample (n,) that each point is seen by."""
        return np.concatenate([np.zeros(0, dtype=np.intp), *(g.sample for g in self.groups)])

    @property
    def distance(self) -> Floats:
        """Distance (n,) of each point from the eye."""
        x, y, z = self.p
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def points(self, index: Ints | slice) -> Triple:
        """Some of the points in the scene's axes."""
        return self.view.raster.point_to_scene(pick(self.p, index))
