"""Show a scene as its picture in a notebook, which calls `Scene._repr_png_` to get a PNG file."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from math import sqrt
from operator import add

from tracer.picture.lint import Exposure, SceneWarning, lint_scene
from tracer.picture.png import CompressedTile, write_tiles
from tracer.picture.render import RenderJob, render_tiles
from tracer.scene.model import Scene

# Maximum number of pixels in a notebook: 4096 x 4096, the most that Safari draws on iOS.
_MAX_PIXELS = 1 << 24
# Maximum width and height in a notebook: the largest texture of usual graphics processors.
_MAX_SIDE = 1 << 14


def make_notebook_png(scene: Scene) -> bytes:
    """Render a scene to the bytes of a PNG file, with no more pixels than a browser can show.

    The picture is made tile by tile, so it takes little more memory than the file.  What looks like
    a mistake in the scene is reported with `warnings.warn`, at the line of the user's code that
    shows the scene.  So is a picture that had to be made smaller.
    """
    shown_scene = _limit_size(scene)
    job = RenderJob(shown_scene)
    exposure = Exposure()

    def collect_tiles() -> Iterator[CompressedTile]:
        nonlocal exposure
        for tile, tile_exposure in render_tiles(job):
            exposure = Exposure(*map(add, exposure, tile_exposure))
            yield tile

    file = io.BytesIO()
    write_tiles(file, shown_scene.width, shown_scene.height, collect_tiles())
    for message in lint_scene(shown_scene, job.prepared_scene, exposure):
        warnings.warn(message, SceneWarning, stacklevel=_find_user_level())
    if shown_scene is not scene:
        message = (
            f"the picture of {scene.width} x {scene.height} pixels is shown with only"
            f" {shown_scene.width} x {shown_scene.height}; tracer.write_png writes all of them"
        )
        warnings.warn(message, stacklevel=_find_user_level())
    return file.getvalue()


def _limit_size(scene: Scene) -> Scene:
    """Return the scene, or a copy with a smaller picture if the picture exceeds the limits.

    The proportions of the picture are kept, and neither side becomes 0.
    """
    width, height = scene.width, scene.height
    factor = max(sqrt(width * height / _MAX_PIXELS), max(width, height) / _MAX_SIDE)
    if factor <= 1:
        return scene
    return replace(scene, width=max(1, int(width / factor)), height=max(1, int(height / factor)))


def _find_user_level() -> int:
    """Return the `stacklevel` with which the caller of this function warns about the user's line.

    User code runs in the module `__main__`.  Between it and this module are functions of the
    notebook.  If no caller is in `__main__`, return 2, which stands for the caller's caller.
    """
    level = 1
    frame = sys._getframe(1)
    while frame.f_globals.get("__name__") != "__main__":
        if frame.f_back is None:
            return 2
        level += 1
        frame = frame.f_back
    return level
