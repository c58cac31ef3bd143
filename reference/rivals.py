"""The renderers that the tracer is measured against: Mitsuba 3 and POV-Ray."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from converters.flavours import exact, stock
from converters.variant import ensure, mi
from reference.povray import to_pov
from tracer.arrays import Floats
from tracer.scene.model import Scene

__all__ = [
    "mitsuba_command",
    "mitsuba_exact",
    "mitsuba_stock",
    "mitsuba_text",
    "povray_command",
    "povray_installed",
    "povray_linear",
    "povray_picture",
    "povray_trace",
    "tracer_command",
]

# What anyone's script to render one scene with Mitsuba amounts to.
_MITSUBA = """
import sys
import mitsuba as mi
variant, source, target = sys.argv[1:]
mi.set_variant(variant)
if "unattenuated_point" in open(source).read():
    import converters.plugins
mi.util.write_bitmap(target, mi.render(mi.load_file(source)), write_async=False)
"""

# Brightest radiance that survives in POV-Ray's 16-bit PNG.
_POVRAY_WHITE = 4.0


def tracer_command(source: Path, target: Path, samples: int = 1) -> list[str]:
    """The tracer's own command, from a scene file to a PNG."""
    options = ("--quiet", "--samples", str(samples), "-o", str(target))
    return [sys.executable, "-m", "tracer", *options, str(source)]


def mitsuba_command(source: Path, target: Path, variant: str | None = None) -> list[str]:
    """Mitsuba from a scene file to a PNG, in a variant: the current one if absent."""
    return [sys.executable, "-c", _MITSUBA, str(variant or mi.variant()), str(source), str(target)]


def mitsuba_text(scene: Scene, samples: int = 1, samplers: Sequence[str] = ()) -> str:
    """The exact flavour's XML, with a sensor for each of these samplers of Mitsuba's.

    Without any, samples are stratified, and a single one is the pixel's centre.
    """
    text = exact(scene, samples)
    if not samplers:
        return text
    count = f'<integer name="sample_count" value="{samples}"/>'

    def with_samplers(sensor: re.Match[str]) -> str:
        return "\n".join(
            re.sub(
                "<sampler .*?</sampler>",
                f'<sampler type="{sampler}">{count}</sampler>',
                sensor[0],
                flags=re.DOTALL,
            )
            for sampler in samplers
        )

    return re.sub("<sensor .*?</sensor>", with_samplers, text, flags=re.DOTALL)


def mitsuba_exact(scene: Scene, samplers: Sequence[str] = ()) -> Any:
    """The same picture from Mitsuba, by this project's plugins, in the current variant.

    Mitsuba's kernels choose among all objects alive in the process: keep one scene at a time.
    """
    _plugins()
    return mi.load_string(mitsuba_text(scene, samplers=samplers))


def mitsuba_stock(scene: Scene, samples: int = 1) -> Any:
    """A similar picture from Mitsuba's own plugins, which are compiled."""
    ensure()
    return mi.load_string(stock(scene, samples))


def _plugins() -> None:
    import converters.plugins  # noqa: F401 (registers the plugins that scenes name)


def povray_installed() -> bool:
    """Whether there is a POV-Ray to measure."""
    return shutil.which("povray") is not None


def povray_command(scene: Scene, target: Path, *options: str, exposure: float = 1.0) -> list[str]:
    """POV-Ray, without a window, from a scene description, which this writes, to a PNG."""
    source = target.with_suffix(".pov")
    source.write_text(to_pov(scene, exposure))
    size = (f"+W{scene.width}", f"+H{scene.height}")
    return ["povray", f"+I{source}", f"+O{target}", *size, "-D", *options]


def povray_linear(scene: Scene, target: Path, *options: str) -> list[str]:
    """`povray_command` to a linear PNG of 16 bits, which `povray_picture` reads."""
    linear = ("+FN16", "File_Gamma=1.0")
    return povray_command(scene, target, *linear, *options, exposure=1 / _POVRAY_WHITE)


def povray_picture(target: Path) -> Floats:
    """The linear radiance (h, w, 3) of such a PNG, clipped at `_POVRAY_WHITE`."""
    image = np.array(mi.Bitmap(str(target)), dtype=np.float64)[..., :3]
    return image / 65535 * _POVRAY_WHITE


def povray_trace(command: Sequence[str]) -> float:
    """Run POV-Ray; the seconds that it says it spent on tracing alone.

    It rounds them to milliseconds; 0 counts as half of one.

    Raises
    ------
    RuntimeError
        If POV-Ray fails.
    """
    done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    found = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", done.stderr)
    if done.returncode or not found:
        raise RuntimeError(f"POV-Ray failed:\n{done.stderr}")
    return max(float(found[1]), 0.0005)
