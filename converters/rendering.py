"""Render scenes with Mitsuba."""

from __future__ import annotations

import os
from collections.abc import Callable
from math import isqrt
from time import perf_counter
from typing import NamedTuple

import numpy as np

from converters.camera import Floats
from converters.flavours import DEFAULT_SAMPLES, convert
from converters.variant import ensure_variant, mi, use_variant
from tracer import Scene
from tracer.files import open_atomically

_EXR_MAGIC = b"\x76\x2f\x31\x01"

# Maximum number of samples in a picture: Mitsuba counts them with 32 bits.
_MAX_SAMPLES = 2**32 - 1


class Rendering(NamedTuple):
    """A picture rendered by Mitsuba.

    Attributes
    ----------
    image : (h, w, 3) float array
        Linear RGB radiance.
    variant : str
        Name of the Mitsuba variant.
    seconds : float
        Rendering time, which does not include loading the scene.
    """

    image: Floats
    variant: str
    seconds: float


def render_with_mitsuba(
    scene: Scene, samples: int | None = None, variant: str | None = None, flavour: str = "exact"
) -> Floats:
    """Render a scene with Mitsuba.

    Parameters
    ----------
    scene : Scene
        The scene to convert and render.
    samples : int, optional
        Number of samples per pixel.  By default, 1 for "exact" and 64 for "stock".
    variant : str, optional
        Name of the Mitsuba variant; by default, the fastest that works on this machine.
    flavour : str
        "exact" to reproduce the tracer's picture with this project's plugins, or "stock" to
        approximate it with Mitsuba's built-in plugins, in square pixels.

    Returns
    -------
    image : (h, w, 3) float array
        Linear RGB radiance.  The size is given by the scene, but the height h may differ in the
        flavour "stock".

    Raises
    ------
    ImportError
        If the variant does not work on this machine.
    ValueError
        If the picture needs 2^32 samples or more, or the scene cannot be converted.
    """
    samples_per_side = isqrt((samples or DEFAULT_SAMPLES[flavour]) - 1) + 1
    total_sample_count = scene.width * scene.height * samples_per_side**2
    if total_sample_count > _MAX_SAMPLES:
        raise ValueError(
            f"{total_sample_count} samples are too many: Mitsuba allows at most {_MAX_SAMPLES};"
            " use fewer per pixel"
        )
    return load_into_mitsuba(convert(scene, flavour, samples), variant)().image


def load_into_mitsuba(scene_xml: str, variant: str | None = None) -> Callable[[], Rendering]:
    """Load a converted scene into Mitsuba, and return a function that renders it.

    Parameters
    ----------
    scene_xml : str
        Content of a Mitsuba scene file, such as `convert` returns.
    variant : str, optional
        Name of the Mitsuba variant; by default, the fastest that works on this machine.

    Returns
    -------
    render_scene : callable
        A function that takes no arguments, renders the scene, and returns a `Rendering`.  It can
        be called repeatedly.

    Raises
    ------
    ImportError
        If the variant does not work on this machine.
    """
    chosen_variant = use_variant(variant).variant
    import converters.plugins  # noqa: F401 (registers this project's plugins)

    # Suppress Mitsuba's warning that Python plugins are slow in scalar variants.
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_string(scene_xml)

    def render_scene() -> Rendering:
        start_time = perf_counter()
        image = np.array(mi.render(scene), dtype=np.float64)
        return Rendering(image, chosen_variant, perf_counter() - start_time)

    return render_scene


def write_exr(path: str | os.PathLike[str], image: Floats) -> None:
    """Write a picture of linear radiance to an EXR file, in float32.

    Parameters
    ----------
    path : str or path-like
        Path of the file.  An existing EXR file at this path is replaced.
    image : (h, w, 3) float array
        Linear RGB radiance.

    Raises
    ------
    OSError
        If the file cannot be written, or the path names an existing file of another format.
    """
    ensure_variant()
    stream = mi.MemoryStream()
    mi.Bitmap(image.astype(np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    with open_atomically(path, _EXR_MAGIC) as file:
        file.write(stream.raw_buffer())
