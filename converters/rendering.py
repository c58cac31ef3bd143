"""Render scenes with Mitsuba.

Importing this module needs Mitsuba, unlike converting scenes to files for Mitsuba.
"""

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
    """A picture rendered by Mitsuba, and how long that took."""

    # Linear RGB radiance in the first three channels.  The channels of an "aov" integrator follow
    # if the scene has one.
    image: Shaped[Floats, "height width channels"]
    variant: str  # Mitsuba's variant that rendered the picture
    seconds: float  # for rendering, not for loading the scene


def render_with_mitsuba(
    scene: Scene, samples: int | None = None, variant: str | None = None, flavour: str = "exact"
) -> Shaped[Floats, "height width 3"]:
    """Render a scene with Mitsuba, and return the linear RGB radiance of the picture.

    Parameters
    ----------
    samples
        Number of samples per pixel; by default, `DEFAULT_SAMPLES` of the flavour.
    variant
        Name of Mitsuba's variant; by default, the fastest that works on this machine.
    flavour
        "exact" to reproduce the tracer's picture, or "stock" to approximate it with Mitsuba's
        built-in plugins.  In the stock flavour, pixels are square, so the picture may have another
        height than the scene says.

    Raises
    ------
    ImportError
        If the variant does not work on this machine.
    ValueError
        If the picture needs 2^32 samples or more, or the scene cannot be converted.
    """
    # Mitsuba may round the number of samples per pixel up, at most to the next square number.
    samples_per_side = isqrt((samples or DEFAULT_SAMPLES[flavour]) - 1) + 1
    total_sample_count = scene.width * scene.height * samples_per_side**2
    if total_sample_count > _MAX_SAMPLES:
        raise ValueError(
            f"{total_sample_count} samples are too many: Mitsuba allows at most {_MAX_SAMPLES};"
            " use fewer per pixel"
        )
    return load_into_mitsuba(convert(scene, flavour, samples), variant)().image


def load_into_mitsuba(scene_xml: str, variant: str | None = None) -> Callable[[], Rendering]:
    """Load the text of a Mitsuba scene file, and return a function that renders the scene.

    The function takes no arguments, and may be called repeatedly.  `variant` is the name of
    Mitsuba's variant; None stands for the fastest that works on this machine.  Raise ImportError if
    the variant does not work on this machine, and RuntimeError if Mitsuba cannot load the scene.
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
    """Write a picture of linear RGB radiance to an EXR file, in float32.

    An EXR file that exists at the path is replaced.  Raise OSError if the file cannot be written,
    or a file of another kind exists there.
    """
    ensure_variant()
    stream = mi.MemoryStream()
    mi.Bitmap(image.astype(np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    with open_atomically(path, _EXR_MAGIC) as file:
        file.write(stream.raw_buffer())
