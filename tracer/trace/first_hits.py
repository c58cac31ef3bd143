"""First hits of the camera's rays, as the library reports them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tracer.arrays import BATCH_SIZE, Floats, Ints
from tracer.geometry.camera import camera_frame
from tracer.scene.model import Scene
from tracer.trace.samples import Scattered
from tracer.trace.visibility import nearest_hits
from tracer.world.prepared_scene import PreparedScene

# Maximum number of rays that are traced together: it limits memory.
_RAYS_PER_BATCH = BATCH_SIZE


@dataclass(frozen=True, eq=False)
class FirstHits:
    """The points of surfaces that rays hit first, in the scene's axes and units.

    Attributes
    ----------
    surface : (...)
        Index into the scene's surfaces, in the file's order; -1 where a ray hits nothing.
    distance : (...)
        From the eye; infinity where a ray hits nothing.
    normal : (..., 3)
        Unit normal, on the side of the eye; NaN where a ray hits nothing.
    point : (..., 3)
        NaN where a ray hits nothing.
    """

    surface: Ints
    distance: Floats
    normal: Floats
    point: Floats


@np.errstate(all="ignore")
def first_hits(scene: Scene, x: ArrayLike, y: ArrayLike) -> FirstHits:
    """Trace rays through positions in the picture.

    Parameters
    ----------
    scene : Scene
    x, y : (...)
        Numbers, or arrays of one shape, in pixels to the right and down from the picture's upper
        left corner; pixels' centres are at .5.  Positions outside the picture are allowed.

    Returns
    -------
    FirstHits
        In arrays of that shape; of surfaces at exactly the same distance, the first in the file.

    Raises
    ------
    ValueError
        For positions that are not finite, or of two shapes.
    """
    across, down = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    shape = across.shape
    if shape != down.shape:
        raise ValueError(f"x and y must have one shape, have {shape} and {down.shape}")
    across, down = across.ravel(), down.ravel()
    if not (np.isfinite(across).all() and np.isfinite(down).all()):
        raise ValueError("x and y must be finite")
    frame, n = camera_frame(scene.camera, scene.width, scene.height), across.size
    prepared, file_index = PreparedScene(scene, frame), scene.surfaces.file_index
    normal, point = np.full((2, n, 3), np.nan)
    surface, distance = np.full(n, -1), np.full(n, np.inf)
    step = prepared.at_once(_RAYS_PER_BATCH)
    for start in range(0, n, step):
        samples, order = Scattered.of(across[start : start + step], down[start : start + step])
        seen = nearest_hits(prepared, samples)
        ray = start + order[seen.sample]
        surface[ray] = file_index[seen.hit_object]
        distance[ray] = seen.distance
        point[ray] = np.transpose(seen.points(slice(None)))
        for group in seen.groups:
            at = start + order[group.sample]
            if group.shape.flat:
                normal[at] = 0
                normal[at, group.repeat_runs(group.face)] = group.repeat_runs(group.sign)
            else:
                normal[at] = np.transpose(frame.vector_to_scene(group.n))
    vectors = (*shape, 3)
    return FirstHits(
        surface.reshape(shape),
        distance.reshape(shape),
        normal.reshape(vectors),
        point.reshape(vectors),
    )
