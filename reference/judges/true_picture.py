"""Reference pictures that errors are measured against: certified pictures, and grids of samples."""

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

# Approximate number of samples that `supersampled` renders together: it limits memory.
_SAMPLES_PER_STRIP = 1 << 22


@cache
def _code_hash() -> bytes:
    """Compute a hash of all code on which certificates depend."""
    folders = (Path(package.__path__[0]) for package in (tracer, reference.judges))
    paths = (path for folder in folders for path in sorted(folder.rglob("*.py")))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).digest()


def true_picture(scene: Scene, error: float) -> Certificate:
    """Certify a scene's picture, or read the certificate from the build folder.

    A stored certificate is read only if it is of the same scene and error, and was computed by the
    same code.

    Parameters
    ----------
    scene : Scene
        The scene.
    error : float
        Bound on the error of each pixel, in linear radiance: see `certify`.

    Returns
    -------
    certificate : Certificate
        The picture with its bounds.
    """
    save_scene(scene, text := io.BytesIO())
    key = hashlib.sha256(f"{error!r}".encode() + text.getvalue() + _code_hash()).hexdigest()
    path = built(f"certificate-{key[:16]}.npz")
    if not path.exists():
        certificate = certify(scene, error)
        incomplete = built(f"certificate-{key[:16]}.part.npz")
        np.savez(incomplete, *astuple(certificate))
        incomplete.replace(path)
        return certificate
    with np.load(path) as arrays:
        low, high, image, cells = arrays.values()
        return Certificate(low, high, image, int(cells))


def rmse(image: NDArray[np.float64], reference_image: NDArray[np.float64]) -> float:
    """Compute the root mean square difference of two images (height, width, 3), in all channels."""
    return float(np.sqrt(np.mean((image - reference_image) ** 2)))


def supersampled(scene: Scene, side: int) -> NDArray[np.float64]:
    """Render a scene with a uniform grid of samples in each pixel.

    The samples are the pixels of a picture that is `side` times as wide and high, rendered at one
    sample per pixel, in strips of rows.

    Parameters
    ----------
    scene : Scene
        The scene.
    side : int
        Number of samples along each side of a pixel.

    Returns
    -------
    image : (height, width, 3) float array
        Mean linear radiance of the samples in each pixel.
    """
    strips, camera = [], scene.camera
    rows = max(1, _SAMPLES_PER_STRIP // (scene.width * side**2))
    for top in range(0, scene.height, rows):
        height = min(rows, scene.height - top)
        window = replace(camera, view_height=camera.view_height * height / scene.height)
        large = replace(scene, width=scene.width * side, height=height * side, camera=window)
        offset = (top + height / 2 - scene.height / 2) * side  # of the strip's centre, downwards
        with warnings.catch_warnings():  # a strip may be black although the picture is not
            warnings.simplefilter("ignore", SceneWarning)
            image = render(large, offset=(0, offset))
        strips.append(image.reshape(height, side, scene.width, side, 3).mean(axis=(1, 3)))
    return np.concatenate(strips)
