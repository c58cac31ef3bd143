"""Render scenes with Mitsuba."""

from __future__ import annotations

import os
from collections.abc import Callable
from math import isqrt
from time import perf_counter
from typing import NamedTuple

import numpy as np

from converters.camera import Floats
from converters.flavours import SAMPLES, convert
from converters.variant import ensure, mi, use
from tracer import Scene
from tracer.files import atomic_file

__all__ = ["Rendering", "load", "render_mitsuba", "write_exr"]

_EXR_MAGIC = b"\x76\x2f\x31\x01"

# Maximum number of samples in a picture: Mitsuba's counter of 32 bits would overflow.
_MAX_SAMPLES = 2**32 - 1


class Rendering(NamedTuple):
    """A picture rendered by Mitsuba.

    Attributes
    ----------
    image : (h, w, 3) float array
        Linear radiance.
    variant : str
        Mitsuba's variant.
    seconds : float
        Time to render, without loading the scene.
    """

    image: Floats
    variant: str
    seconds: float


def render_mitsuba(
    scene: Scene, samples: int | None = None, variant: str | None = None, flavour: str = "exact"
) -> Floats:
    """Render a scene with Mitsuba.

    Parameters
    ----------
    scene : Scene
    samples : int, optional
        Number of samples per pixel; the default depends on the flavour.
    variant : str, optional
        Mitsuba's variant; the default is the fastest that works on this machine.
    flavour : str
        A key of `SAMPLES`.  The picture of a stock flavour has square pixels.

    Returns
    -------
    image : (h, w, 3) float array
        Linear radiance.

    Raises
    ------
    ImportError
        If the variant does not work here.
    ValueError
        If there are more samples than Mitsuba can count, or the scene cannot be converted.
    """
    per_side = isqrt((samples or SAMPLES[flavour]) - 1) + 1
    total = scene.width * scene.height * per_side**2
    if total > _MAX_SAMPLES:
        raise ValueError(
            f"{total} samples are too many: Mitsuba takes {_MAX_SAMPLES} at most;"
            " use fewer per pixel"
        )
    return load(convert(scene, flavour, samples), variant)().image


def load(text: str, variant: str | None = None) -> Callable[[], Rendering]:
    """Load a converted scene, which can then be rendered several times.

    Parameters
    ----------
    text : str
        Content of the converted file.
    variant : str, optional
        Mitsuba's variant; the default is the fastest that works on this machine.

    Returns
    -------
    render_loaded : callable
        Takes no arguments; renders the scene and returns a `Rendering`.

    Raises
    ------
    ImportError
        If the variant does not work here.
    """
    chosen = use(variant).variant
    import converters.plugins  # noqa: F401 (registers the plugins that scenes name)

    # Otherwise each process would warn that Python plugins are slow in scalar variants.
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_string(text)

    def render_loaded() -> Rendering:
        start = perf_counter()
        image = np.array(mi.render(scene), dtype=np.float64)
        return Rendering(image, chosen, perf_counter() - start)

    return render_loaded


def write_exr(path: str | os.PathLike[str], image: Floats) -> None:
    """Write a linear picture (h, w, 3) as an EXR file of float32.

    Raises
    ------
    OSError
        If the file cannot be written, or a file that is not an EXR exists at the path.
    """
    ensure()
    stream = mi.MemoryStream()
    mi.Bitmap(image.astype(np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    with atomic_file(path, _EXR_MAGIC) as file:
        file.write(stream.raw_buffer())
