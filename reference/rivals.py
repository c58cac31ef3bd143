"""Mitsuba 3, as the tracer is measured against it, and both as commands."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from converters.flavours import exact, stock
from converters.variant import ensure, mi
from tracer import Scene

__all__ = [
    "mitsuba_command",
    "mitsuba_exact",
    "mitsuba_stock",
    "mitsuba_text",
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
