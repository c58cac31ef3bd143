"""A scene as the eye sees it: what all rows of the picture share."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from tracer.arrays import Bools, Floats
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

    def shape_of(self, owner: int) -> Shape:
        """The shape of an object."""
        return self.spheres if owner < self.boxes.first else self.boxes

    def at_once(self, samples: int) -> int:
        """How many samples to take at a time: fewer where many objects lie behind each other."""
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


def frames_of(raster: Raster, surfaces: Surfaces) -> Frames:
    """Bounds of all objects in the picture, spheres first."""
    return Frames.joined(Spheres.frames_of(raster, surfaces), Boxes.frames_of(raster, surfaces))
