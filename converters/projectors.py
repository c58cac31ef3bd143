"""Light without fall-off from Mitsuba's own projectors: what is seen from a light undoes it.

A ``projector`` is a point light with a picture in front of it: through a texel of value E arrives
pi E / (z^2 cos a) at a depth z, where the ray makes the angle a with the projector's axis.  So a
texel of z^2 cos a, with the depth of what the light shines on there, sends the same to all of it.
Six projectors with square pictures cover all directions from a light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from math import ceil, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from converters.camera import Floats, window_of
from tracer import Camera, Scene, first_hits

__all__ = ["SIDE", "Cell", "Face", "faces", "gather", "pfm"]

Square: TypeAlias = tuple[float, float, float]
"""A square part of a picture, in shares of its side: size, left, top."""

SIDE = 256
"""Texels across a face."""


# Directions to the middle of a face and to its upper side.
_FACES = [
    face
    for s in (1.0, -1.0)
    for face in (
        ((s, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((0.0, s, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, s), (1.0, 0.0, 0.0)),
    )
]


class Face(NamedTuple):
    """What a light shines on, of all that is in view, through one face of a cube around it.

    Attributes
    ----------
    light : int
    camera : Camera
        At the light; it looks at the face.
    part : (float, float, float)
        The part of the face that matters: its size, left and top, as tangents of angles.
    irradiance : (SIDE, SIDE)
        z^2 cos a of each texel of that part; 0 where nothing is met.
    """

    light: int
    camera: Camera
    part: Square
    irradiance: Floats


class Cell(NamedTuple):
    """A face in the picture of all: where, and what its brightest texel, 1, stands for."""

    square: Square
    brightest: float


@np.errstate(all="ignore")
def faces(scene: Scene) -> Iterator[Face]:
    """Every face of every light through which something in view is lit."""
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    seen = first_hits(scene, x, y).point
    for (number, light), (ahead, up) in product(enumerate(scene.lights), _FACES):
        camera = Camera(view_point=light.position, view_dir=ahead, view_up=up)
        right, down, depth = window_of(camera).axes @ (seen - light.position).T
        ends = np.array([right, down]) / depth
        ends = ends[:, (depth > 0) & (np.abs(ends) <= 1).all(axis=0)]
        if not ends.size:
            continue
        low, high = ends.min(axis=1), ends.max(axis=1)
        # A few texels wider on all sides, as objects reach beyond the centres of pixels.
        size = max(float((high - low).max()), 1 / SIDE) * (1 + 8 / SIDE)
        corner = (low + high - size) / 2
        texels = (np.arange(SIDE) + 0.5) * (size / SIDE) + corner[:, None]
        yield Face(number, camera, (size, *corner), _irradiance(scene, camera, *texels))


def _irradiance(scene: Scene, camera: Camera, x: Floats, y: Floats) -> Floats:
    """z^2 cos a (SIDE, SIDE) at the crossings of columns and rows; 0 where nothing is met."""
    # A window of 1 x 1 at distance 1, in a picture of one pixel: its middle is straight ahead.
    square = replace(scene, camera=camera, width=1, height=1)
    across, below = (plane.ravel() for plane in np.meshgrid(x, y))
    distance = first_hits(square, across + 0.5, below + 0.5).distance
    z2_cos = np.where(np.isfinite(distance), distance**2, 0) / (1 + across**2 + below**2) ** 1.5
    return z2_cos.reshape(SIDE, SIDE)


def gather(scene: Scene, found: Sequence[Face]) -> tuple[Floats, list[Cell]]:
    """One picture (h, h, c) of all faces in the colours of their lights, and where each is in it.

    It is grey (c = 1) if all lights are.
    """
    side = max(1, ceil(sqrt(len(found))))
    colors = np.array([light.intensity for light in scene.lights]).reshape(-1, 3)
    if (colors == colors[:, :1]).all():
        colors = colors[:, :1]
    whole = np.zeros((side, SIDE, side, SIDE, colors.shape[1]))
    cells = []
    for number, face in enumerate(found):
        row, column = divmod(number, side)
        picture = face.irradiance[:, :, None] * colors[face.light]
        most = float(picture.max()) or 1.0
        whole[row, :, column] = picture / most
        cells.append(Cell((1 / side, column / side, row / side), most))
    return whole.reshape(side * SIDE, side * SIDE, -1), cells


def pfm(image: Floats) -> bytes:
    """A picture (h, w, 1 or 3) as a PFM file: float32, from the last row to the first."""
    height, width, channels = image.shape
    head = f"{'PF' if channels == 3 else 'Pf'}\n{width} {height}\n-1.0\n"
    return head.encode() + image[::-1].astype("<f4").tobytes()
