"""Mitsuba's pictures of scenes."""

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

_EXR = b"\x76\x2f\x31\x01"  # how a file of this format begins

# More samples in a picture than Mitsuba counts, in 32 bits, would end in a riddle.
_MOST_SAMPLES = 2**32 - 1


class Rendering(NamedTuple):
    """A picture by Mitsuba: (h, w, 3) float64, linear; by which variant, in how many seconds."""

    image: Floats
    variant: str
    seconds: float


def render_mitsuba(
    scene: Scene, samples: int | None = None, variant: str | None = None, flavour: str = "exact"
) -> Floats:
    """Render a scene with Mitsuba: (h, w, 3) float64, linear; stock flavours in square pixels.

    Takes the flavour's samples a pixel, and the fastest variant that works here, unless they are
    given.  Raises ImportError for a variant that does not work, ValueError for more samples than
    Mitsuba can count and for what `convert` refuses.
    """
    every = scene.width * scene.height * (isqrt((samples or SAMPLES[flavour]) - 1) + 1) ** 2
    if every > _MOST_SAMPLES:
        raise ValueError(
            f"{every} samples are too many: Mitsuba takes {_MOST_SAMPLES} at most;"
            " use fewer a pixel"
        )
    return load(convert(scene, flavour, samples), variant)().image


def load(text: str, variant: str | None = None) -> Callable[[], Rendering]:
    """Load a converted scene; each call of what is returned renders it."""
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
