"""Patches: the rectangles of directions, as seen from lights, that are divided into cells.

The directions of each light are divided into eight octants, in which u and v are octahedral
coordinates (see `directions`).  In an octant, the *patch* is a rectangle that contains most of the
objects that the camera may see.  *Relative* rectangles have coordinates that run from 0 to 1 across
the patch.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, find_runs

# On each of its sides, a patch excludes one in this many objects.  Otherwise a single huge object
# could stretch the patch until all other objects lie in one cell.
_OBJECTS_PER_OUTLIER = 64


class Patches(NamedTuple):
    """The patches of the octants that contain objects that the camera may see."""

    # Element octant * lights + light is the index of the patch in this octant of the light; -1 if
    # the octant has no patch.
    of_octant: Shaped[Ints, "octants"]
    origin: Shaped[Floats, "2 patches"]  # smallest u and v
    size: Shaped[Floats, "2 patches"]  # width in u and in v

    def to_relative(
        self, rectangles: Shaped[Floats, "4 n"], patch_index: Shaped[Ints, "n"]
    ) -> Shaped[Floats, "4 n"]:
        """Convert bounds on u and v to coordinates that run from 0 to 1 across the patches."""
        origin = self.origin.take(patch_index, axis=1)
        size = self.size.take(patch_index, axis=1)
        return ((rectangles.reshape(2, 2, -1) - origin[:, None]) / size[:, None]).reshape(4, -1)


def choose_patches(
    octant_index: Shaped[Ints, "n"], rectangles: Shaped[Floats, "4 n"], octant_count: int
) -> Patches:
    """Choose a patch for each octant, from the rectangles of what the camera may see in it.

    A rectangle has the rows minimum and maximum of u, then of v.  It lies in the octant
    `octant_index`, which must be in ascending order.  Octants without rectangles get no patch.
    """
    octant_start, _ = find_runs(octant_index)
    of_octant = np.full(octant_count, -1)
    of_octant[octant_index[octant_start]] = np.arange(octant_start.size)
    origins, sizes = [], []
    # In each coordinate, leave out the smallest minima and the largest maxima.
    for octant_rectangles in np.split(rectangles, octant_start[1:], axis=1):
        outlier_count = octant_rectangles.shape[1] // _OBJECTS_PER_OUTLIER
        sorted_minima = np.partition(octant_rectangles[::2], outlier_count)
        sorted_maxima = np.partition(octant_rectangles[1::2], -1 - outlier_count)
        origin = sorted_minima[:, outlier_count]
        origins.append(origin)
        sizes.append(sorted_maxima[:, -1 - outlier_count] - origin)
    return Patches(of_octant=of_octant, origin=np.array(origins).T, size=np.array(sizes).T)
