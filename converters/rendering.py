"""Mitsuba's pictures of scenes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from math import isqrt
from time import perf_counter

import numpy as np

from converters.flavours import exact
from converters.variant import ensure, mi, use
from tracer.arrays import Floats
from tracer.commands import atomic_file
from tracer.scene.model import Scene

__all__ = ["Rendering", "load", "render_mitsuba", "write_exr"]

_EXR = b"\x76\x2f\x31\x01"  # how a file of this format begins

# More samples in a picture than Mitsuba counts, in 32 bits, would end in a riddle.
_MOST_SAMPLES = 2**32 - 1


@dataclass(frozen=True, slots=True)
class Rendering:
    """A picture by Mitsuba: (h, w, 3) float64, linear; by which variant, in how many seconds."""

    image: Floats
    variant: str
    seconds: float


def render_mitsuba(scene: Scene, samples: int = 1, variant: str | None = None) -> Floats:
    """Render a scene with Mitsuba, in the exact flavour.

    Parameters
    ----------
    scene : Scene
    samples : int
        Samples a pixel: 1 takes the centre, more are stratified.
    variant : str, optional
        Mitsuba's variant; the fastest that works here if absent.

    Returns
    -------
    image : (h, w, 3) float64
        Linear RGB.

    Raises
    ------
    ImportError
        If the given variant does not work here.
    ValueError
        If the samples are more than Mitsuba can count, or a number is beyond those of float32.
    """
    every = scene.width * scene.height * (isqrt(samples - 1) + 1) ** 2
    if every > _MOST_SAMPLES:
        raise ValueError(
            f"{every} samples are too many: Mitsuba takes {_MOST_SAMPLES} at most;"
            " use fewer a pixel"
        )
    return load(exact(scene, samples), variant)().image


def load(text: str, variant: str | None) -> Callable[[], Rendering]:
    """Load a converted scene into Mitsuba; each call of what is returned renders it."""
    chosen = use(variant).variant
    import converters.plugins  # noqa: F401 (registers the plugins that scenes name)

    # Otherwise every run would warn that Python plugins are slow in scalar variants.
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_string(text)

    def rendered() -> Rendering:
        start = perf_counter()
        image = np.array(mi.render(scene), dtype=np.float64)
        return Rendering(image, chosen, perf_counter() - start)

    return rendered


def write_exr(path: str | os.PathLike[str], image: Floats) -> None:
    """Write a linear picture (h, w, 3) as float32 EXR."""
    ensure()
    stream = mi.MemoryStream()
    mi.Bitmap(image.astype(np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    with atomic_file(path, _EXR) as file:
        file.write(stream.raw_buffer())
