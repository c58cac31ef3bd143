"""Render a scene to an array of linear radiance, or to the bytes of a PNG file.

The picture is divided into tiles, which threads of this process share where Python has no global
lock.  They can be shared with an executor of the user instead, whose workers are usually processes.
"""

from __future__ import annotations

import io
from functools import partial
from typing import Annotated as Shaped
from typing import Any, SupportsFloat, SupportsIndex

import numpy as np

from tracer.arrays import Floats
from tracer.picture.distribution import Distribution, Executor
from tracer.picture.lint import Exposure, SceneWarning, lint_scene, warn_user
from tracer.picture.parallel import WorkerPool, choose_thread_count, count_processors
from tracer.picture.png import write_png
from tracer.picture.render_job import Crop, RenderJob
from tracer.picture.tiles import Rectangle
from tracer.scene.model import Scene


def render(
    scene: Scene,
    samples: SupportsIndex = 1,
    *,
    executor: Executor | None = None,
    offset: tuple[SupportsFloat, SupportsFloat] = (0.0, 0.0),
    crop: Crop | None = None,
    threads: SupportsIndex | None = None,
) -> Floats:
    """Render a scene to an array of linear radiance.

    Parameters
    ----------
    scene : Scene
        The scene, for example from `load_scene`.
    samples : int
        Number of samples per pixel, rounded up to a square, n x n.  The error of the picture (RMSE)
        is at most that of a grid of n x n samples in every pixel, and usually much smaller.  With 1
        sample, rays pass through the centres of the pixels.
    executor : concurrent.futures.Executor, optional
        Renders part of the picture in other processes: a ProcessPoolExecutor, or an executor from
        Dask or loky.  If it is omitted, or the picture is too small to be worth sharing, the
        calling process renders the whole picture.
    offset : (float, float)
        Distances to the right and down, in pixels, by which every sample is shifted.
    crop : (int, int, int, int), optional
        The part of the picture to render: the column and the row of its top left pixel, its width
        and its height.  Every pixel is the same, to the last bit, as in the whole picture.
    threads : int, optional
        Number of threads that render the picture where Python has no global lock (free-threaded
        Python); elsewhere, and with an executor, it is 1.  By default, there is one thread for each
        processor in the main thread of a program, and 1 in other threads and in processes that
        `multiprocessing` has started: many pictures at once are rendered faster if each of them has
        one thread.

    Returns
    -------
    image : (height, width, 3) float64
        Linear RGB radiance of each pixel of the picture or its part.  Row 0 is at the top.

    Raises
    ------
    TypeError
        If `scene` is not a Scene, `samples` or `threads` is not an integer, `crop` is not four
        integers, or `executor` is not an executor.
    ValueError
        If `samples` is less than 1 or more than 999,999,999, `threads` is less than 1, `offset` is
        not two finite numbers, or `crop` has no pixel or is not inside the picture.

    Warns
    -----
    SceneWarning
        If the picture is black, more than half of its lit pixels are brighter than 1, a light or a
        shader has no effect, a colour seems to be given as 0 to 255 instead of 0 to 1, or pixels
        are far from square.  The brightness of a part of a picture is not judged.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"render takes a Scene, as load_scene returns it; {scene!r} is not a Scene")
    if executor is not None:
        _check_executor(executor)
    job = RenderJob(scene, samples, offset, crop)
    thread_count = choose_thread_count(threads)
    # NumPy gets zeros from calloc, so memory pages that stay black cost nothing.
    image = np.zeros((job.rectangle.height, job.rectangle.width, 3))
    if executor is None:
        for _ in job.process_tiles(partial(_render_into_image, image, job), thread_count):
            pass
    else:
        _share_with_executor(image, job, executor)
    exposure = Exposure.from_radiance(image) if job.is_whole else None
    for warning in lint_scene(scene, job.prepared_scene, exposure):
        warn_user(warning, SceneWarning)
    return image


def _check_executor(executor: object) -> None:
    """Raise TypeError if an object is not an executor."""
    if not callable(getattr(executor, "submit", None)):
        raise TypeError(f"executor must be a concurrent.futures.Executor, not {executor!r}")
    if hasattr(executor, "get_executor"):
        message = "executor must be a concurrent.futures.Executor"
        raise TypeError(f"{message}: from a Dask client, client.get_executor()")


def _share_with_executor(
    image: Shaped[Floats, "height width 3"], job: RenderJob, executor: Executor
) -> None:
    """Render a picture into an array of zeros, in this process and with an executor.

    The executor gets no tile of a picture that is too small to be worth sharing.
    """

    def fits_tile(tile: Rectangle, result: object) -> bool:
        shape = (tile.height, tile.width, 3)
        return isinstance(result, np.ndarray) and result.shape == shape

    is_shared = job.work.seconds >= WorkerPool.sharing.min_seconds
    distribution = Distribution[Rectangle, Any](
        function=partial(_render_into_image, image, job),
        remote_function=job.render_tile,
        worker_count=count_processors(),
        executor=executor if is_shared else None,
        is_valid=fits_tile,
    )
    tiles = job.work.divide(WorkerPool.sharing if is_shared else None)
    for tile, radiance in zip(tiles, distribution.process(tiles), strict=True):
        if radiance is not None:  # the executor rendered the tile
            image[tile.relative_to(job.rectangle)] = radiance


def _render_into_image(
    image: Shaped[Floats, "height width 3"], job: RenderJob, tile: Rectangle
) -> None:
    """Render a tile into its place in `image`, an array of zeros for the pixels of the job."""
    job.render_tile(tile, out=image[tile.relative_to(job.rectangle)])


def to_png(
    scene: Scene,
    samples: SupportsIndex = 1,
    *,
    crop: Crop | None = None,
    threads: SupportsIndex | None = None,
) -> bytes:
    """Render a scene to the bytes of a PNG file.

    To render many scenes, let each worker of a pool render whole pictures::

        pool.map(partial(tracer.to_png, samples=4), scenes)

    Parameters
    ----------
    scene, samples, crop, threads
        As in `render`.  In a worker of a pool, one thread is the default.

    Returns
    -------
    png : bytes
        The content of an 8-bit RGB PNG file, as written by `write_png`.

    Raises
    ------
    TypeError, ValueError
        As in `render`.

    Warns
    -----
    SceneWarning
        As in `render`.
    """
    write_png(file := io.BytesIO(), render(scene, samples, crop=crop, threads=threads))
    return file.getvalue()
