"""What pictures are measured against: certified ones, which are kept; and grids of samples."""

from __future__ import annotations

import hashlib
import io
import warnings
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import reference.judges
import tracer
from reference.command import built
from reference.judges.certificate import Certificate, certify
from tracer import Scene, SceneWarning, render, save_scene

# About how many samples are rendered at once.
_STRIP = 1 << 22


@cache
def _code() -> bytes:
    """A hash of the code that certificates depend on."""
    folders = (Path(package.__path__[0]) for package in (tracer, reference.judges))
    paths = (path for folder in folders for path in sorted(folder.rglob("*.py")))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).digest()


def true_picture(scene: Scene, error: float) -> Certificate:
    """Certify a scene's picture, or read it where the same code has certified it before."""
    save_scene(scene, text := io.BytesIO())
    key = hashlib.sha256(f"{error!r}".encode() + text.getvalue() + _code()).hexdigest()
    path = built(f"certificate-{key[:16]}.npz")
    if not path.exists():
        made = certify(scene, error)
        part = built(f"certificate-{key[:16]}.part.npz")
        np.savez(part, *astuple(made))
        part.replace(path)
        return made
    with np.load(path) as arrays:
        low, high, image, cells = arrays.values()
        return Certificate(low, high, image, int(cells))


def rmse(image: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Root mean square of the difference."""
    return float(np.sqrt(np.mean((image - truth) ** 2)))


def supersampled(scene: Scene, side: int) -> NDArray[np.float64]:
    """Average a grid of `side` x `side` samples in every pixel (height, width, 3).

    They are the pixels of a picture `side` times as large, rendered at one sample a pixel, strip by
    strip.
    """
    strips, camera = [], scene.camera
    rows = max(1, _STRIP // (scene.width * side**2))
    for top in range(0, scene.height, rows):
        height = min(rows, scene.height - top)
        window = replace(camera, view_height=camera.view_height * height / scene.height)
        large = replace(scene, width=scene.width * side, height=height * side, camera=window)
        below = (top + height / 2 - scene.height / 2) * side
        with warnings.catch_warnings():  # a strip may well be black
            warnings.simplefilter("ignore", SceneWarning)
            image = render(large, offset=(0, below))
        strips.append(image.reshape(height, side, scene.width, side, 3).mean(axis=(1, 3)))
    return np.concatenate(strips)
