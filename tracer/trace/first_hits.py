"""First hits of rays from the eye, as the library reports them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated as Shaped

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import BATCH_SIZE, Floats, Ints, find, map_xyz, split_indices
from tracer.geometry.shape import NO_AXIS
from tracer.scene.model import Scene
from tracer.trace.hits import Hits
from tracer.trace.samples import Scattered
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import PreparedScene

# Maximum number of rays that are traced together: it limits memory.
_RAYS_PER_BATCH = BATCH_SIZE


@dataclass(frozen=True, eq=False)
class FirstHits:
    """The points where rays from the eye first meet a surface, in scene axes and units.

    Attributes
    ----------
    surface : (...) int array
        Index of the surface among the surfaces of the scene, in the order of the file; -1 if the
        ray meets no surface.
    distance : (...) float array
        Distance of the point from the eye; infinity if the ray meets no surface.
    normal : (..., 3) float array
        Unit normal that faces the eye; NaN if the ray meets no surface.
    point : (..., 3) float array
        Position of the point; NaN if the ray meets no surface.
    """

    surface: Ints
    distance: Floats
    normal: Floats
    point: Floats

    @classmethod
    def from_hits(cls, hits: Hits) -> FirstHits:
        """Arrange hits, at most one for each sample, in the order of the samples."""
        sample_count = hits.samples.size
        sample_index = hits.sample_index
        surface = np.full(sample_count, -1)
        distance = np.full(sample_count, np.inf)
        normal, point = np.full((2, sample_count, 3), np.nan)
        surface[sample_index] = hits.scene.surfaces.file_index[hits.hit_object]
        distance[sample_index] = hits.distance
        point[sample_index] = np.transpose(hits.get_points(slice(None)))
        for group in hits.groups:
            normal[group.sample_index] = np.transpose(
                hits.scene.frame.rotate_to_scene(map_xyz(group.expand_to_hits, group.planes.normal))
            )
            # Normals of planar faces are exact, unlike normals converted from camera axes.
            axis, sign = map(group.repeat_runs, (group.planes.face_axis, group.planes.normal_sign))
            planar = find(axis != NO_AXIS)
            normal[group.sample_index[planar]] = 0
            normal[group.sample_index[planar], axis[planar]] = sign[planar]
        return cls(surface=surface, distance=distance, normal=normal, point=point)


@np.errstate(all="ignore")
def first_hits(scene: Scene, x: ArrayLike | None = None, y: ArrayLike | None = None) -> FirstHits:
    """Find the first surface that the ray through each position in the picture hits.

    If several surfaces are at exactly the same distance, the first one in the scene file is hit.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : (...) array_like, optional
        Distances from the left and upper edges of the picture, in pixels: two numbers, or two
        arrays of the same shape.  The centre of the first pixel is at x = y = 0.5.  Positions
        outside the picture are allowed.  By default, the centres of all pixels are used.

    Returns
    -------
    hits : FirstHits
        Surface, distance, normal and position of each first hit.  The shape (...) is that of `x`
        and `y`; by default, (height, width).

    Raises
    ------
    TypeError
        If only one of `x` and `y` is given.
    ValueError
        If positions are not finite, or `x` and `y` have different shapes.
    """
    position_x, position_y = _choose_positions(scene, x, y)
    shape = position_x.shape
    hits = _find_first_hits(PreparedScene(scene), position_x.ravel(), position_y.ravel())
    return FirstHits(
        surface=hits.surface.reshape(shape),
        distance=hits.distance.reshape(shape),
        normal=hits.normal.reshape(*shape, 3),
        point=hits.point.reshape(*shape, 3),
    )


def _choose_positions(
    scene: Scene, x: ArrayLike | None, y: ArrayLike | None
) -> tuple[Shaped[Floats, "..."], Shaped[Floats, "..."]]:
    """Return `x` and `y` as arrays of one shape, or the centres of all pixels if both are None.

    Raises the errors of `first_hits`.
    """
    if (x is None) != (y is None):
        raise TypeError("x and y must both be given, or neither")
    if x is None or y is None:
        y, x = np.indices((scene.height, scene.width)) + 0.5
    position_x = np.asarray(x, dtype=np.float64)
    position_y = np.asarray(y, dtype=np.float64)
    if position_x.shape != position_y.shape:
        shapes = f"{position_x.shape} and {position_y.shape}"
        raise ValueError(f"x and y must have the same shape, not {shapes}")
    if not (np.isfinite(position_x).all() and np.isfinite(position_y).all()):
        raise ValueError("x and y must be finite")
    return position_x, position_y


def _find_first_hits(
    scene: PreparedScene, x: Shaped[Floats, "n"], y: Shaped[Floats, "n"]
) -> FirstHits:
    """Find the first hit of the ray through each position; trace the rays in batches."""
    hits = FirstHits(
        surface=np.empty(x.size, dtype=np.intp),
        distance=np.empty(x.size),
        normal=np.empty((x.size, 3)),
        point=np.empty((x.size, 3)),
    )
    for batch in split_indices(np.arange(x.size), scene.choose_batch_size(_RAYS_PER_BATCH)):
        samples, order = Scattered.from_positions(x[batch], y[batch])
        batch_hits = FirstHits.from_hits(find_nearest_hits(scene, samples))
        for name, values in vars(hits).items():
            values[batch[order]] = getattr(batch_hits, name)
    return hits
