"""Mitsuba 3, as the tracer is measured against it, and both as commands."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import converters.plugins  # noqa: F401 (registers the plugins that scenes name)
from converters.flavours import exact, stock
from converters.variant import mi
from tracer import Scene

__all__ = ["mitsuba_command", "mitsuba_exact", "mitsuba_stock", "tracer_command"]

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


def tracer_command(source: Path, target: Path) -> list[str]:
    """The tracer's own command, from a scene file to a PNG."""
    return [sys.executable, "-m", "tracer", "--quiet", "-o", str(target), str(source)]


def mitsuba_command(source: Path, target: Path, variant: str | None = None) -> list[str]:
    """Mitsuba from a scene file to a PNG, in a variant: the current one if absent."""
    return [sys.executable, "-c", _MITSUBA, str(variant or mi.variant()), str(source), str(target)]


def mitsuba_exact(scene: Scene, samplers: Sequence[str] = ()) -> Any:
    """The same picture from Mitsuba, by this project's plugins, in the current variant.

    There is a sensor for each of these samplers of Mitsuba's; without any, a single sample is the
    pixel's centre.  Mitsuba's kernels choose among all objects alive: keep one scene at a time.
    """
    text = exact(scene)
    (sensor,) = re.findall("<sensor .*?</sensor>", text, re.DOTALL)
    sampled = [
        re.sub("<sampler .*?</sampler>", f'<sampler type="{sampler}"/>', sensor, flags=re.DOTALL)
        for sampler in samplers
    ]
    return mi.load_string(text.replace(sensor, "\n".join(sampled or [sensor])))


def mitsuba_stock(scene: Scene) -> Any:
    """A similar picture from Mitsuba's own plugins, at one sample a pixel."""
    return mi.load_string(stock(scene, 1))
