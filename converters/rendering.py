"""Render scenes with Mitsuba."""

from __future__ import annotations

import os
from collections.abc import Callable
from math import isqrt
from time import perf_counter
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from converters.camera import Floats
from converters.flavours import DEFAULT_SAMPLES, convert
from converters.variant import ensure_variant, mi, use_variant
from tracer import Scene
from tracer.files import open_atomically

# The first bytes of every EXR file.
_EXR_MAGIC = b"\x76\x2f\x31\x01"

# Maximum number of samples in a picture: Mitsuba counts them with 32 bits.
_MAX_SAMPLES = 2**32 - 1


class Rendering(NamedTuple):
    """A picture rendered by Mitsuba."""

    # Linear RGB radiance, and then the channels of an "aov" integrator, if the scene has one.
    image: Shaped[Floats, "height width channels"]
    variant: str
    seconds: float  # without loading the scene


def render_with_mitsuba(
    scene: Scene, samples: int | None = None, variant: str | None = None, flavour: str = "exact"
) -> Shaped[Floats, "height width 3"]:
    """Render a scene with Mitsuba.

    Parameters
    ----------
    samples
        Samples per pixel; by default, `DEFAULT_SAMPLES` of the flavour.
    variant
        Mitsuba's variant; by default, the fastest that works on this machine.
    flavour
        "exact" or "stock" (see `converters.flavours`).  In the stock flavour, pixels are square, so
        the picture may have another height than the scene says.

    Raises
    ------
    ImportError
        If the variant does not work on this machine.
    ValueError
        If the picture needs 2^32 samples or more, or the scene cannot be converted.
    """
    # Mitsuba may round the number of samples up, at most to a square.
    samples_per_side = isqrt((samples or DEFAULT_SAMPLES[flavour]) - 1) + 1
    total_sample_count = scene.width * scene.height * samples_per_side**2
    if total_sample_count > _MAX_SAMPLES:
        raise ValueError(
            f"{total_sample_count} samples are too many: Mitsuba allows at most {_MAX_SAMPLES};"
            " use fewer per pixel"
        )
    return load_into_mitsuba(convert(scene, flavour, samples), variant)().image


def load_into_mitsuba(scene_xml: str, variant: str | None = None) -> Callable[[], Rendering]:
    """Load the text of a converted scene, and return a function that renders it.

    The function may be called repeatedly.  Raise ImportError if the variant does not work on this
    machine.
    """
    chosen_variant = use_variant(variant).variant
    import converters.plugins  # noqa: F401 (registers this project's plugins)

    # Suppress Mitsuba's warning that Python plugins are slow in scalar variants.
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_string(scene_xml)

    def render_scene() -> Rendering:
        start_time = perf_counter()
        image = np.array(mi.render(scene), dtype=np.float64)
        seconds = perf_counter() - start_time
        return Rendering(image=image, variant=chosen_variant, seconds=seconds)

    return render_scene


def write_exr(path: str | os.PathLike[str], image: Shaped[Floats, "height width 3"]) -> None:
    """Write a picture of linear radiance to an EXR file, in float32.

    An existing EXR file is replaced.  Raise OSError if the file has another format.
    """
    ensure_variant()
    stream = mi.MemoryStream()
    mi.Bitmap(image.astype(np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    with open_atomically(path, _EXR_MAGIC) as file:
        file.write(stream.raw_buffer())
