"""A scene as the eye sees it: what all rows of the picture share."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Bools, Floats, Ints, changes
from tracer.scene.model import Surfaces
from tracer.shapes.box import Boxes
from tracer.shapes.frames import Frames
from tracer.shapes.sphere import Spheres
from tracer.view.camera import Raster

Shape: TypeAlias = Spheres | Boxes
"""All objects of one kind; see `Spheres` for what they answer."""

# With more objects than this behind each other, fewer samples are taken at a time: memory grows
# with the pairs of both.
_LAYERS = 8.0


class View(NamedTuple):
    """A scene as it is seen from the eye.

    Attributes
    ----------
    raster : Raster
    surfaces : Surfaces
    spheres : Spheres
    boxes : Boxes
    frames, eye_inside, slope, curvature
        As in `Spheres`, of all n objects, spheres first.
    layers : float
        How many objects at most lie behind a sample, on average over any row.
    """

    raster: Raster
    surfaces: Surfaces
    spheres: Spheres
    boxes: Boxes
    frames: Frames
    eye_inside: Bools
    slope: Floats
    curvature: Floats
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
    frames = Frames.joined(spheres.frames, boxes.frames)
    return View(
        raster=raster,
        surfaces=surfaces,
        spheres=spheres,
        boxes=boxes,
        frames=frames,
        eye_inside=np.append(spheres.eye_inside, boxes.eye_inside),
        slope=np.append(spheres.slope, boxes.slope),
        curvature=np.append(spheres.curvature, boxes.curvature),
        layers=frames.layers(raster),
    )


def distinct(surfaces: Surfaces) -> Surfaces:
    """Leave out all that repeat an earlier surface: they are never seen, and shade nothing more."""
    spheres = np.column_stack([surfaces.center, surfaces.radius])
    boxes = np.concatenate([surfaces.min_pt, surfaces.max_pt], axis=1)
    sphere = _first_of_equal(spheres, surfaces.sphere_index)
    box = _first_of_equal(boxes, surfaces.box_index)
    if sphere.size + box.size == len(surfaces):
        return surfaces
    index = np.append(surfaces.sphere_index[sphere], surfaces.box_index[box])
    index = index.argsort().argsort()
    return Surfaces(
        center=surfaces.center[sphere],
        radius=surfaces.radius[sphere],
        sphere_shader=surfaces.sphere_shader[sphere],
        sphere_index=index[: sphere.size],
        min_pt=surfaces.min_pt[box],
        max_pt=surfaces.max_pt[box],
        box_shader=surfaces.box_shader[box],
        box_index=index[sphere.size :],
        shaders=surfaces.shaders,
    )


def _first_of_equal(table: Floats, index: Ints) -> Ints:
    """Rows (n, m) that equal none with a smaller index."""
    # One column mostly tells all rows apart: to sort by all takes several times as long.
    column = np.sort(table[:, 0])
    if np.all(column[1:] != column[:-1]):
        return np.arange(len(table))
    order = np.lexsort((index, *table.T))
    return np.sort(order[changes(*table[order].T)])
