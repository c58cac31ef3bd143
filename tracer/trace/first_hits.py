"""First hits of the camera's rays, as the library reports them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import BATCH_SIZE, Floats, Ints
from tracer.scene.model import Scene
from tracer.trace.hits import Hits
from tracer.trace.samples import Samples, Scattered, pixel_centers
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# Maximum number of rays that are traced together: it limits memory.
_RAYS_PER_BATCH = BATCH_SIZE


@dataclass(frozen=True, eq=False)
class FirstHits:
    """The points where rays first meet a surface, in the axes and units of the scene.

    Attributes
    ----------
    surface : (...) int array
        Index of the surface among the surfaces of the scene, in the order of the file; -1 if the
        ray meets no surface.
    distance : (...) float array
        Distance of the point from the eye; infinity if the ray meets no surface.
    normal : (..., 3) float array
        Unit normal on the side of the eye; NaN if the ray meets no surface.
    point : (..., 3) float array
        Position of the point; NaN if the ray meets no surface.
    """

    surface: Ints
    distance: Floats
    normal: Floats
    point: Floats

    @classmethod
    def from_hits(cls, hits: Hits) -> FirstHits:
        """Arrange the hits of n samples by sample: arrays (n,) and (n, 3)."""
        count, frame = hits.samples.size, hits.prepared.frame
        surface, distance = np.full(count, -1), np.full(count, np.inf)
        normal, point = np.full((2, count, 3), np.nan)
        surface[hits.sample] = hits.prepared.surfaces.file_index[hits.hit_object]
        distance[hits.sample] = hits.distance
        point[hits.sample] = np.transpose(hits.points(slice(None)))
        for group in hits.groups:
            if group.shape.is_planar:  # exact, which normals in the axes of the camera are not
                normal[group.sample] = 0
                normal[group.sample, group.repeat_runs(group.face)] = group.repeat_runs(group.sign)
            else:
                normal[group.sample] = np.transpose(frame.vector_to_scene(group.normal))
        return cls(surface, distance, normal, point)


@np.errstate(all="ignore")
def first_hits(scene: Scene, x: ArrayLike | None = None, y: ArrayLike | None = None) -> FirstHits:
    """Find the surface that the ray through each position of the picture meets first.

    Of several surfaces at exactly the same distance, the first in the file counts.

    Parameters
    ----------
    scene : Scene
        The scene.
    x, y : (...) array_like, optional
        Numbers, or arrays of one shape: positions in pixels to the right and down from the upper
        left corner of the picture.  The centre of the first pixel is at x = y = 0.5.  Positions
        outside of the picture are allowed.  By default, the centres of all pixels.

    Returns
    -------
    hits : FirstHits
        Its arrays have the shape of `x` and `y`; by default, (height, width).

    Raises
    ------
    TypeError
        If only one of `x` and `y` is given.
    ValueError
        If positions are not finite, or `x` and `y` have different shapes.
    """
    if (x is None) != (y is None):
        raise TypeError("x and y must both be given, or neither")
    prepared = PreparedScene(scene)
    if x is None:
        return _gather(prepared, (scene.height, scene.width), _picture_batches(prepared))
    across, down = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if across.shape != down.shape:
        raise ValueError(f"x and y must have one shape, have {across.shape} and {down.shape}")
    if not (np.isfinite(across).all() and np.isfinite(down).all()):
        raise ValueError("x and y must be finite")
    batches = _position_batches(prepared, across.ravel(), down.ravel())
    flat = _gather(prepared, (across.size,), batches)
    return FirstHits(
        *(array.reshape(across.shape + array.shape[1:]) for array in vars(flat).values())
    )


def _picture_batches(prepared: PreparedScene) -> Iterator[tuple[tuple[slice, slice], Samples]]:
    """Divide the picture into batches; yield their rows and columns, and the pixels' centres."""
    width, height = prepared.frame.width, prepared.frame.height
    max_rays = prepared.batch_size(_RAYS_PER_BATCH)
    column_step, row_step = min(width, max_rays), max(1, max_rays // width)
    for top, left in product(range(0, height, row_step), range(0, width, column_step)):
        rows = slice(top, min(top + row_step, height))
        columns = slice(left, min(left + column_step, width))
        yield (rows, columns), pixel_centers(rows, columns)


def _position_batches(
    prepared: PreparedScene, x: Floats, y: Floats
) -> Iterator[tuple[Ints, Samples]]:
    """Divide positions (n,) into batches; yield their indices, and the positions as samples."""
    step = prepared.batch_size(_RAYS_PER_BATCH)
    for start in range(0, x.size, step):
        samples, order = Scattered.from_positions(x[start : start + step], y[start : start + step])
        yield start + order, samples


def _gather(
    prepared: PreparedScene, shape: tuple[int, ...], batches: Iterable[tuple[Any, Samples]]
) -> FirstHits:
    """Find the first hits of samples in batches, and arrange them in arrays.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    shape : tuple of int
        Shape of the arrays.
    batches : iterable of (index, samples)
        For each batch, an index into arrays of this shape, and the samples at this index.
    """
    result = FirstHits(
        np.empty(shape, dtype=np.intp),
        np.empty(shape),
        np.empty((*shape, 3)),
        np.empty((*shape, 3)),
    )
    for index, samples in batches:
        batch = FirstHits.from_hits(nearest_hits(prepared, samples))
        for name, array in vars(result).items():
            values = getattr(batch, name)
            array[index] = values.reshape(array[index].shape)
    return result
