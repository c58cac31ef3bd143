"""The points that samples see."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Floats, Ints, Triple, dot, repeat_runs, take3
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape


class ShapeHits(NamedTuple):
    """The hits on objects of one shape.

    Attributes
    ----------
    shape : Spheres or Boxes
    part : slice
        Their places among the hits.
    sample : (n,)
        Which sample.
    counts : (runs,)
        Runs are neighbours in one row that see one object and one face of it: how many samples
        each has.
    obj : (runs,)
        Which object each sees (spheres first).
    face, sign, level, n, height
        See `Spheres.surface`.
    """

    shape: Shape
    part: slice
    sample: Ints
    counts: Ints
    obj: Ints
    face: Ints
    sign: Floats
    level: Floats
    n: Triple
    height: Floats

    def repeat_runs(self, values: Any) -> Any:
        """Values of runs, repeated for each of their samples."""
        return repeat_runs(values, self.counts)

    def at_samples(self, values: Floats) -> Floats:
        """`n`'s components or `height`, or what is made of them, for each sample."""
        return repeat_runs(values, self.counts) if self.shape.flat else values

    def of(self, values: NDArray[Any]) -> Any:
        """Values of objects, spheres first, for each of the samples that see them."""
        return self.repeat_runs(values[self.obj])

    def height_of(self, position: Floats, vector: Triple, out: Floats) -> None:
        """Height `out` (n,) of a point over the tangent planes.

        `position` (3,): in the scene's axes; `vector`, three (n,): from the hits to the point, in
        the camera's axes.
        """
        if self.shape.flat:
            # Along the scene's axes a light in a face's plane is at height 0 exactly.
            out[:] = self.repeat_runs(self.sign * (position[self.face] - self.level))
        else:
            dot(self.n, vector, out)


class Hits(NamedTuple):
    """The points that samples see, shape by shape.

    Attributes
    ----------
    prepared, samples
    p : (3, n)
        Points seen from the eye, in the camera's axes.
    groups : list of ShapeHits
    sample : (n,)
        The sample that each point is seen by.
    first : (runs + 1,)
        Where each run of points begins, through all groups, and the end of the last.
    obj : (runs,)
        The object that each run sees.
    """

    prepared: PreparedScene
    samples: Samples
    p: Floats
    groups: list[ShapeHits]
    sample: Ints
    first: Ints
    obj: Ints

    @property
    def hit_object(self) -> Ints:
        """The object (n,) that each point lies on."""
        return self.obj.repeat(np.diff(self.first))

    @property
    def distance(self) -> Floats:
        """Distance (n,) of each point from the eye."""
        x, y, z = self.p
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def points(self, index: Ints | slice) -> Triple:
        """Some of the points in the scene's axes."""
        return self.prepared.frame.point_to_scene(take3(self.p, index))
