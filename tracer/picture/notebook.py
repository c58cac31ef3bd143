"""Show a scene as its picture in a notebook, which calls `Scene._repr_png_` to get a PNG file."""

from __future__ import annotations

import io
from dataclasses import replace
from math import sqrt

from tracer.picture.formats import FORMATS
from tracer.picture.lint import SceneWarning, lint_scene, warn_user
from tracer.picture.parallel import choose_thread_count
from tracer.picture.render_job import RenderJob
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
    png = FORMATS["png"]
    file = io.BytesIO()
    tiles = job.render_tiles(png.encode, choose_thread_count(None))
    exposure = png.write_picture(file, job.rectangle.width, job.rectangle.height, tiles)
    for message in lint_scene(shown_scene, job.prepared_scene, exposure):
        warn_user(message, SceneWarning, in_notebook=True)
    if shown_scene is not scene:
        message = (
            f"the picture of {scene.width} x {scene.height} pixels is shown with only"
            f" {shown_scene.width} x {shown_scene.height}; tracer.write_png writes all of them"
        )
        warn_user(message, UserWarning, in_notebook=True)
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
