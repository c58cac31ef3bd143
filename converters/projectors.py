"""Light without fall-off from Mitsuba's own projectors: what is seen from a light undoes it.

A ``projector`` is a point light behind a picture: through a texel of value E arrives
pi E / (z^2 cos a) at a depth z, where the ray makes the angle a with the projector's axis.  So a
texel of z^2 cos a, with the depth of what the light meets there, sends the same to all of it.
Six projectors with square pictures cover all directions from a light.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from converters.camera import Floats, window_of
from tracer import Camera, Scene, first_hits

__all__ = ["Projector", "projectors"]

# Texels across a projector's part of the picture, and at most across all of it.
_SIDE, _LARGEST = 256, 3072

# Least size of a part, in tangents: float32 knows places in it to a hundredth of a texel.
_LEAST = 1 / 256

# Directions to the middle of each face of a cube, and to its upper side.
_FACES = [(s * np.eye(3)[k] + 0, np.eye(3)[k - 2]) for s in (1, -1) for k in range(3)]


class Projector(NamedTuple):
    """A projector, 90 degrees wide, as a camera at a light; `brightest` is a texel of 1.

    A place (x, y) of its square, 0 ... 1, is (zoom x + left, zoom y + top) of the picture.
    """

    camera: Camera
    brightest: float
    zoom: float
    left: float
    top: float


def projectors(scene: Scene) -> tuple[list[Projector], bytes]:
    """Find the projectors for all lights, and their common picture, a PFM file."""
    texels = min(_SIDE, _LARGEST // ceil(sqrt(6 * len(scene.lights) or 1)))
    parts = list(_parts(scene, texels))
    side = max(1, ceil(sqrt(len(parts))))
    picture = np.zeros((side, texels, side, texels, 3), dtype="<f4")
    found = []
    for number, (camera, size, (x, y), irradiance) in enumerate(parts):
        row, column = divmod(number, side)
        brightest = float(irradiance.max()) or 1.0
        picture[row, :, column] = irradiance / brightest
        zoom = 2 / (size * side)
        left, top = column / side - (x + 1) / 2 * zoom, row / side - (y + 1) / 2 * zoom
        found.append(Projector(camera, brightest, zoom, left, top))
    # From the last row to the first.
    rows = picture.reshape(side * texels, -1)[::-1]
    return found, f"PF\n{len(rows)} {len(rows)}\n-1.0\n".encode() + rows.tobytes()


@np.errstate(all="ignore")
def _parts(scene: Scene, side: int) -> Iterator[tuple[Camera, float, Floats, Floats]]:
    """What each light shines on, of all that is in view, through each face of a cube around it.

    Yields a camera that looks at the face; size and corner (2,) of the part that matters, in
    tangents of angles; z^2 cos a there, times the light's intensity (side, side, 3).
    """
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = first_hits(scene, x, y).point
    for light, (ahead, up) in product(scene.lights, _FACES):
        camera = Camera(view_point=light.position, view_dir=ahead, view_up=up)
        right, down, depth = window_of(camera).axes @ (seen - light.position).T
        ends = np.array([right, down]) / depth
        through = (depth > 0) & (np.abs(ends) <= 1).all(axis=0)
        if not through.any():
            continue
        ends = ends[:, through]
        low, high = ends.min(axis=1), ends.max(axis=1)
        # A few texels wider on all sides, as objects reach beyond the centres of pixels.
        size = max(float((high - low).max()), _LEAST) * (1 + 8 / side)
        corner = (low + high - size) / 2
        texels = (np.arange(side) + 0.5) * (size / side) + corner[:, None]
        across, below = (plane.ravel() for plane in np.meshgrid(*texels))
        # The window is 1 x 1 at distance 1: in a picture of one pixel, its middle is at .5, .5.
        face = Scene(camera=camera, width=1, height=1, surfaces=scene.surfaces)
        distance = first_hits(face, across + 0.5, below + 0.5).distance
        # z is the distance times cos a.  What no ray of a texel meets may still be in view.
        usual = np.mean(depth[through] ** 2 / np.sqrt(1 + (ends**2).sum(axis=0)))
        secant = np.sqrt(1 + across**2 + below**2)
        z2_cos = np.where(np.isfinite(distance), distance**2 / secant**3, usual)
        yield camera, size, corner, z2_cos.reshape(side, side, 1) * light.intensity
