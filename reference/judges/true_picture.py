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
from reference.command import build_path
from reference.judges.certificate import Certificate, certify
from tracer import Scene, SceneWarning, render, save_scene

# Approximate number of samples that `render_supersampled` renders together: it limits memory.
_SAMPLES_PER_STRIP = 1 << 22


@cache
def _code_hash() -> bytes:
    """Compute a hash of the source code of the tracer and of the certificate."""
    folders = (Path(package.__path__[0]) for package in (tracer, reference.judges))
    paths = (path for folder in folders for path in sorted(folder.rglob("*.py")))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).digest()


def true_picture(scene: Scene, error: float) -> Certificate:
    """Certify a scene's picture, or read the certificate from the build folder.

    A new certificate is stored in the build folder.  A stored certificate is used again only for
    the same scene and error, and only if the code that computed it has not changed.

    Parameters
    ----------
    scene : Scene
        The scene.
    error : float
        Permitted error of each pixel's mean, in linear radiance: see `certify`.

    Returns
    -------
    certificate : Certificate
        The picture with its bounds.

    Raises
    ------
    ValueError
        If the scene cannot be certified: see `certify`.
    """
    save_scene(scene, scene_file := io.BytesIO())
    key = hashlib.sha256(f"{error!r}".encode() + scene_file.getvalue() + _code_hash()).hexdigest()
    path = build_path(f"certificate-{key[:16]}.npz")
    if not path.exists():
        certificate = certify(scene, error)
        incomplete_path = build_path(f"certificate-{key[:16]}.part.npz")
        np.savez(incomplete_path, *astuple(certificate))
        incomplete_path.replace(path)
        return certificate
    with np.load(path) as arrays:
        low, high, image, cell_count = arrays.values()
        return Certificate(low, high, image, int(cell_count))


def rmse(image: NDArray[np.float64], reference_image: NDArray[np.float64]) -> float:
    """Compute the root mean square difference of two images.

    Parameters
    ----------
    image, reference_image : (height, width, 3) float arrays
        The two images.

    Returns
    -------
    rmse : float
        The root of the mean square difference of all pixels and channels.
    """
    return float(np.sqrt(np.mean((image - reference_image) ** 2)))


def render_supersampled(scene: Scene, side: int) -> NDArray[np.float64]:
    """Render a scene with a uniform grid of samples in each pixel.

    The samples are the pixels of a picture that is `side` times as wide and high.  It is rendered
    at one sample per pixel, in strips of rows, because the whole picture may not fit into memory.

    Parameters
    ----------
    scene : Scene
        The scene.
    side : int
        Number of samples along each side of a pixel.

    Returns
    -------
    image : (height, width, 3) float array
        Mean linear RGB radiance of the samples in each pixel.
    """
    strips, camera = [], scene.camera
    strip_height = max(1, _SAMPLES_PER_STRIP // (scene.width * side**2))
    for top in range(0, scene.height, strip_height):
        height = min(strip_height, scene.height - top)
        strip_camera = replace(camera, view_height=camera.view_height * height / scene.height)
        window = replace(scene, camera=strip_camera, width=scene.width * side, height=height * side)
        # Distance of the strip's centre below the picture's centre, in samples.
        offset = (top + height / 2 - scene.height / 2) * side
        with warnings.catch_warnings():  # a strip may be black although the picture is not
            warnings.simplefilter("ignore", SceneWarning)
            image = render(window, offset=(0, offset))
        strips.append(image.reshape(height, side, scene.width, side, 3).mean(axis=(1, 3)))
    return np.concatenate(strips)
