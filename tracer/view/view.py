"""A scene as the eye sees it, what all rows of the picture share; and the points that are seen."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, Triple, changes, dot, pick, spread
from tracer.scene.model import Surfaces
from tracer.shapes.box import Boxes
from tracer.shapes.sphere import Spheres
from tracer.view.camera import Frames, Raster

Shape: TypeAlias = Spheres | Boxes
"""All objects of one kind; see `Spheres` for what they answer."""

# With more objects than this behind each other, fewer samples are taken at a time: memory grows
# with the pairs of both.
_LAYERS = 8.0


class View(NamedTuple):
    """A scene as it is seen from the eye.

    Attributes
    ----------
    raster, surfaces, spheres, boxes
    frames, eye_inside
        As in `Spheres`, of all n objects, spheres first.
    curvature : (n,)
        One over the radius; 0 for planes.
    repeated : (n,)
        Whether an object equals one that is earlier in the file: it is never seen, and shades
        nothing more.
    layers : float
        How many objects at most lie behind a sample, on average over any row.
    """

    raster: Raster
    surfaces: Surfaces
    spheres: Spheres
    boxes: Boxes
    frames: Frames
    eye_inside: Bools
    curvature: Floats
    repeated: Bools
    layers: float

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The kinds of objects that there are."""
        both: tuple[Shape, ...] = self.spheres, self.boxes
        return tuple(shape for shape in both if shape.count)

    def at_once(self, samples: int) -> int:
        """Number of samples to take at a time: fewer where many objects lie behind each other."""
        return max(1, int(samples * min(1.0, _LAYERS / max(self.layers, 1.0))))


def view_of(raster: Raster, surfaces: Surfaces) -> View:
    """Prepare surfaces to be seen from a raster's eye."""
    spheres, boxes = Spheres.of(raster, surfaces), Boxes.of(raster, surfaces)
    frames = Frames(*map(np.append, spheres.frames, boxes.frames))
    same = _repeated(surfaces)
    frames = frames._replace(top=np.where(same, np.inf, frames.top))
    return View(
        raster=raster,
        surfaces=surfaces,
        spheres=spheres,
        boxes=boxes,
        frames=frames,
        eye_inside=np.append(spheres.eye_inside, boxes.eye_inside),
        curvature=np.append(1 / spheres.radius, np.zeros(boxes.count)),
        repeated=same,
        layers=frames.layers(raster),
    )


def _repeated(surfaces: Surfaces) -> Bools:
    """See `View.repeated`."""
    radius, ends = surfaces.radius, [*surfaces.min_pt.T, *surfaces.max_pt.T]
    spheres = [*surfaces.center.T, radius, radius, radius + np.inf]  # no box ends there
    numbers = np.concatenate([spheres, ends], axis=1)
    # By one number that hardly any others share: equal objects then follow each other.
    number = (np.sqrt([[2], [3], [5], [7], [11]]) * numbers[:5]).sum(axis=0)
    order = np.lexsort((surfaces.file_index, number))
    repeated = np.empty(order.size, dtype=np.bool_)
    repeated[order] = ~changes(*numbers[:, order])
    return repeated


class Group(NamedTuple):
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
    owner : (runs,)
        Which object each sees (spheres first).
    face, sign, level, n, height
        See `Spheres.surface`.
    """

    shape: Shape
    part: slice
    sample: Ints
    counts: Ints
    owner: Ints
    face: Ints
    sign: Floats
    level: Floats
    n: Triple
    height: Floats

    def spread(self, values: Any) -> Any:
        """Values of runs, repeated for each of their samples."""
        return spread(values, self.counts)

    def at_samples(self, values: Floats) -> Floats:
        """`n`'s components or `height`, or what is made of them, for each sample."""
        return spread(values, self.counts) if self.shape.flat else values

    def of(self, values: NDArray[Any]) -> Any:
        """Values of objects, spheres first, for each of the samples that see them."""
        return self.spread(values[self.owner])

    def height_of(self, position: Floats, vector: Triple, out: Floats) -> None:
        """Height `out` (n,) of a point over the tangent planes.

        `position` (3,): in the scene's axes; `vector`, three (n,): from the hits to the point, in
        the camera's axes.
        """
        if self.shape.flat:
            # Along the scene's axes a light in a face's plane is at height 0 exactly.
            out[:] = self.spread(self.sign * (position[self.face] - self.level))
        else:
            dot(self.n, vector, out)


class Visible(NamedTuple):
    """The points that samples see, shape by shape.

    Attributes
    ----------
    view : View
    p : (3, n)
        Points seen from the eye, in the camera's axes.
    groups : list of Group
    sample : (n,)
        The sample that each point is seen by.
    first : (runs + 1,)
        Where each run of points begins, through all groups, and the end of the last.
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
    sample: Ints
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
    def distance(self) -> Floats:
        """Distance (n,) of each point from the eye."""
        x, y, z = self.p
        return np.sqrt(dot((x, y, z), (x, y, z)))

    def points(self, index: Ints | slice) -> Triple:
        """Some of the points in the scene's axes."""
        return self.view.raster.point_to_scene(pick(self.p, index))
